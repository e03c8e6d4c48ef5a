//! SIMD batches of factors: errors, costs and derivatives of eight at a time.
//!
//! Loops over the lanes of a batch become vector instructions. They use no fused operations, so
//! that every processor gets the same numbers.

use super::between::Factor;
use super::local_error::Frame;
use super::simd::LANES;
use super::trigonometry::wrap;

/// One number of each factor of a batch.
type Lanes<const N: usize> = [f64; N];

/// Some factors, by columns. A batch that is not full is filled up with copies of one of its
/// factors with weight 0.
#[derive(Debug, Clone)]
pub(crate) struct Batch<const N: usize = LANES> {
    from: [u32; N],
    to: [u32; N],
    measurement: Ends<N>,
    /// The upper triangle row by row, weighted.
    information: [Lanes<N>; 6],
}

/// Frames of some poses, by columns.
#[derive(Debug, Clone)]
struct Ends<const N: usize> {
    x: Lanes<N>,
    y: Lanes<N>,
    theta: Lanes<N>,
    cos: Lanes<N>,
    sin: Lanes<N>,
}

/// What the derivatives of a batch's factors depend on: the place of the second pose seen from the
/// first, and cosine and sine of the turn between them, less the measured one.
#[derive(Debug, Clone)]
pub(crate) struct Motions<const N: usize = LANES> {
    x: Lanes<N>,
    y: Lanes<N>,
    cos: Lanes<N>,
    sin: Lanes<N>,
}

/// Parts of H of a batch's factors, by columns of the blocks.
pub(crate) struct Blocks<const N: usize> {
    from_from: [Lanes<N>; 9],
    from_to: [Lanes<N>; 9],
    to_to: [Lanes<N>; 9],
}

/// One factor's parts of H, each by columns.
pub(crate) struct BlocksOfOne {
    pub(crate) from_from: [[f64; 3]; 3],
    /// The first pose's rows, the second one's columns.
    pub(crate) from_to: [[f64; 3]; 3],
    pub(crate) to_to: [[f64; 3]; 3],
}

/// Replaces the batches with those of some factors.
pub(crate) fn fill_batches(factors: &[Factor], batches: &mut Vec<Batch>) {
    batches.clear();
    batches.extend(factors.chunks(LANES).map(Batch::of));
}

/// Appends factors to batches that hold `known` factors already.
pub(crate) fn append_to_batches(factors: &[Factor], known: usize, batches: &mut Vec<Batch>) {
    let free = (batches.len() * LANES)
        .saturating_sub(known)
        .min(factors.len());
    let (first, rest) = factors.split_at(free);
    if let Some(batch) = batches.last_mut() {
        for (k, factor) in first.iter().enumerate() {
            batch.set((known + k) % LANES, factor);
        }
    }
    batches.extend(rest.chunks(LANES).map(Batch::of));
}

/// F at the poses with these frames, and half its gradient: g = Σ JᵀΩe for steps in the poses'
/// own frames, three numbers for each pose, held ones too. Both are added up.
#[inline(always)]
pub(crate) fn cost_and_gradient(
    batches: &[Batch],
    frames: &[Frame],
    gradient: &mut [[f64; 3]],
) -> f64 {
    let mut costs = [0.0; LANES];
    for batch in batches {
        let (from, to) = batch.ends(frames);
        let mut gradients = [[0.0; LANES]; 6];
        batch.add_cost_and_gradient(&from, &to, &mut costs, &mut gradients);
        let [of_from, of_to] = [&gradients[..3], &gradients[3..]];
        for (lane, (&from, &to)) in batch.from.iter().zip(&batch.to).enumerate() {
            for (end, gradients) in [(from, of_from), (to, of_to)] {
                for (sum, part) in gradient[end as usize].iter_mut().zip(gradients) {
                    *sum += part[lane];
                }
            }
        }
    }
    costs.iter().sum()
}

