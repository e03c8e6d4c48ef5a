//! A cell of the screen with the hits and misses of each pass.

use super::cell_key::{CELL_M, CellKey, centre_of};
use crate::change::history::{
    History, NATS_PER_OBSERVATION, NATS_PER_PASS, NO_RETURN_WORTH, limited,
};
use crate::observation::{Cell, Outcome};

/// A cell is counted once this many observations have a hit in it: one alone is noise.
pub const HITS_TO_COUNT: u32 = 2;
/// More equal outcomes of one pass do not change a cell's signature.
const COUNT_CAP: u32 = 16;
/// Fewest hits, and fewest misses, of a candidate.
const ANSWERS_MIN: f64 = 2.0;
/// How much the share of hits must differ between the two states; the decision requires more.
const CONTRAST_MIN: f64 = 0.5;
/// A cell is occupied by a pass with a larger share of hits, …
const SOLID_SHARE_MIN: f64 = 0.7;
/// … and free by one with a smaller share.
const FREE_SHARE_MAX: f64 = 0.3;

/// A pass is clear about a cell with at least this many hits and misses.
const CLEAR_MIN: u32 = 6;

/// A hash of a cell's history, in steps that matter to a decision.
pub type Signature = u64;

/// A span of time of one trip, about a pass; they sort by time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct PassKey {
    /// Number of the span.
    pub span: i64,
    /// Hash of the trip.
    pub trip: u32,
}

/// A cell of the screen.
pub struct CountedCell {
    /// Where it is.
    pub key: CellKey,
    /// Observations that have a hit in it.
    pub hit_by: u32,
    /// Whether its history has a change.
    pub candidate: bool,
    /// Its signature when it was last judged, if it was touched since.
    pub before: Option<Signature>,
    /// Ascending by pass.
    pub passes: Vec<PassCounts>,
}

/// How often one pass hit and missed a cell.
#[derive(Clone, Copy)]
pub struct PassCounts {
    /// The pass.
    pub pass: PassKey,
    /// Observations that hit the cell.
    pub hits: u32,
    /// Observations that missed it.
    pub misses: u32,
    /// Observations whose beams towards it gave no return.
    pub no_returns: u32,
}

impl PassCounts {
    fn new(pass: PassKey) -> Self {
        Self {
            pass,
            hits: 0,
            misses: 0,
            no_returns: 0,
        }
    }

    fn count_mut(&mut self, outcome: Outcome) -> Option<&mut u32> {
        match outcome {
            Outcome::Hit => Some(&mut self.hits),
            Outcome::Miss => Some(&mut self.misses),
            Outcome::NoReturn => Some(&mut self.no_returns),
            Outcome::Unknown => None,
        }
    }

    fn is_empty(&self) -> bool {
        self.hits + self.misses + self.no_returns == 0
    }

    /// Misses, with each no-return as `no_return_worth` of one.
    fn free(&self, no_return_worth: f64) -> f64 {
        f64::from(self.misses) + no_return_worth * f64::from(self.no_returns)
    }

    /// 1 if the pass found the cell occupied, −1 if free, 0 if unclear.
    fn vote(&self) -> i32 {
        let (hits, all) = (f64::from(self.hits), f64::from(self.hits + self.misses));
        i32::from(hits > SOLID_SHARE_MIN * all) - i32::from(hits < FREE_SHARE_MAX * all)
    }
}

impl CountedCell {
    /// A cell without hits.
    pub fn new(key: CellKey) -> Self {
        Self {
            key,
            hit_by: 0,
            candidate: false,
            before: None,
            passes: Vec::new(),
        }
    }

    /// Forgets its passes: too few observations hit it now.
    pub fn clear(&mut self) {
        self.candidate = false;
        self.passes.clear();
    }

    /// Marks it as touched; returns whether that is the first time since it was judged.
    pub fn touch(&mut self) -> bool {
        let is_first = self.before.is_none();
        if is_first {
            self.before = Some(self.signature());
        }
        is_first
    }

    /// Whether enough observations hit it.
    pub fn is_counted(&self) -> bool {
        self.hit_by >= HITS_TO_COUNT
    }

    /// Its geometry for the ray test.
    pub fn geometry(&self) -> Cell {
        Cell::of_grid(centre_of(self.key), 0.5 * CELL_M)
    }

    /// Whether more of the passes for which `counts` holds found it occupied than free.
    pub fn is_solid_to(&self, counts: impl Fn(&PassKey) -> bool) -> bool {
        let votes = self.passes.iter().filter(|p| counts(&p.pass));
        votes.map(PassCounts::vote).sum::<i32>() > 0
    }

