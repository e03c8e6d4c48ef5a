//! Factors side by side: errors, costs and derivatives of eight at a time.
//!
//! Loops over the lanes of a pack become vector instructions. They use no fused operations, so
//! that every processor gets the same numbers.

use super::local_error::Frame;
use super::problem::Factor;
use super::trigonometry::wrap;

/// How many factors there are in a pack.
pub(super) const LANES: usize = 8;

/// One number of each factor of a pack.
type Lanes = [f64; LANES];

/// Some factors, by columns. A pack that is not full is filled up with copies of its last factor
/// that weigh nothing.
#[derive(Debug, Clone)]
pub(super) struct Pack {
    from: [u32; LANES],
    to: [u32; LANES],
    measurement: Ends,
    /// The upper triangle row by row, weighted.
    information: [Lanes; 6],
}

/// Frames of eight poses, by columns.
#[derive(Debug, Clone)]
struct Ends {
    x: Lanes,
    y: Lanes,
    theta: Lanes,
    cos: Lanes,
    sin: Lanes,
}

/// Parts of H of a pack's factors, by columns of the blocks.
pub(super) struct Blocks {
    from_from: [Lanes; 9],
    from_to: [Lanes; 9],
    to_to: [Lanes; 9],
}

/// One factor's parts of H, each by columns.
pub(super) struct BlocksOfOne {
    pub(super) from_from: [[f64; 3]; 3],
    /// The first pose's rows, the second one's columns.
    pub(super) from_to: [[f64; 3]; 3],
    pub(super) to_to: [[f64; 3]; 3],
}

/// Puts factors into packs.
pub(super) fn pack_factors(factors: &[Factor], packs: &mut Vec<Pack>) {
    packs.clear();
    packs.extend(factors.chunks(LANES).map(Pack::of));
}

/// F at the poses with these frames, and half its gradient: g = Σ JᵀΩe for steps in the poses'
/// own frames, three numbers for each pose, held ones too.
#[inline(always)]
pub(super) fn cost_and_gradient(
    packs: &[Pack],
    frames: &[Frame],
    gradient: &mut [[f64; 3]],
) -> f64 {
    gradient.fill([0.0; 3]);
    let mut costs = [0.0; LANES];
    for pack in packs {
        let (from, to) = pack.ends(frames);
        let mut pulls = [[0.0; LANES]; 6];
        pack.pull(&from, &to, &mut costs, &mut pulls);
        let [from_pulls, to_pulls] = [&pulls[..3], &pulls[3..]];
        for (lane, (&from, &to)) in pack.from.iter().zip(&pack.to).enumerate() {
            for (end, pulls) in [(from, from_pulls), (to, to_pulls)] {
                for (sum, pull) in gradient[end as usize].iter_mut().zip(pulls) {
                    *sum += pull[lane];
                }
            }
        }
    }
    costs.iter().sum()
}

impl Pack {
    /// A pack of one factor.
    pub(super) fn of_one(factor: &Factor) -> Self {
        Self::of(std::slice::from_ref(factor))
    }

    /// A pack of at least one and at most eight factors.
    fn of(factors: &[Factor]) -> Self {
        let mut pack = Self {
            from: [0; LANES],
            to: [0; LANES],
            measurement: Ends::new(),
            information: [[0.0; LANES]; 6],
        };
        for (lane, factor) in factors.iter().enumerate() {
            pack.set(lane, factor);
        }
        if let Some(last) = factors.last() {
            let nothing = Factor {
                weight: 0.0,
                ..*last
            };
            for lane in factors.len()..LANES {
                pack.set(lane, &nothing);
            }
        }
        pack
    }

    fn set(&mut self, lane: usize, factor: &Factor) {
        self.from[lane] = factor.from as u32;
        self.to[lane] = factor.to as u32;
        self.measurement.set(lane, &factor.measurement);
        let upper = factor.information.upper();
        for (lanes, entry) in self.information.iter_mut().zip(upper) {
            lanes[lane] = entry * factor.weight;
        }
    }

    #[inline(always)]
    fn ends(&self, frames: &[Frame]) -> (Ends, Ends) {
        let (mut from, mut to) = (Ends::new(), Ends::new());
        for lane in 0..LANES {
            from.set(lane, &frames[self.from[lane] as usize]);
            to.set(lane, &frames[self.to[lane] as usize]);
        }
        (from, to)
    }

    /// Adds the costs, and says how much each factor pulls at its ends: JᵀΩe of the first pose,
    /// then of the second.
    #[inline(always)]
    fn pull(&self, from: &Ends, to: &Ends, costs: &mut Lanes, pulls: &mut [Lanes; 6]) {
        let measured = &self.measurement;
        for l in 0..LANES {
            let (c, s) = (measured.cos[l], measured.sin[l]);
            let (x, y) = from.see(to, l);
            let (dx, dy) = (x - measured.x[l], y - measured.y[l]);
            let angle = to.theta[l] - from.theta[l] - measured.theta[l];
            let error = [c * dx + s * dy, c * dy - s * dx, wrap(angle)];
            let stress = self.weigh(error, l);
            costs[l] += error[0] * stress[0] + error[1] * stress[1] + error[2] * stress[2];
            let first = turned_from(stress, (c, s), (x, y));
            let second = turned_to(stress, from.turn(to, measured, l));
            for k in 0..3 {
                pulls[k][l] = first[k];
                pulls[3 + k][l] = second[k];
            }
        }
    }

