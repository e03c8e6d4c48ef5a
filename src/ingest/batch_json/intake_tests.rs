//! What drivers send beside the rules, and what becomes of it.

use proptest::prelude::*;
use serde_json::{Value, json};

use super::tests::{decode_value, received_at, valid, with};
use super::*;
use crate::geometry::Pose2;
use crate::scan::{LaserScan, Reading, SweepOrder};

fn readings(scan: &LaserScan) -> Vec<Reading> {
    (0..scan.beam_count())
        .map(|beam| scan.reading(beam))
        .collect()
}

#[test]
fn readings_outside_the_range_are_taken_for_what_they_are_and_counted() {
    use Reading::{Invalid, NoReturn, Range};
    let ranges = json!([-0.003, 0.0, 0.0499, 0.05]);
    let batch = decode_value(&with("/scans/1/ranges", Some(ranges))).unwrap();
    assert_eq!(
        readings(&batch.scans[1].scan),
        [Invalid, Invalid, Invalid, Range(0.05)]
    );
    // With the 25.0 and the 0.01 of the first scan.
    let RangeCounts {
        within,
        above_range_max,
        below_range_min,
        ..
    } = batch.ranges;
    assert_eq!((within, above_range_max, below_range_min), (2, 1, 4));
    let ranges = json!([3.4028234663852886e38, 20.0, null, 19.9]);
    let batch = decode_value(&with("/scans/1/ranges", Some(ranges))).unwrap();
    let read = readings(&batch.scans[1].scan);
    assert_eq!(read[..3], [NoReturn; 3]);
    assert_eq!(batch.ranges.above_range_max, 3);
    let sound = decode_value(&with("/scans/0/ranges", Some(json!([1, 2, 3, null])))).unwrap();
    assert!(sound.flags.is_empty(), "{:?}", sound.flags);
}

/// Twenty scans of 64 beams whose ranges are this many times as long.
fn scaled(factor: f64) -> Value {
    let mut body = valid();
    body["lidar"]["angle_increment"] = json!(0.04);
    let scans = (0..20).map(|k| {
        let ranges = (0..64).map(|beam| factor * (1.5 + 0.1 * f64::from((7 * beam + k) % 60)));
        json!({"stamp": format!("2026-11-20T06:00:{k:02}Z"),
               "odometry": {"x": 0.0, "y": 0.0, "theta": 0.0},
               "ranges": ranges.collect::<Vec<_>>()})
    });
    body["scans"] = scans.collect();
    body
}

#[test]
fn millimetres_are_refused_when_they_are_uploaded_and_no_large_number_for_no_return_is() {
    assert!(
        decode_value(&scaled(1.0))
            .unwrap()
            .ranges
            .check_units()
            .is_ok()
    );
    let batch = decode_value(&scaled(1e3)).unwrap();
    let error = batch.ranges.check_units().unwrap_err();
    assert_eq!(error.problem, BatchProblem::OutOfRange);
    assert!(
        error.detail.contains("did you send millimetres?"),
        "{error}"
    );
    for sentinel in [65.533, 4_000.0, 65_533.0, 3.4e38] {
        let mut body = scaled(1.0);
        for scan in body["scans"].as_array_mut().unwrap() {
            scan["ranges"] = json!(vec![sentinel; 64]);
        }
        let batch = decode_value(&body).unwrap();
        assert_eq!(batch.ranges.check_units(), Ok(()), "{sentinel}");
        assert_eq!(batch.flags, ["above_range_max", "empty_scans"]);
    }
}

/// A body whose beams are sent from the other end: the same sweep, clockwise.
fn clockwise(mut body: Value) -> Value {
    let beams = body["scans"][0]["ranges"].as_array().unwrap().len();
    let lidar = &mut body["lidar"];
    let increment_rad = lidar["angle_increment"].as_f64().unwrap();
    let last_rad = lidar["angle_min"].as_f64().unwrap() + (beams - 1) as f64 * increment_rad;
    lidar["angle_min"] = json!(last_rad);
    lidar["angle_max"] = json!(last_rad - (beams - 1) as f64 * increment_rad);
    lidar["angle_increment"] = json!(-increment_rad);
    for scan in body["scans"].as_array_mut().unwrap() {
        scan["ranges"].as_array_mut().unwrap().reverse();
    }
    body
}

