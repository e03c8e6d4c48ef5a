//! Folds findings into the alerts of a route.

use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;

use super::alert_id::Raised;
use super::decision_revision;
use super::workspace::Workspace;
use crate::change::series::{ClosureSample, ResidualSeries, residual_series};
use crate::change::{AlertState, AlertUpdate, Finding, fold, resolve_mended};
use crate::geometry::polygon_gap;
use crate::ids::{AlertId, EdgeId, NodeId, RouteId, VehicleId};
use crate::mapping::{Mending, PassScope};
use crate::model::ResidualVerdict;
use crate::store::{AlertRecord, AlertResidual, Handling, HistoryEntry, SYSTEM};

/// Alerts whose regions are this close are related, metres.
const RELATED_M: f64 = 1.0;

/// Folds all present findings into the route's alerts. Returns new alerts and the next revisions of those
/// that changed, and updates the workspace's alerts. Alerts about misplaced segments that were moved are
/// resolved first.
///
/// Call it after the new closures were added to the workspace: an alert states the residual of its least
/// likely closure.
pub(super) fn fold_into(
    workspace: &mut Workspace,
    route: &RouteId,
    findings: &[Finding],
    mendings: &[Mending],
    at: Timestamp,
) -> Vec<AlertRecord> {
    let mut folded = Folded::default();
    let mended = mendings.iter().map(|m| (&m.mismatch, m.shift));
    let mended: Vec<_> = mended.collect();
    let updates = resolve_mended(&states_of(workspace), &mended);
    take(workspace, route, updates, at, &mut folded);
    let updates = fold(&states_of(workspace), findings);
    take(workspace, route, updates, at, &mut folded);
    add_passes(workspace, &mut folded.changed);
    folded.changed
}

/// Updates the passes by the changed alerts' places, and the clearance of these to the vehicles' path.
fn add_passes(workspace: &mut Workspace, changed: &mut [AlertRecord]) {
    for alert in changed {
        let scope = PassScope {
            accepted: &workspace.accepted,
            vehicles: &workspace.vehicles,
            false_alerts_per_lap: workspace.false_alarm_rate,
        };
        alert.passes = workspace.map.passes_by(&alert.evidence, &scope);
        alert.clearance = workspace.map.clearance(&alert.evidence);
        workspace.replace_alert(alert);
    }
}

/// The alerts that a job changes.
#[derive(Default)]
struct Folded {
    /// New alerts, and the next revisions of those that change.
    changed: Vec<AlertRecord>,
    /// The changed ones as they were before the job.
    stored: BTreeMap<AlertId, AlertRecord>,
}

/// Removes passes whose scans were removed from the map from all alerts that are not in `changed`, and
/// appends the next revisions of these alerts to it. `nodes` are ascending.
pub(super) fn take_out_passes(
    workspace: &mut Workspace,
    nodes: &[NodeId],
    at: Timestamp,
    changed: &mut Vec<AlertRecord>,
) {
    let is_out = |node: NodeId| nodes.binary_search(&node).is_ok();
    let next = |alert: &AlertRecord| {
        let passes = alert.passes.as_ref()?;
        Some(AlertRecord {
            revision: alert.revision + 1,
            updated_at: at.max(alert.updated_at),
            passes: Some(passes.without(alert.evidence.kind, is_out)?),
            ..alert.clone()
        })
    };
    let others = workspace.alerts.iter();
    let others = others.filter(|alert| !changed.iter().any(|other| other.id == alert.id));
    let others: Vec<AlertRecord> = others.filter_map(next).collect();
    for alert in others {
        workspace.replace_alert(&alert);
        changed.push(alert);
    }
}

fn states_of(workspace: &Workspace) -> Vec<AlertState> {
    workspace.alerts.iter().map(state_of).collect()
}

/// Updates alerts; each gets one revision however often it changes.
fn take(
    workspace: &mut Workspace,
    route: &RouteId,
    updates: Vec<AlertUpdate>,
    at: Timestamp,
    Folded { changed, stored }: &mut Folded,
) {
    if updates.is_empty() {
        return;
    }
    let mut residuals = Residuals::of(workspace);
    // New alerts of one job are not related to each other.
    let mut raised_now = Vec::new();
    for update in updates {
        let before = update.existing.map(|k| workspace.alerts[k].clone());
        if let Some(before) = &before
            && !changed.iter().any(|earlier| earlier.id == before.id)
        {
            stored.insert(before.id, before.clone());
        }
        let residual = residuals.strongest(workspace, &update.state.evidence);
        let is_new = before.is_none();
        let raise = || {
            let taken = |id: AlertId| {
                let mut known = workspace.alerts.iter().chain(&raised_now);
                known.any(|alert: &AlertRecord| alert.id == id)
            };
            let at_once = workspace
                .alerts
                .iter()
                .filter(|alert| alert.raised_at == at);
            let by = Raised {
                route,
                at,
                rank: at_once.count() + raised_now.len(),
                kind: update.state.evidence.kind,
                location: update.state.evidence.location,
            };
            raised(workspace, route, &update.state, by.id(taken), at)
        };
        let mut alert = before.unwrap_or_else(raise);
        bring_up_to_date(&mut alert, update, at);
        alert.vehicles = vehicles_of(workspace, &alert.evidence);
        alert.residual = residual;
        decision_revision::count(stored.get(&alert.id), &mut alert);
        match changed.iter_mut().find(|earlier| earlier.id == alert.id) {
            Some(earlier) => {
                alert.revision = earlier.revision;
                *earlier = alert.clone();
            }
            None => changed.push(alert.clone()),
        }
        match is_new {
            true => raised_now.push(alert),
            false => workspace.replace_alert(&alert),
        }
    }
    workspace.alerts.extend(raised_now);
    // As they are read from the store.
    workspace.alerts.sort_by_key(|alert| alert.id);
}

