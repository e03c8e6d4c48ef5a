use super::*;
use crate::change::{AlertAction, Counterpart, Tier};
use proptest::prelude::*;

/// A square of 0.4 m round (x, y).
fn finding(kind: ChangeKind, x: f64, y: f64, since: i64, until: Option<i64>) -> Finding {
    let corners = [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]];
    let location = Vector2::new(x, y);
    Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
        kind,
        location,
        sigma_m: 0.05,
        region: corners.map(|c| location + Vector2::from(c)).to_vec(),
        edges: Vec::new(),
        nodes: Vec::new(),
        trips: vec![TripId::new("t").unwrap()],
        views: 3,
        laps: 1,
        confidence: 0.99,
        since: StampNs(since),
        last_seen: StampNs(until.unwrap_or(since + 5) - 1),
        until: until.map(StampNs),
    }
}

fn appeared(x: f64, since: i64, until: Option<i64>) -> Finding {
    finding(ChangeKind::Appeared, x, 0.0, since, until)
}

/// Alerts with the statuses that they took.
#[derive(Default)]
struct Alerts {
    states: Vec<AlertState>,
    histories: Vec<Vec<AlertStatus>>,
}

impl Alerts {
    fn fold(&mut self, findings: &[Finding]) -> usize {
        let updates = fold(&self.states, findings);
        for update in &updates {
            let k = update.existing.unwrap_or(self.states.len());
            if k == self.states.len() {
                self.states.push(update.state.clone());
                self.histories.push(Vec::new());
            }
            let last = self.histories[k].last().copied();
            let steps = update.steps.iter().map(|step| step.status);
            self.histories[k].extend(steps);
            if update.steps.is_empty() {
                assert_eq!(last, Some(update.state.status));
            }
            assert_eq!(self.histories[k].last(), Some(&update.state.status));
            self.states[k] = update.state.clone();
        }
        updates.len()
    }

    fn act(&mut self, k: usize, action: AlertAction) {
        if self.states[k].status.allows(action)
            && let Some(status) = action.leads_to()
        {
            self.states[k].status = status;
            self.histories[k].push(status);
        }
    }

    fn statuses(&self) -> Vec<AlertStatus> {
        self.states.iter().map(|state| state.status).collect()
    }

    fn pending(&self) -> Vec<&Finding> {
        let pending = self.states.iter().filter(|s| s.status.is_pending());
        pending.map(|state| &state.evidence).collect()
    }
}

use AlertStatus::{Accepted, Dismissed, Open, Resolved};

#[test]
fn a_change_is_raised_once_and_follows_its_finding() {
    let mut alerts = Alerts::default();
    assert_eq!(alerts.fold(&[appeared(1.0, 100, None)]), 1);
    let mut later = appeared(1.1, 100, None);
    later.views = 9;
    assert_eq!(alerts.fold(std::slice::from_ref(&later)), 1);
    assert_eq!(alerts.pending(), [&later]);
    // A hair's breadth is no news.
    later.location.x += 1e-4;
    assert_eq!(alerts.fold(&[later]), 0);
    assert_eq!(alerts.histories, [[Open]]);
}

#[test]
fn what_a_shift_explains_is_reported_elsewhere() {
    let mut alerts = Alerts::default();
    let [near, far] = [1.0, 9.0].map(|x| appeared(x, 100, None));
    alerts.fold(&[near, far]);
    let mismatch = Finding {
        shift: Some(Vector2::new(0.4, 0.0)),
        ..finding(ChangeKind::MapMismatch, 1.1, 0.0, 100, None)
    };
    let updates = fold(&alerts.states, std::slice::from_ref(&mismatch));
    let notes: Vec<_> = updates.iter().map(|u| u.steps[0].note.as_deref()).collect();
    assert_eq!(notes, [Some(REPORTED_ELSEWHERE), Some(REFUTED), None]);
    assert_eq!(updates[2].state.evidence, mismatch);
}

#[test]
fn a_change_of_tier_counterpart_or_shift_is_news() {
    let mut alerts = Alerts::default();
    let mut seen = Finding {
        tier: Tier::Tentative,
        ..appeared(1.0, 100, None)
    };
    alerts.fold(std::slice::from_ref(&seen));
    let mut fold_again = |seen: &Finding| {
        let changed = alerts.fold(std::slice::from_ref(seen));
        assert_eq!(alerts.statuses(), [Open]);
        if changed > 0 {
            assert_eq!(alerts.pending(), [seen]);
        }
        changed
    };
    assert_eq!(fold_again(&seen), 0);
    seen.tier = Tier::Confirmed;
    assert_eq!(fold_again(&seen), 1);
    let gone = finding(ChangeKind::Disappeared, 3.0, 0.0, 100, None);
    seen.counterpart = Some(Counterpart {
        kind: gone.kind,
        region: gone.region,
    });
    assert_eq!(fold_again(&seen), 1);
    assert_eq!(fold_again(&seen), 0);
    let mut move_corner = |x_m: f64| {
        let counterpart = seen.counterpart.as_mut().unwrap();
        counterpart.region[2].x += x_m;
        fold_again(&seen)
    };
    assert_eq!(move_corner(1e-4), 0, "a hair's breadth is no news");
    assert_eq!(move_corner(0.1), 1);
    seen.counterpart = None;
    assert_eq!(fold_again(&seen), 1);
    for (x_m, changed) in [(0.3, 1), (0.3001, 0), (0.4, 1)] {
        seen.shift = Some(Vector2::new(x_m, 0.0));
        assert_eq!(fold_again(&seen), changed);
    }
    seen.shift = None;
    assert_eq!(fold_again(&seen), 1);
    seen.tier = Tier::Tentative;
    assert_eq!(fold_again(&seen), 1);
}

