//! One job of edges: the nodes that it names, which of its batches are connected to the map, and the
//! computation.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Context;

use super::added::{Added, AddedEdge, AddedNode, count_added};
use super::process::conclude;
use super::refusal::{Processed, Refusal};
use super::result::{Origin, outcome_of};
use super::shift::PosesBefore;
use super::workspace::Workspace;
use crate::ids::NodeId;
use crate::ingest::edges_json::{self, NodeName, UploadedEdges};
use crate::mapping::{End, GivenEdge, GivenGraph, GivenNode, NotAttached, RouteMap};
use crate::model::BatchStatus;
use crate::store::{BatchOutcome, ClaimedJob, Store, StoreError};

/// The batches of a job of edges, and the known ones of the nodes that they name.
pub(super) struct EdgeJob {
    origins: Vec<Origin>,
    uploads: Vec<UploadedEdges>,
    /// Nodes of the vehicle's earlier batches, by the vehicle's names for them.
    known: BTreeMap<String, NodeId>,
}

impl EdgeJob {
    /// Decodes the job's bodies; [`EdgeJob::look_up`] finds the known nodes.
    ///
    /// # Errors
    /// If a journalled body cannot be decoded.
    pub fn decode(job: &ClaimedJob) -> anyhow::Result<Self> {
        let (mut origins, mut uploads) = (Vec::new(), Vec::new());
        for entry in &job.entries {
            let batch = &entry.batch;
            let upload = edges_json::decode(&entry.body, batch.received_at);
            uploads
                .push(upload.with_context(|| {
                    format!("the stored body of batch {} is refused", batch.id)
                })?);
            origins.push(Origin::of(batch));
        }
        Ok(Self {
            origins,
            uploads,
            known: BTreeMap::new(),
        })
    }

    /// Looks up which of the names belong to stored nodes.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn look_up(&mut self, store: &Store, job: &ClaimedJob) -> Result<(), StoreError> {
        let Some(origin) = self.origins.last() else {
            return Ok(());
        };
        let named = self.named_in_edges().filter_map(|name| match name {
            NodeName::Own(name) => Some(name),
            NodeName::OfMap(_) => None,
        });
        let declared = self.uploads.iter().flat_map(|upload| &upload.nodes);
        let names: BTreeSet<&String> = named.chain(declared.map(|node| &node.name)).collect();
        let names: Vec<String> = names.into_iter().cloned().collect();
        let known = store.client_nodes(&job.route_id, &origin.vehicle_id, &names);
        self.known = known.await?.into_iter().collect();
        Ok(())
    }

    /// The nodes of the map that the edges name, ascending.
    pub fn named_nodes(&self) -> Vec<NodeId> {
        let ids = self.named_in_edges().filter_map(|name| match name {
            NodeName::Own(name) => self.known.get(name).copied(),
            NodeName::OfMap(id) => Some(*id),
        });
        let ids: BTreeSet<NodeId> = ids.collect();
        ids.into_iter().collect()
    }

    fn named_in_edges(&self) -> impl Iterator<Item = &NodeName> {
        let edges = self.uploads.iter().flat_map(|upload| &upload.edges);
        edges.flat_map(|edge| [&edge.from, &edge.to])
    }

    /// The batches that can never be merged, and why: they declare a node that exists already.
    fn refused(&self) -> BTreeMap<usize, String> {
        let mut refused = BTreeMap::new();
        let mut brought: BTreeSet<&str> = self.known.keys().map(String::as_str).collect();
        for (k, upload) in self.uploads.iter().enumerate() {
            let mut names = upload.nodes.iter().map(|node| node.name.as_str());
            if let Some(name) = names.clone().find(|name| brought.contains(name)) {
                let reason = format!(
                    "node {name} came with an earlier batch of this vehicle: name it in edges \
                     alone, and give new nodes new ids"
                );
                refused.insert(k, reason);
            } else {
                brought.extend(&mut names);
            }
        }
        refused
    }
}

/// Why batches are not merged, by their index.
type Waiting = BTreeMap<usize, String>;

