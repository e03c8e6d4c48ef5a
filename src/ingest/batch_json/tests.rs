use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::scan::{BandView, HeightBand};

pub(super) fn received_at() -> Timestamp {
    "2026-11-20T07:00:00Z".parse().unwrap()
}

pub(super) fn valid() -> Value {
    json!({
        "vehicle_id": "agv-07", "trip_id": "2026-11-20-a", "sequence": 0,
        "lidar": {"angle_min": -1.5, "angle_increment": 0.5, "range_min": 0.05, "range_max": 20.0,
                  "mount": {"x": 0.2, "y": 0.0, "theta": 0.1}, "range_sigma": 0.02},
        "initial_pose": {"x": 3.5, "y": 3.4, "theta": 0.02, "sigma_xy": 0.3, "sigma_theta": 0.1},
        "scans": [
            {"stamp": "2026-11-20T06:00:00.000Z", "odometry": {"x": 0.0, "y": 0.0, "theta": 0.0},
             "ranges": [1.5, null, 25.0, 0.01]},
            {"stamp": "2026-11-20T06:00:00.100Z", "odometry": {"x": 0.1, "y": 0.0, "theta": 0.0},
             "ranges": [1.5, 2.5, 3.5, 4.5]}
        ]
    })
}

/// The valid body with one place replaced, or removed by `None`.
pub(super) fn with(pointer: &str, value: Option<Value>) -> Value {
    let mut body = valid();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match (body.pointer_mut(parent).unwrap(), value) {
        (Value::Object(object), Some(value)) => {
            object.insert(key.into(), value);
        }
        (Value::Object(object), None) => {
            object.remove(key);
        }
        (Value::Array(array), Some(value)) => array[key.parse::<usize>().unwrap()] = value,
        _ => panic!("{pointer} cannot be set"),
    }
    body
}

pub(super) fn decode_value(body: &Value) -> Result<UploadedBatch, BatchBodyError> {
    decode(&serde_json::to_vec(body).unwrap(), received_at())
}

#[test]
fn a_valid_body_keeps_every_value() {
    let batch = decode_value(&valid()).unwrap();
    assert_eq!(batch.vehicle_id.as_str(), "agv-07");
    assert_eq!(batch.sequence, 0);
    assert_eq!(batch.flags, ["above_range_max", "below_range_min"]);
    assert_eq!(batch.extensions, None);
    let initial = batch.initial_pose.unwrap();
    assert_eq!((initial.sigma_xy_m, initial.sigma_theta_rad), (0.3, 0.1));
    assert_eq!(batch.scans.len(), 2);
    assert_eq!(batch.scans[0].stamp, StampNs(1_795_154_400_000_000_000));
    assert_eq!(batch.scans[1].odom_from_base, Pose2::new(0.1, 0.0, 0.0));
    let ranges: Vec<_> = batch.scans[0].scan.ranges_m().collect();
    assert_eq!(ranges, [Some(1.5), None, None, None]);
    assert_eq!(batch.scans[0].scan.lidar().mount, Pose2::new(0.2, 0.0, 0.1));
}

#[test]
fn what_is_optional_may_be_missing_or_null() {
    for value in [None, Some(Value::Null)] {
        for pointer in ["/initial_pose", "/lidar/mount", "/lidar/range_sigma"] {
            assert!(decode_value(&with(pointer, value.clone())).is_ok());
        }
    }
    let batch = decode_value(&with("/initial_pose/sigma_xy", None)).unwrap();
    assert_eq!(batch.initial_pose.unwrap().sigma_xy_m, 0.5);
    let with_intensities = with("/scans/0/intensities", Some(json!([1, 2, null, 4.5])));
    assert!(decode_value(&with_intensities).is_ok());
    assert!(decode_value(&with("/lidar/angle_max", Some(json!(0.0)))).is_ok());
}

#[test]
fn the_time_of_a_beam_is_that_which_is_stated() {
    let interval_s = |times: Value| {
        let mut body = valid();
        let lidar = body["lidar"].as_object_mut().unwrap();
        lidar.extend(times.as_object().unwrap().clone());
        decode_value(&body).map(|batch| batch.scans[1].beam_interval_s)
    };
    assert_eq!(interval_s(json!({})).unwrap(), 0.0);
    assert_eq!(interval_s(json!({"time_increment": 0.01})).unwrap(), 0.01);
    // Beams of half a radian, a turn in 0.1 s.
    let of_turn_s = interval_s(json!({"scan_time": 0.1})).unwrap();
    assert!((of_turn_s - 0.05 / std::f64::consts::TAU).abs() < 1e-12);
    let both = json!({"scan_time": 0.1, "time_increment": 0.02});
    assert_eq!(interval_s(both).unwrap(), 0.02);
    // Four beams 0.04 s apart do not fit into a tenth of a second.
    let error = interval_s(json!({"scan_time": 0.1, "time_increment": 0.04})).unwrap_err();
    assert_eq!(error.pointer, "/lidar/time_increment");
    assert!(error.detail.contains("0.120 s"), "{error}");
}

