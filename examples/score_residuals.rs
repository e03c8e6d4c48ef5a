//! How the calibrated residual test does on closures without scans, where ΔF is the only witness:
//! laps of a vehicle that sends edges, some of them displaced from a lap on.
//!
//! `cargo run --release --example score_residuals -- FIRST_SEED SEEDS [RATE]`

#![allow(clippy::unwrap_used, clippy::print_stdout)]

use mapshift::change::series::{ClosureSample, SeriesParams, residual_series};
use mapshift::change::{JudgedClosure, VehicleResidual, p_values_in_order, residual_runs};
use mapshift::geometry::Pose2;
use mapshift::graph::EdgeKind;
use mapshift::ids::{StampNs, TripId};
use mapshift::mapping::{End, GivenEdge, GivenGraph, GivenNode, RouteMap, Weighting};

#[path = "../tests/service/edge_laps.rs"]
#[allow(dead_code)]
mod edge_laps;
use edge_laps::{Displaced, LAP, Laps};

const LAPS: usize = 14;
/// From this lap on closures are displaced.
const CHANGED: usize = 10;
/// Where they are displaced: a fifth of the way.
const PLACES: std::ops::Range<usize> = 10..18;

#[derive(Default)]
struct Tally {
    cases: usize,
    settled: usize,
    settled_at: usize,
    unchanged: usize,
    unchanged_flagged: usize,
    entering: usize,
    entering_flagged: usize,
    displaced: usize,
    displaced_flagged: usize,
    found: usize,
    elsewhere: usize,
    several: usize,
}

fn main() {
    let arguments: Vec<f64> = std::env::args()
        .skip(1)
        .map(|a| a.parse().unwrap())
        .collect();
    let (first, seeds) = (arguments[0] as u64, arguments[1] as u64);
    let rate = arguments.get(2).copied().unwrap_or(1e-3);
    println!(
        "displaced by | settled, at | flagged unchanged | flagged displaced | flagged on entering | alerts: one, none, several | elsewhere"
    );
    for by_m in [0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5] {
        let mut tally = Tally::default();
        for seed in first..first + seeds {
            run(seed, by_m, rate, &mut tally);
        }
        let t = &tally;
        println!(
            "{by_m:.2} m | {}/{}, {:.0} | {}/{} | {}/{} | {}/{} | {}, {}, {} | {}",
            t.settled,
            t.cases,
            t.settled_at as f64 / t.settled.max(1) as f64,
            t.unchanged_flagged,
            t.unchanged,
            t.displaced_flagged,
            t.displaced,
            t.entering_flagged,
            t.entering,
            t.found,
            t.settled - t.found - t.several,
            t.several,
            t.elsewhere,
        );
    }
}

fn run(seed: u64, by_m: f64, rate: f64, tally: &mut Tally) {
    let laps = if by_m > 0.0 { CHANGED..LAPS } else { 0..0 };
    let (sin, cos) = (seed as f64).sin_cos();
    let displaced = Displaced {
        laps,
        places: PLACES,
        by: Pose2::new(by_m * cos, by_m * sin, 0.0),
    };
    let drive = Laps::drive("v", LAPS, seed, &displaced);
    let mut map = RouteMap::new(Weighting::Robust);
    let mut samples = Vec::new();
    for lap in 0..LAPS {
        let attached = map.attach(&part(&drive, lap)).unwrap();
        samples.extend(attached.edges.iter().filter_map(|(edge_id, delta_f)| {
            Some(ClosureSample {
                edge_id: *edge_id,
                delta_f: (*delta_f)?,
            })
        }));
    }
    tally.cases += 1;
    let series = residual_series(&samples, &SeriesParams::default());
    let Some(baseline) = series.converged_at else {
        return;
    };
    tally.settled += 1;
    tally.settled_at += baseline;
    let residuals = samples.iter().map(|sample| VehicleResidual {
        vehicle: 0,
        residual: sample.delta_f,
    });
    let residuals: Vec<_> = residuals.collect();
    let p_values = p_values_in_order(&residuals, baseline, rate);
    let judged: Vec<JudgedClosure> = (baseline..samples.len())
        .map(|n| judged(&map, &samples[n], p_values[n].unwrap_or(1.0), rate))
        .collect();
    for closure in &judged {
        let node = closure.nodes[1].0 as usize - 1;
        let (lap, place) = (node / LAP, node % LAP);
        let is_off = by_m > 0.0 && lap >= CHANGED && PLACES.contains(&place);
        // Just behind the place the way back shows, too.
        let is_behind =
            by_m > 0.0 && lap >= CHANGED && (PLACES.end..PLACES.end + 3).contains(&place);
        if is_off {
            tally.displaced += 1;
            tally.displaced_flagged += usize::from(closure.flagged);
            if place == PLACES.start {
                tally.entering += 1;
                tally.entering_flagged += usize::from(closure.flagged);
            }
        } else if !is_behind {
            tally.unchanged += 1;
            tally.unchanged_flagged += usize::from(closure.flagged);
        }
    }
    let findings = residual_runs(&judged);
    let middle = drive.truth[(PLACES.start + PLACES.end) / 2].translation();
    let (near, far): (Vec<_>, Vec<_>) = findings
        .iter()
        .partition(|f| by_m > 0.0 && (f.location - middle).norm() < 6.0);
    tally.found += usize::from(near.len() == 1);
    tally.several += usize::from(near.len() > 1);
    tally.elsewhere += far.len();
}

fn part(drive: &Laps, lap: usize) -> GivenGraph {
    let nodes = lap * LAP..(lap + 1) * LAP;
    let end = |k: usize| match k.checked_sub(nodes.start) {
        Some(place) => End::New(place),
        None => End::Known(mapshift::ids::NodeId(k as i64 + 1)),
    };
    let ending = drive.motions.iter().filter(|m| nodes.contains(&m.to));
    GivenGraph {
        nodes: nodes
            .clone()
            .map(|k| GivenNode {
                trip: TripId::new("t").unwrap(),
                stamp: StampNs(k as i64),
                pose: drive.truth[k],
            })
            .collect(),
        edges: ending
            .map(|m| GivenEdge {
                from: end(m.from),
                to: end(m.to),
                measurement: m.measurement,
                information: m.information,
                kind: m.kind,
            })
            .collect(),
    }
}

fn judged(map: &RouteMap, sample: &ClosureSample, p_value: f64, rate: f64) -> JudgedClosure {
    let edge = map.graph().edge(sample.edge_id).unwrap();
    assert_eq!(edge.kind, EdgeKind::LoopClosure);
    let nodes = [edge.from, edge.to];
    let [older, newer] = nodes.map(|node| map.graph().node(node).unwrap().pose.translation());
    let keyframe = map.keyframe(edge.to).unwrap();
    JudgedClosure {
        edge: edge.id,
        nodes,
        place: 0.5 * (older + newer),
        stamp: keyframe.stamp,
        trip: (keyframe.trip.clone(), keyframe.trip_order),
        p_value,
        flagged: p_value < rate,
    }
}