/// Merges those of the job's batches that are connected to the map, in whatever order they came.
///
/// # Errors
/// If the graph refuses an edge; the workspace is lost then.
pub(super) fn process_edges(
    mut workspace: Workspace,
    job: &ClaimedJob,
    edges: &EdgeJob,
) -> anyhow::Result<Processed> {
    let mut refused = edges.refused();
    let usable = (0..edges.uploads.len()).filter(|k| !refused.contains_key(k));
    let (selected, waiting) = select(edges, usable.collect(), &workspace.map);
    let Joined {
        graph,
        node_sources,
        edge_sources,
    } = Joined::of(edges, &selected, &workspace.map);
    // Uploaded edges must not move nodes with scans, nor those of other vehicles.
    let vehicle = edges.origins.last().map(|origin| &origin.vehicle_id);
    let before = PosesBefore::of(&workspace.map, workspace.max_shift_m, |keyframe| {
        keyframe.scan.is_none() && workspace.vehicles.get(&keyframe.trip) == vehicle
    });
    let attached = match workspace.map.attach(&graph) {
        Ok(attached) => match before.too_far(&workspace.map) {
            Some(shift) => Err(shift.to_string()),
            None => Ok(attached),
        },
        Err(costly @ (NotAttached::TooDense { .. } | NotAttached::TooCostly)) => {
            Err(costly.to_string())
        }
        Err(error) => return Err(error.into()),
    };
    let attached = match attached {
        Ok(attached) => attached,
        Err(reason) => {
            refused.extend(selected.iter().map(|k| (*k, reason.clone())));
            return Ok(Processed::Refused(Refusal {
                outcomes: outcomes(&edges.origins, &refused, &waiting),
                origins: edges.origins.clone(),
            }));
        }
    };
    let mut added = Added::default();
    let new_nodes = attached.nodes.iter().zip(node_sources);
    for (node, (origin, client_id)) in new_nodes {
        let client_id = Some(client_id);
        added.nodes.insert(*node, AddedNode { origin, client_id });
    }
    for ((edge, delta_f), origin) in attached.edges.iter().zip(edge_sources) {
        let new = AddedEdge {
            origin,
            delta_f: *delta_f,
            closure: None,
        };
        added.edges.insert(*edge, new);
    }
    let mut outcomes = outcomes(&edges.origins, &refused, &waiting);
    count_added(&mut outcomes, &added);
    let concluded = conclude(workspace, job, &edges.origins, added, outcomes)?;
    Ok(Processed::Taken(Box::new(concluded)))
}

/// The outcome of each batch: refused for good, waiting, or merged.
fn outcomes(origins: &[Origin], refused: &Waiting, waiting: &Waiting) -> Vec<BatchOutcome> {
    let outcomes = origins.iter().enumerate().map(|(k, origin)| {
        let (status, reason) = match (refused.get(&k), waiting.get(&k)) {
            (Some(reason), _) => (BatchStatus::Quarantined, Some(reason.clone())),
            (_, Some(reason)) => (BatchStatus::Unanchored, Some(reason.clone())),
            _ => (BatchStatus::Merged, None),
        };
        BatchOutcome {
            reason,
            ..outcome_of(origin, status)
        }
    });
    outcomes.collect()
}

/// The batches that are connected to the map, and why the others are not. Batches that name unknown nodes or
/// are not connected are left out until none is left.
fn select(edges: &EdgeJob, mut selected: Vec<usize>, map: &RouteMap) -> (Vec<usize>, Waiting) {
    let mut waiting = Waiting::new();
    loop {
        let mut left_out = Waiting::new();
        let brought: BTreeSet<&str> = brought_by(edges, &selected).collect();
        for &k in &selected {
            left_out.extend(missing(edges, k, &brought, map).map(|reason| (k, reason)));
        }
        if left_out.is_empty() {
            selected = in_order(edges, selected, map);
            let joined = Joined::of(edges, &selected, map);
            for node in map.untied(&joined.graph) {
                let (k, name) = &joined.node_sources[node];
                let reason = format!("node {name} is not connected: no edge ties it to the map");
                left_out.entry(*k).or_insert(reason);
            }
        }
        if left_out.is_empty() {
            return (selected, waiting);
        }
        selected.retain(|k| !left_out.contains_key(k));
        waiting.append(&mut left_out);
    }
}

