//! What leaves a route's map when its drives have settled, and what is fetched back.

use std::collections::BTreeSet;

use anyhow::Context;

use super::options::PipelineOptions;
use super::workspace::Workspace;
use crate::ids::{EdgeId, NodeId, RouteId, TripId};
use crate::mapping::{RouteMap, Stay, TRIP_TAIL};
use crate::store::{AlertRecord, SETTLED_CLOSURES_MAX, SettledClosure, Store, StoreError};

/// Of the nodes that an alert names the oldest that show the change stay, which tell since when
/// it is there …
const ALERT_OLDEST: usize = 16;
/// … and the newest.
const ALERT_NEWEST: usize = 48;

/// Lets nodes leave the map whose drives have settled, before a drive of `trip` extends it. Those
/// that the job names stay.
///
/// A map by the paper's rule keeps everything: the rule reads the places of the whole series.
///
/// # Errors
/// If what is left does not fit together; the workspace is lost then.
pub(super) fn settle(
    workspace: &mut Workspace,
    trip: &TripId,
    named: &[NodeId],
    options: &PipelineOptions,
) -> anyhow::Result<()> {
    if workspace.detector.keeps_as_sent() {
        return Ok(());
    }
    let mut nodes = named_by_alerts(workspace);
    nodes.extend(named);
    let leaving = workspace.map.settled_nodes(&Stay {
        stretches: options.active_stretches,
        first_stretches: options.first_stretches,
        trip,
        nodes: &nodes,
    });
    if leaving.is_empty() {
        return Ok(());
    }
    remember_closures(workspace, &leaving);
    let released = workspace.map.release(&leaving);
    released.context("what is left of the map does not fit together")?;
    let keyframes = workspace.map.keyframes().iter();
    let trips: BTreeSet<TripId> = keyframes.map(|keyframe| keyframe.trip.clone()).collect();
    workspace.vehicles.retain(|trip, _| trips.contains(trip));
    Ok(())
}

/// What alerts that wait for a decision rest on: of each the oldest and the newest nodes that show
/// the change.
fn named_by_alerts(workspace: &Workspace) -> BTreeSet<NodeId> {
    let pending = workspace.alerts.iter().filter(|a| a.status.is_pending());
    pending
        .flat_map(|alert| named_by(&workspace.map, alert))
        .collect()
}

fn named_by(map: &RouteMap, alert: &AlertRecord) -> Vec<NodeId> {
    let evidence = &alert.evidence;
    let showing = evidence.nodes.iter().filter_map(|node| {
        let position = map.graph().node_position(*node)?;
        let stamp = map.keyframes()[position].stamp;
        (stamp >= evidence.since).then_some((stamp, *node))
    });
    let mut showing: Vec<_> = showing.collect();
    showing.sort_unstable();
    if showing.len() > ALERT_OLDEST + ALERT_NEWEST {
        showing.drain(ALERT_OLDEST..showing.len() - ALERT_NEWEST);
    }
    showing.into_iter().map(|(_, node)| node).collect()
}

/// Moves the closures that end at leaving nodes among the settled ones, of which the first stay
/// known to their series.
fn remember_closures(workspace: &mut Workspace, leaving: &[NodeId]) {
    let subgraphs = workspace.subgraph_of_edges();
    let graph = workspace.map.graph();
    let leaves = |node: &NodeId| leaving.binary_search(node).is_ok();
    let settled = workspace.closures.iter().filter_map(|closure| {
        let edge = graph.edge(closure.edge_id)?;
        if !(leaves(&edge.from) || leaves(&edge.to)) {
            return None;
        }
        let newer = workspace.map.keyframe(edge.from.max(edge.to))?;
        Some(SettledClosure {
            id: edge.id,
            from: edge.from,
            to: edge.to,
            subgraph_id: subgraphs.get(&edge.id).copied(),
            delta_f: closure.delta_f,
            vehicle_id: workspace.vehicles.get(&newer.trip)?.clone(),
            given: workspace.given.contains(&edge.id),
        })
    });
    let settled: Vec<SettledClosure> = settled.collect();
    let gone: BTreeSet<EdgeId> = settled.iter().map(|closure| closure.id).collect();
    workspace.closures.retain(|c| !gone.contains(&c.edge_id));
    workspace.given.retain(|edge| !gone.contains(edge));
    workspace.settled_closures.extend(settled);
    workspace.settled_closures.sort_unstable_by_key(|c| c.id);
    workspace.settled_closures.truncate(SETTLED_CLOSURES_MAX);
}

/// Takes back into the active graph what a trip needs to go on; returns what had left.
///
/// # Errors
/// [`StoreError`].
pub(super) async fn recall_trip(
    store: &Store,
    route: &RouteId,
    trip: &TripId,
) -> Result<Vec<NodeId>, StoreError> {
    let settled = store.settled_tail(route, trip, TRIP_TAIL).await?;
    recall(store, route, settled).await
}

/// Takes what has left among some nodes and the ends of some edges back into the active graph;
/// returns what had left.
///
/// # Errors
/// [`StoreError`].
pub(super) async fn recall_named(
    store: &Store,
    route: &RouteId,
    nodes: &[NodeId],
    edges: &[EdgeId],
) -> Result<Vec<NodeId>, StoreError> {
    let settled = store.settled_among(route, nodes, edges).await?;
    recall(store, route, settled).await
}

async fn recall(
    store: &Store,
    route: &RouteId,
    settled: Vec<NodeId>,
) -> Result<Vec<NodeId>, StoreError> {
    if !settled.is_empty() {
        store.recall_nodes(route, settled.clone()).await?;
    }
    Ok(settled)
}

/// Solves the sub-graphs that recalled nodes are part of: the map may have moved since they left.
pub(super) fn solve_recalled(map: &mut RouteMap, recalled: &[NodeId]) {
    let graph = map.graph();
    let edges = recalled.iter().flat_map(|node| graph.edges_at(*node));
    let as_they_are: Vec<_> = edges.map(|edge| (edge.id, edge.status)).collect();
    if !as_they_are.is_empty() {
        map.restate_edges(&as_they_are);
    }
}
