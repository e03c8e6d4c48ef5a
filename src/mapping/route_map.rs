//! A route's graph with the scans of its nodes.

use std::collections::{BTreeMap, BTreeSet};

use super::closure::ClosureRule;
use super::keyframe::Keyframe;
use super::partners::Placed;
use crate::change::Layers;
use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, GraphError, Node, PoseGraph};
use crate::ids::{EdgeId, NodeId, TripId};
use crate::solver::{Interrupt, Solver};

/// How edges are measured, which measurement enters the optimisation, and how it is weighed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Weighting {
    /// Robust estimates with their information; all-points estimates are only watched.
    #[default]
    Robust,
    /// All-points estimates with Ω = I, as in the paper's statistics (section 4.1).
    ///
    /// What is *not* the paper's: a closure is made only if a robust match and a comparison with
    /// free space accept it first, and odometry edges are robust matches with a local map, drawn
    /// towards the wheels. The service's detector `seed` works so.
    AllPointsIdentity,
    /// The paper's protocol and nothing besides; for reproducing it, not for the service.
    ///
    /// Odometry edges and closures alike come from matching two scans with all of their points
    /// (sections 2 and 4), with Ω = I (section 4.1). A closure is accepted by the score of that
    /// match alone (section 5.1).
    Paper,
}

impl Weighting {
    /// What an edge is weighed with, given the information that was measured.
    pub(super) fn information(self, measured: Information) -> Information {
        match self {
            Self::Robust => measured,
            Self::AllPointsIdentity | Self::Paper => Information::identity(),
        }
    }
}

/// A route's map: the pose graph and a keyframe for each node.
pub struct RouteMap {
    pub(super) graph: PoseGraph,
    /// In the order of `graph.nodes()`.
    pub(super) keyframes: Vec<Keyframe>,
    /// What it remembers is forgotten after each drive.
    pub(super) solver: Solver,
    pub(super) weighting: Weighting,
    pub(super) closure_rule: ClosureRule,
    /// Places in `keyframes` of each trip's nodes, in the order of the drive.
    pub(super) trips: BTreeMap<TripId, Vec<usize>>,
    /// Where something may have changed, layer by layer.
    pub(super) layers: Layers,
    /// Trips that observe nothing.
    distrusted: BTreeSet<TripId>,
    pub(super) interrupt: Interrupt,
    next_node: i64,
    next_edge: i64,
}

impl RouteMap {
    /// An empty map.
    pub fn new(weighting: Weighting) -> Self {
        Self {
            graph: PoseGraph::new(),
            keyframes: Vec::new(),
            solver: Solver::default(),
            weighting,
            closure_rule: ClosureRule::default(),
            trips: BTreeMap::new(),
            layers: Layers::default(),
            distrusted: BTreeSet::new(),
            interrupt: Interrupt::default(),
            next_node: 1,
            next_edge: 1,
        }
    }

    /// What a solver remembers shows in the last bits: a map that is restored remembers nothing
    /// either. It takes memory, too.
    pub(super) fn forget_solves(&mut self) {
        self.solver = Solver::heeding(&self.interrupt);
    }

    /// A map from its parts, as they were saved. The next ids are the first never used.
    ///
    /// # Errors
    /// [`GraphError`] if they do not fit together.
    pub fn restore(
        weighting: Weighting,
        nodes: impl IntoIterator<Item = (Pose2, Keyframe)>,
        edges: impl IntoIterator<Item = Edge>,
        next_node: NodeId,
        next_edge: EdgeId,
    ) -> Result<Self, GraphError> {
        let mut map = Self::new(weighting);
        for (pose, keyframe) in nodes {
            map.insert_keyframe(pose, keyframe)?;
        }
        for edge in edges {
            map.graph.add_edge(edge)?;
        }
        map.next_node = next_node.0;
        map.next_edge = next_edge.0;
        if weighting == Weighting::Robust {
            map.settle_screen();
        }
        Ok(map)
    }

    /// From now on walks through the map stop once this is raised; the map is lost then.
    pub fn heed(&mut self, interrupt: &Interrupt) {
        self.interrupt = interrupt.clone();
        self.forget_solves();
    }

    /// The same map with another rule for the closures to come.
    pub fn with_closure_rule(self, closure_rule: ClosureRule) -> Self {
        Self {
            closure_rule,
            ..self
        }
    }

    /// From now on these trips observe nothing, nor have they: when they observed it is not known. Their
    /// scans stay in the map.
    pub fn distrust(&mut self, trips: impl IntoIterator<Item = TripId>) {
        self.distrusted.extend(trips);
    }

    /// Whether what was seen from a keyframe says anything about changes.
    pub(super) fn observes(&self, keyframe: &Keyframe) -> bool {
        !keyframe.is_lost() && !self.distrusted.contains(&keyframe.trip)
    }

    /// The pose graph.
    pub fn graph(&self) -> &PoseGraph {
        &self.graph
    }

    /// The keyframes, in the order of the graph's nodes.
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// The keyframe of a node.
    pub fn keyframe(&self, node: NodeId) -> Option<&Keyframe> {
        Some(&self.keyframes[self.graph.node_position(node)?])
    }

    /// The first node id never used.
    pub fn next_node_id(&self) -> NodeId {
        NodeId(self.next_node)
    }

    /// The first edge id never used.
    pub fn next_edge_id(&self) -> EdgeId {
        EdgeId(self.next_edge)
    }

    /// The keyframe at a place of [`RouteMap::keyframes`] with its pose.
    pub(super) fn placed(&self, index: usize) -> Placed<'_> {
        Placed {
            pose: self.graph.nodes()[index].pose,
            keyframe: &self.keyframes[index],
        }
    }

    pub(super) fn take_node_id(&mut self) -> NodeId {
        let id = NodeId(self.next_node);
        self.next_node += 1;
        id
    }

    pub(super) fn take_edge_id(&mut self) -> EdgeId {
        let id = EdgeId(self.next_edge);
        self.next_edge += 1;
        id
    }

    /// Takes back the ids of edges that were taken out again.
    pub(super) fn set_next_edge(&mut self, next: EdgeId) {
        self.next_edge = next.0;
    }

    pub(super) fn insert_keyframe(
        &mut self,
        pose: Pose2,
        mut keyframe: Keyframe,
    ) -> Result<usize, GraphError> {
        let index = self.keyframes.len();
        let id = keyframe.node;
        self.graph.add_node(Node { id, pose })?;
        let trip = self.trips.entry(keyframe.trip.clone()).or_default();
        if let Some(&before) = trip.last() {
            let next = self.keyframes[before].trip_order + 1;
            keyframe.trip_order = keyframe.trip_order.max(next);
        }
        trip.push(index);
        self.keyframes.push(keyframe);
        Ok(index)
    }
}