    /// JᵀΩJ of every factor.
    #[inline(always)]
    pub(super) fn blocks(&self, frames: &[Frame]) -> Blocks {
        let (from, to) = self.ends(frames);
        let measured = &self.measurement;
        let mut blocks = Blocks::new();
        for l in 0..LANES {
            let (c, s) = (measured.cos[l], measured.sin[l]);
            let seen = from.see(&to, l);
            let turn = from.turn(&to, measured, l);
            // Jᵀ Ω by columns, which are the rows of ΩJ.
            let mut rows_from = [[0.0; 3]; 3];
            let mut rows_to = [[0.0; 3]; 3];
            for k in 0..3 {
                let row = self.row(k, l);
                rows_from[k] = turned_from(row, (c, s), seen);
                rows_to[k] = turned_to(row, turn);
            }
            for k in 0..3 {
                let weighted_from = [rows_from[0][k], rows_from[1][k], rows_from[2][k]];
                let weighted_to = [rows_to[0][k], rows_to[1][k], rows_to[2][k]];
                let from_from = turned_from(weighted_from, (c, s), seen);
                let from_to = turned_from(weighted_to, (c, s), seen);
                let to_to = turned_to(weighted_to, turn);
                for r in 0..3 {
                    blocks.from_from[3 * k + r][l] = from_from[r];
                    blocks.from_to[3 * k + r][l] = from_to[r];
                    blocks.to_to[3 * k + r][l] = to_to[r];
                }
            }
        }
        blocks
    }

    #[inline(always)]
    fn row(&self, row: usize, l: usize) -> [f64; 3] {
        const PLACES: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        let [a, b, c] = PLACES[row];
        let upper = &self.information;
        [upper[a][l], upper[b][l], upper[c][l]]
    }

    #[inline(always)]
    fn weigh(&self, error: [f64; 3], l: usize) -> [f64; 3] {
        let mut weighed = [0.0; 3];
        for (k, weighed) in weighed.iter_mut().enumerate() {
            let row = self.row(k, l);
            *weighed = row[0] * error[0] + row[1] * error[1] + row[2] * error[2];
        }
        weighed
    }
}

impl Ends {
    #[inline(always)]
    fn new() -> Self {
        let zero = [0.0; LANES];
        Self {
            x: zero,
            y: zero,
            theta: zero,
            cos: zero,
            sin: zero,
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, frame: &Frame) {
        self.x[lane] = frame.pose.x;
        self.y[lane] = frame.pose.y;
        self.theta[lane] = frame.pose.theta;
        self.cos[lane] = frame.cos;
        self.sin[lane] = frame.sin;
    }

    /// As [`Frame::see`].
    #[inline(always)]
    fn see(&self, other: &Self, l: usize) -> (f64, f64) {
        let (dx, dy) = (other.x[l] - self.x[l], other.y[l] - self.y[l]);
        let (c, s) = (self.cos[l], self.sin[l]);
        (c * dx + s * dy, c * dy - s * dx)
    }

    /// Cosine and sine of the turn to another pose, less the measured one.
    #[inline(always)]
    fn turn(&self, other: &Self, measured: &Self, l: usize) -> (f64, f64) {
        let cos = self.cos[l] * other.cos[l] + self.sin[l] * other.sin[l];
        let sin = self.cos[l] * other.sin[l] - self.sin[l] * other.cos[l];
        let (c, s) = (measured.cos[l], measured.sin[l]);
        (cos * c + sin * s, sin * c - cos * s)
    }
}

impl Blocks {
    #[inline(always)]
    fn new() -> Self {
        let zero = [[0.0; LANES]; 9];
        Self {
            from_from: zero,
            from_to: zero,
            to_to: zero,
        }
    }

    /// Those of one factor.
    #[inline(always)]
    pub(super) fn of(&self, lane: usize) -> BlocksOfOne {
        BlocksOfOne {
            from_from: block_of(&self.from_from, lane),
            from_to: block_of(&self.from_to, lane),
            to_to: block_of(&self.to_to, lane),
        }
    }
}

#[inline(always)]
fn block_of(lanes: &[Lanes; 9], lane: usize) -> [[f64; 3]; 3] {
    let mut block = [[0.0; 3]; 3];
    for c in 0..3 {
        for r in 0..3 {
            block[c][r] = lanes[3 * c + r][lane];
        }
    }
    block
}

/// The first pose's derivatives, transposed, times a vector. See [`Frame::local_error`].
#[inline(always)]
fn turned_from(v: [f64; 3], (c, s): (f64, f64), (x, y): (f64, f64)) -> [f64; 3] {
    [
        s * v[1] - c * v[0],
        -(s * v[0] + c * v[1]),
        (c * y - s * x) * v[0] - (s * y + c * x) * v[1] - v[2],
    ]
}

/// The second pose's derivatives, transposed, times a vector.
#[inline(always)]
fn turned_to(v: [f64; 3], (cos, sin): (f64, f64)) -> [f64; 3] {
    [cos * v[0] + sin * v[1], cos * v[1] - sin * v[0], v[2]]
}
