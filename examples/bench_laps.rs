//! What a lap costs after many laps.
//!
//! `cargo run --release --example bench_laps -- [LAPS [DIRECTORY [SPACING_M [STRETCHES]]]]` drives one route through a
//! simulated hall, 500 laps if no number is given, by 20 vehicles of four builds in turn, each lap
//! a trip of its own. Every lap goes through the store and the workers of the service. It prints a
//! line every ten laps, writes `laps.csv` and `laps.svg` into the directory (`target/laps` if none
//! is given), and ends with an error if a change that is made before the last lap and seen in it
//! is not found, or if anything else was. The last lap is the first vehicle's, which looks all
//! round.
//!
//! Scans are taken every SPACING_M metres, 0.5 if no number is given; with 2 m a lap costs an eighth, and
//! ten thousand of them take half an hour.
//!
//! This many of the newest STRETCHES stay in the map as the service lets stay if no number is given.
//!
//! A lap's time is the processor time of the whole process from the upload to the commit of its
//! result, all threads together; making the lap up is not counted.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, ensure};
use jiff::{SignedDuration, Timestamp};
use mapshift::change::AlertStatus;
use mapshift::geometry::{Pose2, distance_to_polygon};
use mapshift::ids::{BatchId, RouteId, TripId, VehicleId};
use mapshift::model::Actor;
use mapshift::pipeline::{self, PipelineOptions};
use mapshift::render::{Curve, Plot, to_svg};
use mapshift::sim::{ChangeEvent, Changes, Hall, Scene, SimScan, Vehicle};
use mapshift::store::{
    AlertFilter, AlertRecord, BatchContent, NewBatch, RouteUpdate, Store, StoreOptions,
};
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

const LAPS: usize = 500;
const VEHICLES: usize = 20;
const PATH_NOISE_M: f64 = 0.5;
const SCAN_SPACING_M: f64 = 0.5;
const SEED: u64 = 4_711;
/// Between the starts of two laps.
const LAP_EVERY: SignedDuration = SignedDuration::from_mins(5);
/// No more laps than about this many are drawn.
const DRAWN_LAPS_MAX: usize = 1_000;
/// Objects put down before the last lap.
const CHANGES: usize = 3;
/// How near to the changed object an alert's region must be, metres.
const FOUND_WITHIN_M: f64 = 0.5;

/// What one lap cost, and what there was after it.
struct Lap {
    cpu_ms: f64,
    active_nodes: i64,
    rss_mb: f64,
    database_mb: f64,
}

/// A route in a hall, and the service that keeps its map.
struct Bench {
    scene: Scene,
    fleet: Vec<Vehicle>,
    laps: usize,
    store: Store,
    route: RouteId,
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let laps = args.next().map(|text| text.parse()).transpose()?;
    let laps = laps.unwrap_or(LAPS);
    let directory = args.next().map_or("target/laps".into(), PathBuf::from);
    std::fs::create_dir_all(&directory)?;
    let mut options = PipelineOptions::default();
    let scan_spacing_m = args.next().map(|text| text.parse()).transpose()?;
    let scan_spacing_m = scan_spacing_m.unwrap_or(SCAN_SPACING_M);
    if let Some(stretches) = args.next() {
        options.active_segments = stretches.parse()?;
    }
    let data = tempfile::tempdir()?;
    let stopping = CancellationToken::new();
    let bench = Bench::new(laps, scan_spacing_m, data.path().to_owned()).await?;
    let pipeline = pipeline::start(&bench.store, options, &stopping)?;

    let mut driven = Vec::with_capacity(laps);
    for lap in 0..laps {
        driven.push(bench.drive(lap).await?);
        if lap % 10 == 9 {
            say(&line(lap, &driven))?;
        }
    }
    stopping.cancel();
    for task in pipeline.tasks {
        task.await?;
    }
    std::fs::write(directory.join("laps.csv"), csv(&driven))?;
    std::fs::write(directory.join("laps.svg"), to_svg(&plots(&driven)))?;
    let verdict = bench.judge().await;
    bench.store.close().await?;
    report_ratio(&driven)?;
    verdict
}

impl Bench {
    async fn new(laps: usize, scan_spacing_m: f64, data_dir: PathBuf) -> anyhow::Result<Self> {
        let mut scene = Scene::of_hall(&Hall::generate(SEED)?, SEED);
        Changes::new(&mut scene, laps - 1, PATH_NOISE_M, SEED).add(CHANGES, 0.5);
        let fleet = (0..VEHICLES).map(|k| Vehicle {
            scan_spacing_m,
            ..Vehicle::of_fleet(k, PATH_NOISE_M)
        });
        let store = Store::open(StoreOptions { data_dir }).await?;
        let route = RouteId::new("laps")?;
        let update = RouteUpdate::default();
        let made = store.put_route(&route, update, &Actor::System, Timestamp::now());
        made.await?;
        Ok(Self {
            scene,
            fleet: fleet.collect(),
            laps,
            store,
            route,
        })
    }

