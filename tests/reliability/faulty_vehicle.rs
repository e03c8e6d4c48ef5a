//! One vehicle of a fleet sees the world otherwise than it says: nobody else is the worse for it.
//!
//! Nothing changes in the workshop, so every change that is reported is false. The fleet drives in
//! turn, three laps a trip; a trip of fewer than 150 scans says nothing of its vehicle.

use std::collections::BTreeSet;

use mapshift::geometry::{Pose2, angle_difference_rad};
use mapshift::sim::{Scene, Vehicle};
use serde_json::Value;
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Batch, Drive, workshop};
use crate::process::Process;
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::state::State;

pub const ROW: Row = Row {
    name: "faulty-vehicle",
    shows: "one faulty vehicle raises no change, is named or corrected within 20 batches, and moves no other's poses",
    obstacle: nothing_in_the_way,
    run: |form| run(faulty_vehicle(form)),
};

const ROUTE: &str = "line";
const LAPS: usize = 3;
const SCANS: usize = 60;
const SCAN_SPACING_M: f64 = 0.5;
const PATH_NOISE_M: f64 = 0.3;
/// Trips of each vehicle before one of them is knocked: this many make it known.
const TRIPS_BEFORE: usize = 4;
const RECOGNISED_WITHIN_BATCHES: usize = 20;
const MOVED_WITHIN_M: f64 = 0.02;

/// What is wrong with the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    /// Its lidar is turned on its mount by 2°.
    Yaw,
    /// Its ranges are 3 % too long.
    Scale,
    /// Its lidar sits 0.2 m ahead of where it says.
    Offset,
}

impl Fault {
    /// The field of a vehicle's calibration that shows it.
    fn quantity(self) -> &'static str {
        match self {
            Self::Yaw => "yaw",
            Self::Scale => "range_scale",
            Self::Offset => "offset_x",
        }
    }
}

/// What the service does about a faulty vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Answer {
    /// It raises a `vehicle_suspect`.
    Named,
    /// It corrects the vehicle's scans and shows that under the vehicle: right for a fault that is
    /// always the same, which no trip contradicts.
    Corrected,
}

/// Since when.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Onset {
    /// After trips in which it was sound.
    Knocked,
    /// For ever.
    Always,
}

/// A fleet, and which of its vehicles is faulty since when.
#[derive(Debug, Clone, Copy)]
struct Case {
    fault: Option<Fault>,
    onset: Onset,
    vehicles: usize,
    faulty: usize,
    rounds: usize,
    seed: u64,
}

/// What a fleet left.
struct Outcome {
    state: State,
    /// Change alerts that rest on the faulty vehicle alone, in words.
    on_its_word: Vec<String>,
    /// Other changes, all of them false too.
    other_changes: usize,
    /// Vehicles named `vehicle_suspect`.
    suspects: BTreeSet<String>,
    /// The first answer to the fault, and how many batches of the faulty vehicle it took.
    answered: Option<(Answer, usize)>,
}

async fn faulty_vehicle(form: Form) -> Finding {
    let mut finding = Finding::default();
    let cases = match form {
        Form::Quick => vec![(Fault::Yaw, Onset::Knocked)],
        Form::Full => [Onset::Knocked, Onset::Always]
            .into_iter()
            .flat_map(|onset| [Fault::Yaw, Fault::Scale, Fault::Offset].map(|fault| (fault, onset)))
            .collect(),
    };
    for seed in 1..form.choose(2, 3) {
        let sound = Case {
            fault: None,
            onset: Onset::Knocked,
            vehicles: form.choose(2, 10),
            faulty: form.choose(0, 4),
            rounds: form.choose(TRIPS_BEFORE + 1, TRIPS_BEFORE + 7),
            seed,
        };
        let undisturbed = outcome(&sound).await;
        finding
            .control
            .extend(judged(&sound, &undisturbed, &undisturbed).1);
        for &(fault, onset) in &cases {
            let case = Case {
                fault: Some(fault),
                onset,
                ..sound
            };
            let (figure, faults) = judged(&case, &outcome(&case).await, &undisturbed);
            if form == Form::Full {
                eprintln!("{figure}");
            }
            finding.figure(figure);
            finding.faults.extend(faults);
        }
    }
    finding
}

/// The figures of a case, and what of the guarantee does not hold.
fn judged(case: &Case, outcome: &Outcome, undisturbed: &Outcome) -> (String, Vec<String>) {
    let name = match case.fault {
        Some(fault) => format!("{fault:?}, {:?}, seed {}", case.onset, case.seed),
        None => format!("no fault, seed {}", case.seed),
    };
    let moved = moved(case, &outcome.state, &undisturbed.state);
    let figure = format!(
        "{name}: {} changes on its word alone, {} others; {}; of others' {} poses the \
         farthest moved {:.1} mm and {:.2}°",
        outcome.on_its_word.len(),
        outcome.other_changes,
        match outcome.answered {
            Some((Answer::Named, count)) => format!("named after {count} batches"),
            Some((Answer::Corrected, count)) => format!("corrected after {count} batches"),
            None => "neither named nor corrected".to_owned(),
        },
        moved.compared,
        1e3 * moved.metres,
        moved.radians.to_degrees()
    );
    let mut faults: Vec<String> = Vec::new();
    faults.extend(
        outcome
            .on_its_word
            .iter()
            .map(|alert| format!("{name}: {alert}")),
    );
    if outcome
        .answered
        .is_none_or(|(_, count)| count > RECOGNISED_WITHIN_BATCHES)
    {
        faults.push(format!(
            "{name}: neither named nor corrected within {RECOGNISED_WITHIN_BATCHES} batches"
        ));
    }
    let faulty = vehicle_name(case.faulty);
    let wrong: Vec<&String> = outcome
        .suspects
        .iter()
        .filter(|name| **name != faulty)
        .collect();
    if !wrong.is_empty() {
        faults.push(format!("{name}: sound vehicles are named: {wrong:?}"));
    }
    if moved.metres >= MOVED_WITHIN_M {
        faults.push(format!(
            "{name}: a pose of another vehicle moves by {:.3} m",
            moved.metres
        ));
    }
    (figure, faults)
}

