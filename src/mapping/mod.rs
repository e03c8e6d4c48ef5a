//! A route's map, and how a trip extends it: keyframes, odometry edges, the localisation of a new
//! trip, loop closures to reference nodes, the solve of the sub-graph that they touch.
//!
//! Knows nothing of uploads, batches or storage. Begin with [`RouteMap::extend`], the walk of one
//! batch.

mod anchor;
mod attach;
mod carried;
mod clearance;
mod clock;
mod closure;
mod companions;
mod confirmation;
mod corridor;
mod drift;
mod drive;
mod evidence;
mod expected;
mod extend;
mod falsified;
mod front_end;
mod given;
mod intermediate;
mod keyframe;
mod local_map;
mod loops;
mod lost;
mod mend;
mod moments;
mod odometry;
mod partners;
mod passes;
mod placing;
mod pose_sigma;
mod restate;
mod route_map;
mod settle;
mod step;
mod suspects;
mod take_out;
#[cfg(test)]
mod testing;

pub use anchor::AnchorError;
pub use attach::{Attached, NotAttached};
pub use closure::{Closure, ClosureRule};
pub use drift::LOST_DRIFT_M;
pub use drive::{Drive, DriveScan, InitialPose, LidarOfVehicle};
pub use evidence::{Scope, Sites};
pub use extend::{Extension, NotExtended};
pub use given::{End, GivenEdge, GivenGraph, GivenNode};
pub use intermediate::{Companion, IntermediateScan};
pub use keyframe::{Keyframe, TakenScan};
pub use mend::Mending;
pub use passes::PassScope;
pub use route_map::{RouteMap, Weighting};
pub use settle::{ACTIVE_STRETCHES, FIRST_STRETCHES, Stay, TRIP_TAIL};