#[test]
fn a_height_band_is_kept_and_is_seen_all_the_way_unless_it_says_otherwise() {
    let band_of = |band: Value| {
        let batch = decode_value(&with("/lidar/band", Some(band))).unwrap();
        batch.scans[1].scan.lidar().band
    };
    let band = HeightBand::new(0.1, 0.4).unwrap();
    assert_eq!(band_of(Value::Null), None);
    let all_the_way = BandView::all_the_way(band, 20.0);
    assert_eq!(band_of(json!({"from": 0.1, "to": 0.4})), Some(all_the_way));
    let stated = json!({"from": 0.1, "to": 0.4, "clear_from": 1.5, "clear_to": 6.0});
    let in_part = BandView {
        band,
        clear_from_m: 1.5,
        clear_to_m: 6.0,
    };
    assert_eq!(band_of(stated), Some(in_part));
}

#[test]
fn a_band_that_makes_no_sense_is_explained() {
    for (band, problem, pointer, said) in [
        (
            json!({"from": 0.4, "to": 0.1}),
            BatchProblem::OutOfRange,
            "/lidar/band",
            "goes up by",
        ),
        (
            json!({"from": 0.4, "to": 0.4}),
            BatchProblem::OutOfRange,
            "/lidar/band",
            "goes up by",
        ),
        (
            json!({"from": 100, "to": 400}),
            BatchProblem::OutOfRange,
            "/lidar/band",
            "above the floor",
        ),
        (
            json!({"from": 0.1, "to": 0.4, "clear_from": 9.0, "clear_to": 2.0}),
            BatchProblem::OutOfRange,
            "/lidar/band/clear_from",
            "distances from the lidar",
        ),
        (
            json!({"from": 0.1}),
            BatchProblem::InvalidField,
            "/lidar/band",
            "missing field",
        ),
        (
            json!([0.1, 0.4]),
            BatchProblem::InvalidField,
            "/lidar/band",
            "",
        ),
        (
            json!({"from": 0.1, "to": 0.4, "by": 1}),
            BatchProblem::MalformedJson,
            "/lidar/band/by",
            "",
        ),
    ] {
        let error = decode_value(&with("/lidar/band", Some(band))).unwrap_err();
        assert_eq!(
            (error.problem, &*error.pointer),
            (problem, pointer),
            "{error}"
        );
        assert!(error.detail.contains(said), "{error}");
    }
}

#[test]
fn each_mistake_names_its_kind_and_place() {
    use BatchProblem::{InvalidField, MalformedJson, OutOfRange, ScanGeometry, TimestampOrder};
    let cases = [
        ("/vehicle_id", Some(json!("a b")), InvalidField),
        ("/trip_id", Some(json!("")), InvalidField),
        ("/sequence", Some(json!(-1)), InvalidField),
        ("/sequence", Some(json!("0")), InvalidField),
        ("/lidar", Some(json!([1, 2, 3, 4])), InvalidField),
        ("/surprise", Some(json!(1)), MalformedJson),
        ("/lidar/angle_increment", Some(json!(2.0)), ScanGeometry),
        ("/lidar/angle_increment", Some(json!(0)), ScanGeometry),
        ("/lidar/angle_increment", Some(json!(-2.0)), ScanGeometry),
        ("/lidar/angle_increment", Some(json!(-1e-9)), ScanGeometry),
        ("/lidar/angle_min", Some(json!(-180)), ScanGeometry),
        ("/lidar/angle_max", Some(json!(-2.0)), ScanGeometry),
        ("/lidar/angle_max", Some(json!(3.0)), ScanGeometry),
        ("/lidar/range_min", Some(json!(20.0)), ScanGeometry),
        ("/lidar/range_max", Some(json!(501)), ScanGeometry),
        ("/lidar/mount/x", Some(json!(1e39)), OutOfRange),
        ("/lidar/range_sigma", Some(json!(0)), OutOfRange),
        ("/lidar/scan_time", Some(json!(-0.1)), OutOfRange),
        ("/lidar/scan_time", Some(json!(100)), OutOfRange),
        ("/lidar/time_increment", Some(json!(-1e-4)), OutOfRange),
        ("/lidar/time_increment", Some(json!(1.0)), OutOfRange),
        ("/initial_pose/sigma_xy", Some(json!(0)), OutOfRange),
        ("/initial_pose/sigma_theta", Some(json!(5.7)), OutOfRange),
        ("/initial_pose/theta", Some(json!(1e6)), OutOfRange),
        ("/scans", Some(json!([])), ScanGeometry),
        ("/scans/1/ranges", Some(json!([1.0])), ScanGeometry),
        ("/scans/0/intensities", Some(json!([1.0])), ScanGeometry),
        ("/extensions", Some(json!([1])), InvalidField),
        ("/extensions", Some(json!("4.2")), InvalidField),
        ("/scans/0/extensions", Some(json!({})), MalformedJson),
        ("/scans/0/ranges/2", Some(json!("far")), InvalidField),
        ("/scans/1/odometry/x", Some(json!(1e39)), OutOfRange),
        ("/scans/1/stamp", Some(json!("yesterday")), InvalidField),
        (
            "/scans/1/stamp",
            Some(json!("1969-12-31T23:59:59Z")),
            OutOfRange,
        ),
        (
            "/scans/1/stamp",
            Some(json!("2100-01-01T00:00:00Z")),
            OutOfRange,
        ),
        (
            "/scans/1/stamp",
            Some(json!("2026-11-20T06:00:00Z")),
            TimestampOrder,
        ),
    ];
    for (pointer, value, problem) in cases {
        let error = decode_value(&with(pointer, value)).unwrap_err();
        assert_eq!(error.problem, problem, "{pointer}: {error}");
        assert_eq!(error.pointer, pointer, "{error}");
    }
}

