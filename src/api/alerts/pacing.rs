//! How often a stream sends an alert that only gains evidence.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use tokio::time::Instant;

use crate::ids::AlertId;
use crate::store::AlertEvent;

/// The least time between two events of an alert, unless what a decision is about has changed.
const PACE: Duration = Duration::from_secs(5);

/// Which events of a stream are sent now, and which are held back. Has no clock of its own.
#[derive(Default)]
pub(super) struct Pacing {
    /// Alerts sent within the last [`PACE`]: when, and with which revision.
    sent: HashMap<AlertId, (Instant, i64)>,
    /// The newest event of each alert that is held back.
    held: BTreeMap<AlertId, AlertEvent>,
}

impl Pacing {
    /// Takes an event that was read: returns it to be sent now, or holds it back. An event whose revision was
    /// sent within the last 5 s is dropped.
    pub(super) fn take(&mut self, event: AlertEvent, now: Instant) -> Option<AlertEvent> {
        self.sent.retain(|_, (at, _)| now < *at + PACE);
        let Some((_, carried)) = self.sent.get(&event.alert_id) else {
            self.held.remove(&event.alert_id);
            return Some(event);
        };
        if event.revision <= *carried {
            return None;
        }
        if event.is_decision {
            self.held.remove(&event.alert_id);
            return Some(event);
        }
        self.held.insert(event.alert_id, event);
        None
    }

    /// An event that was held back long enough.
    pub(super) fn due(&mut self, now: Instant) -> Option<AlertEvent> {
        let is_due = |alert: &AlertId| match self.sent.get(alert) {
            Some((at, _)) => now >= *at + PACE,
            None => true,
        };
        let alert = *self.held.keys().find(|alert| is_due(alert))?;
        self.held.remove(&alert)
    }

    /// An event that is held back, due or not, for the end of the stream.
    pub(super) fn rest(&mut self) -> Option<AlertEvent> {
        self.held.pop_first().map(|(_, event)| event)
    }

    /// Notes that an alert was sent in this revision.
    pub(super) fn note(&mut self, alert: AlertId, revision: i64, now: Instant) {
        self.sent.insert(alert, (now, revision));
    }

    /// The event after which a client that disconnects now must resume to miss nothing, if events up to `read`
    /// were read. Never decreases.
    pub(super) fn resume_after(&self, read: i64) -> i64 {
        let first_held = self.held.values().map(|event| event.sequence).min();
        first_held.map_or(read, |first| first - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alert(number: u128) -> AlertId {
        AlertId(uuid::Uuid::from_u128(number))
    }

    fn event(sequence: i64, number: u128, revision: i64, is_decision: bool) -> AlertEvent {
        AlertEvent {
            sequence,
            alert_id: alert(number),
            revision,
            at: jiff::Timestamp::UNIX_EPOCH,
            is_decision,
        }
    }

    /// What is sent of an event, which carries its own revision.
    fn sent(pacing: &mut Pacing, event: AlertEvent, now: Instant) -> bool {
        let sent = pacing.take(event, now);
        if let Some(event) = sent {
            pacing.note(event.alert_id, event.revision, now);
        }
        sent.is_some()
    }

    #[test]
    fn evidence_is_sent_once_in_five_seconds_and_the_newest_is_not_lost() {
        let (mut pacing, start) = (Pacing::default(), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        assert!(sent(&mut pacing, event(1, 7, 1, true), at(0)));
        for (k, sequence) in (2..40).enumerate() {
            let grown = event(sequence, 7, sequence, false);
            assert!(!sent(&mut pacing, grown, at(100 * k as u64)));
        }
        assert_eq!(pacing.due(at(4_999)), None);
        let newest = pacing.due(at(5_000)).unwrap();
        assert_eq!(newest.sequence, 39);
        pacing.note(newest.alert_id, newest.revision, at(5_000));
        assert_eq!((pacing.due(at(60_000)), pacing.rest()), (None, None));
        // Another alert is not held up, and one that was quiet for long is sent at once.
        assert!(sent(&mut pacing, event(40, 8, 3, false), at(5_100)));
        assert!(sent(&mut pacing, event(41, 7, 41, false), at(10_000)));
    }

    #[test]
    fn a_decision_is_sent_at_once_and_carries_what_was_held() {
        let (mut pacing, now) = (Pacing::default(), Instant::now());
        assert!(sent(&mut pacing, event(1, 7, 1, true), now));
        assert!(!sent(&mut pacing, event(2, 7, 2, false), now));
        assert!(sent(&mut pacing, event(3, 7, 3, true), now));
        assert_eq!(pacing.rest(), None);
        assert!(sent(&mut pacing, event(4, 7, 4, true), now));
    }

    #[test]
    fn what_an_event_has_carried_is_not_sent_again() {
        let (mut pacing, now) = (Pacing::default(), Instant::now());
        let raised = pacing.take(event(1, 7, 1, true), now).unwrap();
        pacing.note(raised.alert_id, 5, now);
        assert!(!sent(&mut pacing, event(2, 7, 5, true), now));
        assert!(sent(&mut pacing, event(3, 7, 6, true), now));
    }

    #[test]
    fn a_client_goes_on_before_the_first_event_that_is_held() {
        let (mut pacing, now) = (Pacing::default(), Instant::now());
        for number in [7, 8] {
            assert!(sent(
                &mut pacing,
                event(number as i64, number, 1, true),
                now
            ));
        }
        assert_eq!(pacing.resume_after(8), 8);
        let mut last = 8;
        for (sequence, number) in [(9, 7), (10, 8), (11, 7), (12, 9), (13, 8)] {
            sent(&mut pacing, event(sequence, number, sequence, false), now);
            let resume = pacing.resume_after(sequence);
            assert!(resume >= last, "{resume} after {last}");
            last = resume;
        }
        assert_eq!(last, 10, "11 and 13 are held");
        assert_eq!(pacing.rest().unwrap().sequence, 11);
        assert_eq!(pacing.resume_after(13), 12);
        assert_eq!(pacing.rest().unwrap().sequence, 13);
        assert_eq!(pacing.resume_after(13), 13);
    }
}
