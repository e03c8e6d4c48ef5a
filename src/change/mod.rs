//! What observations and residuals say about changes of the world.

mod accepted;
mod alert;
mod beam_verdict;
mod calibration;
mod detector;
mod false_alerts;
mod finding;
mod fold;
mod history;
mod join;
mod kind;
mod median;
mod mismatch;
pub mod paper;
mod pass;
mod region;
mod residual_runs;
mod running_calibration;
mod screen;
pub mod series;
mod site;
#[cfg(test)]
mod testing;
pub mod threshold;
mod tier;
mod vehicle;

pub use accepted::{ACCEPTED_MARGIN_M, AcceptedChange};
pub use alert::{AlertAction, AlertStatus};
pub use beam_verdict::{BeamVerdict, JudgedBeam, judge_beams};
pub use calibration::{VehicleResidual, calibrated_p_values};
pub use detector::Detector;
pub use false_alerts::FALSE_ALERTS_PER_LAP;
pub use finding::{Counterpart, Finding};
pub use fold::{AlertState, AlertUpdate, SAME_PLACE_M, Step, fold};
pub use join::join_counterparts;
pub use kind::ChangeKind;
pub use mismatch::{TiedPose, mismatches};
pub use pass::{Standpoint, passes};
pub use region::region_round;
pub use residual_runs::{JudgedClosure, residual_runs};
pub use running_calibration::{RESIDUAL_FALSE_ALARM_RATE, p_values_in_order};
pub use screen::{Agreement, CandidateSite, Fit, ObservationKey, Reliability, Screen, Screened};
pub use site::{Observed, Site, asked_about, state_changes, support_min};
pub use tier::Tier;
pub use vehicle::{MountTurn, TripPose, mount_turn, suspect_vehicle};
