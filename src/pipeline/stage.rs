//! When a route's reference is complete.

use std::collections::BTreeSet;

use super::workspace::Workspace;
use crate::change::series::residual_series;
use crate::store::Stage;

/// Passes over the route before its reference can be complete (paper, section 4.1: at least two
/// laps).
const LAPS_MIN: usize = 2;

/// A route is monitored once the reference has been driven at least twice and the specific
/// function f of one of its sub-graphs has converged; it stays monitored.
pub(super) fn stage_of(workspace: &Workspace) -> Stage {
    if workspace.stage == Stage::Monitoring || laps(workspace) < LAPS_MIN {
        return workspace.stage;
    }
    let subgraphs: BTreeSet<i64> = workspace
        .saved_edges
        .iter()
        .filter_map(|edge| edge.subgraph_id)
        .collect();
    let converged = subgraphs.into_iter().any(|subgraph_id| {
        let samples = workspace.closures_of(subgraph_id);
        let series = residual_series(&samples, &workspace.detector.series_params());
        series.converged_at.is_some()
    });
    if converged {
        Stage::Monitoring
    } else {
        Stage::Mapping
    }
}

/// How often the reference has been driven, on average.
fn laps(workspace: &Workspace) -> usize {
    let keyframes = workspace.map.keyframes();
    let references = keyframes
        .iter()
        .filter(|keyframe| keyframe.reference)
        .count();
    keyframes.len() / references.max(1)
}
