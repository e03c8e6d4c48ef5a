//! `mapshift demo`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use jiff::Timestamp;

use super::fleet::Fleet;
use super::plan::{Plan, PlanArgs, WorldKind};
use super::progress::say;
use super::serve::StopSignal;
use crate::app::{self, RunningApp};
use crate::client::Gateway;
use crate::config::{LogFormat, ServiceArgs, temporary_data_dir};
use crate::ids::RouteId;
use crate::sim::Changes;

const ROUTE: &str = "demo-hall";
const SEED: u64 = 4;
/// Pause between batches at which a person can follow …
const PACE: Duration = Duration::from_millis(600);
/// … unless the whole run would take longer than a person waits.
const DRIVE_MAX: Duration = Duration::from_secs(45);
/// Fewest laps with an object that is there in the second lap only …
const LAPS_WITH_OBSTACLE: u8 = 4;
const OBSTACLE_LAP: usize = 1;
/// … of so large a share of the mean area of what else stands there;
const OBSTACLE_AREA_SHARE: f64 = 0.3;
/// fewest laps with a vehicle whose lidar is knocked aside before the fourth.
const LAPS_WITH_FAULT: u8 = 5;
/// How far laps stray from the route, metres.
const PATH_NOISE_M: f64 = 0.3;

/// Arguments of `mapshift demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Address on which the service listens; port 0 takes a free one.
    #[arg(long, default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Data directory; without it a temporary one, which is removed at the end.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Laps of each vehicle.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=50))]
    laps: u8,
    /// Drive as fast as the service maps, and end after the laps: for scripts.
    #[arg(long)]
    exit: bool,
}

/// Runs the command.
///
/// # Errors
/// If the service could not be started or did not take the laps.
pub fn run(args: Args) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("the runtime could not be started")?
        .block_on(demo(&args))
}

async fn demo(args: &Args) -> anyhow::Result<()> {
    let data = DataDirectory::open(args.data.as_deref())?;
    let mut stop = StopSignal::listen()?;
    let service = start_service(args.listen, &data.path).await?;
    let url = format!("http://{}", service.local_addr());
    let route = RouteId::new(ROUTE)?;
    say(&welcome(&url, &data, args.laps));
    let driven = tokio::select! {
        driven = drive_laps(args, &url, &route) => driven.map(|()| true),
        () = stop.received() => Ok(false),
    };
    if matches!(driven, Ok(true)) && !args.exit {
        say(&format!(
            "Decide about the alerts at {}; ctrl-c ends the service.",
            page(&url)
        ));
        stop.received().await;
    }
    service.shutdown().await?;
    driven.map(|_| ())
}

/// Room for the one map of the demonstration.
const MAP_MEMORY_MB: usize = 256;

async fn start_service(listen: SocketAddr, data: &Path) -> anyhow::Result<RunningApp> {
    let settings = ServiceArgs {
        accept_lost_log: false,
        listen,
        data: data.to_owned(),
        map_memory_mb: MAP_MEMORY_MB,
        keep_bodies_days: None,
        trajectory_retention_days: None,
        name_retention_days: None,
        address_share: 100,
        log_format: LogFormat::Text,
        log: String::new(),
        insecure_open_to_network: false,
        public_url: None,
        trusted_proxies: Vec::new(),
        proxy_roles: Vec::new(),
        // Webhooks are tried out with a receiver on the same machine.
        webhooks_to_private_networks: true,
    };
    app::start(settings.app_config())
        .await
        .with_context(|| format!("if {listen} is taken, choose another with --listen 127.0.0.1:0"))
}

async fn drive_laps(args: &Args, url: &str, route: &RouteId) -> anyhow::Result<()> {
    let plan = plan_of(args.laps)?;
    let fleet = Fleet::new(&plan, Timestamp::now())?;
    let gateway = Gateway::new(url, None, say)?;
    gateway
        .ensure_route(route, Some("Demonstration hall"))
        .await?;
    let pace = if args.exit {
        Duration::ZERO
    } else {
        PACE.min(DRIVE_MAX / fleet.batch_count().max(1) as u32)
    };
    fleet.drive(&gateway, route, pace).await?;
    fleet.report(&gateway, route).await
}