/// How far poses of the others lie from where they are without the fault.
struct Moved {
    compared: usize,
    metres: f64,
    radians: f64,
}

fn moved(case: &Case, state: &State, undisturbed: &State) -> Moved {
    let (poses, before) = (state.poses(), undisturbed.poses());
    let own = format!("-{}", vehicle_name(case.faulty));
    let others = poses.iter().filter(|((trip, _), _)| !trip.ends_with(&own));
    let mut moved = Moved {
        compared: 0,
        metres: 0.0,
        radians: 0.0,
    };
    for (key, pose) in others {
        let Some(was) = before.get(key) else {
            continue;
        };
        moved.compared += 1;
        let apart_m = (pose.translation() - was.translation()).norm();
        moved.metres = moved.metres.max(apart_m);
        moved.radians = moved
            .radians
            .max(angle_difference_rad(pose.theta, was.theta).abs());
    }
    moved
}

fn vehicle_name(number: usize) -> String {
    format!("agv-{number:02}")
}

/// Drives a fleet, and hands back what the service makes of it.
async fn outcome(case: &Case) -> Outcome {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    client.put_route(ROUTE, Value::Null).await;
    let faulty = vehicle_name(case.faulty);
    let (mut sent, mut answered) = (0, None);
    for round in 0..case.rounds {
        for number in 0..case.vehicles {
            let is_faulty = number == case.faulty;
            let counts = is_faulty && (case.onset == Onset::Always || round >= TRIPS_BEFORE);
            for batch in trip(case, round, number, counts) {
                client.put(ROUTE, &batch).await;
                client.settled(ROUTE, true).await;
                if counts {
                    sent += 1;
                    let answer = answer(&client, case, &faulty).await;
                    answered = answered.or(answer.map(|answer| (answer, sent)));
                }
            }
        }
    }
    let alerts = alerts(&client).await;
    let is_change = |alert: &&Value| alert["kind"] != "vehicle_suspect";
    let is_its_own = |alert: &&Value| names(alert) == [faulty.as_str()];
    let changes: Vec<&Value> = alerts.iter().filter(is_change).collect();
    let (on_its_word, others): (Vec<&Value>, Vec<&Value>) =
        changes.into_iter().partition(is_its_own);
    let brief = |alert: &Value| format!("{} {} on its word alone", alert["status"], alert["kind"]);
    Outcome {
        state: State::of(&client, ROUTE).await,
        on_its_word: on_its_word.into_iter().map(brief).collect(),
        other_changes: others.len(),
        suspects: suspects(&alerts),
        answered,
    }
}

async fn answer(client: &Client, case: &Case, vehicle: &str) -> Option<Answer> {
    if suspects(&alerts(client).await).contains(vehicle) {
        return Some(Answer::Named);
    }
    if case.onset == Onset::Knocked {
        return None;
    }
    let shown = client
        .json(&format!("/v1/routes/{ROUTE}/vehicles/{vehicle}"))
        .await;
    let quantity = case.fault.map(Fault::quantity)?;
    let is_corrected = shown["calibration"][quantity]["applied"] == true;
    is_corrected.then_some(Answer::Corrected)
}

async fn alerts(client: &Client) -> Vec<Value> {
    let mut page = client
        .json(&format!("/v1/alerts?route_id={ROUTE}&limit=1000"))
        .await;
    serde_json::from_value(page["items"].take()).unwrap()
}

fn names(alert: &Value) -> Vec<&str> {
    let names = alert["vehicle_ids"].as_array().unwrap().iter();
    names.filter_map(Value::as_str).collect()
}

fn suspects(alerts: &[Value]) -> BTreeSet<String> {
    let suspecting = alerts
        .iter()
        .filter(|alert| alert["kind"] == "vehicle_suspect");
    suspecting.flat_map(names).map(ToOwned::to_owned).collect()
}

/// A trip of one vehicle, as it is sent.
fn trip(case: &Case, round: usize, number: usize, is_faulty: bool) -> Vec<Batch> {
    let scene = Scene::of_hall(&workshop(), case.seed);
    let mut vehicle = Vehicle {
        scan_spacing_m: SCAN_SPACING_M,
        ..Vehicle::of_fleet(number, PATH_NOISE_M)
    };
    let fault = case.fault.filter(|_| is_faulty);
    match fault {
        Some(Fault::Yaw) => vehicle = vehicle.with_turned_lidar(2.0_f64.to_radians()),
        Some(Fault::Offset) => vehicle.lidar.mount_error = Pose2::new(0.2, 0.0, 0.0),
        Some(Fault::Scale) | None => {}
    }
    let turn = round * case.vehicles + number;
    let first = turn * LAPS;
    let mut scans = scene.drive(&vehicle, first..first + LAPS, case.seed);
    if fault == Some(Fault::Scale) {
        let reach_m = vehicle.lidar.geometry.range_max_m;
        for range_m in scans.iter_mut().flat_map(|scan| &mut scan.ranges_m) {
            *range_m = range_m
                .map(|range_m| 1.03 * range_m)
                .filter(|range_m| *range_m < reach_m);
        }
    }
    let (vehicle_id, trip_id) = (
        vehicle_name(number),
        format!("{round:02}-{}", vehicle_name(number)),
    );
    Drive::of(&vehicle, (&vehicle_id, &trip_id), scans, turn as i64).batches(SCANS)
}