#[test]
fn clockwise_scans_are_the_counter_clockwise_ones_from_the_other_end() {
    let sent = decode_value(&valid()).unwrap();
    let flipped = decode_value(&clockwise(valid())).unwrap();
    assert_eq!(
        flipped.flags,
        ["above_range_max", "below_range_min", "clockwise_scans"]
    );
    for (sent, flipped) in sent.scans.iter().zip(&flipped.scans) {
        assert_eq!(flipped.scan.ticks(), sent.scan.ticks());
        for beam in 0..4 {
            let apart_rad =
                flipped.scan.lidar().beam_angle_rad(beam) - sent.scan.lidar().beam_angle_rad(beam);
            assert!(apart_rad.abs() < 1e-12);
        }
    }
    let mut wrong = clockwise(valid());
    wrong["lidar"]["angle_max"] = json!(3.0);
    let error = decode_value(&wrong).unwrap_err();
    assert_eq!(error.pointer, "/lidar/angle_max");
    assert!(error.detail.contains("must be below"), "{error}");
}

/// Seen in a mirror, a counter-clockwise sweep is a clockwise one, and what is seen is its mirror image.
#[test]
fn the_times_of_clockwise_beams_run_backwards() {
    let mut body = scaled(1.0);
    body["lidar"]["mount"] = json!({"x": 0.2, "y": 0.1, "theta": 0.4});
    body["lidar"]["time_increment"] = json!(0.001);
    let mut mirrored = body.clone();
    let negated = |value: &Value| json!(-value.as_f64().unwrap());
    for field in ["angle_min", "angle_increment"] {
        mirrored["lidar"][field] = negated(&body["lidar"][field]);
    }
    for field in ["y", "theta"] {
        mirrored["lidar"]["mount"][field] = negated(&body["lidar"]["mount"][field]);
    }
    let (plain, mirrored) = (
        decode_value(&body).unwrap(),
        decode_value(&mirrored).unwrap(),
    );
    let motion = Pose2::new(0.1, 0.03, 0.15);
    let mirrored_motion = Pose2::new(0.1, -0.03, -0.15);
    for (plain, mirrored) in plain.scans.iter().zip(&mirrored.scans) {
        assert_eq!(
            (plain.beam_interval_s, mirrored.beam_interval_s),
            (0.001, -0.001)
        );
        let plain = plain.scan.undistorted(&motion, SweepOrder::FirstBeamFirst);
        let mirrored = mirrored
            .scan
            .undistorted(&mirrored_motion, SweepOrder::LastBeamFirst);
        let last = plain.beam_count() - 1;
        for beam in 0..=last {
            match (plain.reading(beam), mirrored.reading(last - beam)) {
                (Reading::Range(a_m), Reading::Range(b_m)) => {
                    assert!((a_m - b_m).abs() < 1.1e-3, "{beam}: {a_m} {b_m}");
                }
                (a, b) => assert_eq!(a, b, "{beam}"),
            }
        }
        assert!(plain.return_count() > 40);
    }
    // The interval that follows from the time of a turn runs backwards as well.
    let lidar = body["lidar"].as_object_mut().unwrap();
    lidar.remove("time_increment");
    lidar.insert("scan_time".into(), json!(0.4));
    let of_turn = decode_value(&clockwise(body)).unwrap();
    assert!(of_turn.scans[0].beam_interval_s < -0.002);
}

#[test]
fn stamps_in_another_form_are_explained() {
    for (stamp, said) in [
        (
            json!(1_795_154_400),
            "Unix seconds: send \"2026-11-20T06:00:00.000Z\"",
        ),
        (
            json!(1_795_154_400_250_i64),
            "milliseconds: send \"2026-11-20T06:00:00.250Z\"",
        ),
        (
            json!(1_795_154_400.25),
            "seconds: send \"2026-11-20T06:00:00.250Z\"",
        ),
        (
            json!(1_795_154_400_250_000_000_i64),
            "nanoseconds: send \"2026-11-20T06:00:00.250Z\"",
        ),
        (json!(-1e300), "send an RFC 3339 time"),
        (
            json!({"sec": 1_795_154_400, "nanosec": 0}),
            "ROS's sec and nanosec",
        ),
        (json!("20.11.2026 06:00"), "as \"2026-11-20T06:00:00.000Z\""),
        (json!(null), "RFC 3339"),
    ] {
        let error = decode_value(&with("/scans/1/stamp", Some(stamp.clone()))).unwrap_err();
        assert_eq!(
            error.problem,
            BatchProblem::InvalidField,
            "{stamp}: {error}"
        );
        assert_eq!(error.pointer, "/scans/1/stamp", "{error}");
        assert!(error.detail.contains(said), "{stamp}: {error}");
    }
}