    /// Drives a lap, uploads it, and waits until it is in the map.
    async fn drive(&self, lap: usize) -> anyhow::Result<Lap> {
        let scans = self.scans(lap);
        let batch = self.upload(lap, &scans)?;
        let before_ms = cpu_ms()?;
        self.store.journal_batch(batch).await?;
        while self.pending().await? > 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let cpu_ms = cpu_ms()? - before_ms;
        Ok(Lap {
            cpu_ms,
            active_nodes: self.store.active_nodes(&self.route).await?,
            rss_mb: rss_mb()?,
            database_mb: self.store.file_bytes() as f64 / 1e6,
        })
    }

    /// Whose lap it is.
    fn vehicle(&self, lap: usize) -> usize {
        if lap + 1 == self.laps {
            return 0;
        }
        lap % VEHICLES
    }

    fn scans(&self, lap: usize) -> Vec<SimScan> {
        let vehicle = self.vehicle(lap);
        let seed = SEED + vehicle as u64;
        let vehicle = &self.fleet[vehicle];
        self.scene.drive(vehicle, lap..lap + 1, seed)
    }

    fn upload(&self, lap: usize, scans: &[SimScan]) -> anyhow::Result<NewBatch> {
        let vehicle = self.vehicle(lap);
        let name = format!("lap-{lap:05}");
        let first = scans.first().context("a lap without scans")?;
        let lidar = &self.fleet[vehicle].lidar.geometry;
        let start = Timestamp::from_second(1_750_000_000)? + LAP_EVERY * i32::try_from(lap)?;
        let scans: Result<Vec<Value>, anyhow::Error> = scans
            .iter()
            .map(|scan| {
                let since = SignedDuration::try_from_secs_f64(scan.time_s)?;
                Ok(json!({
                    "stamp": (start + since).to_string(),
                    "odometry": pose_json(&scan.odom_from_base),
                    "ranges": scan.ranges_m,
                }))
            })
            .collect();
        let scans = scans?;
        let mut pose = pose_json(&first.map_from_base);
        pose["sigma_xy"] = json!(0.1);
        pose["sigma_theta"] = json!(0.05);
        let body = json!({
            "vehicle_id": format!("v{vehicle:02}"),
            "trip_id": name,
            "sequence": 0,
            "lidar": {
                "angle_min": lidar.angle_min_rad,
                "angle_increment": lidar.angle_increment_rad,
                "range_min": lidar.range_min_m,
                "range_max": lidar.range_max_m,
                "range_sigma": lidar.range_sigma_m,
                "mount": pose_json(&lidar.mount),
            },
            "initial_pose": pose,
            "scans": scans,
        });
        Ok(NewBatch {
            route_id: self.route.clone(),
            id: BatchId::new(name.clone())?,
            vehicle_id: VehicleId::new(format!("v{vehicle:02}"))?,
            trip_id: TripId::new(name)?,
            content: BatchContent::Scans {
                sequence: 0,
                scans: i64::try_from(scans.len())?,
            },
            flags: Vec::new(),
            out_of_range: None,
            extensions: None,
            body: serde_json::to_vec(&body)?,
            received_at: start,
        })
    }

    async fn pending(&self) -> anyhow::Result<i64> {
        let route = self.store.route(&self.route).await?;
        Ok(route.context("the route is gone")?.pending_batches)
    }

    /// Whether the changes were found, and nothing else.
    async fn judge(&self) -> anyhow::Result<()> {
        let route = self.store.route(&self.route).await?;
        let counts = route.context("the route is gone")?.counts;
        say(&format!(
            "{} nodes, {} edges, {} loop closures",
            counts.nodes, counts.edges, counts.loop_closures
        ))?;
        let last = [self.scans(self.laps - 2), self.scans(self.laps - 1)];
        let truth = self.scene.visible_changes(last.iter().flatten());
        let filter = AlertFilter::default();
        let alerts = self.store.alert_page(&filter, None, 100).await?;
        let tells = |alert: &AlertRecord, event: &ChangeEvent| {
            let (centre, _) = event.shape.bounding_circle();
            alert.status == AlertStatus::Open
                && alert.evidence.kind == event.kind
                && distance_to_polygon(&centre, &alert.evidence.region) <= FOUND_WITHIN_M
        };
        let found = truth
            .iter()
            .filter(|event| alerts.iter().any(|alert| tells(alert, event)));
        let found = found.count();
        let is_false = |alert: &&AlertRecord| !truth.iter().any(|event| tells(alert, event));
        for alert in alerts.iter().filter(is_false) {
            say(&format!("false: {:?} {:?}", alert.status, alert.evidence))?;
        }
        say(&format!(
            "{found} of {} visible changes found, {} alerts",
            truth.len(),
            alerts.len()
        ))?;
        ensure!(!truth.is_empty(), "no change can be seen in the last lap");
        ensure!(
            found == truth.len(),
            "a change of the last lap was not found"
        );
        ensure!(
            !alerts.iter().any(|a| is_false(&a)),
            "something else was reported"
        );
        Ok(())
    }
}

