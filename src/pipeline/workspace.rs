//! A route's map in memory, as it was last saved.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, anyhow};

use super::clock_faults::ClockFaults;
use super::vehicles::Calibrations;
use crate::change::is_in_baseline;
use crate::change::series::ClosureSample;
use crate::graph::Edge;
use crate::ids::{EdgeId, NodeId, RouteId, TripId, VehicleId};
use crate::mapping::{Companion, IntermediateScan, Keyframe, RouteMap, Weighting};
use crate::model::{Detector, Stage};
use crate::scan::decode_scan;
use crate::store::{
    AcceptedChange, AlertRecord, ArchivedClosure, EdgeChange, EdgeRecord, IntermediateRecord,
    NodeChange, NodeWithScan, RouteGraph, Store,
};

/// A route's map, with what the store has saved of it.
pub(super) struct Workspace {
    /// The store's revision of the map.
    pub revision: i64,
    pub stage: Stage,
    /// The route's detector; it decides how edges are weighted.
    pub detector: Detector,
    /// Accepted false alerts per lap. One lap is a driven distance as long as the reference.
    pub false_alarm_rate: f64,
    /// How far a batch may move what others have mapped, metres.
    pub max_shift_m: f64,
    pub map: RouteMap,
    /// Each node as it was saved, in the order of the graph.
    pub saved_nodes: Vec<NodeChange>,
    /// Each edge as it was saved, in the order of the graph.
    pub saved_edges: Vec<EdgeChange>,
    /// ΔF of every closure in the map, in the order of insertion.
    pub closures: Vec<ClosureSample>,
    /// Those of them that were uploaded as edges, without scans.
    pub external: BTreeSet<EdgeId>,
    /// The first of the archived closures, in the order of insertion.
    pub archived_closures: Vec<ArchivedClosure>,
    /// The vehicle of each trip with a node in the map.
    pub vehicles: BTreeMap<TripId, VehicleId>,
    pub map_version: i64,
    /// Every alert of the route, the oldest first.
    pub alerts: Vec<AlertRecord>,
    /// Accepted changes in the order of acceptance: in their regions, observations from before the change do
    /// not count.
    pub accepted: Vec<AcceptedChange>,
    /// Calibrations of the newest trips.
    pub calibrations: Calibrations,
    /// The trips whose clock is behind.
    pub clock_faults: ClockFaults,
}

impl Workspace {
    /// The map after its changes were committed.
    pub fn saved(mut self) -> Self {
        self.revision += 1;
        self
    }

    /// Replaces an alert by its next revision.
    pub fn replace_alert(&mut self, alert: &AlertRecord) {
        if let Some(old) = self.alerts.iter_mut().find(|old| old.id == alert.id) {
            *old = alert.clone();
        }
    }

    fn restore(graph: RouteGraph) -> anyhow::Result<Self> {
        let weighting = match graph.settings.detector.keeps_as_sent() {
            true => Weighting::AllPointsIdentity,
            false => Weighting::Robust,
        };
        let nodes: Vec<_> = graph
            .nodes
            .iter()
            .map(keyframe_of)
            .collect::<Result<_, _>>()?;
        let poses = graph.nodes.iter().map(|n| n.node.pose);
        let mut map = RouteMap::restore(
            weighting,
            poses.zip(nodes),
            graph.edges.iter().map(edge_of),
            graph.next_node_id,
            graph.next_edge_id,
        )
        .context("the stored graph is inconsistent")?;
        if !graph.clock_faults.is_empty() {
            map.distrust(graph.clock_faults.iter().map(|fault| fault.trip.clone()));
            map.settle_screen();
        }
        let closures = graph.edges.iter().filter_map(|edge| {
            Some(ClosureSample {
                edge_id: edge.id,
                delta_f: edge.delta_f?,
            })
        });
        let external = graph.edges.iter();
        let external = external.filter(|edge| edge.delta_f.is_some() && edge.closure.is_none());
        Ok(Self {
            external: external.map(|edge| edge.id).collect(),
            revision: graph.revision,
            stage: graph.stage,
            detector: graph.settings.detector,
            false_alarm_rate: graph.settings.false_alarm_rate,
            max_shift_m: graph.settings.max_shift_m,
            map,
            saved_nodes: graph.nodes.iter().map(node_change_of).collect(),
            saved_edges: graph.edges.iter().map(edge_change_of).collect(),
            closures: closures.collect(),
            archived_closures: graph.archived_closures,
            vehicles: graph.nodes.iter().map(trip_and_vehicle).collect(),
            map_version: graph.map_version,
            alerts: graph.alerts,
            accepted: graph.accepted,
            calibrations: Calibrations::of(graph.calibrations),
            clock_faults: ClockFaults::of(graph.clock_faults),
        })
    }

