//! A vehicle that is off, corrected when its trips are sure of it.

use serde_json::json;

use super::bench::{Bench, MapState, route};
use crate::calibration::{Quantity, TripCorrections};
use crate::change::{AlertStatus, ChangeKind, Tier};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{BatchId, TripId, VehicleId};
use crate::scan::decode_scan;
use crate::sim::{OdometryError, Route, Shape, SimLidar, SimScan, Vehicle, World, drive};
use crate::store::{AlertRecord, BatchContent, NewBatch};

/// How the lidar sits on its mount, and from a trip on, when it was knocked, radians.
const TURN_RAD: f64 = 0.05;
const KNOCKED_RAD: f64 = -0.06;
const KNOCKED_FROM: usize = 5;
/// By how much the wheels overstate ways.
const SCALE: f64 = 0.04;
const TRIPS: usize = 7;
const MOUNT: Pose2 = Pose2 {
    x: 0.2,
    y: 0.0,
    theta: 0.0,
};

fn driven(trip: usize) -> Vec<SimScan> {
    let rectangle =
        |[x, y, length, width]: [f64; 4]| Shape::rectangle(&Pose2::new(x, y, 0.0), length, width);
    let world = World::new([
        rectangle([6.0, 5.0, 13.0, 11.0]),
        rectangle([4.5, 4.6, 2.0, 1.5]),
        rectangle([6.5, 9.9, 5.0, 1.0]),
        rectangle([12.0, 6.5, 0.8, 3.0]),
        rectangle([8.2, 5.8, 0.6, 2.2]),
    ]);
    let corners = [(2.0, 2.0), (10.0, 2.0), (10.0, 8.0), (2.0, 8.0)];
    let corners = corners.map(|(x, y)| Vector2::new(x, y));
    let turn_rad = if trip < KNOCKED_FROM {
        TURN_RAD
    } else {
        KNOCKED_RAD
    };
    let vehicle = Vehicle {
        lidar: SimLidar {
            mount_error: Pose2::new(0.0, 0.0, turn_rad),
            ..SimLidar::all_round(180, 20.0, 0.01, MOUNT)
        },
        odometry: OdometryError {
            scale: SCALE,
            yaw_drift_rad_per_m: 0.0,
            sigma_xy_m: 0.003,
            sigma_theta_rad: 0.002,
        },
        path_noise_m: 0.2,
        scan_spacing_m: 0.15,
        speed_mps: 1.2,
    };
    let path = Route::new(&corners, 1.0).unwrap();
    drive(&world, &path, &vehicle, 2, 7 + trip as u64)
}

fn name(trip: usize) -> TripId {
    TripId::new(format!("t{trip}")).unwrap()
}

/// The two halves of a trip, as two uploads.
fn uploads(trip: usize) -> [NewBatch; 2] {
    let scans = driven(trip);
    let pose = |p: &Pose2| json!({"x": p.x, "y": p.y, "theta": p.theta});
    let geometry = SimLidar::all_round(180, 20.0, 0.01, MOUNT).geometry;
    let half = scans.len() / 2;
    [&scans[..half], &scans[half..]].map(|scans| {
        let sequence = i64::from(scans[0].time_s > 0.0);
        let sent: Vec<_> = scans
            .iter()
            .map(|scan| {
                let stamp = super::bench::at(trip as i64)
                    + jiff::SignedDuration::from_millis((scan.time_s * 1e3) as i64);
                json!({
                    "stamp": stamp,
                    "odometry": pose(&scan.odom_from_base),
                    "ranges": scan.ranges_m,
                })
            })
            .collect();
        let body = json!({
            "vehicle_id": "agv", "trip_id": name(trip), "sequence": sequence,
            "lidar": {
                "angle_min": geometry.angle_min_rad, "angle_increment": geometry.angle_increment_rad,
                "range_min": geometry.range_min_m, "range_max": geometry.range_max_m,
                "mount": pose(&geometry.mount), "range_sigma": geometry.range_sigma_m,
            },
            "scans": sent,
        });
        NewBatch {
            route_id: route(),
            id: BatchId::new(format!("t{trip}-{sequence}")).unwrap(),
            vehicle_id: VehicleId::new("agv").unwrap(),
            trip_id: name(trip),
            content: BatchContent::Scans {
                sequence,
                scans: scans.len() as i64,
            },
            flags: Vec::new(),
            out_of_range: None,
            extensions: None,
            body: serde_json::to_vec(&body).unwrap(),
            received_at: super::bench::at(trip as i64),
        }
    })
}

/// What came of the trips.
struct Driven {
    corrections: Vec<TripCorrections>,
    alerts: Vec<Vec<AlertRecord>>,
    state: MapState,
    bench: Bench,
}

