//! Findings from closures that were uploaded as edges, without scans: ΔF is their only evidence.

use std::collections::BTreeMap;

use super::workspace::Workspace;
use crate::change::series::{ClosureSample, residual_series};
use crate::change::{
    Finding, JudgedClosure, RESIDUAL_FALSE_ALARM_RATE, VehicleResidual, p_values_in_order,
    residual_runs,
};
use crate::ids::{EdgeId, VehicleId};

/// A closure with a smaller ΔF closed no cycle when it came: nothing could contradict it.
const DELTA_F_MIN: f64 = 1e-12;

/// The places that closures without scans contradict.
///
/// Those of each sub-graph are tested one after the other at [`RESIDUAL_FALSE_ALARM_RATE`] once their mean
/// has converged; those before are the baseline. The route's own rate counts alerts per lap, and does not
/// apply to single closures.
pub(super) fn by_residuals(workspace: &Workspace) -> Vec<Finding> {
    if workspace.external.is_empty() {
        return Vec::new();
    }
    let archived = workspace.archived_closures.iter();
    let archived: BTreeMap<EdgeId, &VehicleId> = archived
        .filter(|closure| closure.given)
        .map(|closure| (closure.id, &closure.vehicle_id))
        .collect();
    let mut judged = Vec::new();
    for samples in workspace.closures_by_subgraph().into_values() {
        let external = |sample: &ClosureSample| {
            let id = sample.edge_id;
            workspace.external.contains(&id) || archived.contains_key(&id)
        };
        let contradictable = |sample: &ClosureSample| sample.delta_f > DELTA_F_MIN;
        let samples = samples.into_iter();
        let samples: Vec<_> = samples
            .filter(|s| external(s) && contradictable(s))
            .collect();
        judged.extend(judge(workspace, &archived, &samples));
    }
    residual_runs(&judged)
}

/// Judges the closures of a sub-graph that came after its baseline and are in the map.
fn judge(
    workspace: &Workspace,
    archived: &BTreeMap<EdgeId, &VehicleId>,
    samples: &[ClosureSample],
) -> Vec<JudgedClosure> {
    let params = workspace.detector.series_params();
    let Some(baseline) = residual_series(samples, &params).converged_at else {
        return Vec::new();
    };
    let residuals = samples.iter().map(|sample| VehicleResidual {
        vehicle: match archived.get(&sample.edge_id) {
            Some(vehicle) => Some(*vehicle),
            None => vehicle_of(workspace, sample.edge_id),
        },
        residual: sample.delta_f,
    });
    let residuals: Vec<_> = residuals.collect();
    let p_values = p_values_in_order(&residuals, baseline, RESIDUAL_FALSE_ALARM_RATE);
    let tested = samples.iter().zip(p_values).skip(baseline);
    tested
        .filter_map(|(sample, p_value)| judged(workspace, sample.edge_id, p_value?))
        .collect()
}

fn vehicle_of(workspace: &Workspace, edge: EdgeId) -> Option<&VehicleId> {
    let edge = workspace.map.graph().edge(edge)?;
    let newer = workspace.map.keyframe(edge.from.max(edge.to))?;
    workspace.vehicles.get(&newer.trip)
}

fn judged(workspace: &Workspace, id: EdgeId, p_value: f64) -> Option<JudgedClosure> {
    let graph = workspace.map.graph();
    let edge = graph.edge(id)?;
    let nodes = [edge.from.min(edge.to), edge.from.max(edge.to)];
    let [older, newer] = nodes.map(|node| graph.node(node).map(|n| n.pose.translation()));
    let keyframe = workspace.map.keyframe(nodes[1])?;
    Some(JudgedClosure {
        edge: id,
        nodes,
        place: 0.5 * (older? + newer?),
        stamp: keyframe.stamp,
        trip: (keyframe.trip.clone(), keyframe.trip_order),
        p_value,
        flagged: p_value < RESIDUAL_FALSE_ALARM_RATE,
    })
}
