//! A lidar with many rings, and the virtual scans that a gateway makes of its clouds.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::normal;
use super::{Scene, Shape, World};
use crate::geometry::{Pose2, Vector2};
use crate::scan::CloudLidar;

/// How tall people are, metres.
const PERSON_M: f64 = 1.75;

/// A 3D lidar with its faults.
#[derive(Debug, Clone, PartialEq)]
pub struct SimCloudLidar {
    /// Where it sits, and its rings; a ring has a ray for each beam of a virtual scan.
    pub lidar: CloudLidar,
    /// Share of the rays that give no return though something is there.
    pub dropout_rate: f64,
}

/// A solid between two heights above the floor, metres.
struct Solid<'a> {
    shape: &'a Shape,
    middle: Vector2<f64>,
    reach_m: f64,
    heights_m: (f64, f64),
}

impl<'a> Solid<'a> {
    fn new(shape: &'a Shape, heights_m: (f64, f64)) -> Self {
        let (middle, reach_m) = shape.bounding_circle();
        Self {
            shape,
            middle,
            reach_m,
            heights_m,
        }
    }

    /// Distances along the floor between which rays in a direction are in it; those of a building
    /// that it stands round the eye, as a room does, are its walls, without thickness.
    fn spans(&self, eye: &Vector2<f64>, direction: &Vector2<f64>) -> Vec<(f64, f64)> {
        let to_middle = self.middle - eye;
        let across = direction.x * to_middle.y - direction.y * to_middle.x;
        if across.abs() > self.reach_m || to_middle.dot(direction) < -self.reach_m {
            return Vec::new();
        }
        let crossings = self.shape.crossings(eye, direction);
        if crossings.len() % 2 == 1 {
            return crossings.into_iter().map(|at_m| (at_m, at_m)).collect();
        }
        crossings
            .chunks_exact(2)
            .map(|pair| (pair[0], pair[1]))
            .collect()
    }

    /// Where a ray first is in it, if it is over a span.
    fn met_within(&self, span: (f64, f64), height_m: f64, slope: f64) -> Option<f64> {
        let (low_m, high_m) = self.heights_m;
        let at_entry_m = height_m + slope * span.0;
        if (low_m..=high_m).contains(&at_entry_m) {
            return Some(span.0);
        }
        let face_m = if at_entry_m > high_m { high_m } else { low_m };
        let met_m = (face_m - height_m) / slope;
        (span.0 < met_m && met_m <= span.1).then_some(met_m)
    }
}

