//! What one scan costs on its way, stage by stage, each run alone and warm.

use std::collections::BTreeMap;
use std::io::Write;
use std::time::Instant;

use anyhow::Context;
use jiff::Timestamp;
use mapshift::change::FALSE_ALERTS_PER_LAP;
use mapshift::geometry::Pose2;
use mapshift::ids::{TripId, VehicleId};
use mapshift::ingest::batch_json;
use mapshift::mapping::{Drive, RouteMap, Scope, Sites, Weighting};
use mapshift::matching::{IcpParams, ReferenceCloud, align};
use mapshift::scan::{decode_scan, encode_scan, surface_points};
use mapshift::sim::{Hall, drive};
use sha2::{Digest, Sha256};

use super::fleet;

const LAPS: usize = 4;
const SCANS_PER_BATCH: usize = 20;
/// The least time of this many rounds is reported.
const ROUNDS: usize = 3;
const JOURNAL_LEVEL: i32 = 3;

/// Least time of a stage over the scans of a lap, microseconds a scan.
struct Table {
    scans: usize,
    rows: Vec<(&'static str, f64)>,
}

impl Table {
    fn time<T>(&mut self, name: &'static str, mut work: impl FnMut() -> T) -> T {
        let mut least_s = f64::INFINITY;
        let mut run = || {
            let begin = Instant::now();
            let outcome = work();
            least_s = least_s.min(begin.elapsed().as_secs_f64());
            outcome
        };
        for _ in 1..ROUNDS {
            run();
        }
        let outcome = run();
        self.rows.push((name, least_s * 1e6 / self.scans as f64));
        outcome
    }
}

/// The laps that a map has, and the one that is measured.
struct Laps {
    before: Vec<Drive>,
    vehicles: BTreeMap<TripId, VehicleId>,
    bodies: Vec<Vec<u8>>,
    drives: Vec<Drive>,
}

impl Laps {
    fn simulate(beams: usize) -> anyhow::Result<Self> {
        let hall = Hall::generate(1).context("no hall")?;
        let vehicle = fleet::vehicle(beams);
        let mut laps = Self {
            before: Vec::new(),
            vehicles: BTreeMap::new(),
            bodies: Vec::new(),
            drives: Vec::new(),
        };
        for lap in 0..LAPS {
            let scans = drive(&hall.world, &hall.route, &vehicle, 1, lap as u64);
            let name = format!("trip-{lap}");
            let body = |(k, part)| fleet::body(&vehicle, lap, &name, k, part);
            let parts = scans.chunks(SCANS_PER_BATCH).enumerate();
            laps.bodies = parts.map(body).collect::<Result<_, _>>()?;
            laps.before.append(&mut laps.drives);
            laps.drives = decode(&laps.bodies)?;
            let trip = laps.drives[0].trip.clone();
            laps.vehicles
                .insert(trip, VehicleId::new(format!("agv-{lap}"))?);
        }
        Ok(laps)
    }
}

/// Prints the table for one lap in a map of some laps.
pub fn print(beams: usize) -> anyhow::Result<()> {
    let laps = Laps::simulate(beams)?;
    let mut console = std::io::stdout();
    for (name, us) in measure(&laps)?.rows {
        writeln!(console, "{us:9.1} µs  {name}")?;
    }
    Ok(())
}

fn decode(bodies: &[Vec<u8>]) -> anyhow::Result<Vec<Drive>> {
    let drive = |body: &Vec<u8>| {
        let batch = batch_json::decode(body, Timestamp::now())?;
        Ok(Drive {
            wheels: Default::default(),
            trip: batch.trip_id,
            initial_pose: batch.initial_pose,
            scans: batch.scans,
        })
    };
    bodies.iter().map(drive).collect()
}

fn measure(laps: &Laps) -> anyhow::Result<Table> {
    let Laps { bodies, drives, .. } = laps;
    let scans: Vec<_> = drives.iter().flat_map(|drive| &drive.scans).collect();
    let mut table = Table {
        scans: scans.len(),
        rows: Vec::new(),
    };
    table
        .time("decode and check the JSON (twice a scan)", || {
            decode(bodies)
        })
        .map(drop)?;
    table.time("SHA-256 of the body (three times)", || {
        bodies.iter().map(Sha256::digest).collect::<Vec<_>>()
    });
    let compress = |body: &Vec<u8>| zstd::bulk::compress(body, JOURNAL_LEVEL);
    table
        .time("compress the body for the journal", || {
            bodies.iter().map(compress).collect::<Result<Vec<_>, _>>()
        })
        .map(drop)?;
    let encoded = table.time("encode the scan for the store", || {
        scans
            .iter()
            .map(|scan| encode_scan(&scan.scan))
            .collect::<Result<Vec<_>, _>>()
    })?;
    table
        .time("decode the stored scan (only when a map is loaded)", || {
            encoded
                .iter()
                .map(|bytes| decode_scan(bytes))
                .collect::<Result<Vec<_>, _>>()
        })
        .map(drop)?;
    let points = table.time("points and normals", || {
        scans
            .iter()
            .map(|scan| surface_points(&scan.scan))
            .collect::<Vec<_>>()
    });
    let clouds = table.time("index of neighbours, one scan", || {
        let cloud = |points: &Vec<_>| ReferenceCloud::new([(Pose2::IDENTITY, points.as_slice())]);
        points.iter().filter_map(cloud).collect::<Vec<_>>()
    });
    let eight: Vec<_> = points
        .iter()
        .take(8)
        .map(|p| (Pose2::IDENTITY, p.as_slice()))
        .collect();
    table.time("index of neighbours, eight scans", || {
        (0..scans.len())
            .filter_map(|_| ReferenceCloud::new(eight.iter().copied()))
            .count()
    });
    let pairs: Vec<_> = (1..scans.len().min(clouds.len()))
        .map(|k| {
            (
                k,
                scans[k - 1]
                    .odom_from_base
                    .between(&scans[k].odom_from_base),
            )
        })
        .collect();
    for (name, params) in [
        ("match, robust", IcpParams::ROBUST),
        ("match, all points", IcpParams::ALL_POINTS),
    ] {
        table.time(name, || {
            let one = |(k, start): &(usize, Pose2)| {
                align(&clouds[k - 1], &points[*k], start, 0.01, None, &params)
            };
            pairs.iter().map(one).collect::<Vec<_>>()
        });
    }
    extend_and_find(&mut table, laps)?;
    Ok(table)
}

/// Extends a new map of the laps before in each round; those are not counted.
fn extend_and_find(table: &mut Table, laps: &Laps) -> anyhow::Result<()> {
    let (mut extend_s, mut find_s) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        let mut map = RouteMap::new(Weighting::Robust);
        for drive in &laps.before {
            map.extend(drive)?;
        }
        let (mut extending_s, mut finding_s) = (0.0, 0.0);
        for drive in &laps.drives {
            let begin = Instant::now();
            map.extend(drive)?;
            extending_s += begin.elapsed().as_secs_f64();
            let begin = Instant::now();
            map.findings(&Scope {
                sites: Sites::Touched,
                pending: &[],
                false_alerts_per_lap: FALSE_ALERTS_PER_LAP,
                accepted: &[],
                vehicles: &laps.vehicles,
                suspects: &[],
            });
            finding_s += begin.elapsed().as_secs_f64();
        }
        extend_s = extend_s.min(extending_s);
        find_s = find_s.min(finding_s);
    }
    let us_per_scan = |seconds: f64| seconds * 1e6 / table.scans as f64;
    let rows = [
        (
            "the map in all: points, matches, solve",
            us_per_scan(extend_s),
        ),
        ("findings of changes", us_per_scan(find_s)),
    ];
    table.rows.extend(rows);
    Ok(())
}
