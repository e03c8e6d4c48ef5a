//! A vehicle that uploads as it drives, and whose clock goes back by 20 hours.

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use super::bench::{Bench, at, route, upload};
use crate::ids::{BatchId, StampNs, TripId, VehicleId};
use crate::store::{BatchContent, NewBatch};

const SCANS: usize = 12;

/// A drive that begins in an hour by a clock that is so many hours behind, in batches that arrive a
/// second after their last scan.
fn live(trip: &str, hour: i64, behind_h: i64) -> Vec<NewBatch> {
    let whole = upload(trip, hour - behind_h, 1);
    let body: Value = serde_json::from_slice(&whole.body).unwrap();
    let scans = body["scans"].as_array().unwrap();
    let part = |(sequence, scans): (i64, &[Value])| {
        let mut body = body.clone();
        body["vehicle_id"] = json!("agv");
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
            vehicle_id: VehicleId::new("agv").unwrap(),
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
