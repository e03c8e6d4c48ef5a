//! Ids of alerts. They are derived from what raises the alert, so a replay gives the same ones.

use jiff::Timestamp;
use sha2::{Digest, Sha256};
use uuid::{Builder, Uuid};

use crate::geometry::Vector2;
use crate::ids::{AlertId, RouteId};
use crate::model::ChangeKind;

/// Alerts of one kind that are raised at once differ by their places, to this many metres. Coarse, so that
/// an alert keeps its id where the map is made anew and comes out a little different.
const PLACE_M: f64 = 0.5;

/// What an alert is raised by.
pub(super) struct Raised<'a> {
    pub route: &'a RouteId,
    pub at: Timestamp,
    /// How many alerts of the same time there are before it.
    pub rank: usize,
    pub kind: ChangeKind,
    /// In the map frame, metres.
    pub location: Vector2<f64>,
}

impl Raised<'_> {
    /// The first id that is not `taken`: a UUID of version 7 of the time, with the microsecond (RFC 9562,
    /// section 6.2, method 3), and a digest instead of random bits. It does not depend on what was raised
    /// before.
    pub fn id(&self, taken: impl Fn(AlertId) -> bool) -> AlertId {
        let mut attempt: u64 = 0;
        loop {
            let id = self.nth_id(attempt);
            if !taken(id) {
                return id;
            }
            attempt += 1;
        }
    }

    fn nth_id(&self, attempt: u64) -> AlertId {
        let cell = |coordinate_m: f64| (coordinate_m / PLACE_M).floor() as i64;
        let mut digest = Sha256::new();
        digest.update(self.route.as_str());
        digest.update(self.at.as_microsecond().to_be_bytes());
        digest.update(self.kind.name());
        digest.update(cell(self.location.x).to_be_bytes());
        digest.update(cell(self.location.y).to_be_bytes());
        digest.update(attempt.to_be_bytes());
        let digest = digest.finalize();
        let microsecond = self.at.as_microsecond().max(0).unsigned_abs();
        let fraction = (microsecond % 1_000 * 4_096 / 1_000) as u16;
        let mut rest = [0; 10];
        rest[..2].copy_from_slice(&fraction.to_be_bytes());
        // Alerts of one job sort as they were raised.
        rest[2..4].copy_from_slice(&((self.rank % 0x4000) as u16).to_be_bytes());
        rest[4..].copy_from_slice(&digest[..6]);
        let uuid: Uuid =
            Builder::from_unix_timestamp_millis(microsecond / 1_000, &rest).into_uuid();
        AlertId(uuid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGUN: i64 = 1_790_000_000_123_456;

    fn id_of(route: &str, at: i64, kind: ChangeKind, x_m: f64) -> AlertId {
        let raised = Raised {
            route: &RouteId::new(route).unwrap(),
            at: Timestamp::from_microsecond(at).unwrap(),
            rank: 0,
            kind,
            location: Vector2::new(x_m, 2.0),
        };
        raised.id(|_| false)
    }

    #[test]
    fn ids_follow_from_what_raises_alerts_and_sort_by_its_time() {
        let id = id_of("line", BEGUN, ChangeKind::Appeared, 7.1);
        assert_eq!(id, id_of("line", BEGUN, ChangeKind::Appeared, 7.102));
        for other in [
            id_of("other", BEGUN, ChangeKind::Appeared, 7.1),
            id_of("line", BEGUN, ChangeKind::Disappeared, 7.1),
            id_of("line", BEGUN, ChangeKind::Appeared, 9.1),
        ] {
            assert_ne!(id, other);
        }
        assert!(id < id_of("line", BEGUN + 1, ChangeKind::Appeared, 7.1));
        assert!(id < id_of("line", BEGUN + 1_000, ChangeKind::Appeared, 7.1));
        let uuid = id.0;
        assert_eq!(uuid.get_version_num(), 7);
        let seconds = uuid.get_timestamp().unwrap().to_unix().0;
        assert_eq!(seconds, 1_790_000_000);
    }

    #[test]
    fn an_id_that_is_taken_is_not_given_twice() {
        let route = RouteId::new("line").unwrap();
        let raised = Raised {
            route: &route,
            at: Timestamp::from_microsecond(BEGUN).unwrap(),
            rank: 0,
            kind: ChangeKind::Appeared,
            location: Vector2::new(7.1, 2.0),
        };
        let first = raised.id(|_| false);
        assert_ne!(raised.id(|id| id == first), first);
    }

    #[test]
    fn alerts_of_one_job_sort_as_they_were_raised() {
        let route = RouteId::new("line").unwrap();
        let of_rank = |rank: usize| Raised {
            route: &route,
            at: Timestamp::from_microsecond(BEGUN).unwrap(),
            rank,
            kind: ChangeKind::Appeared,
            location: Vector2::new(7.1 - 3.0 * rank as f64, 2.0),
        };
        let ids: Vec<AlertId> = (0..300).map(|rank| of_rank(rank).id(|_| false)).collect();
        assert!(ids.is_sorted_by(|a, b| a < b));
    }
}
