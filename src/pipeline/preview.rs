//! What accepting an alert would change: accepted in memory, and undone.

use std::collections::BTreeSet;

use super::accept::{accept_change, grid_of, max_displacement_m, poses_of, undo_change};
use super::decide::{DecisionError, Decisions, is_allowed, of_computation};
use super::workspace::Workspace;
use crate::change::{AlertAction, AlertStatus};
use crate::geometry::Pose2;
use crate::ids::{AlertId, EdgeId};
use crate::render::{DifferingCells, MAP_RESOLUTION_M, differing_cells};
use crate::store::AlertRecord;

/// What accepting an alert would change.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// The alert as it was previewed.
    pub alert: AlertRecord,
    /// The version of the map that would begin.
    pub map_version_next: i64,
    /// Cells of the map's picture that would change.
    pub cells: DifferingCells,
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Closures that would be retired, ascending.
    pub edges_retired: Vec<EdgeId>,
    /// Nodes that would become references, or stop being ones.
    pub nodes_handed_over: usize,
    /// How far a node would move at most, metres.
    pub max_displacement_m: f64,
    /// Archived nodes that accepting would reactivate first. Cells, nodes and displacement are computed
    /// without them, and are approximate unless this is 0.
    pub nodes_reactivated: usize,
}

impl Decisions {
    /// What accepting an alert would change now; changes nothing. Waits for the batch that the route is
    /// processing. Costs as much as accepting: one solve of the sub-graphs touched, two drawings of the map.
    ///
    /// # Errors
    /// [`DecisionError::NotAllowed`] if the alert cannot be accepted.
    pub async fn preview(&self, id: AlertId) -> Result<Preview, DecisionError> {
        let own = self.clone();
        // A task of its own: the map is put back even if the caller goes away.
        let task = tokio::spawn(async move { own.compute_preview(id).await });
        task.await
            .map_err(|error| DecisionError::Failed(error.into()))?
    }

    async fn compute_preview(&self, id: AlertId) -> Result<Preview, DecisionError> {
        let (store, workspaces) = (&self.engine.store, &self.engine.workspaces);
        let alert = store.alert(id).await?.ok_or(DecisionError::UnknownAlert)?;
        let route = alert.route_id.clone();
        let _turn = self.engine.turn(&route).await;
        let alert = store.alert(id).await?.ok_or(DecisionError::UnknownAlert)?;
        if !is_allowed(&alert, AlertAction::Accept) {
            return Err(DecisionError::NotAllowed(Box::new(alert)));
        }
        let edges = &alert.evidence.edges;
        let archived = store.archived_among(&route, &[], edges).await?;
        let retired = store.active_closures_among(&route, edges).await?;
        let taken = workspaces.take(store, &route).await;
        let workspace = taken.map_err(of_computation)?;
        let computed = self.engine.compute(move || compute(workspace, alert));
        let (workspace, mut preview) = computed.await.map_err(of_computation)?;
        workspaces.put_back(route, workspace);
        preview.edges_retired = retired;
        preview.nodes_reactivated = archived.len();
        Ok(preview)
    }
}

fn compute(mut workspace: Workspace, alert: AlertRecord) -> (Workspace, Preview) {
    let before = grid_of(&workspace);
    let poses_before: Vec<Pose2> = poses_of(&workspace.map).collect();
    let (_, undo) = accept_change(&mut workspace, &alert);
    let alerts = workspace.alerts.clone();
    workspace.replace_alert(&AlertRecord {
        status: AlertStatus::Accepted,
        ..alert.clone()
    });
    let after = grid_of(&workspace);
    let handed_over: BTreeSet<_> = undo.references.iter().map(|(node, _)| *node).collect();
    let preview = Preview {
        map_version_next: workspace.map_version + 1,
        cells: differing_cells(&before, &after),
        resolution_m: MAP_RESOLUTION_M,
        edges_retired: undo.retired.clone(),
        nodes_handed_over: handed_over.len(),
        max_displacement_m: max_displacement_m(&workspace.map, &poses_before),
        nodes_reactivated: 0,
        alert,
    };
    workspace.alerts = alerts;
    undo_change(&mut workspace, preview.alert.id, &undo);
    (workspace, preview)
}
