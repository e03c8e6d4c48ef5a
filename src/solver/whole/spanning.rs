//! A start along the edges: every pose by composing measurements from its component's first.

use std::collections::VecDeque;

use crate::graph::{EdgeKind, EdgeStatus, PoseGraph};

/// Puts every node where a spanning tree of the active edges says: each component's first node
/// stays, odometry edges are followed before loop closures, then breadth first in the graph's
/// order.
pub fn start_along_odometry(graph: &mut PoseGraph) {
    let mut placed = vec![false; graph.nodes().len()];
    let mut queue = VecDeque::new();
    let mut waiting = VecDeque::new();
    for first in 0..placed.len() {
        if std::mem::replace(&mut placed[first], true) {
            continue;
        }
        queue.push_back(first);
        loop {
            // A closure is crossed only once odometry leads no further.
            let Some(at) = queue.pop_front() else {
                match waiting.pop_front() {
                    Some(edge) => place_end(graph, edge, &mut placed, &mut queue),
                    None => break,
                }
                continue;
            };
            for edge in graph.incident(at).to_vec() {
                match graph.edges()[edge] {
                    e if e.status != EdgeStatus::Active => {}
                    e if e.kind == EdgeKind::LoopClosure => waiting.push_back(edge),
                    _ => place_end(graph, edge, &mut placed, &mut queue),
                }
            }
        }
    }
}

fn place_end(graph: &mut PoseGraph, edge: usize, placed: &mut [bool], queue: &mut VecDeque<usize>) {
    let (from, to) = graph.ends()[edge];
    let measurement = graph.edges()[edge].measurement;
    let (position, pose) = match (placed[from], placed[to]) {
        (true, false) => (to, graph.nodes()[from].pose.compose(&measurement)),
        (false, true) => (from, graph.nodes()[to].pose.compose(&measurement.inverse())),
        _ => return,
    };
    placed[position] = true;
    graph.set_pose_at(position, pose);
    queue.push_back(position);
}
