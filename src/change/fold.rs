//! Folds a new set of findings into the existing alerts.
//!
//! Findings are a function of the set of scans, and so are the pending alerts: exactly the present findings
//! without a decision, in whatever order the scans arrived. Only histories depend on that order.

use std::borrow::Cow;

use super::{AlertStatus, ChangeKind, Finding};
use crate::geometry::{Vector2, polygon_gap};
use crate::ids::{StampNs, TripId};

/// Regions this close are one place, metres.
pub const SAME_PLACE_M: f64 = 0.5;
/// A location or a corner that moves by less than this does not change an alert, metres.
const MOVED_MIN_M: f64 = 0.005;
/// Nor does a confidence that changes by less than this.
const CONFIDENCE_STEP_MIN: f64 = 1e-3;

/// The part of an alert that findings change.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertState {
    /// Its status.
    pub status: AlertStatus,
    /// Its finding; of an accepted or dismissed alert, as it was at the decision.
    pub evidence: Finding,
    /// The first observation that ever showed it.
    pub first_seen: StampNs,
}

/// A change of status.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// The new status.
    pub status: AlertStatus,
    /// Why, for people.
    pub note: Option<Cow<'static, str>>,
}

/// The update of one alert.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertUpdate {
    /// The alert's index among the existing ones; `None` for a new one.
    pub existing: Option<usize>,
    /// The alert after the update.
    pub state: AlertState,
    /// The statuses that it passes through, in order; the last one is the state's.
    pub steps: Vec<Step>,
}

const NO_LONGER_SEEN: &str = "later looks show the former state again";
const KNOWN_ANEW: &str = "later trips say how the vehicle is now";
const REFUTED: &str = "all looks together no longer show it";
const REPORTED_ELSEWHERE: &str = "another alert tells of the place now";
const SEEN_AGAIN: &str = "looks show it again";

/// Folds all present findings into the alerts of a route; returns the new and the changed alerts. It is
/// idempotent.
///
/// A finding joins the alert of its kind at its place: regions within [`SAME_PLACE_M`], and a common height
/// band if they have any; for a suspected vehicle a common trip. Of several episodes at one place the last
/// one counts. An alert whose finding has ended, or is gone, is resolved; a resolved one is reopened by a
/// finding that has not ended. Dismissed and accepted alerts absorb findings of the episode that was decided
/// about; an episode that begins after it was last seen is a new alert.
pub fn fold(existing: &[AlertState], findings: &[Finding]) -> Vec<AlertUpdate> {
    let sites = sites_of(findings);
    let owners = owners_of(&sites, existing);
    let mut updates = Vec::new();
    for (k, alert) in existing.iter().enumerate() {
        let owned: Vec<&Site<'_>> = (sites.iter().zip(&owners))
            .filter(|(_, owner)| **owner == Some(k))
            .map(|(site, _)| site)
            .collect();
        let reported_elsewhere = || sites.iter().any(|site| same_subject(alert, site.last()));
        let advanced = match owned.first() {
            Some(site) if alert.status != AlertStatus::Dismissed => advance(alert, site),
            Some(_) => remember(alert, &owned),
            None if !alert.status.is_pending() => None,
            None if reported_elsewhere() => Some(resolve(alert, REPORTED_ELSEWHERE)),
            None => Some(resolve(alert, REFUTED)),
        };
        updates.extend(advanced.map(|(state, steps)| AlertUpdate {
            existing: Some(k),
            state,
            steps,
        }));
    }
    let unowned = sites.iter().zip(&owners).filter(|(_, o)| o.is_none());
    updates.extend(unowned.map(|(site, _)| raise(site)));
    updates
}

/// Findings of one kind at one place, one after the other.
struct Site<'a> {
    episodes: Vec<&'a Finding>,
}

impl<'a> Site<'a> {
    fn last(&self) -> &'a Finding {
        self.episodes[self.episodes.len() - 1]
    }

    fn first_seen(&self) -> StampNs {
        self.episodes[0].since
    }

    /// How far a later finding is from the site, if it may be its next episode.
    fn gap_to_next(&self, finding: &Finding) -> Option<f64> {
        let last = self.last();
        let is_over = last.until.is_some_and(|until| until <= finding.since);
        gap(last, finding).filter(|_| is_over)
    }
}