fn state_of(alert: &AlertRecord) -> AlertState {
    AlertState {
        status: alert.status,
        evidence: alert.evidence.clone(),
        first_seen: alert.first_seen,
    }
}

/// A new alert, before its first revision.
fn raised(
    workspace: &Workspace,
    route: &RouteId,
    state: &AlertState,
    id: AlertId,
    at: Timestamp,
) -> AlertRecord {
    AlertRecord {
        id,
        route_id: route.clone(),
        revision: 0,
        decision_revision: 1,
        decision_region: state.evidence.region.clone(),
        status: state.status,
        evidence: state.evidence.clone(),
        first_seen: state.first_seen,
        vehicles: Vec::new(),
        passes: None,
        clearance: None,
        residual: None,
        map_version: workspace.map_version,
        related: related_to(workspace, &state.evidence),
        raised_at: at,
        updated_at: at,
        history: Vec::new(),
        handling: Handling::default(),
    }
}

fn bring_up_to_date(alert: &mut AlertRecord, update: AlertUpdate, at: Timestamp) {
    alert.revision += 1;
    alert.status = update.state.status;
    alert.evidence = update.state.evidence;
    alert.first_seen = update.state.first_seen;
    alert.updated_at = at.max(alert.updated_at);
    let at = alert.updated_at;
    alert
        .history
        .extend(update.steps.iter().map(|step| HistoryEntry {
            status: step.status,
            at,
            by: SYSTEM.to_owned(),
            note: step.note.as_deref().map(str::to_owned),
            reason: None,
        }));
}

/// The pending alerts at the same place.
fn related_to(workspace: &Workspace, evidence: &Finding) -> Vec<AlertId> {
    let near = workspace.alerts.iter().filter(|other| {
        other.status.is_pending()
            && polygon_gap(&other.evidence.region, &evidence.region) <= RELATED_M
    });
    near.map(|other| other.id).collect()
}

fn vehicles_of(workspace: &Workspace, evidence: &Finding) -> Vec<VehicleId> {
    let known = evidence.trips.iter();
    let vehicles = known.filter_map(|trip| workspace.vehicles.get(trip).cloned());
    vehicles.collect::<BTreeSet<_>>().into_iter().collect()
}

/// The residual series of a route's sub-graphs, computed on first use.
struct Residuals {
    closures: BTreeMap<i64, Vec<ClosureSample>>,
    subgraph_of: BTreeMap<EdgeId, i64>,
    series: BTreeMap<i64, ResidualSeries>,
}

impl Residuals {
    fn of(workspace: &Workspace) -> Self {
        Self {
            closures: workspace.closures_by_subgraph(),
            subgraph_of: workspace.subgraph_of_edges(),
            series: BTreeMap::new(),
        }
    }

    /// The closure with the smallest p-value in its series.
    fn strongest(&mut self, workspace: &Workspace, evidence: &Finding) -> Option<AlertResidual> {
        let mut strongest: Option<AlertResidual> = None;
        for edge in &evidence.edges {
            let Some(&subgraph_id) = self.subgraph_of.get(edge) else {
                continue;
            };
            let series = self.series.entry(subgraph_id).or_insert_with(|| {
                let samples = self.closures.get(&subgraph_id);
                let samples = samples.map_or(&[][..], Vec::as_slice);
                residual_series(samples, &workspace.detector.series_params())
            });
            let Some(entry) = series.entries.iter().find(|entry| entry.edge_id == *edge) else {
                continue;
            };
            let residual = AlertResidual {
                edge_id: entry.edge_id,
                delta_f: entry.delta_f,
                threshold: entry.threshold,
                ratio: entry.ratio,
                p_value: entry.p_value,
                seed_rule: entry.verdict == ResidualVerdict::Contradiction,
            };
            let weaker = |other: AlertResidual| {
                (other.p_value, -other.delta_f) > (residual.p_value, -residual.delta_f)
            };
            if strongest.is_none_or(weaker) {
                strongest = Some(residual);
            }
        }
        strongest
    }
}