    /// Of the clear passes without the first and the last: how many contradict both the one before and the
    /// one after, and how many there are. A lasting change contradicts only one of the two.
    pub fn contradictions(&self) -> (u32, u32) {
        let clear = self.passes.iter();
        let clear = clear.filter(|p| p.hits + p.misses >= CLEAR_MIN);
        let mut votes = clear.map(PassCounts::vote).filter(|v| *v != 0);
        let (Some(mut before), Some(mut vote)) = (votes.next(), votes.next()) else {
            return (0, 0);
        };
        let (mut contradicting, mut passes) = (0, 0);
        for after in votes {
            contradicting += u32::from(vote != before && vote != after);
            passes += 1;
            (before, vote) = (vote, after);
        }
        (contradicting, passes)
    }

    /// Changes when a pass is added or removed, changes its outcome or doubles its counts, and when the cell
    /// becomes a candidate or ceases to be one.
    pub fn signature(&self) -> Signature {
        let mut signature = 0xcbf2_9ce4_8422_2325;
        let mut mix = |value: u64| signature = (signature ^ value).wrapping_mul(0x0100_0000_01b3);
        let doublings = |count: u32| {
            let log = count.min(COUNT_CAP).checked_ilog2();
            u64::from(log.map_or(0, |log| log + 1))
        };
        mix(u64::from(self.candidate));
        for counts in &self.passes {
            mix(counts.pass.span.cast_unsigned());
            mix(u64::from(counts.pass.trip));
            mix(doublings(counts.hits));
            mix(doublings(counts.misses));
            mix(doublings(counts.no_returns));
            mix(u64::from(counts.hits > counts.misses));
        }
        signature
    }

    /// Adds an outcome, or removes it.
    pub fn count(&mut self, pass: PassKey, outcome: Outcome, adds: bool) {
        if outcome == Outcome::Unknown {
            return;
        }
        let at = match self.passes.binary_search_by_key(&pass, |p| p.pass) {
            Ok(at) => at,
            Err(at) if adds => {
                self.passes.insert(at, PassCounts::new(pass));
                at
            }
            Err(_) => return,
        };
        let counts = &mut self.passes[at];
        if let Some(count) = counts.count_mut(outcome) {
            *count = if adds { *count + 1 } else { *count - 1 };
        }
        if counts.is_empty() {
            self.passes.remove(at);
        }
    }

    /// Whether its history has a change, with or without no-returns: whether these count for the lidar is
    /// decided where the site is judged.
    pub fn has_change(&self) -> bool {
        let has_no_returns = || self.passes.iter().any(|p| p.no_returns > 0);
        self.has_change_if(0.0) || (has_no_returns() && self.has_change_if(NO_RETURN_WORTH))
    }

    fn has_change_if(&self, no_return_worth: f64) -> bool {
        let (hits, free) = counts_of(self.passes.iter(), no_return_worth);
        if hits < ANSWERS_MIN || free < ANSWERS_MIN {
            return false;
        }
        let evidence = self.passes.iter().map(|p| {
            let sum = NATS_PER_OBSERVATION * (f64::from(p.hits) - p.free(no_return_worth));
            limited(sum, NATS_PER_PASS)
        });
        let history = History::of(evidence);
        let Some(change) = history.last_change() else {
            return false;
        };
        let within = share_of_hits(self.passes[change].iter(), no_return_worth);
        // An earlier episode of the new state does not count as the old one.
        let of_passes = self.passes.iter().zip(&history.states);
        let old = of_passes.filter(|(_, state)| Some(**state) == history.baseline());
        let outside = share_of_hits(old.map(|(counts, _)| counts), no_return_worth);
        (within - outside).abs() >= CONTRAST_MIN
    }
}

/// Hits and weighted misses of some passes together.
fn counts_of<'a>(passes: impl Iterator<Item = &'a PassCounts>, no_return_worth: f64) -> (f64, f64) {
    passes.fold((0.0, 0.0), |(hits, free), p| {
        (hits + f64::from(p.hits), free + p.free(no_return_worth))
    })
}

fn share_of_hits<'a>(passes: impl Iterator<Item = &'a PassCounts>, no_return_worth: f64) -> f64 {
    let (hits, free) = counts_of(passes, no_return_worth);
    hits / f64::max(hits + free, f64::MIN_POSITIVE)
}
