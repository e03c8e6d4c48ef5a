//! `mapshift upload`.

mod args;
mod drive;
mod graph;
mod tally;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};

use super::graph_file::{is_graph, read_graph};
use super::progress::say;
use crate::client::{Gateway, GatewayError, RouteReport};
use crate::graph::PoseGraph;
pub use args::Args;
pub(super) use args::parse_beam_spacing;
use drive::PreparedTrip;
use tally::Tally;

const POLL_INTERVAL: Duration = Duration::from_millis(300);

/// Runs the command.
///
/// # Errors
/// If a file could not be read, the service could not be reached, or something was refused.
pub fn run(args: Args) -> anyhow::Result<()> {
    if args.trip.is_some() && args.files.len() > 1 {
        bail!(
            "--trip names one drive, but there are {} files",
            args.files.len()
        );
    }
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("the runtime could not be started")?
        .block_on(upload_all(&args))
}

async fn upload_all(args: &Args) -> anyhow::Result<()> {
    let gateway = Gateway::new(&args.url, args.key.key.as_deref(), say)?;
    let mut tally = Tally::begin();
    for path in &args.files {
        let (args, tally) = (&args, &mut tally);
        match read(args, path) {
            Ok(Content::Trip(trip)) => drive::upload(&gateway, args, path, *trip, tally).await?,
            Ok(Content::Graph(graph)) => {
                graph::upload(&gateway, args, path, &graph, tally).await?;
            }
            Err(error) => tally.failures.push(format!("{error:#}")),
        }
    }
    let seconds = tally.started.elapsed().as_secs_f64();
    say(&format!(
        "stored {} batches ({}) in {seconds:.1} s; {} were there already",
        tally.stored,
        tally.content(),
        tally.replayed
    ));
    for failure in &tally.failures {
        say(&format!("not taken: {failure}"));
    }
    if args.wait && !tally.batches.is_empty() {
        wait_until_settled(&gateway, args, &tally).await?;
    }
    if tally.failures.is_empty() {
        Ok(())
    } else {
        bail!(
            "{} of {} files were not taken whole",
            tally.failures.len(),
            args.files.len()
        )
    }
}

/// What a file holds.
enum Content {
    Trip(Box<PreparedTrip>),
    Graph(Box<PoseGraph>),
}

fn read(args: &Args, path: &Path) -> anyhow::Result<Content> {
    let is_graph = is_graph(path).with_context(|| path.display().to_string())?;
    Ok(match is_graph {
        true => Content::Graph(Box::new(read_graph(path)?.graph)),
        false => Content::Trip(Box::new(PreparedTrip::of(args, path)?)),
    })
}

/// The route's state; `None` if the key may only upload.
async fn readable_route(
    gateway: &Gateway,
    args: &Args,
) -> Result<Option<RouteReport>, GatewayError> {
    match gateway.route(&args.route).await {
        Ok(route) => Ok(Some(route)),
        Err(GatewayError::Refused { problem, .. }) if problem.status == 403 => Ok(None),
        Err(error) => Err(error),
    }
}

/// How many of the uploaded batches are still being processed.
async fn own_pending(gateway: &Gateway, args: &Args, tally: &Tally) -> Result<i64, GatewayError> {
    let mut pending = 0;
    for id in &tally.batches {
        let batch = gateway.batch(&args.route, id).await?;
        pending += i64::from(batch.is_under_way());
    }
    Ok(pending)
}

