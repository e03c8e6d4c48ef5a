//! `mapshift simulate`.

use std::time::Duration;

use anyhow::Context;
use jiff::Timestamp;

use super::fleet::Fleet;
use super::key_arg::KeyArg;
use super::plan::{FAULT_DEG, Plan, PlanArgs};
use super::progress::say;
use crate::client::Gateway;
use crate::ids::RouteId;

/// Arguments of `mapshift simulate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The service.
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    url: String,
    #[command(flatten)]
    key: KeyArg,
    /// The route that is driven; created if it does not exist.
    #[arg(long, default_value = "simulated")]
    route: RouteId,
    #[command(flatten)]
    plan: PlanArgs,
}

/// Runs the command.
///
/// # Errors
/// If the simulation is impossible, or the service could not be reached or refused a batch.
pub fn run(args: Args) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("the runtime could not be started")?
        .block_on(simulate(&args))
}

async fn simulate(args: &Args) -> anyhow::Result<()> {
    let plan = args.plan.plan()?;
    say(&describe(&plan));
    let gateway = Gateway::new(&args.url, args.key.key.as_deref(), say)?;
    gateway.ensure_route(&args.route, None).await?;
    let fleet = Fleet::new(&plan, Timestamp::now())?;
    fleet.drive(&gateway, &args.route, Duration::ZERO).await?;
    fleet.report(&gateway, &args.route).await
}

/// A description of the simulation for people.
fn describe(plan: &Plan) -> String {
    let scene = &plan.scene;
    let mut text = format!(
        "{} objects and walls, {} of them standing free, a route of {:.0} m; vehicles: {}, laps of each: {}",
        scene.world(0).objects.len(),
        scene
            .objects
            .iter()
            .filter(|o| o.is_there(0) && o.stands_free())
            .count(),
        scene.route.length_m(),
        plan.vehicles.len(),
        plan.laps,
    );
    let changed = scene
        .objects
        .iter()
        .flat_map(|o| [Some(o.from_lap), o.until_lap]);
    if let Some(lap) = changed.flatten().filter(|&lap| lap > 0).min() {
        text.push_str(&format!("; the world changes before lap {}", lap + 1));
    }
    if let Some(lap) = plan.knocked_lap {
        text.push_str(&format!(
            "; the lidar of the last vehicle is knocked aside by {FAULT_DEG}° before lap {}",
            lap + 1
        ));
    }
    text
}
