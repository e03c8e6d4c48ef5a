//! A vehicle that uploads as it drives, and whose clock goes back by 20 hours; and simulated clocks.

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use super::super::process::process;
use super::super::refusal::Processed;
use super::super::trip_start::known_start;
use super::bench::{Bench, at, route, upload};
use crate::change::ChangeKind;
use crate::ids::{BatchId, StampNs, TripId, VehicleId};
use crate::model::{BatchStatus, VehicleState};
use crate::store::{BatchContent, NewBatch};

const SCANS: usize = 12;

/// A drive that begins in an hour by a clock that is this many hours behind, in batches that arrive a
/// second after their last scan.
fn live(trip: &str, hour: i64, behind_h: i64) -> Vec<NewBatch> {
    live_of("agv", trip, hour, behind_h)
}

fn live_of(vehicle: &str, trip: &str, hour: i64, behind_h: i64) -> Vec<NewBatch> {
    let whole = upload(trip, hour - behind_h, 1);
    let body: Value = serde_json::from_slice(&whole.body).unwrap();
    let scans = body["scans"].as_array().unwrap();
    let part = |(sequence, scans): (i64, &[Value])| {
        let mut body = body.clone();
        body["vehicle_id"] = json!(vehicle);
        body["sequence"] = json!(sequence);
        body["scans"] = json!(scans);
        if sequence > 0 {
            body.as_object_mut().unwrap().remove("initial_pose");
        }
        let last: Timestamp = scans.last().unwrap()["stamp"]
            .as_str()
            .unwrap()
            .parse()
            .unwrap();
        let late = SignedDuration::from_hours(behind_h) + SignedDuration::from_secs(1);
        NewBatch {
            id: BatchId::new(format!("{trip}-{sequence}")).unwrap(),
            vehicle_id: VehicleId::new(vehicle).unwrap(),
            trip_id: TripId::new(trip).unwrap(),
            content: BatchContent::Scans {
                sequence,
                scans: scans.len() as i64,
            },
            body: serde_json::to_vec(&body).unwrap(),
            received_at: last + late,
            ..whole.clone()
        }
    };
    (0..).zip(scans.chunks(SCANS)).map(part).collect()
}

#[tokio::test]
async fn the_trips_of_a_clock_that_went_back_count_from_when_they_arrived() {
    let bench = Bench::new().await;
    let trips = [
        ("sound", 40, 0),
        ("gone-back", 45, 20),
        ("still-behind", 47, 20),
        ("put-right", 60, 0),
    ];
    for (trip, hour, behind_h) in trips {
        for batch in live(trip, hour, behind_h) {
            let merged = bench.merge(batch, 20).await;
            let is_first = merged.sequence == 0;
            let is_flagged = merged.flags == ["clock_skew"];
            assert_eq!(is_flagged, is_first && behind_h > 0, "{merged:?}");
        }
        let nodes = bench.engine.store.nodes(&route()).await.unwrap();
        let of_trip = nodes.iter().filter(|node| node.trip_id.as_str() == trip);
        let stamps: Vec<StampNs> = of_trip.map(|node| node.stamp).collect();
        let hours = [hour, hour + 1].map(|hour| StampNs(at(hour).as_nanosecond() as i64));
        let is_within = |stamp: &StampNs| (hours[0]..hours[1]).contains(stamp);
        assert!(
            stamps.len() > 20 && stamps.iter().all(is_within),
            "{trip}: {stamps:?}"
        );
    }
}