    /// The block of each edge in the map that lies in one.
    pub fn subgraph_of_edges(&self) -> BTreeMap<EdgeId, i64> {
        let edges = self.saved_edges.iter();
        edges
            .filter_map(|edge| Some((edge.id, edge.subgraph_id?)))
            .collect()
    }

    /// The closures in the residual series of each block, in the order of insertion.
    ///
    /// Of archived closures only the first are among them: a series keeps its beginning.
    pub fn closures_by_subgraph(&self) -> BTreeMap<i64, Vec<ClosureSample>> {
        let subgraphs = self.subgraph_of_edges();
        let mut closures: BTreeMap<i64, Vec<ClosureSample>> = BTreeMap::new();
        for archived in &self.archived_closures {
            if let Some(subgraph) = archived.subgraph_id
                && is_in_baseline(&self.accepted, archived.id, [archived.from, archived.to])
            {
                closures.entry(subgraph).or_default().push(ClosureSample {
                    edge_id: archived.id,
                    delta_f: archived.delta_f,
                });
            }
        }
        for closure in &self.closures {
            if let Some(&subgraph) = subgraphs.get(&closure.edge_id)
                && let Some(edge) = self.map.graph().edge(closure.edge_id)
                && is_in_baseline(&self.accepted, edge.id, [edge.from, edge.to])
            {
                closures.entry(subgraph).or_default().push(*closure);
            }
        }
        for samples in closures.values_mut() {
            samples.sort_by_key(|sample| sample.edge_id);
        }
        closures
    }

    /// Approximate size in memory, bytes.
    pub fn size_bytes(&self) -> usize {
        let named = |a: &AlertRecord| {
            let evidence = &a.evidence;
            size_of_val(evidence.nodes.as_slice())
                + size_of_val(evidence.edges.as_slice())
                + NAME_BYTES * evidence.trips.len()
                + a.passes
                    .as_ref()
                    .map_or(0, |passes| PASS_BYTES * passes.listed.len())
        };
        let alerts: usize = self.alerts.iter().map(|a| size_of_val(a) + named(a)).sum();
        self.map.size_bytes()
            + size_of_val(self.saved_nodes.as_slice())
            + size_of_val(self.saved_edges.as_slice())
            + size_of_val(self.closures.as_slice())
            + EDGE_ID_BYTES * self.external.len()
            + size_of_val(self.archived_closures.as_slice())
            + NAME_BYTES * 2 * self.vehicles.len()
            + self.calibrations.size_bytes()
            + alerts
    }
}

/// Size of an edge id in a set, bytes.
const EDGE_ID_BYTES: usize = 16;
/// Size of a pass with its names, bytes.
const PASS_BYTES: usize = 3 * NAME_BYTES;
/// Size of a name of a trip or a vehicle, bytes.
const NAME_BYTES: usize = 64;

fn keyframe_of(record: &NodeWithScan) -> anyhow::Result<Keyframe> {
    let node = &record.node;
    let (trip, stamp) = (node.trip_id.clone(), node.stamp);
    let mut keyframe = match &record.scan {
        Some(scan) => {
            let scan = decode_scan(scan)
                .with_context(|| format!("the scan of node {} cannot be read", node.id))?;
            Keyframe::new(node.id, trip, stamp, node.odom_from_base, scan)
        }
        None => Keyframe::without_scan(node.id, trip, stamp, node.odom_from_base),
    };
    keyframe.reference = node.reference;
    keyframe.drift_m = node.drift_m;
    keyframe.trip_order = node.trip_order;
    keyframe.lidar.clone_from(&record.lidar);
    let intermediate = record.intermediate.iter();
    let intermediate = intermediate.map(|scan| intermediate_of(node.id, scan));
    Ok(keyframe.with_intermediate(intermediate.collect::<Result<_, _>>()?))
}

fn intermediate_of(node: NodeId, record: &IntermediateRecord) -> anyhow::Result<IntermediateScan> {
    let scan = record.scan.as_deref().map(decode_scan).transpose();
    let scan =
        scan.with_context(|| format!("an intermediate scan of node {node} cannot be read"))?;
    Ok(IntermediateScan {
        stamp: record.stamp,
        keyframe_from_base: record.keyframe_from_base,
        odom_from_base: record.odom_from_base,
        companion: record.companion.clone().map(|lidar| Companion {
            lidar,
            lends: record.lends,
        }),
        scan,
    })
}

