//! When a route's reference is complete.

use super::workspace::Workspace;
use crate::change::series::residual_series;
use crate::model::Stage;

/// Passes over the route before its reference can be complete (paper, section 4.1: at least two
/// laps).
const LAPS_MIN: usize = 2;

/// A route is monitored once its reference has been driven at least twice and the specific function f of
/// one of its sub-graphs has converged. It then stays monitored.
pub(super) fn stage_of(workspace: &Workspace) -> Stage {
    if workspace.stage == Stage::Monitoring || laps(workspace) < LAPS_MIN {
        return workspace.stage;
    }
    let params = workspace.detector.series_params();
    let converged = workspace
        .closures_by_subgraph()
        .values()
        .any(|samples| residual_series(samples, &params).converged_at.is_some());
    if converged {
        Stage::Monitoring
    } else {
        Stage::Mapping
    }
}

/// How often the reference has been driven, on average.
fn laps(workspace: &Workspace) -> usize {
    workspace.map.keyframes().len() / references(workspace).max(1)
}

/// How many reference nodes the map has.
pub(super) fn references(workspace: &Workspace) -> usize {
    let keyframes = workspace.map.keyframes().iter();
    keyframes.filter(|keyframe| keyframe.reference).count()
}