/// A body of two lidars with different fans; the rear one's scan shares a stamp with the front's.
fn of_two_lidars() -> Value {
    let mut body = valid();
    let fields = body.as_object_mut().unwrap();
    fields.remove("lidar");
    fields.insert(
        "lidars".into(),
        json!([
            {"id": "front", "angle_min": -1.5, "angle_increment": 0.5, "range_min": 0.05,
             "range_max": 20.0, "mount": {"x": 0.2, "y": 0.0, "theta": 0.0}},
            {"id": "rear", "angle_min": -0.7, "angle_increment": 0.7, "angle_max": 0.7,
             "range_min": 0.1, "range_max": 10.0, "mount": {"x": -0.2, "y": 0.0, "theta": 3.1},
             "time_increment": 0.01},
        ]),
    );
    let scan = |stamp: &str, lidar: &str, ranges: Value| {
        let odometry = json!({"x": 0.0, "y": 0.0, "theta": 0.0});
        json!({"stamp": stamp, "lidar": lidar, "odometry": odometry, "ranges": ranges})
    };
    fields.insert(
        "scans".into(),
        json!([
            scan("2026-11-20T06:00:00Z", "rear", json!([1, 2, 3])),
            scan("2026-11-20T06:00:00Z", "front", json!([1, 2, 3, 4])),
            scan("2026-11-20T06:00:00.1Z", "front", json!([1, 2, 3, 4])),
            scan("2026-11-20T06:00:00.1Z", "rear", json!([1, null, 3])),
        ]),
    );
    body
}

#[test]
fn each_scan_is_one_of_the_lidar_it_names() {
    let batch = decode_value(&of_two_lidars()).unwrap();
    assert!(batch.flags.is_empty(), "{:?}", batch.flags);
    let which = batch.scans.iter().map(|scan| {
        let name = scan.lidar.name.as_ref().unwrap();
        (name.as_str(), scan.lidar.place, scan.scan.beam_count())
    });
    let expected = [
        ("rear", 1, 3),
        ("front", 0, 4),
        ("front", 0, 4),
        ("rear", 1, 3),
    ];
    assert_eq!(which.collect::<Vec<_>>(), expected);
    let [rear, front] = [&batch.scans[0], &batch.scans[1]];
    assert_eq!(rear.scan.lidar().mount, Pose2::new(-0.2, 0.0, 3.1));
    assert_eq!(front.scan.lidar().mount, Pose2::new(0.2, 0.0, 0.0));
    assert_eq!((rear.beam_interval_s, front.beam_interval_s), (0.01, 0.0));
    // One that took no scan, and one alone with a name.
    let mut body = of_two_lidars();
    body["scans"]
        .as_array_mut()
        .unwrap()
        .retain(|scan| scan["lidar"] == "front");
    assert_eq!(decode_value(&body).unwrap().scans.len(), 2);
    body["lidars"].as_array_mut().unwrap().truncate(1);
    assert_eq!(decode_value(&body).unwrap().scans.len(), 2);
}

