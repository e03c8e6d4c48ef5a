//! A workshop in which things come and go between laps.

use mapshift::geometry::Pose2;
use mapshift::sim::{Scene, SceneObject, Shape, Vehicle};

use crate::drives::{Batch, Drive, workshop};

/// Far more than a scan apart, so that every scan becomes a keyframe.
const SCAN_SPACING_M: f64 = 0.5;
const PATH_NOISE_M: f64 = 0.3;
/// Scans of a batch; a lap has about three batches.
const SCANS: usize = 18;
/// The place of the cupboard among the workshop's things.
const CUPBOARD: usize = 4;

/// A scene that two vehicles drive through in turn, a lap an hour, each lap a trip of its own.
#[derive(Clone)]
pub struct Shop {
    pub scene: Scene,
    pub vehicles: Vec<Vehicle>,
    seed: u64,
}

impl Shop {
    /// The workshop in which nothing changes.
    pub fn new(seed: u64) -> Self {
        Self::of(Scene::of_hall(&workshop(), seed), seed)
    }

    /// A scene as it is.
    pub fn of(scene: Scene, seed: u64) -> Self {
        let vehicles = [0, 1].map(|number| Vehicle {
            scan_spacing_m: SCAN_SPACING_M,
            ..Vehicle::of_fleet(number, PATH_NOISE_M)
        });
        Self {
            scene,
            vehicles: vehicles.into(),
            seed,
        }
    }

    /// A crate of 60 cm × 50 cm stands in the middle from one lap on until before another.
    pub fn with_crate(mut self, from_lap: usize, until_lap: Option<usize>) -> Self {
        self.scene.objects.push(SceneObject {
            from_lap,
            until_lap,
            ..SceneObject::lasting(crate_in_the_middle())
        });
        self
    }

    /// The cupboard is gone from a lap on.
    pub fn without_cupboard(mut self, from_lap: usize) -> Self {
        self.scene.objects[CUPBOARD].until_lap = Some(from_lap);
        self
    }

    pub fn cupboard(&self) -> &Shape {
        &self.scene.objects[CUPBOARD].shape
    }

    /// The drive of one lap.
    pub fn drive(&self, lap: usize) -> Drive {
        let number = lap % self.vehicles.len();
        let vehicle = &self.vehicles[number];
        let names = (&*vehicle_name(number), &*trip_name(lap));
        let scans = self.scene.drive(vehicle, lap..lap + 1, self.seed);
        Drive::of(vehicle, names, scans, lap as i64)
    }

    pub fn lap(&self, lap: usize) -> Vec<Batch> {
        self.drive(lap).batches(SCANS)
    }
}

pub fn vehicle_name(number: usize) -> String {
    format!("agv-{number:02}")
}

pub fn trip_name(lap: usize) -> String {
    format!("lap-{lap:02}")
}

pub fn crate_in_the_middle() -> Shape {
    Shape::rectangle(&Pose2::new(6.4, 4.0, 0.3), 0.6, 0.5)
}