/// A hall that changes when half of the laps are driven.
fn plan_of(laps: u8) -> anyhow::Result<Plan> {
    let arguments = PlanArgs {
        world: WorldKind::Hall,
        laps,
        vehicles: 2,
        changes: 4,
        change_lap: None,
        walkers: 1,
        path_noise: PATH_NOISE_M,
        seed: SEED,
        faulty: laps >= LAPS_WITH_FAULT,
    };
    let mut plan = arguments.plan()?;
    if laps >= LAPS_WITH_OBSTACLE {
        let scene = &mut plan.scene;
        let mut changes = Changes::new(scene, OBSTACLE_LAP, PATH_NOISE_M, SEED);
        for object in changes.add(1, OBSTACLE_AREA_SHARE) {
            scene.objects[object].until_lap = Some(OBSTACLE_LAP + 1);
        }
    }
    Ok(plan)
}

/// Where the console shows the route.
fn page(url: &str) -> String {
    format!("{url}/#/routes/{ROUTE}")
}

fn welcome(url: &str, data: &DataDirectory, laps: u8) -> String {
    let fate = if data.temporary {
        " (removed at the end)"
    } else {
        ""
    };
    let mut next = vec!["two vehicles map a hall; the alerts appear on the page"];
    if laps >= LAPS_WITH_OBSTACLE {
        next.push("something stands in the hall for one lap: its alert resolves by itself");
    }
    if laps > 1 {
        next.push("objects come, go and move: their alerts wait for a decision");
    }
    if laps >= LAPS_WITH_FAULT {
        next.push("a lidar is knocked aside: its vehicle is named");
    }
    let mut lines = vec![
        format!("open   {}", page(url)),
        format!("data   {}{fate}", data.path.display()),
        String::new(),
    ];
    let heads = std::iter::once("next   ").chain(std::iter::repeat("       "));
    lines.extend(heads.zip(next).map(|(head, text)| format!("{head}{text}")));
    in_a_box(&lines)
}

fn in_a_box(lines: &[String]) -> String {
    let width = lines.iter().map(|l| l.chars().count()).max().unwrap_or(0);
    let bar = "─".repeat(width + 2);
    let inside: String = lines
        .iter()
        .map(|line| format!("│ {line:<width$} │\n"))
        .collect();
    format!("┌{bar}┐\n{inside}└{bar}┘")
}

/// Where the service keeps its data; removed when dropped, if it is temporary.
struct DataDirectory {
    path: PathBuf,
    temporary: bool,
}

impl DataDirectory {
    fn open(chosen: Option<&Path>) -> anyhow::Result<Self> {
        let temporary = chosen.is_none();
        let path = chosen.map_or_else(temporary_data_dir, Path::to_owned);
        std::fs::create_dir_all(&path)
            .with_context(|| format!("the directory {} could not be made", path.display()))?;
        Ok(Self { path, temporary })
    }
}

impl Drop for DataDirectory {
    fn drop(&mut self) {
        if self.temporary && std::fs::remove_dir_all(&self.path).is_err() {
            say(&format!("{} could not be removed", self.path.display()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_straight() {
        let text = in_a_box(&["äöü".into(), "longer".into()]);
        let lengths: Vec<_> = text.lines().map(|l| l.chars().count()).collect();
        assert_eq!(lengths, [10, 10, 10, 10]);
    }

    /// Whatever the number of laps, the box says what happens in them and nothing else.
    #[test]
    fn what_is_announced_happens() {
        let data = tempfile::tempdir().unwrap();
        let data = DataDirectory::open(Some(data.path())).unwrap();
        for (laps, announced) in [(1, 1), (2, 2), (3, 2), (4, 3), (5, 4), (9, 4)] {
            let plan = plan_of(laps).unwrap();
            let changes = plan.scene.objects.iter().filter(|o| o.from_lap > 0);
            let (brief, lasting): (Vec<_>, Vec<_>) = changes.partition(|o| o.until_lap.is_some());
            let happens = [
                true,
                !brief.is_empty(),
                !lasting.is_empty(),
                plan.knocked_lap.is_some(),
            ];
            assert_eq!(happens.iter().filter(|&&h| h).count(), announced, "{laps}");
            let text = welcome("http://127.0.0.1:8080", &data, laps);
            assert_eq!(text.lines().count(), 5 + announced, "{text}");
            let first = text.lines().nth(1).unwrap();
            assert!(first.contains("open   http://127.0.0.1:8080/#/routes/demo-hall "));
        }
    }

    #[test]
    fn only_temporary_data_is_removed() {
        let temporary = DataDirectory::open(None).unwrap();
        let path = temporary.path.clone();
        assert!(path.is_dir());
        drop(temporary);
        assert!(!path.exists());

        let kept = tempfile::tempdir().unwrap();
        let chosen = kept.path().join("data");
        drop(DataDirectory::open(Some(&chosen)).unwrap());
        assert!(chosen.is_dir());
    }
}