fn trip_and_vehicle(record: &NodeWithScan) -> (TripId, VehicleId) {
    let node = &record.node;
    (node.trip_id.clone(), node.vehicle_id.clone())
}

fn edge_of(record: &EdgeRecord) -> Edge {
    Edge {
        id: record.id,
        from: record.from,
        to: record.to,
        measurement: record.measurement,
        information: record.information,
        kind: record.kind,
        status: record.status,
    }
}

fn node_change_of(record: &NodeWithScan) -> NodeChange {
    NodeChange {
        id: record.node.id,
        pose: record.node.pose,
        sigma: record.node.sigma,
        subgraph_id: record.node.subgraph_id,
        drift_m: record.node.drift_m,
        reference: record.node.reference,
        active: record.node.active,
    }
}

fn edge_change_of(record: &EdgeRecord) -> EdgeChange {
    EdgeChange {
        id: record.id,
        status: record.status,
        subgraph_id: record.subgraph_id,
    }
}

/// Maps in memory between jobs. A worker takes a map out, and puts it back only after its result was
/// committed.
pub(super) struct Workspaces {
    /// The least recently used first.
    kept: Mutex<Vec<Kept>>,
    bytes_max: usize,
}

struct Kept {
    route: RouteId,
    workspace: Workspace,
    bytes: usize,
}

impl Workspaces {
    /// Keeps maps as long as they take no more than `bytes_max` together.
    pub fn new(bytes_max: usize) -> Self {
        Self {
            kept: Mutex::default(),
            bytes_max,
        }
    }

    /// The route's map, from memory if it is up to date, else from the store.
    pub async fn take(&self, store: &Store, route: &RouteId) -> anyhow::Result<Workspace> {
        let record = store.route(route).await?;
        let record = record.ok_or_else(|| anyhow!("the route is gone"))?;
        if let Some(mut kept) = self.remove(route)
            && kept.revision == record.revision
            && kept.detector == record.settings.detector
        {
            kept.false_alarm_rate = record.settings.false_alarm_rate;
            kept.max_shift_m = record.settings.max_shift_m;
            return Ok(kept);
        }
        let graph = store.load_graph(route).await?;
        let graph = graph.ok_or_else(|| anyhow!("the route is gone"))?;
        tokio::task::spawn_blocking(move || Workspace::restore(graph)).await?
    }

    /// Updates a map in memory after a decision that does not change the graph.
    pub fn note_decision(&self, base_revision: i64, alert: &AlertRecord) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let of_route = kept.iter_mut().find(|kept| kept.route == alert.route_id);
        if let Some(Kept { workspace, .. }) = of_route
            && workspace.revision == base_revision
        {
            workspace.revision += 1;
            workspace.replace_alert(alert);
        }
    }

    /// Keeps a map whose changes are committed; the least recently used ones make room. The last one stays
    /// however large it is.
    pub fn put_back(&self, route: RouteId, workspace: Workspace) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|other| other.route != route);
        let bytes = workspace.size_bytes();
        kept.push(Kept {
            route,
            workspace,
            bytes,
        });
        let mut total: usize = kept.iter().map(|kept| kept.bytes).sum();
        while total > self.bytes_max && kept.len() > 1 {
            total -= kept.remove(0).bytes;
        }
        update_gauges(&kept);
    }

    /// Forgets the map of a route that is gone.
    pub fn forget(&self, route: &RouteId) {
        drop(self.remove(route));
    }

    /// The routes whose maps are in memory, the least recently used first.
    #[cfg(test)]
    pub fn held(&self) -> Vec<String> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().map(|kept| kept.route.to_string()).collect()
    }

    fn remove(&self, route: &RouteId) -> Option<Workspace> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let place = kept.iter().position(|kept| kept.route == *route)?;
        let workspace = kept.remove(place).workspace;
        update_gauges(&kept);
        Some(workspace)
    }
}

fn update_gauges(kept: &[Kept]) {
    let bytes: usize = kept.iter().map(|kept| kept.bytes).sum();
    metrics::gauge!("mapshift_maps_in_memory").set(kept.len() as f64);
    metrics::gauge!("mapshift_maps_in_memory_bytes").set(bytes as f64);
}
