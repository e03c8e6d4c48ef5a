//! The contract for batches, trips, jobs and decisions, in memory: the oracle of `random.rs`.

use std::collections::BTreeMap;

use mapshift::change::AlertStatus;
use mapshift::model::BatchStatus::{
    self, Held, Merged, Processing, Quarantined, Queued, Unanchored,
};
use mapshift::store::Journaled;

pub const LEASE_S: i64 = 60;
pub const HOLD_S: i64 = 30;
/// How often a job is tried.
const TRIES_MAX: i64 = 5;

/// An upload; route, name, trip and vehicle are numbers.
#[derive(Debug, Clone, Copy)]
pub struct Upload {
    pub route: u8,
    pub id: u8,
    pub trip: u8,
    pub vehicle: u8,
    pub sequence: i64,
    /// Two uploads of one name with different bodies are in conflict.
    pub body: u8,
}

#[derive(Debug, Clone)]
pub struct Batch {
    pub upload: Upload,
    pub status: BatchStatus,
    /// Whether its turn is over; a batch that was refused on arrival had none.
    had_turn: bool,
    received_s: i64,
}

#[derive(Debug, Clone)]
struct Job {
    run_after_s: i64,
    /// While it is held.
    lease_ends_s: Option<i64>,
    generation: i64,
    attempts: i64,
}

/// What a worker holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    pub route: u8,
    /// The batch, by the order of arrival.
    pub key: usize,
    pub generation: i64,
    pub attempts: i64,
    /// The batches that it takes along, by order of arrival, and its own.
    pub entries: Vec<usize>,
    pub after_gap: bool,
}

#[derive(Debug, Clone, Copy)]
pub struct Alert {
    pub route: u8,
    pub revision: i64,
    pub status: AlertStatus,
}

#[derive(Debug, Default)]
pub struct Model {
    /// By the order of arrival over all routes.
    pub batches: BTreeMap<usize, Batch>,
    arrived: usize,
    /// Vehicle and due sequence by route and trip.
    trips: BTreeMap<(u8, u8), (u8, i64)>,
    /// By the batch.
    jobs: BTreeMap<usize, Job>,
    pub revisions: BTreeMap<u8, i64>,
    pub alerts: BTreeMap<u128, Alert>,
}

impl Model {
    pub fn upload(&mut self, upload: Upload, now_s: i64) -> Journaled {
        let mut known = self.batches.values().map(|batch| batch.upload);
        let same_name = known.find(|known| (known.route, known.id) == (upload.route, upload.id));
        match same_name {
            Some(known) if known.body == upload.body => return Journaled::Replayed,
            Some(_) => return Journaled::Conflict,
            None => {}
        }
        let status = self.placed(&upload);
        let key = self.arrived;
        self.arrived += 1;
        let batch = Batch {
            upload,
            status,
            had_turn: false,
            received_s: now_s,
        };
        self.batches.insert(key, batch);
        if status == Queued {
            self.queue(key);
        }
        Journaled::Stored
    }

    /// The order within a trip: the batch that is due is queued, an early one is held, and one that is
    /// late, repeats a sequence, or is of another vehicle is quarantined.
    fn placed(&mut self, upload: &Upload) -> BatchStatus {
        let trip = (upload.route, upload.trip);
        let (vehicle, due) = *self.trips.entry(trip).or_insert((upload.vehicle, 0));
        let is_taken = self.of_trip(trip).any(|(_, batch)| {
            let is_in = batch.status != Quarantined || batch.had_turn;
            batch.upload.sequence == upload.sequence && is_in
        });
        match upload.sequence.cmp(&due) {
            _ if vehicle != upload.vehicle || is_taken => Quarantined,
            std::cmp::Ordering::Less => Quarantined,
            std::cmp::Ordering::Equal => Queued,
            std::cmp::Ordering::Greater => Held,
        }
    }

    fn of_trip(&self, trip: (u8, u8)) -> impl Iterator<Item = (usize, &Batch)> {
        let batches = self.batches.iter().map(|(key, batch)| (*key, batch));
        batches.filter(move |(_, batch)| (batch.upload.route, batch.upload.trip) == trip)
    }

    fn trip_of(&self, key: usize) -> (u8, u8) {
        let upload = self.batches[&key].upload;
        (upload.route, upload.trip)
    }

    fn set(&mut self, key: usize, status: BatchStatus) {
        let batch = self.batches.get_mut(&key).unwrap();
        batch.status = status;
        batch.had_turn |= matches!(status, Merged | Unanchored | Quarantined);
    }

    fn queue(&mut self, key: usize) {
        self.set(key, Queued);
        let job = Job {
            run_after_s: 0,
            lease_ends_s: None,
            generation: 0,
            attempts: 0,
        };
        self.jobs.insert(key, job);
    }

    fn end_turn(&mut self, key: usize) {
        self.jobs.remove(&key);
        let (trip, sequence) = (self.trip_of(key), self.batches[&key].upload.sequence);
        let due = &mut self.trips.get_mut(&trip).unwrap().1;
        *due = (*due).max(sequence + 1);
        let due = *due;
        let is_due = |batch: &Batch| batch.status == Held && batch.upload.sequence == due;
        let next = self.of_trip(trip).find(|(_, batch)| is_due(batch));
        if let Some(next) = next.map(|(key, _)| key) {
            self.queue(next);
        }
    }

