//! Batches arrive in any order: the map and what is reported of changes are the same.

use serde_json::Value;
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::Batch;
use crate::process::Process;
use crate::reordering::{difference, laps, reordered, sorted};
use crate::reported::{ROUTE, alerts};
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::state::State;

pub const ROW: Row = Row {
    name: "shuffled",
    shows: "batches in any order end in the same alerts, and in poses within 1 cm and 0.1°",
    obstacle: nothing_in_the_way,
    run: |form| run(shuffled(form)),
};

const SAME_M: f64 = 0.01;
const SAME_DEG: f64 = 0.1;

/// What there is in the end.
struct End {
    alerts: Vec<Value>,
    map: State,
}

async fn shuffled(form: Form) -> Finding {
    let laps = laps();
    let in_order = end_of(&laps.concat()).await;
    let mut finding = Finding::default();
    finding.expect(!in_order.alerts.is_empty(), || {
        "nothing is reported at all".to_owned()
    });
    let (mut farthest_m, mut widest_deg, mut alike) = (0.0_f64, 0.0_f64, 0);
    let seeds = form.choose(2, 100);
    for seed in 0..seeds {
        let end = end_of(&order(&laps, seed)).await;
        let (metres, degrees, faults) = judged(&end, &in_order);
        farthest_m = farthest_m.max(metres);
        widest_deg = widest_deg.max(degrees);
        alike += usize::from(faults.is_empty());
        finding.faults.extend(
            faults
                .into_iter()
                .map(|fault| format!("seed {seed}: {fault}")),
        );
    }
    finding.figure(format!(
        "{alike} of {seeds} orders end alike; poses differ by {:.1} mm and {widest_deg:.3}° at most",
        1e3 * farthest_m
    ));
    // A line that loses the last trips.
    let (_, _, control) = judged(&end_of(&laps[..3].concat()).await, &in_order);
    finding.control = control;
    finding
}

/// The first batch defines the frame of the map: that one stays in front.
fn order(laps: &[Vec<Batch>], seed: u64) -> Vec<Batch> {
    let mut uploads = reordered(laps, seed);
    let first = uploads.iter().position(|batch| batch.id == laps[0][0].id);
    let first = uploads.remove(first.unwrap());
    uploads.insert(0, first);
    uploads
}

async fn end_of(uploads: &[Batch]) -> End {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    client.put_route(ROUTE, Value::Null).await;
    client.put_all(ROUTE, uploads).await;
    client.merged(ROUTE).await;
    End {
        alerts: sorted(alerts(&client).await),
        map: State::of(&client, ROUTE).await,
    }
}

/// How far the poses of two ends are apart, metres and degrees, and what is not alike.
fn judged(end: &End, in_order: &End) -> (f64, f64, Vec<String>) {
    let mut faults = Vec::from_iter(difference(&in_order.alerts, &end.alerts));
    if !end.map.poses().keys().eq(in_order.map.poses().keys()) {
        faults.push("the map has other keyframes".to_owned());
        return (0.0, 0.0, faults);
    }
    let (metres, radians) = end.map.distance_to(&in_order.map);
    let degrees = radians.to_degrees();
    if metres > SAME_M || degrees > SAME_DEG {
        faults.push(format!("a pose is {metres:.4} m and {degrees:.3}° off"));
    }
    (metres, degrees, faults)
}