async fn wait_until_settled(gateway: &Gateway, args: &Args, tally: &Tally) -> anyhow::Result<()> {
    let mut pending_before = None;
    let route = loop {
        let route = readable_route(gateway, args).await?;
        let pending = match &route {
            Some(route) => route.pending_batches,
            None => own_pending(gateway, args, tally).await?,
        };
        if pending == 0 {
            break route;
        }
        if pending_before != Some(pending) {
            say(&format!("  {pending} batches still wait"));
            pending_before = Some(pending);
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    };
    let seconds = tally.started.elapsed().as_secs_f64();
    let mut statuses: BTreeMap<String, usize> = BTreeMap::new();
    let mut reasons: BTreeMap<String, usize> = BTreeMap::new();
    let (mut nodes, mut closures) = (0, 0);
    for id in &tally.batches {
        let batch = gateway.batch(&args.route, id).await?;
        nodes += batch.nodes_added;
        closures += batch.loop_closures;
        if let Some(reason) = batch.reason {
            *reasons
                .entry(format!("{}: {reason}", batch.status))
                .or_default() += 1;
        }
        *statuses.entry(batch.status).or_default() += 1;
    }
    let statuses: Vec<_> = statuses.iter().map(|(s, n)| format!("{n} {s}")).collect();
    say(&format!(
        "settled after {seconds:.1} s ({:.0} {}/s): {}; {nodes} nodes and {closures} loop \
         closures added",
        tally.scans_stored.max(tally.nodes_stored) as f64 / seconds,
        if tally.scans_stored >= tally.nodes_stored {
            "scans"
        } else {
            "nodes"
        },
        statuses.join(", "),
    ));
    for (reason, batches) in reasons {
        say(&format!("  {batches} × {reason}"));
    }
    let Some(route) = route else {
        return Ok(());
    };
    say(&format!(
        "route {} is {}: map version {}, {} nodes, {} edges, {} loop closures\nits map: {}/map.png",
        args.route,
        route.stage,
        route.map_version,
        route.counts.nodes,
        route.counts.edges,
        route.counts.loop_closures,
        gateway.route_url(&args.route),
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::key_arg::KeyArg;
    use crate::client::pretend::{Faults, Pretend};
    use crate::geometry::Pose2;
    use crate::ids::{RouteId, TripId, VehicleId};

    const SCANS: usize = 25;

    fn recording() -> tempfile::NamedTempFile {
        let lines = (1..=SCANS).map(|t| {
            format!(
                "ROBOTLASER1 0 -0.1 0.2 0.1 5 0 0 3 1 2 3 0 {t} 0 0 {t} 0 0 0 0 0 0 0 {t} h {t}\n"
            )
        });
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), lines.collect::<String>()).unwrap();
        file
    }

    fn args(url: &str, file: &Path, batch_scans: u16) -> Args {
        Args {
            files: vec![file.to_owned()],
            route: RouteId::new("line-4").unwrap(),
            vehicle: VehicleId::new("agv-07").unwrap(),
            trip: Some(TripId::new("monday").unwrap()),
            url: url.to_owned(),
            key: KeyArg { key: None },
            batch_scans,
            batch_nodes: 2,
            beam_spacing: 1.0,
            initial_pose: Some(Pose2::new(1.0, 2.0, 0.5)),
            topic: Vec::new(),
            odometry_topic: None,
            mount_x: None,
            mount_y: None,
            mount_theta: None,
            wait: true,
        }
    }

    #[tokio::test]
    async fn a_repeated_upload_is_stored_once() {
        let service = Pretend::start(Faults {
            busy_every: 4,
            ..Faults::default()
        })
        .await;
        let file = recording();
        for _ in 0..2 {
            upload_all(&args(&service.url, file.path(), 10))
                .await
                .unwrap();
        }
        let state = service.state.lock().unwrap();
        assert_eq!(state.routes_made, 1);
        let ids: Vec<_> = state.batches.keys().cloned().collect();
        assert_eq!(ids, ["monday-00000", "monday-00001", "monday-00002"]);
        let scans = |id: &str| state.batches[id]["scans"].as_array().unwrap().len();
        assert_eq!(
            ids.iter().map(|id| scans(id)).collect::<Vec<_>>(),
            [10, 10, 5]
        );
        assert_eq!(state.batches["monday-00000"]["initial_pose"]["theta"], 0.5);
        assert!(state.batches["monday-00001"].get("initial_pose").is_none());
        assert_eq!(state.replays, 3);
    }

    #[tokio::test]
    async fn a_refusal_ends_the_file_and_is_an_error() {
        let service = Pretend::start(Faults::default()).await;
        let file = recording();
        upload_all(&args(&service.url, file.path(), 10))
            .await
            .unwrap();
        let error = upload_all(&args(&service.url, file.path(), 5))
            .await
            .unwrap_err();
        assert!(error.to_string().contains("1 of 1 files"), "{error}");
        assert_eq!(service.state.lock().unwrap().batches.len(), 3);
    }

    #[tokio::test]
    async fn a_graph_is_sent_as_batches_of_edges_once() {
        let service = Pretend::start(Faults {
            busy_every: 3,
            ..Faults::default()
        })
        .await;
        let file = tempfile::NamedTempFile::new().unwrap();
        let text = "# a chain\nVERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n\
                    EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 0 -2 0 0 1 0 0 1 0 1\n";
        std::fs::write(file.path(), text).unwrap();
        for _ in 0..2 {
            upload_all(&args(&service.url, file.path(), 10))
                .await
                .unwrap();
        }
        let state = service.state.lock().unwrap();
        let ids: Vec<_> = state.batches.keys().cloned().collect();
        assert_eq!(ids, ["monday-00000", "monday-00001"]);
        let first = &state.batches["monday-00000"];
        assert_eq!(first["nodes"].as_array().unwrap().len(), 2);
        let last = state.batches["monday-00001"]["edges"].as_array().unwrap();
        let kinds: Vec<_> = last.iter().map(|edge| &edge["kind"]).collect();
        assert_eq!(kinds, ["odometry", "loop_closure"]);
        assert_eq!(state.replays, 2);
    }

    #[tokio::test]
    async fn one_bad_file_does_not_keep_the_others() {
        let service = Pretend::start(Faults::default()).await;
        let (good, bad) = (recording(), tempfile::NamedTempFile::new().unwrap());
        let mut args = args(&service.url, bad.path(), 60);
        args.trip = None;
        args.files.push(good.path().to_owned());
        assert!(upload_all(&args).await.is_err());
        assert_eq!(service.state.lock().unwrap().batches.len(), 1);
    }

    #[tokio::test]
    async fn nothing_to_send_makes_no_route() {
        let service = Pretend::start(Faults::default()).await;
        let bad = tempfile::NamedTempFile::new().unwrap();
        assert!(
            upload_all(&args(&service.url, bad.path(), 60))
                .await
                .is_err()
        );
        assert_eq!(service.state.lock().unwrap().routes_made, 0);
    }
}