#[test]
fn what_leaves_is_resolved_and_what_comes_back_opens_the_same_alert() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, None)]);
    alerts.fold(&[appeared(1.0, 100, Some(200))]);
    assert_eq!(alerts.statuses(), [Resolved]);
    let both = [appeared(1.0, 100, Some(200)), appeared(1.2, 300, None)];
    alerts.fold(&both);
    assert_eq!(alerts.histories, [[Open, Resolved, Open]]);
    assert_eq!(alerts.states[0].first_seen, StampNs(100));
    assert_eq!(alerts.states[0].evidence.since, StampNs(300));
    // Known all at once, it is one alert with the same present state.
    let mut at_once = Alerts::default();
    at_once.fold(&both);
    assert_eq!(at_once.states, alerts.states);
}

#[test]
fn what_was_over_when_it_came_to_be_known_is_raised_and_resolved() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, Some(200))]);
    assert_eq!(alerts.histories, [[Open, Resolved]]);
}

#[test]
fn what_later_evidence_refutes_is_resolved() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, None), appeared(9.0, 100, None)]);
    alerts.act(0, AlertAction::Acknowledge);
    alerts.fold(&[appeared(9.0, 100, None)]);
    assert_eq!(alerts.statuses(), [Resolved, Open]);
    assert_eq!(alerts.fold(&[appeared(9.0, 100, None)]), 0);
}

#[test]
fn neighbours_at_one_time_are_alerts_of_their_own() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, None), appeared(1.6, 100, None)]);
    assert_eq!(alerts.statuses(), [Open, Open]);
    // Seen as one from now on, one of the two tells of it.
    alerts.fold(&[appeared(1.1, 100, None)]);
    assert_eq!(alerts.statuses(), [Open, Resolved]);
    let updates = fold(&alerts.states[..1], &[]);
    assert_eq!(updates[0].steps[0].note.as_deref(), Some(REFUTED));
}

#[test]
fn kinds_do_not_mix() {
    let mut alerts = Alerts::default();
    let gone = finding(ChangeKind::Disappeared, 1.0, 0.0, 100, None);
    alerts.fold(&[appeared(1.0, 100, None), gone]);
    assert_eq!(alerts.statuses(), [Open, Open]);
}

#[test]
fn a_dismissed_alert_swallows_its_episode_as_long_as_it_lasts() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, None)]);
    alerts.act(0, AlertAction::Dismiss);
    // The scans that showed it first may leave the map: what is left begins later each time, and
    // overlaps with what was seen before.
    for since in (104..200).step_by(4) {
        let still_there = [appeared(1.3, since, None)];
        alerts.fold(&still_there);
        assert_eq!(alerts.statuses(), [Dismissed]);
        assert_eq!(alerts.states[0].evidence.last_seen, StampNs(since + 4));
        assert_eq!(alerts.states[0].evidence.location.x, 1.0);
        assert_eq!(alerts.fold(&still_there), 0);
    }
    let gone = [appeared(1.0, 100, Some(300))];
    alerts.fold(&gone);
    assert_eq!(alerts.histories, [[Open, Dismissed]]);
}

#[test]
fn a_later_episode_at_a_dismissed_place_is_a_new_alert() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, None)]);
    alerts.act(0, AlertAction::Dismiss);
    let again = [appeared(1.0, 100, Some(200)), appeared(1.2, 300, None)];
    alerts.fold(&again);
    assert_eq!(alerts.statuses(), [Dismissed, Open]);
    assert_eq!(alerts.states[1].evidence.since, StampNs(300));
    assert_eq!(alerts.fold(&again), 0);
    // It is decided about by itself.
    alerts.act(1, AlertAction::Dismiss);
    assert_eq!(alerts.fold(&again), 0);
    alerts.fold(&[appeared(1.1, 304, None)]);
    assert_eq!(alerts.statuses(), [Dismissed, Dismissed]);
    alerts.fold(&[appeared(1.1, 309, None)]);
    assert_eq!(alerts.statuses(), [Dismissed, Dismissed, Open]);
}

#[test]
fn an_accepted_alert_swallows_its_episode_and_not_the_next() {
    let mut alerts = Alerts::default();
    alerts.fold(&[appeared(1.0, 100, None)]);
    alerts.act(0, AlertAction::Accept);
    assert_eq!(alerts.fold(&[appeared(1.0, 100, None)]), 0);
    assert_eq!(alerts.fold(&[]), 0);
    alerts.fold(&[appeared(1.0, 300, None)]);
    assert_eq!(alerts.statuses(), [Accepted, Open]);
}

