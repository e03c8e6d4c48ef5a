//! What was observed of an alert's place before the change and since, gathered from all scans taken within
//! reach of it.

use crate::api::ApiState;
use crate::api::problem::{Problem, ProblemKind};
use crate::change::{AcceptedChange, Finding, layer_of};
use crate::geometry::Vector2;
use crate::ids::StampNs;
use crate::model::{ChangeKind, PassSide};
use crate::observation::REACH_M;
use crate::render::{PlaceGrid, PosedScan};
use crate::scan::CodecError;
use crate::store::{AlertRecord, NodeWithScan, TimesOfChange, Within};

/// Most keyframes read of a side: those nearest to the change in time.
const NODES_MAX: u32 = 600;
/// Most intermediate scans read of a keyframe.
const INTERMEDIATE_MAX: u32 = 32;

/// Counts what was observed of an alert's place, cell by cell.
///
/// # Errors
/// 404 for an alert that is not about a place; a [`Problem`] if the store does not answer.
pub(super) async fn place_grid(
    state: &ApiState,
    alert: &AlertRecord,
) -> Result<PlaceGrid, Problem> {
    let finding = alert.evidence.clone();
    let Some(within) = within_reach(&finding) else {
        let detail = "this alert is about a vehicle, not about a place, so there are no observations to \
                      compare; its field suspect describes the fault";
        return Err(Problem::new(ProblemKind::NotFound, detail));
    };
    let store = &state.store;
    let accepted = store.accepted_changes(&alert.route_id).await?;
    let times = times_of(&finding, &accepted);
    let ids = store.nodes_about_change(&alert.route_id, within, times, NODES_MAX);
    let ids = ids.await?;
    let nodes = store.scans_of_nodes(&alert.route_id, &ids, INTERMEDIATE_MAX);
    let nodes = nodes.await?;
    let counted = state
        .rendering
        .run(move || counted(&finding, &times, &nodes));
    counted.await?.map_err(Problem::internal)
}

/// The rectangle around a finding's region from which lidars reach it; `None` if it is not about a place.
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

/// The times at which the place shows its state before a change and since.
fn times_of(finding: &Finding, accepted: &[AcceptedChange]) -> TimesOfChange {
    let before = accepted
        .iter()
        .filter(|change| change.since < finding.since && change.covers(&finding.location));
    let last = before.map(|change| change.since).max();
    TimesOfChange {
        from: last.unwrap_or(StampNs(i64::MIN)),
        since: finding.since,
        until: finding.until,
    }
}

fn side_of(stamp: StampNs, times: &TimesOfChange) -> Option<PassSide> {
    if stamp < times.from || times.until.is_some_and(|until| until <= stamp) {
        None
    } else if stamp < times.since {
        Some(PassSide::Before)
    } else {
        Some(PassSide::Since)
    }
}

fn counted(
    finding: &Finding,
    times: &TimesOfChange,
    nodes: &[NodeWithScan],
) -> Result<PlaceGrid, CodecError> {
    let mut scans = Vec::with_capacity(nodes.len());
    for node in nodes {
        scans.extend(node.decoded_scans()?);
    }
    let observations = scans.iter().filter_map(|(stamp, map_from_base, scan)| {
        // Height bands are compared only with their like.
        let is_comparable = !finding.kind.is_of_state() || finding.is_of(layer_of(scan));
        let side = side_of(*stamp, times).filter(|_| is_comparable)?;
        let observation = PosedScan {
            stamp: *stamp,
            map_from_base: *map_from_base,
            scan,
            untied: None,
        };
        Some((side, observation))
    });
    Ok(PlaceGrid::around(&finding.region).with_scans(observations))
}