/// Groups findings into sites, by the findings alone.
fn sites_of(findings: &[Finding]) -> Vec<Site<'_>> {
    let mut in_order: Vec<&Finding> = findings.iter().collect();
    in_order.sort_by(|a, b| {
        (a.since, a.kind, a.until, a.last_seen)
            .cmp(&(b.since, b.kind, b.until, b.last_seen))
            .then(a.location.x.total_cmp(&b.location.x))
            .then(a.location.y.total_cmp(&b.location.y))
    });
    let mut sites: Vec<Site<'_>> = Vec::new();
    for finding in in_order {
        let near = sites.iter_mut().filter_map(|site| {
            let gap_m = site.gap_to_next(finding)?;
            Some((gap_m, distance(site.last(), finding), site))
        });
        let nearest = near.min_by(|(a, b, _), (c, d, _)| a.total_cmp(c).then(b.total_cmp(d)));
        match nearest {
            Some((_, _, site)) => site.episodes.push(finding),
            None => sites.push(Site {
                episodes: vec![finding],
            }),
        }
    }
    sites
}

/// The alert that each site belongs to, the nearest first. A pending alert owns one site, a decided one any
/// number.
fn owners_of(sites: &[Site<'_>], existing: &[AlertState]) -> Vec<Option<usize>> {
    let mut pairs = Vec::new();
    for (s, site) in sites.iter().enumerate() {
        for (k, alert) in existing.iter().enumerate() {
            let last = site.last();
            let later_episode = is_decided(alert.status) && last.since > alert.evidence.last_seen;
            if let Some(gap_m) = gap(&alert.evidence, last).filter(|_| !later_episode) {
                pairs.push((gap_m, distance(&alert.evidence, last), k, s));
            }
        }
    }
    pairs.sort_by(|a, b| {
        (a.0.total_cmp(&b.0))
            .then(a.1.total_cmp(&b.1))
            .then((a.2, a.3).cmp(&(b.2, b.3)))
    });
    let mut owners = vec![None; sites.len()];
    let mut taken = vec![false; existing.len()];
    for (_, _, k, s) in pairs {
        if owners[s].is_none() && (is_decided(existing[k].status) || !taken[k]) {
            owners[s] = Some(k);
            taken[k] = true;
        }
    }
    owners
}

fn is_decided(status: AlertStatus) -> bool {
    matches!(status, AlertStatus::Dismissed | AlertStatus::Accepted)
}

fn same_subject(alert: &AlertState, finding: &Finding) -> bool {
    if finding.shift.is_some() && alert.evidence.kind.is_of_state() {
        return share_a_trip(&alert.evidence.trips, &finding.trips)
            && polygon_gap(outline(&alert.evidence), outline(finding)) <= 0.0;
    }
    let is_silenced = finding.suspect.as_ref();
    if is_silenced.is_some_and(|suspect| suspect.has_silenced(&alert.evidence.as_silenced())) {
        return true;
    }
    let is_other_side = finding.counterpart.as_ref().is_some_and(|other| {
        other.kind == alert.evidence.kind
            && polygon_gap(outline(&alert.evidence), &other.region) <= SAME_PLACE_M
    });
    is_other_side || gap(&alert.evidence, finding).is_some()
}

/// The distance of two findings, metres; `None` if they cannot be about the same change.
pub(super) fn gap(a: &Finding, b: &Finding) -> Option<f64> {
    if a.kind != b.kind || !a.shares_a_band(b) {
        return None;
    }
    if a.kind == ChangeKind::VehicleSuspect {
        return share_a_trip(&a.trips, &b.trips).then_some(0.0);
    }
    let gap_m = polygon_gap(outline(a), outline(b));
    (gap_m <= SAME_PLACE_M).then_some(gap_m)
}

fn share_a_trip(a: &[TripId], b: &[TripId]) -> bool {
    a.iter().any(|trip| b.contains(trip))
}

fn outline(finding: &Finding) -> &[Vector2<f64>] {
    if finding.region.is_empty() {
        return std::slice::from_ref(&finding.location);
    }
    &finding.region
}

fn distance(a: &Finding, b: &Finding) -> f64 {
    (a.location - b.location).norm()
}

/// Why a finding has ended, for people.
fn ended(finding: &Finding) -> &'static str {
    match finding.kind {
        ChangeKind::VehicleSuspect => KNOWN_ANEW,
        _ => NO_LONGER_SEEN,
    }
}

