//! What contradicts a route's map, by the rule of the route's detector.

use std::collections::BTreeSet;

use super::residual_findings::by_residuals;
use super::stage::references;
use super::suspects::suspects;
use super::workspace::Workspace;
use crate::change::paper::{ClosurePlace, PaperChange, PaperParams, Peak, paper_changes};
use crate::change::series::{ClosureSample, residual_series};
use crate::change::{ChangeKind, Detector, Finding, Tier, region_round, stays_untouched};
use crate::ids::{EdgeId, NodeId, TripId};
use crate::mapping::{Mending, RouteMap, Scope, Sites};
use crate::store::AlertRecord;

/// Half the size of the region about a closure that the paper's rule names, metres: the rule does not say
/// where within the scans' range the change is.
const PAPER_REGION_M: f64 = 1.0;

/// What the scans of a map show, and how the map was corrected for it.
#[derive(Default)]
pub(super) struct Detected {
    pub findings: Vec<Finding>,
    pub mendings: Vec<Mending>,
}

/// Detects changes in the scans (detector `fused`), and moves misplaced segments of the map where scans prove
/// where they belong. Only sites with new observations are judged again.
///
/// # Errors
/// If the graph refuses an id; the workspace is lost then.
pub(super) fn detect_in_scans(workspace: &mut Workspace) -> anyhow::Result<Detected> {
    if workspace.detector == Detector::Seed {
        return Ok(Detected::default());
    }
    let evidence = workspace.alerts.iter().map(|alert| &alert.evidence);
    let known = evidence.filter(|known| known.kind == ChangeKind::MapMismatch);
    let known: Vec<Finding> = known.cloned().collect();
    let (findings, mendings) = with_scope(workspace, Sites::Touched, |map, scope| {
        map.findings_and_mendings(scope, &known)
    })?;
    Ok(Detected { findings, mendings })
}

/// Detects changes in the scans (detector `fused`), judging every site again; the map is not corrected.
pub(super) fn detect_everywhere(workspace: &mut Workspace) -> Vec<Finding> {
    if workspace.detector == Detector::Seed {
        return Vec::new();
    }
    with_scope(workspace, Sites::All, |map, scope| map.findings(scope))
}

fn with_scope<T>(
    workspace: &mut Workspace,
    sites: Sites,
    detect: impl FnOnce(&mut RouteMap, &Scope<'_>) -> T,
) -> T {
    let stays = |alert: &&AlertRecord| stays_untouched(alert.status, &alert.evidence);
    let pending = workspace.alerts.iter().filter(stays);
    let pending: Vec<Finding> = pending.map(|alert| alert.evidence.clone()).collect();
    let suspects = suspects(&workspace.calibrations);
    let scope = Scope {
        sites,
        pending: &pending,
        false_alerts_per_lap: workspace.false_alarm_rate,
        accepted: &workspace.accepted,
        vehicles: &workspace.vehicles,
        suspects: &suspects,
    };
    detect(&mut workspace.map, &scope)
}

/// All findings of the route: those of its scans, and those of the residuals of its closures.
pub(super) fn findings(workspace: &Workspace, in_scans: Vec<Finding>) -> Vec<Finding> {
    match workspace.detector {
        Detector::Fused => {
            let mut findings = in_scans;
            findings.extend(by_residuals(workspace));
            findings
        }
        Detector::Seed => by_the_paper(workspace),
    }
}

/// The changes that the series of each sub-graph shows (paper, section 4.2).
fn by_the_paper(workspace: &Workspace) -> Vec<Finding> {
    let keyframes_a_lap = references(workspace).max(1);
    let of_subgraph = |samples: Vec<ClosureSample>| {
        let places: Option<Vec<ClosurePlace>> = samples
            .iter()
            .map(|sample| place_of(workspace, sample, keyframes_a_lap))
            .collect();
        let places = places.unwrap_or_default();
        let params = PaperParams::for_laps(&places, 1.0);
        let series = residual_series(&samples, &params.series);
        let p_value = |peak: &Peak| series.entries[peak.n - 1].p_value;
        let changes = paper_changes(&series, &places, &params);
        let found = changes
            .iter()
            .filter_map(|change| finding_of(workspace, change, p_value(&change.first)));
        found.collect::<Vec<_>>()
    };
    let subgraphs = workspace.closures_by_subgraph();
    subgraphs.into_values().flat_map(of_subgraph).collect()
}

/// Where a closure is and in which lap: one lap is as many keyframes as there are references.
fn place_of(
    workspace: &Workspace,
    sample: &ClosureSample,
    keyframes_a_lap: usize,
) -> Option<ClosurePlace> {
    let graph = workspace.map.graph();
    let (old, new) = graph.ends()[graph.edge_position(sample.edge_id)?];
    let [old_place, new_place] = [old, new].map(|k| graph.nodes()[k].pose.translation());
    Some(ClosurePlace {
        position: 0.5 * (old_place + new_place),
        lap: old.max(new) / keyframes_a_lap,
    })
}

fn finding_of(workspace: &Workspace, change: &PaperChange, p_value: f64) -> Option<Finding> {
    let graph = workspace.map.graph();
    let peaks = || std::iter::once(&change.first).chain(&change.repeats);
    let mut edges: Vec<EdgeId> = peaks().map(|peak| peak.edge_id).collect();
    edges.sort_unstable();
    let ends = |edge: &EdgeId| {
        let (from, to) = graph.ends()[graph.edge_position(*edge)?];
        Some((from.min(to), from.max(to)))
    };
    let ends: Vec<(usize, usize)> = edges.iter().filter_map(ends).collect();
    let nodes: BTreeSet<NodeId> = ends
        .iter()
        .flat_map(|&(old, new)| [old, new].map(|k| graph.nodes()[k].id))
        .collect();
    let keyframes = workspace.map.keyframes();
    let new = || ends.iter().map(|&(_, new)| &keyframes[new]);
    let trips: BTreeSet<TripId> = new().map(|keyframe| keyframe.trip.clone()).collect();
    let (old, newest) = graph.ends()[graph.edge_position(change.first.edge_id)?];
    let around = [old, newest].map(|k| graph.nodes()[k].pose.translation());
    Some(Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
        kind: ChangeKind::Residual,
        location: change.first.place.position,
        sigma_m: PAPER_REGION_M,
        region: region_round(&around, PAPER_REGION_M),
        edges,
        nodes: nodes.into_iter().collect(),
        trips: trips.into_iter().collect(),
        views: ends.len(),
        laps: peaks().count(),
        confidence: 1.0 - p_value,
        since: new().map(|keyframe| keyframe.stamp).min()?,
        last_seen: new().map(|keyframe| keyframe.stamp).max()?,
        until: None,
    })
}
