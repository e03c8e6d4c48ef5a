//! Random work against the store and against the contract in memory: uploads and their repetition,
//! the order within trips, leases, results, failures, decisions, deletion, restarts.

use std::collections::BTreeMap;

use mapshift::change::{AlertAction, AlertStatus, Tier};
use mapshift::ids::{BatchId, RouteId, TripId, VehicleId};
use mapshift::model::BatchStatus;
use mapshift::store::{
    AlertRecord, Applied, BatchContent, BatchFilter, ClaimedJob, Decided, Decision, Deleted,
    HistoryEntry, NewBatch, RouteUpdate, SettingsUpdate,
};
use proptest::prelude::*;
use tokio::runtime::Runtime;

use crate::model::{Claim, HOLD_S, Model, Upload};
use crate::support::{Fixture, at, batch_id, by, open, upload};
use crate::tiers::alert;

const ROUTES: [&str; 2] = ["r", "q"];

#[derive(Debug, Clone)]
enum Step {
    Upload(Upload),
    Wait(i64),
    Claim,
    /// The worker of a claim ends its job, perhaps with an alert.
    Finish(usize, BatchStatus, Option<u8>),
    Fail(usize),
    GiveBack(usize),
    ReleaseOverdue,
    /// A decision about an alert, made on the present revision of the route or on an earlier one.
    Decide(usize, AlertAction, bool),
    DeleteRoute(u8),
    Reopen,
}

fn uploads() -> impl Strategy<Value = Upload> {
    let parts = (0..2_u8, 0..40_u8, 0..3_u8, 0..20_u8, 0..6_i64, 0..8_u8);
    parts.prop_map(|(route, id, trip, vehicle, sequence, body)| Upload {
        route,
        id,
        trip,
        // Now and then one that does not own the trip, or other bytes by the same name.
        vehicle: if vehicle == 0 { 9 } else { trip },
        sequence,
        body: u8::from(body == 0),
    })
}

fn steps() -> impl Strategy<Value = Step> {
    let who = || 0..1_000_usize;
    let ends = prop_oneof![
        4 => Just(BatchStatus::Merged),
        2 => Just(BatchStatus::Unanchored),
        1 => Just(BatchStatus::Quarantined),
    ];
    let actions = prop_oneof![Just(AlertAction::Acknowledge), Just(AlertAction::Dismiss)];
    prop_oneof![
        30 => uploads().prop_map(Step::Upload),
        6 => prop_oneof![0..5_i64, 0..90_i64].prop_map(Step::Wait),
        20 => Just(Step::Claim),
        20 => (who(), ends, prop::option::of(0..3_u8)).prop_map(|(w, end, a)| Step::Finish(w, end, a)),
        8 => who().prop_map(Step::Fail),
        2 => who().prop_map(Step::GiveBack),
        3 => Just(Step::ReleaseOverdue),
        4 => (who(), actions, prop::bool::weighted(0.7)).prop_map(|(w, a, seen)| Step::Decide(w, a, seen)),
        1 => (0..2_u8).prop_map(Step::DeleteRoute),
        1 => Just(Step::Reopen),
    ]
}

fn route_id(route: u8) -> RouteId {
    RouteId::new(ROUTES[usize::from(route)]).unwrap()
}

fn new_batch(upload_of: &Upload, now_s: i64) -> NewBatch {
    NewBatch {
        route_id: route_id(upload_of.route),
        vehicle_id: VehicleId::new(format!("v{}", upload_of.vehicle)).unwrap(),
        trip_id: TripId::new(format!("t{}", upload_of.trip)).unwrap(),
        content: BatchContent::Scans {
            sequence: upload_of.sequence,
            scans: 2,
        },
        body: vec![upload_of.id, upload_of.body],
        received_at: at(now_s),
        ..upload(&format!("b{}", upload_of.id), "t", 0)
    }
}

/// What a claim says: its route, its batches with their bodies, generation, attempts, and whether it
/// comes after a gap.
type Seen = (RouteId, Vec<(BatchId, Vec<u8>)>, i64, i64, bool);

/// The store and the model, with everything that a worker ever claimed.
struct Both {
    fixture: Fixture,
    model: Model,
    claims: Vec<(ClaimedJob, Claim)>,
    uploads: BTreeMap<(u8, u8, u8), Upload>,
    now_s: i64,
}

impl Both {
    async fn new() -> Self {
        let both = Self {
            fixture: Fixture::new().await,
            model: Model::default(),
            claims: Vec::new(),
            uploads: BTreeMap::new(),
            now_s: 0,
        };
        both.put_route(0).await;
        both.put_route(1).await;
        both
    }

