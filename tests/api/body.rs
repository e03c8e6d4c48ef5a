//! Bodies of uploads.

use std::io::Write;

use serde_json::{Value, json};

/// A small room's batch: `scans` scans of 8 beams, `sequence` of the trip `trip-1`.
pub fn batch(sequence: u32, scans: u32) -> Value {
    let scans: Vec<Value> = (0..scans)
        .map(|k| {
            json!({
                "stamp": format!("2026-11-20T06:{sequence:02}:{k:02}.000Z"),
                "odometry": {"x": 0.5 * f64::from(k), "y": 0.0, "theta": 0.0},
                "ranges": [2.0, 2.1, 2.2, null, 2.4, 2.5, 2.6, 2.7]
            })
        })
        .collect();
    json!({
        "vehicle_id": "agv-07", "trip_id": "trip-1", "sequence": sequence,
        "lidar": {"angle_min": -3.0, "angle_increment": 0.78, "range_min": 0.05, "range_max": 20.0},
        "scans": scans
    })
}

/// A valid batch with one place replaced.
pub fn batch_with(pointer: &str, value: Value) -> Value {
    let mut body = batch(0, 2);
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match body.pointer_mut(parent).unwrap() {
        Value::Object(object) => {
            object.insert(key.into(), value);
        }
        Value::Array(array) => array[key.parse::<usize>().unwrap()] = value,
        other => panic!("{other} has no places"),
    }
    body
}

pub fn gzip(plain: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(plain).unwrap();
    encoder.finish().unwrap()
}

pub fn zstd(plain: &[u8]) -> Vec<u8> {
    zstd::bulk::compress(plain, 3).unwrap()
}