type Advanced = (AlertState, Vec<Step>);

/// A new alert; it is resolved at once if its finding has ended already.
fn raise(site: &Site<'_>) -> AlertUpdate {
    let open = AlertState {
        status: AlertStatus::Open,
        evidence: site.last().clone(),
        first_seen: site.first_seen(),
    };
    let raised = Step {
        status: AlertStatus::Open,
        note: None,
    };
    let (state, mut steps) = match site.last().until {
        None => (open, Vec::new()),
        Some(_) => resolve(&open, ended(site.last())),
    };
    steps.insert(0, raised);
    AlertUpdate {
        existing: None,
        state,
        steps,
    }
}

/// The update of an alert by its site; `None` if nothing changes.
fn advance(alert: &AlertState, site: &Site<'_>) -> Option<Advanced> {
    if alert.status == AlertStatus::Accepted {
        return None;
    }
    let finding = site.last();
    let mut state = alert.clone();
    state.first_seen = alert.first_seen.min(site.first_seen());
    if is_news(&alert.evidence, finding) {
        state.evidence = finding.clone();
    }
    let stands = finding.until.is_none();
    if stands && alert.status == AlertStatus::Resolved {
        state.status = AlertStatus::Open;
        let step = Step {
            status: AlertStatus::Open,
            note: Some(SEEN_AGAIN.into()),
        };
        return Some((state, vec![step]));
    }
    if !stands && alert.status.is_pending() {
        return Some(resolve(&state, ended(finding)));
    }
    (state != *alert).then_some((state, Vec::new()))
}

fn resolve(alert: &AlertState, note: &'static str) -> Advanced {
    let state = AlertState {
        status: AlertStatus::Resolved,
        ..alert.clone()
    };
    let step = Step {
        status: AlertStatus::Resolved,
        note: Some(note.into()),
    };
    (state, vec![step])
}

/// A dismissed alert records when its episode was last seen, which may be after the decision.
fn remember(alert: &AlertState, swallowed: &[&Site<'_>]) -> Option<Advanced> {
    let last_seen = swallowed.iter().map(|site| site.last().last_seen).max()?;
    if last_seen <= alert.evidence.last_seen {
        return None;
    }
    let mut state = alert.clone();
    state.evidence.last_seen = last_seen;
    Some((state, Vec::new()))
}

/// Whether an alert's finding is kept where nothing new was observed. A finding with a shift is kept even
/// after a decision or its end: otherwise what it explains would be raised as changes, once a part of it is
/// judged again.
pub fn stays_untouched(status: AlertStatus, evidence: &Finding) -> bool {
    let is_refuted = status == AlertStatus::Resolved && evidence.until.is_none();
    status.is_pending() || (evidence.shift.is_some() && !is_refuted)
}

/// Whether a finding differs by more than slightly improved poses.
fn is_news(before: &Finding, now: &Finding) -> bool {
    let counted = |f: &Finding| (f.tier, f.views, f.laps, f.since, f.last_seen, f.until);
    let moved = |a: &Vector2<f64>, b: &Vector2<f64>| (a - b).norm() >= MOVED_MIN_M;
    let reshaped = |a: &[Vector2<f64>], b: &[Vector2<f64>]| {
        a.len() != b.len() || a.iter().zip(b).any(|(a, b)| moved(a, b))
    };
    let other_counterpart = match (&before.counterpart, &now.counterpart) {
        (Some(a), Some(b)) => a.kind != b.kind || reshaped(&a.region, &b.region),
        (a, b) => a.is_some() != b.is_some(),
    };
    let other_shift = match (&before.shift, &now.shift) {
        (Some(a), Some(b)) => moved(a, b),
        (a, b) => a.is_some() != b.is_some(),
    };
    counted(before) != counted(now)
        || other_counterpart
        || other_shift
        || before.bands != now.bands
        || before.suspect != now.suspect
        || before.edges != now.edges
        || before.nodes != now.nodes
        || before.trips != now.trips
        || moved(&before.location, &now.location)
        || reshaped(&before.region, &now.region)
        || (before.sigma_m - now.sigma_m).abs() >= MOVED_MIN_M
        || (before.confidence - now.confidence).abs() >= CONFIDENCE_STEP_MIN
}

#[cfg(test)]
mod tests;