    /// The oldest job whose time has come, one a route at a time.
    pub fn claim(&mut self, now_s: i64) -> Option<Claim> {
        loop {
            let is_held = |job: &Job| job.lease_ends_s.is_some_and(|ends| ends > now_s);
            let held = self.jobs.iter().filter(|(_, job)| is_held(job));
            let busy: Vec<u8> = held.map(|(key, _)| self.trip_of(*key).0).collect();
            let mut free = self.jobs.iter().filter(|(key, job)| {
                !busy.contains(&self.trip_of(**key).0)
                    && job.lease_ends_s.unwrap_or(job.run_after_s) <= now_s
            });
            let key = *free.next()?.0;
            if self.jobs[&key].attempts < TRIES_MAX {
                return Some(self.take(key, now_s));
            }
            self.give_up(key);
        }
    }

    fn take(&mut self, key: usize, now_s: i64) -> Claim {
        let (trip, sequence) = (self.trip_of(key), self.batches[&key].upload.sequence);
        let waits = |batch: &Batch| batch.status == Unanchored && batch.upload.sequence < sequence;
        let waiting = self.of_trip(trip).filter(|(_, batch)| waits(batch));
        let mut entries: Vec<usize> = waiting.map(|(key, _)| key).collect();
        entries.sort_by_key(|key| self.batches[key].upload.sequence);
        entries.push(key);
        let first = self.batches[&entries[0]].upload.sequence;
        let is_used = self.of_trip(trip).any(|(_, batch)| {
            batch.upload.sequence == first - 1 && matches!(batch.status, Merged | Unanchored)
        });
        self.set(key, Processing);
        let job = self.jobs.get_mut(&key).unwrap();
        job.generation += 1;
        job.attempts += 1;
        job.lease_ends_s = Some(now_s + LEASE_S);
        Claim {
            route: trip.0,
            key,
            generation: job.generation,
            attempts: job.attempts,
            entries,
            after_gap: first > 0 && !is_used,
        }
    }

    fn give_up(&mut self, key: usize) {
        self.set(key, Quarantined);
        self.end_turn(key);
    }

    /// Whether a worker still holds what it claimed: the fence.
    pub fn holds(&self, claim: &Claim) -> bool {
        let job = self.jobs.get(&claim.key);
        job.is_some_and(|job| job.lease_ends_s.is_some() && job.generation == claim.generation)
    }

    /// Ends the batches of a job alike.
    pub fn finish(&mut self, claim: &Claim, status: BatchStatus, alert: Option<u128>) -> bool {
        if !self.holds(claim) {
            return false;
        }
        *self.revisions.entry(claim.route).or_default() += 1;
        for key in &claim.entries {
            self.set(*key, status);
        }
        self.end_turn(claim.key);
        if let Some(number) = alert {
            let raised = Alert {
                route: claim.route,
                revision: 0,
                status: AlertStatus::Open,
            };
            self.alerts.entry(number).or_insert(raised).revision += 1;
        }
        true
    }

    /// A try that failed: again after 1, 4, 16 and 64 s, and then no more.
    pub fn fail(&mut self, claim: &Claim, now_s: i64) {
        if !self.holds(claim) {
            return;
        }
        let job = self.jobs.get_mut(&claim.key).unwrap();
        if job.attempts >= TRIES_MAX {
            return self.give_up(claim.key);
        }
        job.lease_ends_s = None;
        job.run_after_s = now_s + (1 << (2 * (job.attempts - 1)));
        self.set(claim.key, Queued);
    }

    /// A job that is given back does not count as tried.
    pub fn give_back(&mut self, claim: &Claim, now_s: i64) {
        if self.holds(claim) {
            let job = self.jobs.get_mut(&claim.key).unwrap();
            job.lease_ends_s = None;
            job.run_after_s = now_s + 1;
            job.attempts -= 1;
            self.set(claim.key, Queued);
        }
    }

    /// Queues the first held batch of every trip that has waited too long for its predecessor.
    pub fn release_overdue(&mut self, now_s: i64) -> u64 {
        let mut released = 0;
        for trip in self.trips.keys().copied().collect::<Vec<_>>() {
            let has_job = self.jobs.keys().any(|key| self.trip_of(*key) == trip);
            let held = self.of_trip(trip).filter(|(_, batch)| batch.status == Held);
            let first = held.min_by_key(|(_, batch)| batch.upload.sequence);
            if let Some((key, batch)) = first
                && !has_job
                && batch.received_s + HOLD_S <= now_s
            {
                self.trips.get_mut(&trip).unwrap().1 = self.batches[&key].upload.sequence;
                self.queue(key);
                released += 1;
            }
        }
        released
    }

    /// Closing a store gives back all jobs that are held.
    pub fn reopen(&mut self) {
        let held: Vec<usize> = self.jobs.keys().copied().collect();
        for key in held {
            let job = self.jobs.get_mut(&key).unwrap();
            if job.lease_ends_s.take().is_some() {
                job.attempts -= 1;
                self.set(key, Queued);
            }
        }
    }

    /// A decision stands if neither the route nor the alert has moved on.
    pub fn decide(&mut self, number: u128, base_revision: i64, status: AlertStatus) -> bool {
        let alert = self.alerts.get_mut(&number).unwrap();
        let revision = self.revisions.entry(alert.route).or_default();
        if *revision != base_revision {
            return false;
        }
        *revision += 1;
        alert.revision += 1;
        alert.status = status;
        true
    }

    /// Removes everything of a route.
    pub fn delete_route(&mut self, route: u8) {
        self.batches.retain(|_, batch| batch.upload.route != route);
        let batches = &self.batches;
        self.jobs.retain(|key, _| batches.contains_key(key));
        self.trips.retain(|(of, _), _| *of != route);
        self.alerts.retain(|_, alert| alert.route != route);
        self.revisions.remove(&route);
    }
}