async fn drive_all(restarts: bool) -> Driven {
    let mut bench = Bench::new().await;
    let (mut corrections, mut alerts) = (Vec::new(), Vec::new());
    for trip in 0..TRIPS {
        for batch in uploads(trip) {
            bench.merge(batch, 10).await;
            if restarts {
                bench = bench.restarted().await;
            }
        }
        let store = &bench.engine.store;
        let known = store.trip_start(&route(), &name(trip)).await.unwrap();
        corrections.push(known.unwrap().corrections);
        alerts.push(bench.alerts().await);
    }
    Driven {
        corrections,
        alerts,
        state: bench.state().await,
        bench,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vehicle_is_corrected_when_it_is_sure_and_no_longer_when_it_changes() {
    let Driven {
        corrections,
        alerts,
        state,
        bench,
    } = drive_all(false).await;
    let yaw = |trip: usize| {
        let found = corrections[trip].find(None, Quantity::MountYaw);
        found.map(|found| (found.estimate.value, found.since_trip.to_string()))
    };
    for (trip, of_trip) in corrections.iter().enumerate() {
        // Sure after four trips, and in doubt from the first that contradicts.
        let is_corrected = [4, 5].contains(&trip);
        assert_eq!(yaw(trip).is_some(), is_corrected, "{trip}: {of_trip:?}");
        let way = of_trip.find(None, Quantity::WayScale);
        assert_eq!(way.is_some(), trip >= 4, "{trip}: {of_trip:?}");
        let off = way.map_or(0.0, |way| way.estimate.value + SCALE / (1.0 + SCALE));
        assert!(off.abs() < 0.003, "{off}");
    }
    let (value, since) = yaw(5).unwrap();
    assert!((value - TURN_RAD).abs() < 0.003, "{value}");
    assert_eq!(since, "t4");
    // One alert, as soon as a trip contradicts.
    for (trip, alerts) in alerts.iter().enumerate() {
        assert_eq!(
            alerts.len(),
            usize::from(trip >= KNOCKED_FROM),
            "{trip}: {alerts:?}"
        );
    }
    let last = &alerts[TRIPS - 1][0];
    assert_eq!(
        (last.evidence.kind, last.evidence.tier),
        (ChangeKind::VehicleSuspect, Tier::Confirmed)
    );
    assert_eq!((last.status, last.vehicles.len()), (AlertStatus::Open, 1));
    let fault = &last.evidence.suspect.as_ref().unwrap().faults[0];
    let changed = |estimate: Option<crate::calibration::Estimate>| estimate.unwrap().value;
    assert!(
        (changed(fault.before) - TURN_RAD).abs() < 0.003,
        "{fault:?}"
    );
    assert!(
        (changed(fault.now) - KNOCKED_RAD).abs() < 0.003,
        "{fault:?}"
    );
    // What trips say stays about the vehicle as stated, whatever is corrected.
    let store = &bench.engine.store;
    let vehicle = store
        .vehicle(&route(), &VehicleId::new("agv").unwrap())
        .await;
    for (trip, word) in vehicle.unwrap().unwrap().calibrations.iter().enumerate() {
        let said = word.calibration.estimates[&Quantity::MountYaw].value;
        let truth = if trip < KNOCKED_FROM {
            TURN_RAD
        } else {
            KNOCKED_RAD
        };
        assert!((said - truth).abs() < 0.004, "{trip}: {said}");
    }
    // The map sees the lidar where it sits; odometry stays as it was sent.
    let graph = store.load_graph(&route()).await.unwrap().unwrap();
    let sent = driven(4);
    let of_trip = graph
        .nodes
        .iter()
        .filter(|node| node.node.trip_id == name(4));
    let mut nodes = 0;
    for node in of_trip {
        let scan = decode_scan(node.scan.as_ref().unwrap()).unwrap();
        assert!((scan.lidar().mount.theta - TURN_RAD).abs() < 0.003);
        let odom = node.node.odom_from_base;
        assert!(
            sent.iter()
                .any(|s| s.odom_from_base.between(&odom).log().norm() < 1e-12)
        );
        nodes += 1;
    }
    assert!(nodes > 20, "{nodes}");
    // A restart at any time gives the same bits.
    let restarted = drive_all(true).await;
    assert_eq!(restarted.corrections, corrections);
    assert!(restarted.state == state);
    let evidence = |alerts: &[AlertRecord]| -> Vec<_> {
        alerts.iter().map(|alert| alert.evidence.clone()).collect()
    };
    assert_eq!(
        evidence(&restarted.alerts[TRIPS - 1]),
        evidence(&alerts[TRIPS - 1])
    );
}
