//! `mapshift upload`.

mod graph;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use super::graph_file::{is_graph, read_graph};
use super::progress::{Progress, say};
use super::recording;
use crate::client::{Gateway, GatewayError, Outcome};
use crate::client::{ScanToSend, Trip};
use crate::geometry::Pose2;
use crate::graph::PoseGraph;
use crate::ids::{BatchId, RouteId, TripId, VehicleId};
use crate::ingest::CarmenLog;

const POLL_INTERVAL: Duration = Duration::from_millis(300);

/// Arguments of `mapshift upload`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings (CARMEN logs) or pose graphs (planar g2o: edges alone); also gzipped.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The route that was driven; made if it is not there.
    #[arg(long)]
    route: RouteId,
    /// The vehicle that drove.
    #[arg(long)]
    vehicle: VehicleId,
    /// The name of the drive; else the file's name.
    #[arg(long)]
    trip: Option<TripId>,
    /// The service.
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    url: String,
    /// Scans in a batch.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=1_000))]
    batch_scans: u16,
    /// Nodes of a pose graph in a batch.
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u16).range(1..=5_000))]
    batch_nodes: u16,
    /// The beams are so many times as far apart as the file states (some logs state it wrongly).
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = parse_beam_spacing)]
    beam_spacing: f64,
    /// Where the vehicle started in the route's map, roughly: metres, metres, radians.
    #[arg(long, value_name = "X,Y,THETA", value_parser = parse_pose, allow_hyphen_values = true)]
    initial_pose: Option<Pose2>,
    /// Wait until everything is in the map, and say what became of it.
    #[arg(long)]
    wait: bool,
}

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

fn parse_pose(text: &str) -> Result<Pose2, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, theta]) if [x, y, theta].iter().all(|v| v.is_finite()) => {
            Ok(Pose2::new(*x, *y, *theta))
        }
        _ => Err("give three numbers, like 3.5,3.4,0.02 (metres, metres, radians)".into()),
    }
}

pub(super) fn parse_beam_spacing(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor) if (0.5..=2.0).contains(&factor) => Ok(factor),
        _ => Err("give a factor from 0.5 to 2, like 0.925".into()),
    }
}

/// What an upload came to.
#[derive(Debug)]
struct Tally {
    started: Instant,
    scans_stored: usize,
    nodes_stored: usize,
    batches: Vec<BatchId>,
    stored: usize,
    replayed: usize,
    failures: Vec<String>,
}

async fn upload_all(args: &Args) -> anyhow::Result<()> {
    let gateway = Gateway::new(&args.url, say)?;
    if gateway.ensure_route(&args.route, None).await? {
        say(&format!("route {} was made", args.route));
    }
    let mut tally = Tally {
        started: Instant::now(),
        scans_stored: 0,
        nodes_stored: 0,
        batches: Vec::new(),
        stored: 0,
        replayed: 0,
        failures: Vec::new(),
    };
    for path in &args.files {
        let (args, tally) = (&args, &mut tally);
        match read(path) {
            Ok(Content::Log(log)) => {
                let log = log.with_beam_spacing(args.beam_spacing);
                upload_log(&gateway, args, path, &log, tally).await?;
            }
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
    if args.wait {
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
    Log(CarmenLog),
    Graph(Box<PoseGraph>),
}

fn read(path: &Path) -> anyhow::Result<Content> {
    let is_graph = is_graph(path).with_context(|| path.display().to_string())?;
    Ok(match is_graph {
        true => Content::Graph(Box::new(read_graph(path)?.graph)),
        false => Content::Log(recording::read(path)?),
    })
}

impl Tally {
    /// What was stored, for people.
    fn content(&self) -> String {
        let nodes = format!("{} nodes", self.nodes_stored);
        let scans = format!("{} scans", self.scans_stored);
        match (self.scans_stored, self.nodes_stored) {
            (_, 0) => scans,
            (0, _) => nodes,
            _ => format!("{scans}, {nodes}"),
        }
    }
}

fn trip_of(args: &Args, path: &Path) -> anyhow::Result<TripId> {
    match &args.trip {
        Some(trip) => Ok(trip.clone()),
        None => recording::trip_of(path),
    }
}

async fn upload_log(
    gateway: &Gateway,
    args: &Args,
    path: &Path,
    log: &CarmenLog,
    tally: &mut Tally,
) -> anyhow::Result<()> {
    for line in recording::describe(path, log) {
        say(&line);
    }
    let trip_id = trip_of(args, path)?;
    let trip = Trip {
        vehicle_id: args.vehicle.clone(),
        trip_id,
        lidar: log.lidar.clone(),
        initial_pose: args.initial_pose,
    };
    let progress = Progress::new(log.scans.len() as u64, "scans");
    let gateway = gateway.notifying(progress.speaker());
    for (sequence, scans) in log.scans.chunks(args.batch_scans.into()).enumerate() {
        let to_send = scans.iter().map(|scan| ScanToSend {
            stamp: scan.stamp,
            odom_from_base: scan.odom_from_base,
            ranges_m: &scan.ranges_m,
        });
        let batch = trip.encode(sequence, to_send)?;
        match gateway.put_batch(&args.route, &batch).await {
            Ok(Outcome::Stored) => {
                tally.stored += 1;
                tally.scans_stored += scans.len();
            }
            Ok(Outcome::Replayed) => tally.replayed += 1,
            Err(error @ GatewayError::Refused { .. }) => {
                let left = log.scans.len() - sequence * usize::from(args.batch_scans);
                tally.failures.push(format!(
                    "{}: {error}{}; its last {left} scans are not stored",
                    path.display(),
                    advice(&error),
                ));
                break;
            }
            Err(error) => return Err(error.into()),
        }
        tally.batches.push(batch.id);
        progress.advance(scans.len() as u64);
    }
    progress.finish();
    Ok(())
}

fn advice(error: &GatewayError) -> &'static str {
    match error {
        GatewayError::Refused { problem, .. } if problem.status == 409 => {
            " (another drive has this name, or it was sent with other options: --trip chooses \
             another name)"
        }
        _ => "",
    }
}

async fn wait_until_settled(gateway: &Gateway, args: &Args, tally: &Tally) -> anyhow::Result<()> {
    let mut pending_before = None;
    let route = loop {
        let route = gateway.route(&args.route).await?;
        if route.pending_batches == 0 {
            break route;
        }
        if pending_before != Some(route.pending_batches) {
            say(&format!("  {} batches still wait", route.pending_batches));
            pending_before = Some(route.pending_batches);
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
    use crate::client::pretend::{Faults, Pretend};

    #[test]
    fn poses_are_three_numbers() {
        assert_eq!(parse_pose("1, -2,0.5"), Ok(Pose2::new(1.0, -2.0, 0.5)));
        for bad in ["", "1,2", "1,2,3,4", "1,2,nan", "a,b,c"] {
            assert!(parse_pose(bad).is_err(), "{bad}");
        }
    }

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
            batch_scans,
            batch_nodes: 2,
            beam_spacing: 1.0,
            initial_pose: Some(Pose2::new(1.0, 2.0, 0.5)),
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
}