/// By its clock, which is 20 hours behind, the second vehicle sees the box an hour after the first has seen that
/// there is none.
#[tokio::test]
async fn what_a_clock_that_was_always_behind_stamps_is_no_change() {
    let mut bench = Bench::new().await;
    for batch in live_of("sound", "without", 0, 0) {
        bench.merge(batch, 20).await;
    }
    let mut flagged = Vec::new();
    for batch in live_of("behind", "first", 21, 20) {
        let merged = bench.merge(batch, 20).await;
        flagged.push(merged.flags.contains(&"clock_skew".to_owned()));
    }
    assert_eq!(flagged.iter().filter(|is_flagged| **is_flagged).count(), 1);
    assert!(flagged[3], "{flagged:?}");
    let standing = || async {
        let alerts = bench.alerts().await;
        let standing = alerts.iter().filter(|alert| alert.status.is_pending());
        let brief =
            |alert: &crate::store::AlertRecord| (alert.evidence.kind, alert.evidence.trips.clone());
        standing.map(brief).collect::<Vec<_>>()
    };
    let suspected = vec![(
        ChangeKind::VehicleSuspect,
        vec![TripId::new("first").unwrap()],
    )];
    assert_eq!(standing().await, suspected);
    let alerts = bench.alerts().await;
    let suspect = alerts
        .iter()
        .find_map(|alert| alert.evidence.suspect.as_ref());
    let text = &suspect.unwrap().faults[0].text;
    assert!(text.contains("behind by about 20 h"), "{text}");
    let vehicle = VehicleId::new("behind").unwrap();
    let store = &bench.engine.store;
    let record = store.vehicle(&route(), &vehicle).await.unwrap().unwrap();
    assert_eq!(record.state(), VehicleState::Suspect);

    // The same after a restart; and its next trip, which arrives on time, ends it.
    let state = bench.state().await;
    bench = bench.restarted().await;
    assert_eq!(bench.state().await, state);
    for batch in live_of("behind", "put-right", 45, 0) {
        bench.merge(batch, 20).await;
    }
    let alerts = bench.alerts().await;
    let of_vehicle = alerts
        .iter()
        .find(|alert| alert.evidence.kind == ChangeKind::VehicleSuspect);
    assert!(!of_vehicle.unwrap().status.is_pending(), "{of_vehicle:?}");
}

/// A drive by the clock of a simulation that began so many seconds before it, and that is so many times
/// as fast as the clock on the wall; in batches that arrive when they end.
fn simulated(trip: &str, hour: i64, begins_s: i64, times_as_fast: i64) -> Vec<NewBatch> {
    let mut batches = live(trip, hour, 0);
    for batch in &mut batches {
        let mut body: Value = serde_json::from_slice(&batch.body).unwrap();
        let mut newest = SignedDuration::ZERO;
        for scan in body["scans"].as_array_mut().unwrap() {
            let stamp: Timestamp = scan["stamp"].as_str().unwrap().parse().unwrap();
            newest = stamp.duration_since(at(hour));
            let since = newest + SignedDuration::from_secs(begins_s);
            scan["stamp"] = json!(Timestamp::UNIX_EPOCH + since);
        }
        batch.body = serde_json::to_vec(&body).unwrap();
        batch.received_at = at(hour) + newest / i32::try_from(times_as_fast).unwrap();
    }
    batches
}

/// When the first and the last node of each trip were, in seconds after the hour of the first.
async fn spans(bench: &Bench, trips: &[&str]) -> Vec<(f64, f64)> {
    let nodes = bench.engine.store.nodes(&route()).await.unwrap();
    let span = |trip: &&str| {
        let own = nodes.iter().filter(|node| node.trip_id.as_str() == *trip);
        let seconds = own.map(|node| node.stamp.seconds() - at(40).as_second() as f64);
        seconds.fold(
            (f64::INFINITY, f64::NEG_INFINITY),
            |(first, last), second| (first.min(second), last.max(second)),
        )
    };
    trips.iter().map(span).collect()
}

