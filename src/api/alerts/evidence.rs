//! The evidence behind an alert: the two scans that disagree most at its place, and the residuals around
//! the loop closure that shows it best.

use std::collections::{BTreeMap, BTreeSet};

use crate::api::ApiState;
use crate::api::problem::Problem;
use crate::change::{BeamVerdict, JudgedBeam, judge_beams, layer_of};
use crate::geometry::{Pose2, Vector2, distance_to_polygon};
use crate::ids::{EdgeId, NodeId};
use crate::model::EdgeKind;
use crate::observation::Observation;
use crate::pipeline::{ResidualReading, Residuals};
use crate::scan::{LaserScan, decode_scan};
use crate::store::{AlertRecord, EdgeRecord, NodeRecord, RouteRecord};

/// Pairs of scans compared before one is chosen.
const PAIRS_MAX: usize = 16;
/// Contradictions up to this far from the region belong to it, metres.
const REGION_MARGIN_M: f64 = 0.1;
/// Closures of the series on each side of the alert's.
pub(super) const SERIES_REACH: usize = 40;

/// The evidence behind an alert.
#[derive(Debug)]
pub(super) struct Evidence {
    pub alert: AlertRecord,
    /// The closure between the two scans, or without scans that of `ends`; `None` if the scans are not
    /// matched with each other.
    pub edge_id: Option<EdgeId>,
    /// The closure that shows it best; `None` if only nodes show it.
    pub shown_by: Option<EdgeId>,
    /// The old and the new scan; `None` if no two scans are known.
    pub scans: Option<[JudgedScan; 2]>,
    /// Without scans: the poses of the closure's nodes (`map_from_base`), the old one first.
    pub ends: Option<[Pose2; 2]>,
    /// The residuals around `shown_by`; `None` also if that closure was archived long ago and is no longer
    /// among the entries of its series.
    pub series: Option<ResidualReading>,
}

/// A scan, each beam judged by the other scan.
#[derive(Debug)]
pub(super) struct JudgedScan {
    pub node: NodeRecord,
    pub map_from_lidar: Pose2,
    pub beams: Vec<JudgedBeam>,
    /// Standard deviation of the lidar's ranges, metres.
    pub range_sigma_m: f64,
}

/// Two nodes that may show the old and the new state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    edge: Option<EdgeId>,
    old: NodeId,
    new: NodeId,
}

type Scans = BTreeMap<NodeId, (NodeRecord, LaserScan)>;

/// Gathers the evidence of an alert in the map as it is now.
///
/// # Errors
/// A [`Problem`] if the store does not answer.
pub(super) async fn gather(
    state: &ApiState,
    alert: AlertRecord,
    route: &RouteRecord,
) -> Result<Evidence, Problem> {
    let edges = closures(state, &alert).await?;
    let nodes = named_nodes(state, &alert, &edges).await?;
    let pairs = pairs(&alert, &edges, &nodes);
    let ends = ends(&pairs, &nodes);
    let scans = scans_of(state, &alert, &pairs, nodes).await?;
    let mut accepted = state.store.accepted_changes(&alert.route_id).await?;
    // The series of the map that the alert contradicts: later acceptances, the alert's own among them, have
    // taken closures out of it.
    accepted.retain(|change| change.map_version <= alert.map_version);
    let detector = route.settings.detector;
    let residuals = Residuals::load(&state.store, &alert.route_id, detector, accepted).await?;
    let work = move || {
        let chosen = choose(&pairs, &scans, &alert.evidence.region);
        let (pair, scans) = chosen.unzip();
        let (between, ends) = ends.filter(|_| scans.is_none()).unzip();
        let edge_id = pair.and_then(|pair| pair.edge).or(between);
        let shown_by = alert.residual.map(|residual| residual.edge_id).or(edge_id);
        Evidence {
            series: shown_by.and_then(|edge| residuals.around(edge, SERIES_REACH)),
            edge_id,
            shown_by,
            scans,
            ends,
            alert,
        }
    };
    state.rendering.run(work).await
}

/// The nodes that the alert names, and those of its closures.
async fn named_nodes(
    state: &ApiState,
    alert: &AlertRecord,
    closures: &[EdgeRecord],
) -> Result<BTreeMap<NodeId, NodeRecord>, Problem> {
    let ends = closures.iter().flat_map(|edge| [edge.from, edge.to]);
    let ids: BTreeSet<NodeId> = alert.evidence.nodes.iter().copied().chain(ends).collect();
    let ids: Vec<NodeId> = ids.into_iter().collect();
    let nodes = state.store.nodes_named(&alert.route_id, &ids).await?;
    Ok(nodes.into_iter().map(|node| (node.id, node)).collect())
}

