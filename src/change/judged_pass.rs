//! Passes by the place of a change, and what each of them saw.

use serde::{Deserialize, Serialize};

use crate::ids::{NodeId, StampNs, TripId, VehicleId};
use crate::model::{ChangeKind, PassOutcome, PassSide};

/// Most passes that are listed; all are counted.
const LISTED_MAX: usize = 200;

/// A pass by the place of a change, as [`passes`](super::passes) cuts them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JudgedPass {
    /// Its trip.
    pub trip: TripId,
    /// The trip's vehicle.
    pub vehicle: VehicleId,
    /// The first observation with a hit or a miss at the place; if there is none, the first within reach.
    pub begins: StampNs,
    /// The last one.
    pub ends: StampNs,
    /// Before the change or since.
    pub side: PassSide,
    /// What it saw.
    pub outcome: PassOutcome,
    /// The keyframe whose own or following scan shows that best.
    pub node: NodeId,
}

/// How many passes saw what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PassCounts {
    /// Saw the place free.
    pub saw_free: u32,
    /// Saw the place occupied.
    pub saw_occupied: u32,
    /// Saw neither.
    pub could_not_see: u32,
}

impl PassCounts {
    /// How many passes.
    pub fn total(&self) -> u32 {
        self.saw_free + self.saw_occupied + self.could_not_see
    }

    fn less(self, other: Self) -> Self {
        Self {
            saw_free: self.saw_free.saturating_sub(other.saw_free),
            saw_occupied: self.saw_occupied.saturating_sub(other.saw_occupied),
            could_not_see: self.could_not_see.saturating_sub(other.could_not_see),
        }
    }

    fn of<'a>(kind: ChangeKind, passes: impl Iterator<Item = &'a JudgedPass>) -> Self {
        let mut counts = Self::default();
        for pass in passes {
            let shows_new = match pass.outcome {
                PassOutcome::CouldNotSee => {
                    counts.could_not_see += 1;
                    continue;
                }
                PassOutcome::NewState => true,
                PassOutcome::OldState => false,
            };
            match shows_new == (kind == ChangeKind::Appeared) {
                true => counts.saw_occupied += 1,
                false => counts.saw_free += 1,
            }
        }
        counts
    }
}

/// All passes by the place of a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JudgedPasses {
    /// Passes before the change.
    pub before: PassCounts,
    /// Passes since.
    pub since: PassCounts,
    /// In the order of time: of more than 200 the first and the newest.
    pub listed: Vec<JudgedPass>,
}

impl JudgedPasses {
    /// From passes in any order, by the place of a change of this kind.
    pub fn of(kind: ChangeKind, mut passes: Vec<JudgedPass>) -> Self {
        passes.sort_by(|a, b| (a.begins, &a.trip, a.node).cmp(&(b.begins, &b.trip, b.node)));
        let counts = |side| PassCounts::of(kind, passes.iter().filter(|pass| pass.side == side));
        let (before, since) = (counts(PassSide::Before), counts(PassSide::Since));
        if let Some(left_out) = passes.len().checked_sub(LISTED_MAX) {
            passes.drain(1..=left_out);
        }
        Self {
            before,
            since,
            listed: passes,
        }
    }

    /// The passes without those whose scan was removed; `None` if none was. `kind` is that of the change.
    pub fn without(&self, kind: ChangeKind, is_out: impl Fn(NodeId) -> bool) -> Option<Self> {
        let passes = self.listed.iter().cloned();
        let (out, listed): (Vec<_>, Vec<_>) = passes.partition(|pass| is_out(pass.node));
        let counts = |side| PassCounts::of(kind, out.iter().filter(|pass| pass.side == side));
        (!out.is_empty()).then(|| Self {
            before: self.before.less(counts(PassSide::Before)),
            since: self.since.less(counts(PassSide::Since)),
            listed,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pass(second: i64, side: PassSide, outcome: PassOutcome) -> JudgedPass {
        JudgedPass {
            trip: TripId::new("monday").unwrap(),
            vehicle: VehicleId::new("agv-07").unwrap(),
            begins: StampNs(second),
            ends: StampNs(second + 1),
            side,
            outcome,
            node: NodeId(second),
        }
    }

    #[test]
    fn what_is_free_and_what_is_occupied_depends_on_the_kind() {
        let passes = vec![
            pass(3, PassSide::Since, PassOutcome::NewState),
            pass(1, PassSide::Before, PassOutcome::OldState),
            pass(2, PassSide::Before, PassOutcome::CouldNotSee),
            pass(4, PassSide::Since, PassOutcome::OldState),
        ];
        let appeared = JudgedPasses::of(ChangeKind::Appeared, passes.clone());
        let counts = |saw_free, saw_occupied, could_not_see| PassCounts {
            saw_free,
            saw_occupied,
            could_not_see,
        };
        assert_eq!(appeared.before, counts(1, 0, 1));
        assert_eq!(appeared.since, counts(1, 1, 0));
        let disappeared = JudgedPasses::of(ChangeKind::Disappeared, passes);
        assert_eq!(disappeared.before, counts(0, 1, 1));
        assert_eq!(disappeared.since, counts(1, 1, 0));
        let begins: Vec<i64> = appeared.listed.iter().map(|pass| pass.begins.0).collect();
        assert_eq!(begins, [1, 2, 3, 4]);
    }

    #[test]
    fn what_is_taken_out_counts_no_more() {
        let passes = (0..4).map(|k| pass(k, PassSide::Before, PassOutcome::OldState));
        let all = JudgedPasses::of(ChangeKind::Disappeared, passes.collect());
        assert_eq!(
            all.without(ChangeKind::Disappeared, |node| node.0 > 3),
            None
        );
        let left = all
            .without(ChangeKind::Disappeared, |node| node.0 == 2)
            .unwrap();
        assert_eq!((left.before.saw_occupied, left.listed.len()), (3, 3));
        assert!(left.listed.iter().all(|pass| pass.node != NodeId(2)));
    }

    #[test]
    fn all_passes_are_counted_and_the_newest_listed_with_the_first() {
        let passes = (0..250).map(|k| pass(k, PassSide::Before, PassOutcome::OldState));
        let judged = JudgedPasses::of(ChangeKind::Appeared, passes.collect());
        assert_eq!(judged.before.total(), 250);
        assert_eq!(judged.listed.len(), LISTED_MAX);
        let begins = |k: usize| judged.listed[k].begins.0;
        assert_eq!((begins(0), begins(1), begins(199)), (0, 51, 249));
    }
}