#[tokio::test]
async fn the_trips_of_a_simulation_are_in_the_order_in_which_they_came() {
    let bench = Bench::new().await;
    let mut sent = Vec::new();
    // At the pace of the wall's clock; twenty times as fast; and from 0 again.
    for (trip, hour, begins_s, times_as_fast) in [
        ("one", 40, 5, 1),
        ("two", 41, 400, 20),
        ("three", 41, 0, 20),
    ] {
        for batch in simulated(trip, hour, begins_s, times_as_fast) {
            let merged = bench.merge(batch.clone(), 20).await;
            assert_eq!(merged.status, BatchStatus::Merged, "{merged:?}");
            assert!(
                merged.flags.is_empty(),
                "the bench's own batches: {merged:?}"
            );
            sent.push(batch);
        }
    }
    let spans = spans(&bench, &["one", "two", "three"]).await;
    let [one, two, three] = spans[..] else {
        panic!("{spans:?}")
    };
    // The first batch ends when it arrives, and the trip keeps its pace.
    let first = &sent[0];
    let body: Value = serde_json::from_slice(&first.body).unwrap();
    let stamps = body["scans"].as_array().unwrap().iter();
    let stamps: Vec<f64> = stamps
        .map(|scan| {
            scan["stamp"]
                .as_str()
                .unwrap()
                .parse::<Timestamp>()
                .unwrap()
        })
        .map(|stamp| stamp.as_nanosecond() as f64 * 1e-9)
        .collect();
    let arrived_s = first.received_at.duration_since(at(40)).as_secs_f64();
    let begun_s = arrived_s - (stamps[stamps.len() - 1] - stamps[0]);
    assert!((one.0 - begun_s).abs() < 1e-3, "{one:?} {begun_s}");
    assert!(one.1 - one.0 > 10.0 && two.1 - two.0 > 10.0, "{spans:?}");
    assert!(
        two.0 > one.1 && (3_590.0..3_700.0).contains(&two.0),
        "{spans:?}"
    );
    assert!(three.0 >= two.1 + 1.0, "{spans:?}");
}

/// Journals a batch and says whether a worker takes it into the map.
async fn refusal_of(bench: &Bench, batch: NewBatch) -> Option<String> {
    let store = &bench.engine.store;
    store.journal_batch(batch).await.unwrap();
    let lease = std::time::Duration::from_secs(60);
    let job = store.claim_job(Timestamp::now(), lease).await.unwrap();
    let job = job.unwrap();
    let workspace = bench.engine.workspaces.take(store, &route()).await.unwrap();
    let known = known_start(store, &workspace, &job).await.unwrap();
    match process(workspace, &job, &known).unwrap() {
        Processed::Taken(_) => None,
        Processed::Refused(refusal) => refusal.outcomes[0].reason.clone(),
    }
}

#[tokio::test]
async fn a_clock_that_is_set_in_the_middle_of_a_trip_is_believed_and_one_that_starts_anew_is_not() {
    let bench = Bench::new().await;
    let (mut unset, real) = (simulated("set", 40, 0, 1), live("set", 40, 0));
    bench.merge(unset.swap_remove(0), 20).await;
    bench.merge(real[1].clone(), 20).await;
    let (first_s, last_s) = spans(&bench, &["set"]).await[0];
    assert!(first_s > -60.0 && last_s < 600.0, "{first_s} {last_s}");

    let (mut anew, real) = (simulated("anew", 45, 0, 1), live("anew", 45, 0));
    bench.merge(real[0].clone(), 20).await;
    let reason = refusal_of(&bench, anew.swap_remove(1)).await.unwrap();
    assert!(reason.contains("begin a new trip"), "{reason}");
}

#[tokio::test]
async fn a_clock_that_is_set_to_a_time_that_its_trip_has_passed_is_not_believed() {
    let bench = Bench::new().await;
    let (mut unset, mut real) = (simulated("back", 40, 0, 1), live("back", 39, 0));
    bench.merge(unset.swap_remove(0), 20).await;
    let mut set = real.swap_remove(1);
    set.received_at = at(41);
    let reason = refusal_of(&bench, set).await.unwrap();
    assert!(reason.contains("begin a new trip"), "{reason}");
}