    async fn put_route(&self, route: u8) {
        let update = RouteUpdate {
            settings: SettingsUpdate {
                hold_s: Some(HOLD_S as u32),
                ..SettingsUpdate::default()
            },
            ..RouteUpdate::default()
        };
        let (store, id) = (&self.fixture.store, route_id(route));
        store.put_route(&id, update, by(), at(0)).await.unwrap();
    }

    /// A claim chosen by a number, mostly one of the newest.
    fn claimed(&self, number: usize) -> Option<&(ClaimedJob, Claim)> {
        let back = match number % 4 {
            3 => number % self.claims.len().max(1),
            few => few / 2,
        };
        self.claims.iter().nth_back(back)
    }

    async fn take(mut self, step: Step) -> Self {
        match step {
            Step::Upload(upload) => self.upload(upload).await,
            Step::Wait(seconds) => self.now_s += seconds,
            Step::Claim => self.claim().await,
            Step::Finish(who, end, alert) => self.finish(who, end, alert).await,
            Step::Fail(who) => self.fail(who).await,
            Step::GiveBack(who) => self.give_back(who).await,
            Step::ReleaseOverdue => {
                let released = self.fixture.store.release_overdue(at(self.now_s)).await;
                assert_eq!(released.unwrap(), self.model.release_overdue(self.now_s));
            }
            Step::Decide(who, action, has_seen) => self.decide(who, action, has_seen).await,
            Step::DeleteRoute(route) => self.delete_route(route).await,
            Step::Reopen => self = self.reopened().await,
        }
        self
    }

    async fn reopened(mut self) -> Self {
        let Fixture { store, directory } = self.fixture;
        store.close().await.unwrap();
        let store = open(&directory).await;
        self.model.reopen();
        Self {
            fixture: Fixture { store, directory },
            ..self
        }
    }

    async fn upload(&mut self, upload: Upload) {
        let journaled = self.fixture.journal(new_batch(&upload, self.now_s)).await;
        assert_eq!(journaled, self.model.upload(upload, self.now_s));
        self.uploads
            .insert((upload.route, upload.id, upload.body), upload);
    }

    async fn claim(&mut self) {
        let job = self.fixture.claim(self.now_s).await;
        let expected = self.model.claim(self.now_s);
        let found = job.as_ref().map(|job| self.seen(job));
        assert_eq!(found, expected.as_ref().map(|claim| self.expected(claim)));
        self.claims.extend(job.zip(expected));
    }

    fn seen(&self, job: &ClaimedJob) -> Seen {
        let entries = job.entries.iter();
        let entries = entries.map(|entry| (entry.batch.id.clone(), entry.body.clone()));
        (
            job.route_id.clone(),
            entries.collect(),
            job.generation,
            job.attempts,
            job.after_gap,
        )
    }

    fn expected(&self, claim: &Claim) -> Seen {
        let entries = claim.entries.iter().map(|key| {
            let upload = self.model.batches[key].upload;
            (
                batch_id(&format!("b{}", upload.id)),
                vec![upload.id, upload.body],
            )
        });
        let (generation, attempts) = (claim.generation, claim.attempts);
        (
            route_id(claim.route),
            entries.collect(),
            generation,
            attempts,
            claim.after_gap,
        )
    }

    async fn finish(&mut self, who: usize, end: BatchStatus, alert: Option<u8>) {
        let Some((job, claim)) = self.claimed(who).cloned() else {
            return;
        };
        let mut result = self.fixture.result(&job, end).await;
        let number = alert.map(|alert| 1 + u128::from(alert) + 10 * u128::from(claim.route));
        if let Some(number) = number {
            result
                .alerts
                .push(self.next_alert(number, claim.route).await);
        }
        let applied = self.fixture.store.apply_result(result).await.unwrap();
        let is_held = self.model.finish(&claim, end, number);
        assert_eq!(applied == Applied::Committed, is_held);
    }

    /// The next revision of an alert, or its first.
    async fn next_alert(&self, number: u128, route: u8) -> AlertRecord {
        let first = AlertRecord {
            route_id: route_id(route),
            ..alert(number, Tier::Confirmed)
        };
        match self.fixture.store.alert(first.id).await.unwrap() {
            Some(stored) => AlertRecord {
                revision: stored.revision + 1,
                ..stored
            },
            None => first,
        }
    }