impl SimCloudLidar {
    /// The points at which its rays ended, as [`BandScanner::scan`](crate::scan::BandScanner::scan)
    /// wants them: from the lidar, in its directions, metres.
    pub(super) fn cloud(
        &self,
        scene: &Scene,
        lap: usize,
        people: &World,
        map_from_base: &Pose2,
        rng: &mut ChaCha8Rng,
    ) -> Vec<[f64; 3]> {
        let there = scene.objects.iter().filter(|object| object.is_there(lap));
        let things = there.map(|object| Solid::new(&object.shape, object.heights_m));
        let people = people
            .shapes()
            .map(|body| Solid::new(body, (0.0, PERSON_M)));
        let solids: Vec<Solid<'_>> = things.chain(people).collect();
        let map_from_lidar = map_from_base.compose(&self.lidar.mount);
        let eye = map_from_lidar.translation();
        let mut points = Vec::new();
        for beam in 0..self.lidar.beams {
            let turn_rad = std::f64::consts::TAU * (beam as f64 / self.lidar.beams as f64 - 0.5);
            let (sin, cos) = (map_from_lidar.theta + turn_rad).sin_cos();
            let direction = Vector2::new(cos, sin);
            let spans: Vec<(usize, (f64, f64))> = (solids.iter().enumerate())
                .flat_map(|(k, solid)| {
                    let spans = solid.spans(&eye, &direction);
                    spans.into_iter().map(move |span| (k, span))
                })
                .collect();
            let (sin, cos) = turn_rad.sin_cos();
            for elevation_rad in &self.lidar.elevations_rad {
                // Drawn for every ray, so that a change leaves the others as they were.
                let noise_m = normal(rng, self.lidar.range_sigma_m);
                let dropped = rng.random::<f64>() < self.dropout_rate;
                let slope = elevation_rad.tan();
                let height_m = self.lidar.height_m;
                let met = spans
                    .iter()
                    .filter_map(|(k, span)| solids[*k].met_within(*span, height_m, slope));
                let floor_m = (slope < 0.0).then(|| -height_m / slope);
                let Some(met_m) = met.chain(floor_m).min_by(f64::total_cmp) else {
                    continue;
                };
                let range_m = met_m / elevation_rad.cos() + noise_m;
                if !dropped && range_m < self.lidar.range_max_m {
                    let along_m = range_m * elevation_rad.cos();
                    points.push([along_m * cos, along_m * sin, range_m * elevation_rad.sin()]);
                }
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{BandScanner, HeightBand, LaserScan, Reading};
    use crate::sim::random::{Purpose, stream};
    use crate::sim::{Furniture, Route, SceneObject};

    fn lidar() -> SimCloudLidar {
        SimCloudLidar {
            lidar: CloudLidar {
                mount: Pose2::new(0.1, 0.0, 0.3),
                height_m: 0.8,
                elevations_rad: (0..32).map(|k| f64::from(k - 16).to_radians()).collect(),
                beams: 180,
                range_min_m: 0.1,
                range_max_m: 30.0,
                range_sigma_m: 1e-9,
            },
            dropout_rate: 0.0,
        }
    }

    /// A room of 8 m × 6 m with a table ahead.
    fn scan(band: (f64, f64)) -> LaserScan {
        let corners = [(-2.0, 0.0), (2.0, 0.0), (0.0, 2.0)].map(|(x, y)| Vector2::new(x, y));
        let room = Shape::rectangle(&Pose2::IDENTITY, 8.0, 6.0);
        let mut scene = Scene::lasting(Route::new(&corners, 0.1).unwrap(), [room], 1);
        let table = Furniture::Table;
        let parts = table
            .parts(&table.outline(&Pose2::new(2.0, 0.0, 0.0)))
            .unwrap();
        scene
            .objects
            .extend(parts.into_iter().map(|(shape, heights_m)| SceneObject {
                heights_m,
                ..SceneObject::lasting(shape)
            }));
        let lidar = lidar();
        let mut rng = stream(1, Purpose::Ranges { from_lap: 0 });
        let pose = lidar.lidar.mount.inverse();
        let cloud = lidar.cloud(&scene, 0, &World::new([]), &pose, &mut rng);
        let band = HeightBand::new(band.0, band.1).unwrap();
        BandScanner::new(&lidar.lidar, band, 0.1)
            .unwrap()
            .scan(cloud)
            .unwrap()
    }

    #[test]
    fn a_table_is_a_top_in_one_band_and_legs_in_another() {
        let (low, high) = (scan((0.1, 0.4)), scan((0.6, 1.0)));
        // Straight ahead, between the legs, the low band sees the wall 4 m away.
        let ahead = |scan: &LaserScan| scan.range_m(90).unwrap();
        assert!((ahead(&low) - 4.0).abs() < 1e-3, "{}", ahead(&low));
        assert!((1.39..2.0).contains(&ahead(&high)), "{}", ahead(&high));
        // Back, both see the wall.
        for scan in [&low, &high] {
            assert!((scan.range_m(0).unwrap() - 4.0).abs() < 1e-3);
        }
        // A leg stands 1.475 m ahead and 0.325 m to the left.
        let leg = 90 + (0.325_f64 / 1.475).atan().to_degrees().div_euclid(2.0) as usize;
        let hits = (leg - 1..=leg + 1).filter_map(|beam| low.range_m(beam));
        assert!(hits.fold(f64::INFINITY, f64::min) < 1.7);
        let invalid = (0..180).filter(|&beam| low.reading(beam) == Reading::Invalid);
        assert!(invalid.count() < 20);
    }
}