/// The loop closures that the alert names, that of its residual first.
async fn closures(state: &ApiState, alert: &AlertRecord) -> Result<Vec<EdgeRecord>, Problem> {
    let strongest = alert.residual.map(|residual| residual.edge_id);
    let mut ids = alert.evidence.edges.clone();
    ids.extend(strongest);
    let edges = state.store.edges_named(&alert.route_id, &ids).await?;
    let mut closures: Vec<EdgeRecord> = edges
        .into_iter()
        .filter(|edge| edge.kind == EdgeKind::LoopClosure)
        .collect();
    let place = |edge: &EdgeRecord| {
        let named = alert.evidence.edges.iter().position(|id| *id == edge.id);
        (Some(edge.id) != strongest, named)
    };
    closures.sort_by_key(place);
    Ok(closures)
}

/// Pairs worth comparing: the nodes of the alert's closures, or without any each new node with the nearest
/// old one.
fn pairs(
    alert: &AlertRecord,
    edges: &[EdgeRecord],
    nodes: &BTreeMap<NodeId, NodeRecord>,
) -> Vec<Pair> {
    let matched = edges.iter().filter_map(|edge| {
        let (from, to) = (nodes.get(&edge.from)?, nodes.get(&edge.to)?);
        let (old, new) = if from.stamp <= to.stamp {
            (from, to)
        } else {
            (to, from)
        };
        Some(Pair {
            edge: Some(edge.id),
            old: old.id,
            new: new.id,
        })
    });
    let matched: Vec<Pair> = matched.take(PAIRS_MAX).collect();
    if !matched.is_empty() {
        return matched;
    }
    let since = alert.evidence.since;
    let (new, old): (Vec<&NodeRecord>, Vec<&NodeRecord>) =
        nodes.values().partition(|node| node.stamp >= since);
    let distance =
        |a: &NodeRecord, b: &NodeRecord| (a.pose.translation() - b.pose.translation()).norm();
    let nearest = |new: &&NodeRecord| {
        let by_distance =
            |a: &&&NodeRecord, b: &&&NodeRecord| distance(a, new).total_cmp(&distance(b, new));
        let old = old.iter().min_by(by_distance)?;
        Some(Pair {
            edge: None,
            old: old.id,
            new: new.id,
        })
    };
    new.iter().filter_map(nearest).take(PAIRS_MAX).collect()
}

/// The closure of the first pair, and the poses of its nodes.
fn ends(pairs: &[Pair], nodes: &BTreeMap<NodeId, NodeRecord>) -> Option<(EdgeId, [Pose2; 2])> {
    let pair = pairs.first()?;
    let (old, new) = (nodes.get(&pair.old)?, nodes.get(&pair.new)?);
    Some((pair.edge?, [old.pose, new.pose]))
}

async fn scans_of(
    state: &ApiState,
    alert: &AlertRecord,
    pairs: &[Pair],
    mut nodes: BTreeMap<NodeId, NodeRecord>,
) -> Result<Scans, Problem> {
    let mut scans = Scans::new();
    for id in pairs.iter().flat_map(|pair| [pair.old, pair.new]) {
        let Some(node) = nodes.remove(&id) else {
            continue;
        };
        if let Some(bytes) = state.store.node_scan(&alert.route_id, id).await? {
            let scan = decode_scan(&bytes).map_err(Problem::internal)?;
            scans.insert(id, (node, scan));
        }
    }
    Ok(scans)
}

/// Chooses the pair whose scans contradict each other most within the region; of equals the first, so that
/// the closure of the residual is chosen if nothing contradicts.
fn choose(
    pairs: &[Pair],
    scans: &Scans,
    region: &[Vector2<f64>],
) -> Option<(Pair, [JudgedScan; 2])> {
    let mut best: Option<(usize, Pair, [JudgedScan; 2])> = None;
    for pair in pairs {
        let Some(judged) = judged(pair, scans) else {
            continue;
        };
        let count = contradictions(&judged, region);
        if best.as_ref().is_none_or(|(most, ..)| count > *most) {
            best = Some((count, *pair, judged));
        }
    }
    best.map(|(_, pair, judged)| (pair, judged))
}

fn judged(pair: &Pair, scans: &Scans) -> Option<[JudgedScan; 2]> {
    let (old, new) = (scans.get(&pair.old)?, scans.get(&pair.new)?);
    // Scans of different height bands do not contradict each other.
    if layer_of(&old.1) != layer_of(&new.1) {
        return None;
    }
    let judge = |judged: &(NodeRecord, LaserScan), by: &(NodeRecord, LaserScan)| JudgedScan {
        node: judged.0.clone(),
        map_from_lidar: judged.0.pose.compose(&judged.1.lidar().mount),
        beams: judge_beams(&observation(judged), &observation(by)),
        range_sigma_m: judged.1.lidar().range_sigma_m,
    };
    Some([judge(old, new), judge(new, old)])
}

fn observation((node, scan): &(NodeRecord, LaserScan)) -> Observation {
    Observation::new(scan, &node.pose)
}

fn contradictions(scans: &[JudgedScan; 2], region: &[Vector2<f64>]) -> usize {
    let beams = scans.iter().flat_map(|scan| &scan.beams);
    let contradicting = beams.filter(|beam| beam.verdict == BeamVerdict::Contradicts);
    let ends = contradicting.filter_map(|beam| beam.end);
    ends.filter(|end| distance_to_polygon(end, region) <= REGION_MARGIN_M)
        .count()
}
