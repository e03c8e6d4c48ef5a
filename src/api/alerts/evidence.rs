//! The evidence behind an alert: the two scans that disagree most at its place, and the residuals
//! around the closure that tells it.

use std::collections::{BTreeMap, BTreeSet};

use crate::api::ApiState;
use crate::api::problem::Problem;
use crate::change::{BeamVerdict, JudgedBeam, judge_beams, layer_of};
use crate::geometry::{Pose2, Vector2, distance_to_polygon};
use crate::graph::EdgeKind;
use crate::ids::{EdgeId, NodeId};
use crate::observation::Observation;
use crate::pipeline::{ResidualReading, Residuals};
use crate::scan::{LaserScan, decode_scan};
use crate::store::{AlertRecord, EdgeRecord, NodeRecord, RouteRecord};

/// Pairs of scans that are compared before one is chosen.
const PAIRS_MAX: usize = 16;
/// Contradictions this far from the region still belong to it, metres.
const REGION_MARGIN_M: f64 = 0.1;
/// Closures of the series to each side of the alert's.
pub(super) const SERIES_REACH: usize = 40;

/// What an alert rests on.
#[derive(Debug)]
pub(super) struct Evidence {
    pub alert: AlertRecord,
    /// The closure between the two looks, or where there are none that of `tied`; `None` if the
    /// looks are not matched with each other.
    pub edge_id: Option<EdgeId>,
    /// The closure that tells it most clearly; `None` if nothing but nodes does.
    pub told_by: Option<EdgeId>,
    /// The old and the new look; `None` where no two scans are known.
    pub looks: Option<[LookBack; 2]>,
    /// Without scans: where the ends of the closure are that tells it (`map_from_base`), the old
    /// one first.
    pub tied: Option<[Pose2; 2]>,
    /// The residuals around the closure that tells it; `None` also if that left the active graph
    /// long ago, and is not among the entries of its series any more.
    pub series: Option<ResidualReading>,
}

/// A scan with what the other one says of it.
#[derive(Debug)]
pub(super) struct LookBack {
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

/// Gathers the evidence of an alert as the map stands now.
///
/// # Errors
/// [`Problem`] if the store does not answer.
pub(super) async fn gather(
    state: &ApiState,
    alert: AlertRecord,
    route: &RouteRecord,
) -> Result<Evidence, Problem> {
    let edges = closures(state, &alert).await?;
    let nodes = named_nodes(state, &alert, &edges).await?;
    let pairs = pairs(&alert, &edges, &nodes);
    let tied = tied(&pairs, &nodes);
    let scans = scans_of(state, &alert, &pairs, nodes).await?;
    let mut accepted = state.store.accepted_changes(&alert.route_id).await?;
    // The series as it stood against the map that the alert contradicts: an acceptance, the
    // alert's own too, takes closures out of it.
    accepted.retain(|change| change.map_version <= alert.map_version);
    let detector = route.settings.detector;
    let residuals = Residuals::load(&state.store, &alert.route_id, detector, accepted).await?;
    let work = move || {
        let chosen = choose(&pairs, &scans, &alert.evidence.region);
        let (pair, looks) = chosen.unzip();
        let (tied_by, tied) = tied.filter(|_| looks.is_none()).unzip();
        let edge_id = pair.and_then(|pair| pair.edge).or(tied_by);
        let told_by = alert.residual.map(|residual| residual.edge_id).or(edge_id);
        Evidence {
            series: told_by.and_then(|edge| residuals.around(edge, SERIES_REACH)),
            edge_id,
            told_by,
            looks,
            tied,
            alert,
        }
    };
    state.rendering.run(work).await
}

/// The nodes that the alert names, itself or as ends of its closures.
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

/// The closures that the alert names, the one of its residual first.
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

/// Pairs worth comparing: the alert's closures, or else each new look with the nearest old one.
fn pairs(
    alert: &AlertRecord,
    edges: &[EdgeRecord],
    nodes: &BTreeMap<NodeId, NodeRecord>,
) -> Vec<Pair> {
    let tied = edges.iter().filter_map(|edge| {
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
    let tied: Vec<Pair> = tied.take(PAIRS_MAX).collect();
    if !tied.is_empty() {
        return tied;
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

/// The closure of the first pair, and where its ends are.
fn tied(pairs: &[Pair], nodes: &BTreeMap<NodeId, NodeRecord>) -> Option<(EdgeId, [Pose2; 2])> {
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

/// Chooses the pair whose scans contradict each other most within the region; the earlier one of
/// equals, so that the residual's own closure wins where nothing contradicts.
fn choose(pairs: &[Pair], scans: &Scans, region: &[Vector2<f64>]) -> Option<(Pair, [LookBack; 2])> {
    let mut best: Option<(usize, Pair, [LookBack; 2])> = None;
    for pair in pairs {
        let Some(looks) = judged(pair, scans) else {
            continue;
        };
        let count = contradictions(&looks, region);
        if best.as_ref().is_none_or(|(most, ..)| count > *most) {
            best = Some((count, *pair, looks));
        }
    }
    best.map(|(_, pair, looks)| (pair, looks))
}

fn judged(pair: &Pair, scans: &Scans) -> Option<[LookBack; 2]> {
    let (old, new) = (scans.get(&pair.old)?, scans.get(&pair.new)?);
    // What two height bands show is no contradiction.
    if layer_of(&old.1) != layer_of(&new.1) {
        return None;
    }
    let look = |judged: &(NodeRecord, LaserScan), by: &(NodeRecord, LaserScan)| LookBack {
        node: judged.0.clone(),
        map_from_lidar: judged.0.pose.compose(&judged.1.lidar().mount),
        beams: judge_beams(&observation(judged), &observation(by)),
        range_sigma_m: judged.1.lidar().range_sigma_m,
    };
    Some([look(old, new), look(new, old)])
}

fn observation((node, scan): &(NodeRecord, LaserScan)) -> Observation {
    Observation::new(scan, &node.pose)
}

fn contradictions(looks: &[LookBack; 2], region: &[Vector2<f64>]) -> usize {
    let beams = looks.iter().flat_map(|look| &look.beams);
    let contradicting = beams.filter(|beam| beam.verdict == BeamVerdict::Contradicts);
    let ends = contradicting.filter_map(|beam| beam.end);
    ends.filter(|end| distance_to_polygon(end, region) <= REGION_MARGIN_M)
        .count()
}
