//! From fields to checked values. JSON has no NaN and no infinity, so every number is finite here.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::raw;
use super::uploaded::{
    EDGES_MAX, MAP_PREFIX, NODES_MAX, NodeName, UploadedEdge, UploadedEdges, UploadedNode,
};
use crate::geometry::{Information, Pose2};
use crate::ids::{InvalidName, NodeId, StampNs, validate_name};
use crate::ingest::batch_json::{COORDINATE_MAX_M, HEADING_MAX_RAD, Pose, clock_flags};
use crate::ingest::body_error::{BatchProblem, Checked, refuse};
use crate::ingest::extensions::Extensions;
use crate::ingest::json::Object;
use crate::ingest::stamp::SentStamp;

/// Largest entry of an information matrix: a standard deviation of a micrometre or a microradian is not
/// credible.
const INFORMATION_MAX: f64 = 1e12;
/// Least ratio of the smallest to the largest eigenvalue of an information matrix: a smaller one cannot be
/// distinguished from a singular matrix.
const CONDITION_MIN: f64 = 1e-12;

pub(super) fn batch(raw: raw::Batch, received_at: Timestamp) -> Checked<UploadedEdges> {
    check_count("/nodes", raw.nodes.count, NODES_MAX)?;
    check_count("/edges", raw.edges.count, EDGES_MAX)?;
    if raw.nodes.count == 0 && raw.edges.count == 0 {
        let detail = "a batch has at least one node or one edge".to_owned();
        return refuse(BatchProblem::EdgeGraph, "/nodes", detail);
    }
    let extensions = raw.extensions.map(Extensions::checked).transpose()?;
    let sent = sent_stamps(&raw.nodes.kept)?;
    let nodes = nodes(raw.nodes.kept, &sent, received_at)?;
    let sent: Vec<StampNs> = sent.into_iter().flatten().collect();
    let edges = raw.edges.kept.into_iter().enumerate();
    Ok(UploadedEdges {
        vehicle_id: raw.vehicle_id,
        trip_id: raw.trip_id,
        nodes,
        edges: edges.map(|(k, raw)| edge(k, raw)).collect::<Checked<_>>()?,
        flags: clock_flags(&sent, received_at),
        extensions,
    })
}

fn check_count(pointer: &str, count: usize, count_max: usize) -> Checked<()> {
    if count <= count_max {
        return Ok(());
    }
    let what = &pointer[1..];
    let detail =
        format!("a batch has at most {count_max} {what}, this one has {count}: send parts");
    refuse(BatchProblem::TooLarge, pointer, detail)
}

/// The stamps of the nodes, where they were sent.
fn sent_stamps(raw: &[raw::Node]) -> Checked<Vec<Option<StampNs>>> {
    let stamps = raw.iter().enumerate().map(|(k, node)| {
        let checked = |stamp: SentStamp| stamp.checked(|| format!("/nodes/{k}/stamp"));
        node.stamp.map(checked).transpose()
    });
    stamps.collect()
}

fn nodes(
    raw: Vec<raw::Node>,
    sent: &[Option<StampNs>],
    received_at: Timestamp,
) -> Checked<Vec<UploadedNode>> {
    let mut nodes = Vec::with_capacity(raw.len());
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let received_ns = i64::try_from(received_at.as_nanosecond()).unwrap_or(i64::MAX);
    for (k, raw) in raw.into_iter().enumerate() {
        let at_id = || format!("/nodes/{k}/id");
        let name = match name(raw.id, &at_id())? {
            NodeName::Own(name) => name,
            NodeName::OfMap(id) => {
                let detail = format!(
                    "node {id} of the map is there already: name it in edges alone, as {MAP_PREFIX}{id}"
                );
                return refuse(BatchProblem::EdgeGraph, at_id(), detail);
            }
        };
        if let Some(before) = places.insert(name.clone(), k) {
            let detail = format!("{name} is the id of /nodes/{before} as well");
            return refuse(BatchProblem::EdgeGraph, at_id(), detail);
        }
        let as_received = StampNs(received_ns.saturating_add(k as i64));
        let sent = sent[k].filter(|stamp| !stamp.is_simulated());
        let stamp = sent.unwrap_or(as_received);
        let pose = pose(raw.pose, &format!("/nodes/{k}/pose"))?;
        nodes.push(UploadedNode { name, pose, stamp });
    }
    Ok(nodes)
}

fn edge(k: usize, raw: raw::Edge) -> Checked<UploadedEdge> {
    let from = name(raw.from, &format!("/edges/{k}/from"))?;
    let to = name(raw.to, &format!("/edges/{k}/to"))?;
    if from == to {
        let detail = format!("the edge joins node {to} to itself: an edge has two ends");
        return refuse(BatchProblem::EdgeGraph, format!("/edges/{k}/to"), detail);
    }
    Ok(UploadedEdge {
        from,
        to,
        measurement: pose(raw.measurement, &format!("/edges/{k}/measurement"))?,
        information: information(raw.information, format!("/edges/{k}/information"))?,
        kind: raw.kind,
    })
}

fn name(raw: raw::Name, pointer: &str) -> Checked<NodeName> {
    let raw::Name(name) = raw;
    if let Some(digits) = name.strip_prefix(MAP_PREFIX) {
        let number = digits.parse().ok().filter(|number: &i64| *number >= 0);
        return match number.filter(|number| number.to_string() == digits) {
            Some(number) => Ok(NodeName::OfMap(NodeId(number))),
            None => refuse(
                BatchProblem::InvalidField,
                pointer,
                format!("after {MAP_PREFIX} stands the number of a node of the map"),
            ),
        };
    }
    match validate_name(&name) {
        Ok(()) => Ok(NodeName::Own(name)),
        Err(InvalidName) => refuse(BatchProblem::InvalidField, pointer, InvalidName.to_string()),
    }
}

fn pose(Object(raw): Object<Pose>, pointer: &str) -> Checked<Pose2> {
    let wrong = |field: &str, value: f64, max: f64, unit: &str| {
        let detail = format!("{field} {value} is not within ±{max} {unit}");
        let pointer = format!("{pointer}/{field}");
        refuse(BatchProblem::OutOfRange, pointer, detail)
    };
    for (field, value) in [("x", raw.x), ("y", raw.y)] {
        if value.abs() > COORDINATE_MAX_M {
            return wrong(field, value, COORDINATE_MAX_M, "m");
        }
    }
    if raw.theta.abs() > HEADING_MAX_RAD {
        return wrong("theta", raw.theta, HEADING_MAX_RAD, "rad: send radians");
    }
    Ok(Pose2::new(raw.x, raw.y, raw.theta))
}

fn information(upper: [f64; 6], pointer: String) -> Checked<Information> {
    if let Some(entry) = upper.iter().find(|entry| entry.abs() > INFORMATION_MAX) {
        let detail = format!("{entry} is not within ±{INFORMATION_MAX:e}: nothing is that certain");
        return refuse(BatchProblem::OutOfRange, pointer, detail);
    }
    let information = Information::from_upper(upper);
    if information.is_positive_definite(CONDITION_MIN) {
        return Ok(information);
    }
    let detail = "the matrix is not positive definite: send the inverse of the covariance, \
                  (xx, xy, xθ, yy, yθ, θθ)";
    refuse(BatchProblem::EdgeGraph, pointer, detail.to_owned())
}
