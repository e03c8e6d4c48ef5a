//! Removing uploads from a route.

use std::collections::BTreeSet;

use anyhow::{Context, anyhow};
use jiff::Timestamp;

use super::alerts::{fold_into, take_out_passes};
use super::archive::{reactivate_named, solve_reactivated};
use super::engine::Engine;
use super::findings::{detect_everywhere, findings};
use super::result::changes_of;
use super::shift::PosesBefore;
use super::workspace::Workspace;
use crate::ids::{EdgeId, OperationId, RouteId, TripId};
use crate::store::{
    OperationRecord, OperationResult, Removable, Removal, RemovalRequest, RemovalResult,
};

/// How often a removal is computed again because the route changed meanwhile, before it fails.
const COMPUTATIONS_MAX: usize = 4;

/// What follows on a removal that takes nodes out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Then {
    /// The operation ends.
    Ends,
    /// The map is made anew.
    IsRebuilt,
}

/// Computes a removal and writes it; a dry run only says what it would do.
pub(super) async fn remove(
    engine: &Engine,
    operation: &OperationRecord,
    request: &RemovalRequest,
    then: Then,
    at: Timestamp,
) -> anyhow::Result<()> {
    let Engine {
        store, workspaces, ..
    } = engine;
    let route = operation.route_id.as_ref();
    let route = route.ok_or_else(|| anyhow!("a removal is of one route"))?;
    let _turn = engine.turn(route).await;
    for _ in 0..COMPUTATIONS_MAX {
        let removable = store.removable(route, &request.meant).await?;
        let reactivated =
            reactivate_named(store, route, &removable.nodes, &removable.edges).await?;
        let mut workspace = workspaces.take(store, route).await?;
        let input = RemovalInput {
            operation: operation.id,
            route: route.clone(),
            request: request.clone(),
            then,
            at,
        };
        let computed = engine.compute(move || {
            solve_reactivated(&mut workspace.map, &reactivated);
            take_out(workspace, input, removable)
        });
        let (workspace, removal) = computed.await??;
        if request.dry_run {
            let result = OperationResult::Removal(removal.result);
            let ended = store.end_operation(operation.id, Ok(result), removal.at);
            return Ok(ended.await?);
        }
        if store.apply_removal(removal).await? {
            workspaces.put_back(route.clone(), workspace.saved());
            return Ok(());
        }
    }
    Err(anyhow!(
        "the route kept changing while the removal was computed"
    ))
}

/// Which removal it is, and when.
struct RemovalInput {
    operation: OperationId,
    route: RouteId,
    request: RemovalRequest,
    then: Then,
    at: Timestamp,
}

/// Takes the removable nodes and edges out of the map, and detects changes everywhere in what is left.
fn take_out(
    mut workspace: Workspace,
    RemovalInput {
        operation,
        route,
        request,
        then,
        at,
    }: RemovalInput,
    removable: Removable,
) -> anyhow::Result<(Workspace, Removal)> {
    let Removable { nodes, edges, .. } = &removable;
    let before = PosesBefore::of(&workspace.map, 0.0, |keyframe| {
        nodes.binary_search(&keyframe.node).is_ok()
    });
    let base_revision = workspace.revision;
    let stays = |edge: &EdgeId| edges.binary_search(edge).is_err();
    workspace.closures.retain(|closure| stays(&closure.edge_id));
    workspace.external.retain(stays);
    workspace
        .archived_closures
        .retain(|closure| stays(&closure.id));
    workspace.calibrations.forget(&removable.trips);
    workspace.clock_faults.forget(&removable.trips);
    let taken_out = workspace.map.take_out(nodes, edges);
    taken_out.context("what is left of the map does not fit together")?;
    let keyframes = workspace.map.keyframes().iter();
    let trips: BTreeSet<TripId> = keyframes.map(|keyframe| keyframe.trip.clone()).collect();
    workspace.vehicles.retain(|trip, _| trips.contains(trip));

    let (mut changed_nodes, changed_edges) = changes_of(&mut workspace);
    changed_nodes.retain(|change| nodes.binary_search(&change.id).is_err());
    let in_scans = detect_everywhere(&mut workspace);
    let found = findings(&workspace, in_scans);
    let mut alerts = fold_into(&mut workspace, &route, &found, &[], at);
    take_out_passes(&mut workspace, nodes, at, &mut alerts);
    let count = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
    let result = RemovalResult {
        batches: count(removable.batches.len()),
        nodes: count(nodes.len()),
        edges: count(edges.len()),
        alerts: count(alerts.len()),
        moved_m: before.farthest_m(&workspace.map),
        ..RemovalResult::default()
    };
    let removal = Removal {
        operation,
        route_id: route,
        base_revision,
        changed_nodes,
        changed_edges,
        alerts,
        reason: (request.note).unwrap_or_else(|| "taken out of the map".to_owned()),
        erase: request.erase,
        ends: then == Then::Ends || nodes.is_empty(),
        result,
        at,
        removable,
    };
    Ok((workspace, removal))
}
