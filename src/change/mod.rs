//! What the residuals of a pose graph say about changes of the world.

mod accepted;
mod alert;
mod beam_verdict;
mod calibration;
mod detect;
mod detector;
mod finding;
mod fold;
mod history;
mod kind;
mod look;
mod median;
mod mismatch;
pub mod paper;
mod region;
mod residual_runs;
mod running_calibration;
pub mod series;
#[cfg(test)]
mod testing;
pub mod threshold;
mod tier;
mod vehicle;

pub use accepted::{ACCEPTED_MARGIN_M, AcceptedChange};
pub use alert::{AlertAction, AlertStatus};
pub use beam_verdict::{BeamVerdict, DepthTolerance, JudgedBeam, PlacedScan, judge_beams};
pub use calibration::{VehicleResidual, calibrated_p_values};
pub use detect::{Evidence, Suspicion, detect};
pub use detector::Detector;
pub use finding::{Counterpart, Finding};
pub use fold::{AlertState, AlertUpdate, SAME_PLACE_M, Step, fold};
pub use kind::ChangeKind;
pub use look::{Look, Sight};
pub use mismatch::{TiedPose, mismatches};
pub use region::region_round;
pub use residual_runs::{JudgedClosure, residual_runs};
pub use running_calibration::{RESIDUAL_FALSE_ALARM_RATE, p_values_in_order};
pub use tier::Tier;
pub use vehicle::{MountTurn, TripPose, mount_turn, suspect_vehicle};
