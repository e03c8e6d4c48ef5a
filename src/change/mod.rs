//! Detects changes of the world from observations and residuals, and folds findings into alerts.
//!
//! Must not know graphs or matching: it sees numbers, scans with poses, and findings. Begin with
//! [`state_changes`], which judges one site in seven steps; [`fold`] turns findings into alerts.

mod accepted;
mod alert;
mod beam_verdict;
mod calibration;
mod common_shift;
mod detector;
mod displaced;
mod false_alerts;
mod finding;
mod fold;
mod history;
mod join;
mod join_bands;
mod judged_pass;
mod layers;
mod median;
mod mended;
mod mismatch;
mod nearness;
pub mod paper;
mod pass;
mod pending;
mod region;
mod residual_runs;
mod running_calibration;
mod screen;
pub mod series;
mod shift_fit;
mod site;
mod suspect_evidence;
#[cfg(test)]
pub(crate) mod testing;
pub mod threshold;
mod vehicle;

pub use crate::model::{AlertAction, AlertStatus, BeamVerdict, ChangeKind, Detector, Tier};
pub use accepted::{ACCEPTED_MARGIN_M, AcceptedChange, is_in_baseline};
pub use beam_verdict::{JudgedBeam, judge_beams};
pub use calibration::{VehicleResidual, calibrated_p_values};
pub use common_shift::explain_by_shift;
pub use displaced::{MovedPose, displaced_segments};
pub use false_alerts::FALSE_ALERTS_PER_LAP;
pub use finding::{Counterpart, Finding};
pub use fold::{AlertState, AlertUpdate, SAME_PLACE_M, Step, fold, stays_untouched};
pub use join::{join_counterparts, separate_counterparts};
pub use join_bands::{join_bands, separate_bands};
pub use judged_pass::{JudgedPass, JudgedPasses, PassCounts};
pub use layers::{Layer, Layers, layer_of};
pub use mended::resolve_mended;
pub use mismatch::{KnownPose, TiedPose, mismatches};
pub use pass::{Standpoint, passes};
pub use pending::PendingChange;
pub use region::{centroid, region_round};
pub use residual_runs::{JudgedClosure, residual_runs};
pub use running_calibration::{RESIDUAL_FALSE_ALARM_RATE, p_values_in_order};
pub use screen::{Agreement, CandidateSite, Fit, ObservationKey, Reliability, Screen, Screened};
pub use shift_fit::{SHIFT_MAX_M, ShiftFit};
pub use site::{Observed, PassSeen, Presence, Site, pass_outcomes, state_changes, support_min};
pub use suspect_evidence::{SilencedChange, SuspectEvidence};
pub use vehicle::Suspect;
