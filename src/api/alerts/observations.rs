//! What was observed of an alert's place before the change and since: gathered from all scans of
//! vehicles that came within reach.

use crate::api::ApiState;
use crate::api::problem::{Problem, ProblemKind};
use crate::change::{AcceptedChange, Finding, layer_of};
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs};
use crate::model::{ChangeKind, PassSide};
use crate::observation::REACH_M;
use crate::render::{PlaceGrid, PosedScan};
use crate::scan::CodecError;
use crate::store::{AlertRecord, NodeRecord, NodeWithScan, Within};

/// Keyframes of a side that are read, at most: those nearest to the change in time.
const NODES_MAX: usize = 600;
/// Scans behind a keyframe that are read, at most.
const BEHIND_MAX: u32 = 32;

/// Counts what was observed of an alert's place, cell by cell.
///
/// # Errors
/// 404 for an alert that is about no place; or if the store does not answer.
pub(super) async fn place_grid(
    state: &ApiState,
    alert: &AlertRecord,
) -> Result<PlaceGrid, Problem> {
    let finding = alert.evidence.clone();
    let Some(within) = within_reach(&finding) else {
        let detail = "this alert is about a vehicle, not about a place: there are no observations to \
                      compare; its suspect says what is off";
        return Err(Problem::new(ProblemKind::NotFound, detail));
    };
    let store = &state.store;
    let accepted = store.accepted_changes(&alert.route_id).await?;
    let sides = Sides::of(&finding, &accepted);
    let nodes = store.nodes_within(&alert.route_id, within).await?;
    let ids = nearest_in_time(&nodes, &sides);
    let nodes = store.scans_of_nodes(&alert.route_id, &ids, BEHIND_MAX);
    let nodes = nodes.await?;
    let counted = state
        .rendering
        .run(move || counted(&finding, &sides, &nodes));
    counted.await?.map_err(Problem::internal)
}

/// The rectangle round a finding's region in which lidars see it; `None` if it is about no place.
fn within_reach(finding: &Finding) -> Option<Within> {
    let first = finding.region.first()?;
    if finding.kind == ChangeKind::VehicleSuspect {
        return None;
    }
    let corners = || finding.region.iter();
    let reach = Vector2::repeat(REACH_M);
    let low = corners().fold(*first, |low, corner| low.inf(corner)) - reach;
    let high = corners().fold(*first, |high, corner| high.sup(corner)) + reach;
    Some(Within {
        x: [low.x, high.x],
        y: [low.y, high.y],
    })
}

/// When observations show the place before a change and since.
struct Sides {
    /// The change that was accepted there before: what was observed earlier is out of date.
    from: StampNs,
    since: StampNs,
    /// When the old state was observed again.
    until: Option<StampNs>,
}

impl Sides {
    fn of(finding: &Finding, accepted: &[AcceptedChange]) -> Self {
        let before = accepted
            .iter()
            .filter(|change| change.since < finding.since && change.covers(&finding.location));
        Self {
            from: before
                .map(|change| change.since)
                .max()
                .unwrap_or(StampNs(i64::MIN)),
            since: finding.since,
            until: finding.until,
        }
    }

    fn side_of(&self, stamp: StampNs) -> Option<PassSide> {
        if stamp < self.from || self.until.is_some_and(|until| until <= stamp) {
            None
        } else if stamp < self.since {
            Some(PassSide::Before)
        } else {
            Some(PassSide::Since)
        }
    }
}

/// Of nodes in the order of their stamps the last ones before the change, and the first ones since and
/// the newest.
fn nearest_in_time(nodes: &[NodeRecord], sides: &Sides) -> Vec<NodeId> {
    let of = |wanted: PassSide| {
        let nodes = nodes.iter().filter(|node| node.is_localised());
        let nodes = nodes.filter(|node| sides.side_of(node.stamp) == Some(wanted));
        nodes.map(|node| node.id).collect::<Vec<NodeId>>()
    };
    let (mut before, mut since) = (of(PassSide::Before), of(PassSide::Since));
    before.drain(..before.len().saturating_sub(NODES_MAX));
    if since.len() > NODES_MAX {
        since.drain(NODES_MAX / 2..since.len() - NODES_MAX / 2);
    }
    [before, since].concat()
}

fn counted(
    finding: &Finding,
    sides: &Sides,
    nodes: &[NodeWithScan],
) -> Result<PlaceGrid, CodecError> {
    let mut scans = Vec::with_capacity(nodes.len());
    for node in nodes {
        scans.extend(node.decoded_scans()?);
    }
    let scans = scans.iter().filter_map(|(stamp, map_from_base, scan)| {
        // What one height band shows is no answer to another.
        let is_comparable = !finding.kind.is_of_state() || finding.is_of(layer_of(scan));
        let side = sides.side_of(*stamp).filter(|_| is_comparable)?;
        let scan = PosedScan {
            stamp: *stamp,
            map_from_base: *map_from_base,
            scan,
        };
        Some((side, scan))
    });
    Ok(PlaceGrid::around(&finding.region).with_scans(scans))
}