#[test]
fn a_suspected_vehicle_is_known_by_its_trips() {
    let suspect = |trip: &str, x: f64| Finding {
        trips: vec![TripId::new(trip).unwrap()],
        ..finding(ChangeKind::VehicleSuspect, x, 0.0, 100, None)
    };
    let mut alerts = Alerts::default();
    alerts.fold(&[suspect("a", 0.0), suspect("b", 0.0)]);
    assert_eq!(alerts.statuses(), [Open, Open]);
    alerts.fold(&[suspect("b", 70.0), suspect("a", 0.0)]);
    assert_eq!(alerts.statuses(), [Open, Open]);
    assert_eq!(alerts.states[1].evidence.location.x, 70.0);
}

fn any_finding() -> impl Strategy<Value = Finding> {
    (
        prop_oneof![Just(ChangeKind::Appeared), Just(ChangeKind::Disappeared)],
        0.0..4.0_f64,
        0.0..2.0_f64,
        0..50_i64,
        proptest::option::of(1..20_i64),
    )
        .prop_map(|(kind, x, y, since, lasts)| {
            finding(kind, x, y, since, lasts.map(|lasts| since + lasts))
        })
}

fn any_findings() -> impl Strategy<Value = Vec<Finding>> {
    proptest::collection::vec(any_finding(), 0..8)
}

fn sorted(findings: Vec<&Finding>) -> Vec<(ChangeKind, StampNs, String)> {
    let key = |f: &&Finding| (f.kind, f.since, format!("{:?}", f.location));
    let mut keys: Vec<_> = findings.iter().map(key).collect();
    keys.sort();
    keys
}

proptest! {
    #[test]
    fn folding_twice_changes_nothing(
        lists in proptest::collection::vec(any_findings(), 1..5),
        actions in proptest::collection::vec((0..9_usize, 0..5_usize), 0..6),
    ) {
        let mut alerts = Alerts::default();
        for findings in &lists {
            alerts.fold(findings);
            for (k, action) in &actions {
                if *k < alerts.states.len() {
                    alerts.act(*k, AlertAction::ALL[*action]);
                }
            }
            alerts.fold(findings);
            prop_assert_eq!(fold(&alerts.states, findings), vec![]);
            let mut reversed = findings.clone();
            reversed.reverse();
            prop_assert_eq!(fold(&alerts.states, &reversed), vec![]);
        }
    }

    /// Whatever was believed on the way, what waits for a decision is what stands now.
    #[test]
    fn what_is_pending_does_not_depend_on_the_way(
        lists in proptest::collection::vec(any_findings(), 0..4),
        last in any_findings(),
    ) {
        let mut alerts = Alerts::default();
        for findings in lists.iter().chain([&last]) {
            alerts.fold(findings);
        }
        let mut at_once = Alerts::default();
        at_once.fold(&last);
        prop_assert_eq!(sorted(alerts.pending()), sorted(at_once.pending()));
        let standing = last.iter().filter(|f| f.until.is_none()).collect();
        prop_assert_eq!(sorted(alerts.pending()), sorted(standing));
    }

    #[test]
    fn what_was_dismissed_is_not_raised_again(
        findings in any_findings(),
        shift in (-0.3..0.3_f64, -0.3..0.3_f64),
        // It was seen until four after it began.
        later in 0..=4_i64,
    ) {
        let mut alerts = Alerts::default();
        let standing = findings.iter().filter(|f| f.until.is_none());
        let standing: Vec<Finding> = standing.cloned().collect();
        alerts.fold(&standing);
        for k in 0..alerts.states.len() {
            alerts.act(k, AlertAction::Dismiss);
        }
        let raised = alerts.states.len();
        let moved = standing.iter().map(|f| {
            let (x, y) = (f.location.x + shift.0, f.location.y + shift.1);
            finding(f.kind, x, y, f.since.0 + later, None)
        });
        alerts.fold(&moved.collect::<Vec<_>>());
        prop_assert!(alerts.pending().is_empty());
        prop_assert_eq!(alerts.states.len(), raised);
    }

    /// Only what the table allows happens, and the system never undoes a decision.
    #[test]
    fn the_system_leaves_decisions_alone(
        lists in proptest::collection::vec(any_findings(), 1..5),
        decided in proptest::collection::vec((0..9_usize, proptest::bool::ANY), 0..6),
    ) {
        let mut alerts = Alerts::default();
        alerts.fold(&lists[0]);
        for (k, accept) in decided {
            if k < alerts.states.len() {
                let action = if accept { AlertAction::Accept } else { AlertAction::Dismiss };
                alerts.act(k, action);
            }
        }
        let is_decided = |s: &AlertStatus| matches!(s, Accepted | Dismissed);
        let before = alerts.statuses();
        for findings in &lists[1..] {
            alerts.fold(findings);
        }
        for (was, is) in before.iter().zip(alerts.statuses()) {
            prop_assert!(!is_decided(was) || *was == is);
            prop_assert!(is_decided(was) || !is_decided(&is));
        }
    }
}
