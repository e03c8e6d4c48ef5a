//! A cell of the screen, and what each pass has said about it.

use super::cell_key::{CELL_M, CellKey, centre_of};
use crate::change::history::{
    History, NATS_PER_OBSERVATION, NATS_PER_PASS, NO_RETURN_WORTH, limited,
};
use crate::observation::{Cell, Outcome};

/// A cell is counted once so many observations have a hit in it: one alone is noise.
pub const MAKERS_MIN: u32 = 2;
/// A pass that says something so often has said all it can.
const SAID_OFTEN: u32 = 16;
/// Hits and misses that a cell needs.
const ANSWERS_MIN: f64 = 2.0;
/// How much the share of hits must differ between the two states: the decision wants more.
const CONTRAST_MIN: f64 = 0.5;
/// A cell is solid to a pass of which a larger share hits it, …
const SOLID_SHARE_MIN: f64 = 0.7;
/// … and free to one of which a smaller share does.
const FREE_SHARE_MAX: f64 = 0.3;

/// A pass says much about a cell if it answers so often.
const TELLING_MIN: u32 = 6;

/// What a cell's passes say, in steps of what matters to a decision.
pub type Signature = u64;

/// A span of time of one trip: about a pass. They sort by time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct PassKey {
    /// Number of the span.
    pub span: i64,
    /// Hash of the trip.
    pub trip: u32,
}

/// A place that is counted once something was hit in it twice.
pub struct CountedCell {
    /// Where it is.
    pub key: CellKey,
    /// Observations that have a hit in it.
    pub makers: u32,
    /// Whether its history has a change.
    pub candidate: bool,
    /// What its passes said when it was last judged, if it was touched since.
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

    /// Misses, and no-returns if one is worth so many of them.
    fn free(&self, no_return_worth: f64) -> f64 {
        f64::from(self.misses) + no_return_worth * f64::from(self.no_returns)
    }

    /// 1 where the pass found the cell solid, -1 where free, 0 in doubt.
    fn vote(&self) -> i32 {
        let (hits, all) = (f64::from(self.hits), f64::from(self.hits + self.misses));
        i32::from(hits > SOLID_SHARE_MIN * all) - i32::from(hits < FREE_SHARE_MAX * all)
    }
}

impl CountedCell {
    /// A cell that nothing was hit in.
    pub fn new(key: CellKey) -> Self {
        Self {
            key,
            makers: 0,
            candidate: false,
            before: None,
            passes: Vec::new(),
        }
    }

    /// Forgets what was said: too little is hit in it now.
    pub fn clear(&mut self) {
        self.candidate = false;
        self.passes.clear();
    }

    /// Notes that something was said about it; whether that is the first time since it was judged.
    pub fn touch(&mut self) -> bool {
        let is_first = self.before.is_none();
        if is_first {
            self.before = Some(self.signature());
        }
        is_first
    }

    /// Whether enough was hit in it.
    pub fn is_counted(&self) -> bool {
        self.makers >= MAKERS_MIN
    }

    /// What observations are asked about.
    pub fn geometry(&self) -> Cell {
        Cell::of_grid(centre_of(self.key), 0.5 * CELL_M)
    }

    /// Whether more of the passes that `counts` found it solid than free.
    pub fn is_solid_to(&self, counts: impl Fn(&PassKey) -> bool) -> bool {
        let votes = self.passes.iter().filter(|p| counts(&p.pass));
        votes.map(PassCounts::vote).sum::<i32>() > 0
    }

    /// Of the passes that said much about it, the first and the last aside: how many contradict
    /// both the one before and the one after, and how many there are. What has changed and stays so
    /// contradicts one of them alone.
    pub fn contradictions(&self) -> (u32, u32) {
        let telling = self.passes.iter();
        let telling = telling.filter(|p| p.hits + p.misses >= TELLING_MIN);
        let mut votes = telling.map(PassCounts::vote).filter(|v| *v != 0);
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

    /// Changes when a pass comes, leaves, or says something else, or twice as much: what is said
    /// again and again says no more, unless it makes the cell a candidate, or none any more.
    pub fn signature(&self) -> Signature {
        let mut signature = 0xcbf2_9ce4_8422_2325;
        let mut mix = |value: u64| signature = (signature ^ value).wrapping_mul(0x0100_0000_01b3);
        let doublings = |count: u32| {
            let log = count.min(SAID_OFTEN).checked_ilog2();
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

    /// Counts an answer, or takes it back.
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

    /// Whether its passes tell of a change, with or without what the no-returns say: whether the
    /// lidar earns a word for them is asked where it is decided.
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
        // An earlier episode of the new state is no witness of the old one.
        let of_passes = self.passes.iter().zip(&history.states);
        let old = of_passes.filter(|(_, state)| Some(**state) == history.baseline());
        let outside = share_of_hits(old.map(|(counts, _)| counts), no_return_worth);
        (within - outside).abs() >= CONTRAST_MIN
    }
}

/// Hits, and answers for free, of some passes together.
fn counts_of<'a>(passes: impl Iterator<Item = &'a PassCounts>, no_return_worth: f64) -> (f64, f64) {
    passes.fold((0.0, 0.0), |(hits, free), p| {
        (hits + f64::from(p.hits), free + p.free(no_return_worth))
    })
}

fn share_of_hits<'a>(passes: impl Iterator<Item = &'a PassCounts>, no_return_worth: f64) -> f64 {
    let (hits, free) = counts_of(passes, no_return_worth);
    hits / f64::max(hits + free, f64::MIN_POSITIVE)
}