#[test]
fn mistakes_with_several_lidars_are_explained() {
    use BatchProblem::{InvalidField, MalformedJson, OutOfRange, ScanGeometry, TimestampOrder};
    let refused = |pointer: &str, value: Option<Value>| {
        let mut body = of_two_lidars();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        let parent = body.pointer_mut(parent).unwrap();
        match (parent, value) {
            (Value::Object(fields), Some(value)) => drop(fields.insert(key.into(), value)),
            (Value::Object(fields), None) => drop(fields.remove(key)),
            (place, value) => place[key.parse::<usize>().unwrap()] = value.unwrap(),
        }
        decode_value(&body).unwrap_err()
    };
    let lidar = &of_two_lidars()["lidars"][0];
    let nine = (0..9).map(|k| {
        let mut lidar = lidar.clone();
        lidar["id"] = json!(format!("l{k}"));
        lidar
    });
    let nine = Value::Array(nine.collect());
    let cases = [
        (
            "/lidar",
            Some(lidar.clone()),
            InvalidField,
            "/lidars",
            "either",
        ),
        ("/lidars", None, InvalidField, "", "`lidars`"),
        (
            "/lidars",
            Some(json!([])),
            InvalidField,
            "/lidars",
            "1 to 8",
        ),
        (
            "/lidars",
            Some(nine),
            InvalidField,
            "/lidars",
            "1 to 8 lidars, this one 9",
        ),
        ("/lidars", Some(json!({})), InvalidField, "/lidars", "array"),
        (
            "/lidars/1/id",
            None,
            InvalidField,
            "/lidars/1",
            "missing field `id`",
        ),
        (
            "/lidars/1/id",
            Some(json!("front")),
            InvalidField,
            "/lidars/1/id",
            "same",
        ),
        (
            "/lidars/1/id",
            Some(json!("a b")),
            InvalidField,
            "/lidars/1/id",
            "characters",
        ),
        (
            "/lidars/1/surprise",
            Some(json!(1)),
            MalformedJson,
            "/lidars/1/surprise",
            "unknown",
        ),
        (
            "/lidars/1/range_max",
            Some(json!(501)),
            ScanGeometry,
            "/lidars/1/range_max",
            "range_max",
        ),
        (
            "/lidars/1/mount/x",
            Some(json!(1e39)),
            OutOfRange,
            "/lidars/1/mount/x",
            "metres",
        ),
        (
            "/lidars/1/angle_max",
            Some(json!(9.0)),
            ScanGeometry,
            "/lidars/1/angle_max",
            "beams",
        ),
        (
            "/lidars/1/scan_time",
            Some(json!(-1)),
            OutOfRange,
            "/lidars/1/scan_time",
            "scan_time",
        ),
        (
            "/lidars/1/time_increment",
            Some(json!(2)),
            OutOfRange,
            "/lidars/1/time_increment",
            "s",
        ),
        (
            "/scans/2/lidar",
            None,
            InvalidField,
            "/scans/2",
            "front, rear",
        ),
        (
            "/scans/2/lidar",
            Some(json!("top")),
            InvalidField,
            "/scans/2/lidar",
            "front, rear",
        ),
        (
            "/scans/3/ranges",
            Some(json!([1])),
            ScanGeometry,
            "/scans/3/ranges",
            "lidar rear",
        ),
        (
            "/scans/2/stamp",
            Some(json!("2026-11-20T06:00:00Z")),
            TimestampOrder,
            "/scans/2/stamp",
            "of lidar front",
        ),
        (
            "/scans/3/stamp",
            Some(json!("2026-11-20T06:00:00.05Z")),
            TimestampOrder,
            "/scans/3/stamp",
            "whichever lidar",
        ),
    ];
    for (spoilt, value, problem, pointer, says) in cases {
        let error = refused(spoilt, value);
        assert_eq!(
            (error.problem, error.pointer.as_str()),
            (problem, pointer),
            "{error}"
        );
        assert!(error.detail.contains(says), "{spoilt}: {error}");
    }
    for (pointer, value) in [
        ("/lidar/id", json!("front")),
        ("/scans/0/lidar", json!("front")),
    ] {
        let error = decode_value(&with(pointer, Some(value))).unwrap_err();
        assert_eq!(
            (error.problem, error.pointer.as_str()),
            (MalformedJson, pointer),
            "{error}"
        );
    }
    for missing in [None, Some(Value::Null)] {
        let error = decode_value(&with("/lidar", missing)).unwrap_err();
        assert_eq!(
            (error.problem, error.pointer.as_str()),
            (InvalidField, ""),
            "{error}"
        );
    }
}

