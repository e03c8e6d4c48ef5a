//! Ids of alerts. They are derived from what raises the alert, so a replay gives the same ones.

use jiff::Timestamp;
use sha2::{Digest, Sha256};
use uuid::{Builder, Uuid};

use crate::ids::{AlertId, RouteId};

/// The id of the alert that a route raises after `count` others: a UUID of version 7 of the time,
/// with the microsecond (RFC 9562, section 6.2, method 3), and a digest instead of random bits.
pub(super) fn alert_id(route: &RouteId, at: Timestamp, count: usize) -> AlertId {
    let mut digest = Sha256::new();
    digest.update(route.as_str());
    digest.update(at.as_microsecond().to_be_bytes());
    digest.update((count as u64).to_be_bytes());
    let digest = digest.finalize();
    let microsecond = at.as_microsecond().max(0).unsigned_abs();
    let fraction = (microsecond % 1_000 * 4_096 / 1_000) as u16;
    let mut rest = [0; 10];
    rest[..2].copy_from_slice(&fraction.to_be_bytes());
    // Alerts of one job sort as they were raised.
    rest[2..4].copy_from_slice(&((count % 0x4000) as u16).to_be_bytes());
    rest[4..].copy_from_slice(&digest[..6]);
    let uuid: Uuid = Builder::from_unix_timestamp_millis(microsecond / 1_000, &rest).into_uuid();
    AlertId(uuid)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(microsecond: i64) -> Timestamp {
        Timestamp::from_microsecond(microsecond).unwrap()
    }

    #[test]
    fn ids_follow_from_what_raises_alerts_and_sort_by_it() {
        let line = RouteId::new("line").unwrap();
        let other = RouteId::new("other").unwrap();
        let begun = 1_790_000_000_123_456;
        let ids = [
            alert_id(&line, at(begun), 3),
            alert_id(&line, at(begun), 4),
            alert_id(&line, at(begun + 1), 0),
            alert_id(&line, at(begun + 1_000), 0),
        ];
        assert!(ids.is_sorted_by(|a, b| a < b), "{ids:?}");
        assert_eq!(ids[0], alert_id(&line, at(begun), 3));
        assert_ne!(ids[0], alert_id(&other, at(begun), 3));
        let uuid = ids[0].0;
        assert_eq!(uuid.get_version_num(), 7);
        let seconds = uuid.get_timestamp().unwrap().to_unix().0;
        assert_eq!(seconds, 1_790_000_000);
    }
}
