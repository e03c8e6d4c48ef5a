//! The vehicles of a route.

use mapshift::ids::{LidarId, StampNs, TripId, VehicleId};
use mapshift::model::BatchStatus;
use mapshift::store::{Applied, LidarRecord, TripCalibrationRecord};

use crate::support::{Fixture, route, upload};

fn vehicle() -> VehicleId {
    VehicleId::new("v").unwrap()
}

#[tokio::test]
async fn what_trips_say_of_their_vehicle_is_kept_and_replaced() {
    use mapshift::calibration::{CalibratedTrip, Estimate, Quantity, TripCalibration};
    let fixture = Fixture::new().await;
    let said = |yaw_rad: f64| TripCalibration {
        estimates: [(
            Quantity::MountYaw,
            Estimate {
                value: yaw_rad,
                sigma: 0.01,
            },
        )]
        .into(),
        ..TripCalibration::default()
    };
    for (k, (trip, yaw_rad)) in [("t", 0.1), ("u", 0.2), ("t", 0.3)].into_iter().enumerate() {
        let sequence = i64::from(k == 2);
        fixture
            .journal(upload(&format!("b{k}"), trip, sequence))
            .await;
        let job = fixture.claim(0).await.unwrap();
        let mut result = fixture.result(&job, BatchStatus::Merged).await;
        let of_only_one = TripCalibrationRecord {
            trip_id: TripId::new(trip).unwrap(),
            vehicle_id: vehicle(),
            lidar: None,
            stamp: StampNs(1 + k as i64),
            scans: 200,
            calibration: said(yaw_rad),
            beside_primary: None,
        };
        let lidar = |name: &str| Some(LidarId::new(name).unwrap());
        let front = TripCalibrationRecord {
            lidar: lidar("front"),
            calibration: said(1.0 + yaw_rad),
            ..of_only_one.clone()
        };
        let rear = TripCalibrationRecord {
            lidar: lidar("rear"),
            calibration: said(2.0 + yaw_rad),
            beside_primary: Some(said(3.0 + yaw_rad)),
            ..of_only_one.clone()
        };
        result.calibrations = vec![of_only_one, front, rear];
        let applied = fixture.store.apply_result(result).await.unwrap();
        assert_eq!(applied, Applied::Committed);
    }
    let known = fixture
        .store
        .vehicle(&route(), &vehicle())
        .await
        .unwrap()
        .unwrap();
    let words = |trips: &[CalibratedTrip]| -> Vec<TripCalibration> {
        trips.iter().map(|word| word.calibration.clone()).collect()
    };
    assert_eq!(words(&known.calibrations), [said(0.2), said(0.3)]);
    let newest = &known.calibrations[1];
    assert_eq!(
        (newest.trip.as_str(), newest.stamp, newest.scans),
        ("t", StampNs(3), 200)
    );
    let lidars = known.lidars.iter().map(|lidar| {
        let LidarRecord {
            id,
            calibrations,
            beside_primary,
        } = lidar.clone();
        (id.to_string(), words(&calibrations), words(&beside_primary))
    });
    let yaws = |added_rad: f64| vec![said(added_rad + 0.2), said(added_rad + 0.3)];
    let expected = [
        ("front".to_owned(), yaws(1.0), vec![]),
        ("rear".to_owned(), yaws(2.0), yaws(3.0)),
    ];
    assert_eq!(lidars.collect::<Vec<_>>(), expected);
    assert_eq!((known.batches, known.trips), (3, 2));
    assert_eq!(known.suspected_by, []);
    let page = fixture
        .store
        .vehicle_page(&route(), None, 10)
        .await
        .unwrap();
    assert_eq!(page, std::slice::from_ref(&known));
    let page = fixture
        .store
        .vehicle_page(&route(), Some(&known.id), 10)
        .await
        .unwrap();
    assert_eq!(page, []);
}

#[tokio::test]
async fn what_is_corrected_in_a_trip_is_decided_once() {
    use mapshift::calibration::{AppliedCorrection, Estimate, Quantity, TripCorrections};
    use mapshift::store::TripStart;
    let fixture = Fixture::new().await;
    let trip = TripId::new("t").unwrap();
    let corrections = |yaw_rad: f64| {
        let estimate = Estimate {
            value: yaw_rad,
            sigma: 0.001,
        };
        let since = (trip.clone(), StampNs(7));
        let yaw = AppliedCorrection::new(None, Quantity::MountYaw, &estimate, since);
        TripCorrections::new(vec![yaw])
    };
    let known = async || {
        let read = fixture.store.trip_start(&route(), &trip).await;
        read.unwrap()
    };
    let start = |yaw_rad: f64| TripStart {
        corrections: corrections(yaw_rad),
        clock_ahead_ns: (yaw_rad * 1e10) as i64,
    };
    for (sequence, yaw_rad) in [0.1 / 3.0, 0.5].into_iter().enumerate() {
        let batch = upload(&format!("b{sequence}"), "t", sequence as i64);
        fixture.journal(batch).await;
        assert_eq!(known().await.is_some(), sequence > 0);
        let job = fixture.claim(0).await.unwrap();
        let mut result = fixture.result(&job, BatchStatus::Unanchored).await;
        result.trip_start = Some((trip.clone(), start(yaw_rad)));
        let applied = fixture.store.apply_result(result).await.unwrap();
        assert_eq!(applied, Applied::Committed);
        assert_eq!(known().await, Some(start(0.1 / 3.0)));
    }
    let vehicle = fixture.store.vehicle(&route(), &vehicle()).await.unwrap();
    assert_eq!(vehicle.unwrap().corrections, corrections(0.1 / 3.0));
}