impl<const N: usize> Batch<N> {
    /// A batch of at least one and at most N factors.
    fn of(factors: &[Factor]) -> Self {
        let mut batch = Self {
            from: [0; N],
            to: [0; N],
            measurement: Ends::new(),
            information: [[0.0; N]; 6],
        };
        for (lane, factor) in factors.iter().enumerate() {
            batch.set(lane, factor);
        }
        if let Some(last) = factors.last() {
            let nothing = Factor {
                weight: 0.0,
                ..*last
            };
            for lane in factors.len()..N {
                batch.set(lane, &nothing);
            }
        }
        batch
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

    /// One of its factors.
    #[inline(always)]
    pub(crate) fn lane(&self, lane: usize) -> Batch<1> {
        let measured = &self.measurement;
        Batch {
            from: [self.from[lane]],
            to: [self.to[lane]],
            measurement: Ends {
                x: [measured.x[lane]],
                y: [measured.y[lane]],
                theta: [measured.theta[lane]],
                cos: [measured.cos[lane]],
                sin: [measured.sin[lane]],
            },
            information: self.information.map(|lanes| [lanes[lane]]),
        }
    }

    #[inline(always)]
    fn ends(&self, frames: &[Frame]) -> (Ends<N>, Ends<N>) {
        let (mut from, mut to) = (Ends::new(), Ends::new());
        for lane in 0..N {
            from.set(lane, &frames[self.from[lane] as usize]);
            to.set(lane, &frames[self.to[lane] as usize]);
        }
        (from, to)
    }

    /// Adds the costs, and sets each factor's part in the gradient: JᵀΩe of the first pose, then of
    /// the second.
    #[inline(always)]
    fn add_cost_and_gradient(
        &self,
        from: &Ends<N>,
        to: &Ends<N>,
        costs: &mut Lanes<N>,
        gradients: &mut [Lanes<N>; 6],
    ) {
        let measured = &self.measurement;
        for l in 0..N {
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
                gradients[k][l] = first[k];
                gradients[3 + k][l] = second[k];
            }
        }
    }

    /// The motions between the ends of every factor.
    #[inline(always)]
    pub(crate) fn motions(&self, frames: &[Frame]) -> Motions<N> {
        let (from, to) = self.ends(frames);
        let mut motions = Motions::none();
        for l in 0..N {
            (motions.x[l], motions.y[l]) = from.see(&to, l);
            (motions.cos[l], motions.sin[l]) = from.turn(&to, &self.measurement, l);
        }
        motions
    }

    /// How far apart two motions of each factor are, squared: as an angle, where a shift counts
    /// for as much as the factor knows of it compared with angles.
    #[inline(always)]
    pub(crate) fn square_distances(&self, a: &Motions<N>, b: &Motions<N>) -> Lanes<N> {
        let mut distances = [0.0; N];
        let [xx, _, _, yy, _, angles] = &self.information;
        for l in 0..N {
            let (dx, dy) = (a.x[l] - b.x[l], a.y[l] - b.y[l]);
            let (dc, ds) = (a.cos[l] - b.cos[l], a.sin[l] - b.sin[l]);
            let shift = xx[l] * dx * dx + yy[l] * dy * dy;
            let turn = dc * dc + ds * ds;
            // A factor that weighs nothing is nowhere.
            distances[l] = if shift > 0.0 {
                turn + shift / angles[l]
            } else {
                turn
            };
        }
        distances
    }

    /// JᵀΩJ of every factor.
    #[inline(always)]
    pub(crate) fn blocks(&self, motions: &Motions<N>) -> Blocks<N> {
        let measured = &self.measurement;
        let mut blocks = Blocks::new();
        for l in 0..N {
            let (c, s) = (measured.cos[l], measured.sin[l]);
            let seen = (motions.x[l], motions.y[l]);
            let turn = (motions.cos[l], motions.sin[l]);
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

impl<const N: usize> Motions<N> {
    /// Of factors that are not there yet.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        let zero = [0.0; N];
        Self {
            x: zero,
            y: zero,
            cos: zero,
            sin: zero,
        }
    }

    /// That of one factor.
    #[inline(always)]
    pub(crate) fn lane(&self, lane: usize) -> Motions<1> {
        Motions {
            x: [self.x[lane]],
            y: [self.y[lane]],
            cos: [self.cos[lane]],
            sin: [self.sin[lane]],
        }
    }

    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, motion: &Motions<1>) {
        [self.x[lane]] = motion.x;
        [self.y[lane]] = motion.y;
        [self.cos[lane]] = motion.cos;
        [self.sin[lane]] = motion.sin;
    }
}

impl<const N: usize> Ends<N> {
    #[inline(always)]
    fn new() -> Self {
        let zero = [0.0; N];
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

impl<const N: usize> Blocks<N> {
    #[inline(always)]
    fn new() -> Self {
        let zero = [[0.0; N]; 9];
        Self {
            from_from: zero,
            from_to: zero,
            to_to: zero,
        }
    }

    /// Those of one factor.
    #[inline(always)]
    pub(crate) fn of(&self, lane: usize) -> BlocksOfOne {
        BlocksOfOne {
            from_from: block_of(&self.from_from, lane),
            from_to: block_of(&self.from_to, lane),
            to_to: block_of(&self.to_to, lane),
        }
    }
}

#[inline(always)]
fn block_of<const N: usize>(lanes: &[Lanes<N>; 9], lane: usize) -> [[f64; 3]; 3] {
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
