//! The rule of this service: what scans saw of a place before and since, and the residuals of closures that
//! came without scans.

use super::rule::{Detected, Rule};
use crate::change::{ChangeKind, Finding, stays_untouched};
use crate::mapping::{RouteMap, Scope, Sites};
use crate::pipeline::residual_findings::by_residuals;
use crate::pipeline::suspects::suspects;
use crate::pipeline::workspace::Workspace;
use crate::store::AlertRecord;

/// The rule of the detector `fused`.
pub(super) struct Fused;

impl Rule for Fused {
    fn detect_in_scans(&self, workspace: &mut Workspace) -> anyhow::Result<Detected> {
        let evidence = workspace.alerts.iter().map(|alert| &alert.evidence);
        let known = evidence.filter(|known| known.kind == ChangeKind::MapMismatch);
        let known: Vec<Finding> = known.cloned().collect();
        let (findings, mendings) = with_scope(workspace, Sites::Touched, |map, scope| {
            map.findings_and_mendings(scope, &known)
        })?;
        Ok(Detected { findings, mendings })
    }

    fn detect_everywhere(&self, workspace: &mut Workspace) -> Vec<Finding> {
        with_scope(workspace, Sites::All, |map, scope| map.findings(scope))
    }

    fn findings(&self, workspace: &Workspace, observed: Vec<Finding>) -> Vec<Finding> {
        let mut findings = observed;
        findings.extend(by_residuals(workspace));
        findings
    }
}

fn with_scope<T>(
    workspace: &mut Workspace,
    sites: Sites,
    ask: impl FnOnce(&mut RouteMap, &Scope<'_>) -> T,
) -> T {
    let stays = |alert: &&AlertRecord| stays_untouched(alert.status, &alert.evidence);
    let pending = workspace.alerts.iter().filter(stays);
    let pending: Vec<Finding> = pending.map(|alert| alert.evidence.clone()).collect();
    let mut suspects = suspects(&workspace.calibrations);
    workspace.clock_faults.add_to(&mut suspects);
    let scope = Scope {
        sites,
        pending: &pending,
        false_alerts_per_lap: workspace.false_alarm_rate,
        accepted: &workspace.accepted,
        vehicles: &workspace.vehicles,
        suspects: &suspects,
    };
    ask(&mut workspace.map, &scope)
}
