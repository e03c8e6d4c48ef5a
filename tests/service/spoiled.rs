//! Uploads with something wrong in every scan.

use serde_json::{Value, json};

use crate::drives::Batch;

/// The same batch with its scans changed, by their place.
pub fn with_scans(batch: &Batch, change: impl Fn(usize, &mut Value)) -> Batch {
    let mut body: Value = serde_json::from_slice(&batch.body).unwrap();
    let scans = body["scans"].as_array_mut().unwrap();
    for (k, scan) in scans.iter_mut().enumerate() {
        change(k, scan);
    }
    Batch {
        id: batch.id.clone(),
        body: serde_json::to_vec(&body).unwrap(),
    }
}

/// The same scans without any return.
pub fn blind(batch: &Batch) -> Batch {
    with_scans(batch, |_, scan| {
        for range in scan["ranges"].as_array_mut().unwrap() {
            *range = Value::Null;
        }
    })
}

/// Odometry that jumps by kilometres and spins.
pub fn wild(batch: &Batch) -> Batch {
    with_scans(batch, |k, scan| {
        let far = [9e5, -9e5, 3e3, 0.0][k % 4];
        scan["odometry"] = json!({"x": far, "y": 0.5 * far, "theta": (2 * k) as f64});
    })
}
