//! A synthetic room that is driven through to and fro.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::experiments::recording::Recording;
use crate::geometry::{Pose2, Vector2};
use crate::ids::{StampNs, TripId};
use crate::ingest::RecordedScan;
use crate::scan::Lidar;
use crate::sim::{Shape, normal};

/// A room of 8 m × 5 m, one scan a second and 0.2 m on a line at y = 0 from x = 1 to 7 m and back,
/// with no noise in its odometry; `late` stands there from the second half on.
pub(crate) fn room(count: usize, late: Option<&Shape>) -> Vec<Recording> {
    let lidar = Lidar {
        angle_min_rad: -3.1,
        angle_increment_rad: 0.02,
        range_min_m: 0.05,
        range_max_m: 12.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
        band: None,
    };
    let walls = Shape::rectangle(&Pose2::new(4.0, 0.5, 0.0), 8.0, 5.0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let scan = |k: usize| {
        let way_m = 0.2 * (k % 60) as f64;
        let x = 1.0 + if way_m > 6.0 { 12.0 - way_m } else { way_m };
        let eye = Vector2::new(x, 0.0);
        let range_m = |direction: Vector2<f64>| {
            let late = late.filter(|_| 2 * k >= count);
            let shapes = std::iter::once(&walls).chain(late);
            let hits = shapes.filter_map(|shape| shape.distance_along(&eye, &direction));
            let range_m = hits.min_by(f64::total_cmp)?;
            Some(range_m + normal(&mut rng, 0.01))
        };
        RecordedScan {
            stamp: StampNs(k as i64 * 1_000_000_000),
            odom_from_base: Pose2::new(x, 0.0, 0.0),
            ranges_m: lidar.beam_directions(311).map(range_m).collect(),
        }
    };
    let scans = (0..count).map(scan).collect();
    vec![Recording {
        trip: TripId::new("room").unwrap(),
        lidar: Arc::new(lidar),
        scans,
    }]
}

/// The poses of its scans: its odometry is its map.
pub(crate) fn posed(recordings: &[Recording]) -> BTreeMap<StampNs, Pose2> {
    let scans = recordings.iter().flat_map(|r| &r.scans);
    scans
        .map(|scan| (scan.stamp, scan.odom_from_base))
        .collect()
}