/// The batches in the order of arrival, but each after those that declare the nodes it names.
fn in_order(edges: &EdgeJob, mut left: Vec<usize>, map: &RouteMap) -> Vec<usize> {
    let mut ordered = Vec::with_capacity(left.len());
    let mut brought: BTreeSet<&str> = BTreeSet::new();
    while !left.is_empty() {
        let is_next = |k: &usize| missing(edges, *k, &brought, map).is_none();
        // Batches that name each other's nodes have no order.
        let next = left.iter().position(is_next).unwrap_or(0);
        let next = left.remove(next);
        brought.extend(
            edges.uploads[next]
                .nodes
                .iter()
                .map(|node| node.name.as_str()),
        );
        ordered.push(next);
    }
    ordered
}

fn brought_by<'a>(edges: &'a EdgeJob, selected: &'a [usize]) -> impl Iterator<Item = &'a str> {
    let nodes = selected.iter().flat_map(|&k| &edges.uploads[k].nodes);
    nodes.map(|node| node.name.as_str())
}

/// The first unknown node that a batch names.
fn missing(edges: &EdgeJob, k: usize, brought: &BTreeSet<&str>, map: &RouteMap) -> Option<String> {
    let vehicle = &edges.origins[k].vehicle_id;
    let own_nodes = edges.uploads[k].nodes.iter();
    let own_nodes: BTreeSet<&str> = own_nodes.map(|node| node.name.as_str()).collect();
    let in_map = |id: NodeId| map.graph().node(id).is_some();
    edges.uploads[k].edges.iter().enumerate().find_map(|(e, edge)| {
        [&edge.from, &edge.to].into_iter().find_map(|name| match name {
            NodeName::Own(own) => {
                let known = edges.known.get(own).is_some_and(|id| in_map(*id));
                (!known && !own_nodes.contains(own.as_str()) && !brought.contains(own.as_str())).then(|| {
                    format!("edge {e} names node {own}, which vehicle {vehicle} has not brought yet")
                })
            }
            NodeName::OfMap(id) => (!in_map(*id))
                .then(|| format!("edge {e} names node {id} of the map, which has none of that number")),
        })
    })
}

/// Some batches as one graph.
struct Joined {
    graph: GivenGraph,
    /// The batch of each node, and the vehicle's name for it.
    node_sources: Vec<(usize, String)>,
    /// The batch of each edge.
    edge_sources: Vec<usize>,
}

impl Joined {
    /// Joins the batches; edges with an unknown end are left out.
    fn of(edges: &EdgeJob, selected: &[usize], map: &RouteMap) -> Self {
        let mut joined = Self {
            graph: GivenGraph::default(),
            node_sources: Vec::new(),
            edge_sources: Vec::new(),
        };
        let mut places: BTreeMap<&str, usize> = BTreeMap::new();
        for &k in selected {
            for node in &edges.uploads[k].nodes {
                places.insert(&node.name, joined.graph.nodes.len());
                joined.node_sources.push((k, node.name.clone()));
                joined.graph.nodes.push(GivenNode {
                    trip: edges.origins[k].trip_id.clone(),
                    stamp: node.stamp,
                    pose: node.pose,
                });
            }
        }
        let end_of = |name: &NodeName| match name {
            NodeName::OfMap(id) => map.graph().node(*id).map(|_| End::Known(*id)),
            NodeName::Own(own) => match places.get(own.as_str()) {
                Some(place) => Some(End::New(*place)),
                None => edges.known.get(own).map(|id| End::Known(*id)),
            },
        };
        for &k in selected {
            for edge in &edges.uploads[k].edges {
                let (Some(from), Some(to)) = (end_of(&edge.from), end_of(&edge.to)) else {
                    continue;
                };
                joined.edge_sources.push(k);
                joined.graph.edges.push(GivenEdge {
                    from,
                    to,
                    measurement: edge.measurement,
                    information: edge.information,
                    kind: edge.kind,
                });
            }
        }
        joined
    }
}