#[test]
fn a_missing_field_points_to_its_parent() {
    for (pointer, parent) in [
        ("/vehicle_id", ""),
        ("/lidar/angle_min", "/lidar"),
        ("/scans/1/ranges", "/scans/1"),
    ] {
        let error = decode_value(&with(pointer, None)).unwrap_err();
        assert_eq!(error.problem, BatchProblem::InvalidField);
        assert_eq!(error.pointer, parent);
        assert!(error.detail.contains("missing field"), "{error}");
    }
}

#[test]
fn what_is_too_much_is_counted_without_being_kept() {
    let scan = |beams: usize| json!({"stamp": "2026-11-20T06:00:00Z", "odometry": {"x": 0, "y": 0, "theta": 0}, "ranges": vec![1; beams]});
    let error = decode_value(&with("/scans", Some(json!([scan(8_193)])))).unwrap_err();
    assert_eq!(error.problem, BatchProblem::ScanGeometry);
    assert!(error.detail.contains("8193"), "{error}");
    let error = decode_value(&with("/scans", Some(json!(vec![scan(1); 5_001])))).unwrap_err();
    assert_eq!(error.problem, BatchProblem::ScanGeometry);
    assert!(error.detail.contains("5001"), "{error}");
    let error = decode_value(&with("/scans", Some(json!(vec![scan(8_000); 501])))).unwrap_err();
    assert_eq!(error.problem, BatchProblem::TooLarge);
}

#[test]
fn a_literal_of_another_language_is_explained() {
    let text = valid().to_string().replacen("25.0", "Infinity", 1);
    let error = decode(text.as_bytes(), received_at()).unwrap_err();
    assert_eq!(error.problem, BatchProblem::MalformedJson);
    assert_eq!(error.pointer, "/scans/0/ranges/2");
    assert!(error.detail.contains("REP-117"), "{error}");
    let text = valid().to_string().replacen("25.0", "1e400", 1);
    let error = decode(text.as_bytes(), received_at()).unwrap_err();
    assert_eq!(error.problem, BatchProblem::OutOfRange);
}

#[test]
fn oddities_are_flagged_not_refused() {
    let flags_of = |pointer, value| {
        let flags = decode_value(&with(pointer, Some(value))).unwrap().flags;
        let is_new = |flag: &String| !matches!(&**flag, "above_range_max" | "below_range_min");
        flags.into_iter().filter(is_new).collect::<Vec<_>>()
    };
    assert_eq!(
        flags_of("/scans/1/odometry/x", json!(6.0)),
        ["wild_odometry"]
    );
    let empty = json!([null, null, null, null]);
    assert_eq!(flags_of("/scans/1/ranges", empty), ["empty_scans"]);
    let future = json!("2026-11-21T07:00:00.001Z");
    assert_eq!(flags_of("/scans/1/stamp", future), ["clock_skew"]);
    let past = json!("2026-10-20T06:00:00Z");
    assert_eq!(flags_of("/scans/0/stamp", past), ["late"]);
    // Neither late nor a wrong clock.
    let simulated = json!("1970-01-01T00:00:12.5Z");
    assert_eq!(flags_of("/scans/0/stamp", simulated), ["simulated_time"]);
}

proptest! {
    #[test]
    fn mutated_bodies_never_panic(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
        cuts in any::<bool>(),
    ) {
        let mut body = serde_json::to_vec(&valid()).unwrap();
        for (place, byte) in changes {
            let place = place.index(body.len());
            body[place] = byte;
        }
        if cuts {
            body.truncate(cut.index(body.len()));
        }
        if let Err(error) = decode(&body, received_at()) {
            prop_assert!(!error.detail.is_empty());
        }
    }

    #[test]
    fn any_number_in_any_place_is_finite_afterwards(
        place in prop::sample::select(vec![
            "/lidar/angle_min", "/lidar/angle_increment", "/lidar/range_min", "/lidar/range_max",
            "/lidar/mount/x", "/lidar/mount/theta", "/lidar/range_sigma", "/initial_pose/x",
            "/initial_pose/sigma_xy", "/scans/0/odometry/x", "/scans/0/odometry/theta",
            "/scans/0/ranges/0",
        ]),
        value in prop_oneof![any::<f64>(), -10.0..10.0_f64],
    ) {
        if let Ok(batch) = decode_value(&with(place, Some(json!(value)))) {
            prop_assert!(batch.scans.iter().all(|s| s.odom_from_base.is_finite()));
            prop_assert!(batch.scans.iter().all(|s| s.scan.ranges_m().flatten().all(f64::is_finite)));
            prop_assert!(batch.initial_pose.unwrap().pose.is_finite());
        }
    }
}
