//! When a delivery is tried again.

use std::time::Duration;

use jiff::Timestamp;
use sha2::{Digest, Sha256};

use crate::model::WebhookEvent;
use crate::store::{AttemptEnd, AttemptVerdict, NextDelivery};

/// Pauses after the first, second … attempt that failed: eight attempts within 28 hours, as
/// Standard Webhooks recommends.
pub(super) const PAUSES: [Duration; 7] = [
    Duration::from_secs(5),
    Duration::from_mins(5),
    Duration::from_mins(30),
    Duration::from_hours(2),
    Duration::from_hours(5),
    Duration::from_hours(10),
    Duration::from_hours(10),
];
/// Longest wait that a receiver can ask for.
const ASKED_MAX: Duration = Duration::from_hours(10);
/// Up to this share is added to a pause, so that receivers of many events are not hit by all of
/// them at once.
const JITTER: f64 = 0.1;

const GONE: u16 = 410;
const TOO_MANY_REQUESTS: u16 = 429;
const UNAVAILABLE: u16 = 503;

/// What follows from the attempt that has just ended. `asked` is the wait that the answer asked
/// for.
pub(super) fn verdict(
    next: &NextDelivery,
    end: AttemptEnd,
    asked: Option<Duration>,
    pauses: &[Duration],
    now: Timestamp,
) -> AttemptVerdict {
    let asked = match end {
        AttemptEnd::Answer(200..=299) => return AttemptVerdict::Delivered,
        AttemptEnd::Answer(GONE) => return AttemptVerdict::Gone,
        AttemptEnd::Answer(TOO_MANY_REQUESTS | UNAVAILABLE) => asked.unwrap_or_default(),
        _ => Duration::ZERO,
    };
    // Whoever tests is there to see it fail, and to test again.
    if next.event == WebhookEvent::Test {
        return AttemptVerdict::Failed;
    }
    let made = usize::try_from(next.attempts).unwrap_or(usize::MAX);
    let Some(pause) = pauses.get(made) else {
        return AttemptVerdict::Failed;
    };
    let pause = (*pause).max(asked.min(ASKED_MAX));
    let pause = pause.mul_f64(1.0 + JITTER * share(&next.id, next.attempts));
    match now.checked_add(pause) {
        Ok(at) => AttemptVerdict::RetryAt(at),
        Err(_) => AttemptVerdict::Failed,
    }
}

/// A number in [0, 1] that follows from the delivery and the attempt.
fn share(id: &str, attempts: i64) -> f64 {
    let digest = Sha256::digest(format!("{attempts} {id}"));
    f64::from(digest[0]) / 255.0
}

/// The wait that a `Retry-After` asks for: seconds, or a date (RFC 9110, section 10.2.3).
pub(super) fn asked_wait(text: &str, now: Timestamp) -> Option<Duration> {
    if let Ok(seconds) = text.trim().parse::<u32>() {
        return Some(Duration::from_secs(seconds.into()));
    }
    let date = jiff::fmt::rfc2822::parse(text.trim()).ok()?;
    let wait = now.duration_until(date.timestamp());
    Some(Duration::try_from(wait).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::WebhookId;
    use crate::model::{DeliveryFailure, WebhookTopic};
    use crate::store::WebhookSecret;

    fn now() -> Timestamp {
        "2026-11-20T06:00:00Z".parse().unwrap()
    }

    fn next(attempts: i64) -> NextDelivery {
        NextDelivery {
            key: 1,
            id: "msg_1".into(),
            webhook_id: WebhookId(uuid::Uuid::nil()),
            webhook_revision: 1,
            url: "https://example.com/".into(),
            secret: WebhookSecret([0; 32]),
            previous_secret: None,
            event: WebhookEvent::Topic(WebhookTopic::AlertRaised),
            subject: None,
            at: now(),
            attempts,
            due_at: now(),
        }
    }

    fn pause(attempts: i64, end: AttemptEnd, asked_s: Option<u64>) -> Option<f64> {
        let asked = asked_s.map(Duration::from_secs);
        match verdict(&next(attempts), end, asked, &PAUSES, now()) {
            AttemptVerdict::RetryAt(at) => Some(now().duration_until(at).as_secs_f64()),
            AttemptVerdict::Failed => None,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn eight_attempts_are_made_ever_farther_apart() {
        let timeout = AttemptEnd::Failure(DeliveryFailure::Timeout);
        let wanted_s = [5.0, 300.0, 1_800.0, 7_200.0, 18_000.0, 36_000.0, 36_000.0];
        for (made, wanted) in (0..).zip(wanted_s) {
            for end in [AttemptEnd::Answer(500), AttemptEnd::Answer(302), timeout] {
                let pause = pause(made, end, None).unwrap();
                assert!((wanted..=1.1 * wanted).contains(&pause), "{made}: {pause}");
            }
        }
        assert_eq!(pause(7, timeout, None), None);
        assert_eq!(pause(8, timeout, None), None);
    }

    #[test]
    fn the_same_attempt_waits_the_same_and_others_do_not() {
        let shares: Vec<f64> = (0..50).map(|k| share(&format!("msg_{k}"), 1)).collect();
        assert_eq!(shares[3], share("msg_3", 1));
        assert!(shares.iter().any(|share| *share < 0.3) && shares.iter().any(|share| *share > 0.7));
    }

    #[test]
    fn answers_decide() {
        let verdict = |next: &NextDelivery, status| {
            verdict(next, AttemptEnd::Answer(status), None, &PAUSES, now())
        };
        for status in [200, 204, 299] {
            assert_eq!(verdict(&next(3), status), AttemptVerdict::Delivered);
        }
        assert_eq!(verdict(&next(0), 410), AttemptVerdict::Gone);
        let mut test = next(0);
        test.event = WebhookEvent::Test;
        assert_eq!(verdict(&test, 500), AttemptVerdict::Failed);
        assert_eq!(verdict(&test, 204), AttemptVerdict::Delivered);
        assert_eq!(verdict(&test, 410), AttemptVerdict::Gone);
    }

    #[test]
    fn a_receiver_can_ask_for_a_longer_wait_within_reason() {
        for status in [429, 503] {
            let pause = |asked_s| pause(0, AttemptEnd::Answer(status), Some(asked_s)).unwrap();
            assert!((60.0..=66.0).contains(&pause(60)));
            assert!((5.0..=5.5).contains(&pause(1)));
            assert!((36_000.0..=39_600.0).contains(&pause(u64::from(u32::MAX))));
        }
        assert!(pause(0, AttemptEnd::Answer(500), Some(60)).unwrap() < 6.0);
    }

    #[test]
    fn both_forms_of_retry_after_are_read() {
        let wait = |text| asked_wait(text, now()).map(|wait| wait.as_secs());
        assert_eq!(wait("120"), Some(120));
        assert_eq!(wait(" 0 "), Some(0));
        assert_eq!(wait("Fri, 20 Nov 2026 06:02:00 GMT"), Some(120));
        assert_eq!(wait("Fri, 20 Nov 2026 05:00:00 GMT"), Some(0));
        for bad in ["", "-1", "1.5", "soon", "99999999999", "Fri, 20 Foo 2026"] {
            assert_eq!(wait(bad), None, "{bad}");
        }
    }
}