    async fn fail(&mut self, who: usize) {
        if let Some((job, claim)) = self.claimed(who).cloned() {
            let (store, now) = (&self.fixture.store, at(self.now_s));
            let failed = store.fail_job(job.job_id, job.generation, "unlucky", now);
            failed.await.unwrap();
            self.model.fail(&claim, self.now_s);
        }
    }

    async fn give_back(&mut self, who: usize) {
        if let Some((job, claim)) = self.claimed(who).cloned() {
            let (store, now) = (&self.fixture.store, at(self.now_s));
            store
                .return_job(job.job_id, job.generation, now)
                .await
                .unwrap();
            self.model.give_back(&claim, self.now_s);
        }
    }

    async fn decide(&mut self, who: usize, action: AlertAction, has_seen: bool) {
        let numbers: Vec<u128> = self.model.alerts.keys().copied().collect();
        let Some(&number) = numbers.get(who % numbers.len().max(1)) else {
            return;
        };
        let route = self.model.alerts[&number].route;
        let mut next = self.next_alert(number, route).await;
        next.status = match action {
            AlertAction::Acknowledge => AlertStatus::Acknowledged,
            _ => AlertStatus::Dismissed,
        };
        next.updated_at = at(self.now_s);
        next.history.push(HistoryEntry {
            status: next.status,
            at: at(self.now_s),
            by: "kim".to_owned(),
            note: None,
            reason: None,
        });
        let status = next.status;
        let base_revision = self.model.revisions[&route] - i64::from(!has_seen);
        let decision = Decision {
            base_revision,
            action,
            actor: by().clone(),
            alerts: vec![next],
            map: None,
        };
        let decided = self.fixture.store.apply_decision(decision).await.unwrap();
        let stands = self.model.decide(number, base_revision, status);
        assert_eq!(decided == Decided::Committed, stands);
    }

    async fn delete_route(&mut self, route: u8) {
        let (store, id) = (&self.fixture.store, route_id(route));
        let deleted = store.delete_route(&id, None, by(), at(self.now_s));
        assert_eq!(deleted.await.unwrap(), Deleted::Done);
        self.put_route(route).await;
        self.model.delete_route(route);
        self.uploads.retain(|(of, ..), _| *of != route);
    }

    async fn check(&self) {
        let store = &self.fixture.store;
        for route in [0, 1] {
            let (id, all) = (route_id(route), BatchFilter::default());
            let found = store.batches(&id, &all, None, 1_000).await.unwrap();
            let found = found.into_iter().map(|batch| (batch.id, batch.status));
            let batches = self.model.batches.values();
            let batches: Vec<_> = batches
                .filter(|batch| batch.upload.route == route)
                .collect();
            let expected = batches
                .iter()
                .map(|batch| (batch_id(&format!("b{}", batch.upload.id)), batch.status));
            assert_eq!(found.collect::<Vec<_>>(), expected.collect::<Vec<_>>());
            let record = store.route(&id).await.unwrap().unwrap();
            let revision = self
                .model
                .revisions
                .get(&route)
                .copied()
                .unwrap_or_default();
            assert_eq!(record.revision, revision);
            assert_eq!(record.counts.batches, batches.len() as i64);
            let waits = [BatchStatus::Queued, BatchStatus::Processing];
            let pending = batches.iter().filter(|batch| waits.contains(&batch.status));
            assert_eq!(record.pending_batches, pending.count() as i64);
            let waiting = [AlertStatus::Open, AlertStatus::Acknowledged];
            let alerts = self
                .model
                .alerts
                .values()
                .filter(|alert| alert.route == route);
            let open = alerts.filter(|alert| waiting.contains(&alert.status));
            assert_eq!(record.counts.open_alerts, open.count() as i64);
        }
        for (number, expected) in &self.model.alerts {
            let id = alert(*number, Tier::Confirmed).id;
            let stored = store.alert(id).await.unwrap().unwrap();
            assert_eq!(
                (stored.revision, stored.status),
                (expected.revision, expected.status)
            );
        }
    }

    /// Repeats every upload: what was acknowledged is still known, and nothing changes.
    async fn send_everything_again(&mut self) {
        for upload in self.uploads.clone().into_values() {
            self.upload(upload).await;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn the_store_does_what_the_contract_says(steps in prop::collection::vec(steps(), 20..80)) {
        Runtime::new().unwrap().block_on(async {
            let mut both = Both::new().await;
            for step in steps {
                both = both.take(step).await;
                both.check().await;
            }
            both.send_everything_again().await;
            both.check().await;
            both.fixture.store.close().await.unwrap();
        });
    }
}