#[test]
fn degrees_are_suspected() {
    let mut body = scaled(1.0);
    body["lidar"]["angle_increment"] = json!(0.5);
    let error = decode_value(&body).unwrap_err();
    assert_eq!(error.pointer, "/scans/0/ranges");
    assert!(error.detail.contains("did you send degrees?"), "{error}");
}

#[test]
fn extensions_are_kept_as_they_were_sent() {
    let sent = r#"{ "b": 1.50, "a": [null, "\u00fc {[", 12345678901234567890123] }"#;
    let text = valid()
        .to_string()
        .replacen('{', &format!("{{\"extensions\": {sent},"), 1);
    let batch = decode(text.as_bytes(), received_at()).unwrap();
    assert_eq!(batch.extensions.as_deref(), Some(sent));
    let none = decode_value(&with("/extensions", Some(Value::Null))).unwrap();
    assert_eq!(none.extensions, None);
    let fits = json!({"note": "x".repeat(16 * 1024 - 11)});
    assert!(decode_value(&with("/extensions", Some(fits))).is_ok());
    let deep = |depth: usize| {
        let nested: Result<Value, _> =
            serde_json::from_str(&("[".repeat(depth - 1) + &"]".repeat(depth - 1)));
        json!({"nested": nested.unwrap()})
    };
    assert!(decode_value(&with("/extensions", Some(deep(8)))).is_ok());
    for (extensions, said) in [
        (
            json!({"note": "x".repeat(16 * 1024 - 10)}),
            "at most 16384 bytes, these have 16385",
        ),
        (deep(9), "no deeper than 8"),
    ] {
        let error = decode_value(&with("/extensions", Some(extensions))).unwrap_err();
        assert_eq!(error.pointer, "/extensions");
        assert!(error.detail.contains(said), "{error}");
    }
}

fn any_range() -> impl Strategy<Value = Option<f64>> {
    let extremes = [-0.0, 0.0, 0.05, 20.0, f64::MAX, f64::MIN, f64::MIN_POSITIVE];
    prop_oneof![
        Just(None),
        (-1.0..30.0_f64).prop_map(Some),
        any::<f64>().prop_map(|range_m| range_m.is_finite().then_some(range_m)),
        prop::sample::select(extremes.to_vec()).prop_map(Some),
    ]
}

proptest! {
    /// Whatever a driver sends for a beam, the beam is a measurement, no return, or invalid, and the
    /// counts say so.
    #[test]
    fn every_beam_is_counted_once(
        ranges in prop::collection::vec(any_range(), 2..60),
        is_clockwise in any::<bool>(),
    ) {
        let mut body = with("/lidar/angle_increment", Some(json!(0.1)));
        body["scans"].as_array_mut().unwrap().truncate(1);
        body["scans"][0]["ranges"] = json!(ranges);
        if is_clockwise {
            body = clockwise(body);
        }
        let batch = decode_value(&body).unwrap();
        let read = readings(&batch.scans[0].scan);
        let count = |is_one: fn(&Reading) -> bool| read.iter().filter(|r| is_one(r)).count() as u64;
        let nulls = ranges.iter().filter(|range| range.is_none()).count() as u64;
        let RangeCounts { within, above_range_max, below_range_min, .. } = batch.ranges;
        prop_assert_eq!(within + above_range_max + below_range_min + nulls, ranges.len() as u64);
        prop_assert_eq!(within, count(|r| matches!(r, Reading::Range(_))));
        prop_assert_eq!(above_range_max + nulls, count(|r| *r == Reading::NoReturn));
        prop_assert_eq!(below_range_min, count(|r| *r == Reading::Invalid));
        let flagged = |flag: &str| batch.flags.iter().any(|f| f == flag);
        prop_assert_eq!(flagged("above_range_max"), above_range_max > 0);
        prop_assert_eq!(flagged("below_range_min"), below_range_min > 0);
        prop_assert_eq!(flagged("clockwise_scans"), is_clockwise);
    }
}