fn pose_json(pose: &Pose2) -> Value {
    json!({ "x": pose.x, "y": pose.y, "theta": pose.theta })
}

fn line(lap: usize, driven: &[Lap]) -> String {
    let last = &driven[driven.len() - 10..];
    let Lap {
        active_nodes,
        rss_mb,
        database_mb,
        ..
    } = last[9];
    let cpu_ms = median(last);
    format!(
        "lap {:5}: {cpu_ms:7.1} ms, {active_nodes:5} active nodes, {rss_mb:6.1} MB resident, \
         {database_mb:7.1} MB on disk",
        lap + 1
    )
}

fn report_ratio(driven: &[Lap]) -> anyhow::Result<()> {
    if driven.len() < 220 {
        return say("too few laps for a ratio: the last hundred to laps 20 to 120");
    }
    let (early, late) = (
        median(&driven[20..120]),
        median(&driven[driven.len() - 100..]),
    );
    say(&format!(
        "median lap: {early:.1} ms in laps 20 to 120, {late:.1} ms in the last hundred: ratio {:.3}",
        late / early
    ))
}

fn median(laps: &[Lap]) -> f64 {
    let mut sorted: Vec<f64> = laps.iter().map(|lap| lap.cpu_ms).collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn csv(driven: &[Lap]) -> String {
    let mut text = "lap,cpu_ms,active_nodes,rss_mb,database_mb\n".to_owned();
    for (k, lap) in driven.iter().enumerate() {
        let _ = writeln!(
            text,
            "{},{:.1},{},{:.1},{:.1}",
            k + 1,
            lap.cpu_ms,
            lap.active_nodes,
            lap.rss_mb,
            lap.database_mb
        );
    }
    text
}

fn plots(driven: &[Lap]) -> Vec<Plot> {
    let plot = |title: &str, y_label: &str, joined, value: fn(&Lap) -> f64| {
        let points = driven.iter().enumerate();
        let points = points.step_by(driven.len().div_ceil(DRAWN_LAPS_MAX).max(1));
        Plot {
            title: title.to_owned(),
            x_label: "laps driven".to_owned(),
            y_label: y_label.to_owned(),
            curves: vec![Curve {
                label: String::new(),
                colour: "#1f5fa8",
                joined,
                points: points
                    .map(|(k, lap)| ((k + 1) as f64, value(lap)))
                    .collect(),
            }],
            guides: Vec::new(),
        }
    };
    vec![
        plot("Processor time of a lap", "ms", false, |lap| lap.cpu_ms),
        plot("Nodes in the active graph", "nodes", true, |lap| {
            lap.active_nodes as f64
        }),
        plot("Resident memory", "MB", true, |lap| lap.rss_mb),
        plot("Database", "MB", true, |lap| lap.database_mb),
    ]
}

/// Processor time of the process so far: fields 14 and 15 of its `stat`, hundredths of a second.
fn cpu_ms() -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let (_, after_name) = stat
        .rsplit_once(')')
        .context("no name in /proc/self/stat")?;
    let ticks = after_name.split_whitespace().skip(11).take(2);
    let ticks: Result<Vec<f64>, _> = ticks.map(str::parse::<f64>).collect();
    Ok(10.0 * ticks?.iter().sum::<f64>())
}

/// Resident memory of the process: pages of 4 KiB.
fn rss_mb() -> anyhow::Result<f64> {
    let statm = std::fs::read_to_string("/proc/self/statm")?;
    let pages = statm
        .split_whitespace()
        .nth(1)
        .context("no second field in statm")?;
    Ok(pages.parse::<f64>()? * 4096.0 / 1e6)
}

fn say(line: &str) -> anyhow::Result<()> {
    Ok(writeln!(std::io::stdout(), "{line}")?)
}
