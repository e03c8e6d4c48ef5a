//! Simulated worlds and vehicles that drive laps in them: for the demonstration, the experiments and
//! the tests. Everything is a function of its arguments and a seed.
//!
//! Knows geometry, scans and the names of changes; knows nothing of maps. Begin with [`drive`].

mod build;
mod changes;
mod clouds;
mod drive;
mod furniture;
mod hall;
mod lidar;
mod pass_errors;
mod racks;
mod random;
mod rooms;
mod route;
mod scene;
mod shape;
mod street;
mod truth;
mod vehicle;
mod walker;
mod world;

pub use changes::Changes;
pub use clouds::SimCloudLidar;
pub use drive::{SimScan, drive};
pub use furniture::Furniture;
pub use hall::Hall;
pub use lidar::SimLidar;
pub use pass_errors::PassErrors;
pub(crate) use random::normal;
pub use rooms::{FloorPlan, Rooms};
pub use route::{Route, RouteError};
pub use scene::{LapWorld, Scene, SceneObject};
pub use shape::Shape;
pub use truth::ChangeEvent;
pub use vehicle::{OdometryError, Vehicle};
pub use world::{Hit, World};

#[cfg(test)]
mod tests;
