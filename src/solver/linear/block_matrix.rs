//! A symmetric sparse matrix of B × B blocks.

use nalgebra::SMatrix;

/// No pair.
const NONE: u32 = u32::MAX;

/// A symmetric matrix of B × B blocks that may grow: a diagonal block for each variable, and a
/// block for each coupled pair of variables. A pair may come more than once: its blocks add up.
#[derive(Debug, Default)]
pub struct BlockMatrix<const B: usize> {
    /// By variable.
    pub diagonal: Vec<SMatrix<f64, B, B>>,
    /// By pair (a, b): a's rows, b's columns.
    pub blocks: Vec<SMatrix<f64, B, B>>,
    pairs: Vec<Pair>,
    /// For each variable its newest pair.
    newest: Vec<u32>,
}

#[derive(Debug, Clone, Copy)]
struct Pair {
    ends: [u32; 2],
    /// For each end the pair before this one among its pairs.
    before: [u32; 2],
}

impl<const B: usize> BlockMatrix<B> {
    /// The number of variables.
    pub fn variables(&self) -> usize {
        self.diagonal.len()
    }

    /// Makes room for no more than this many variables and pairs.
    pub fn reserve(&mut self, variables: usize, pairs: usize) {
        self.diagonal.reserve_exact(variables);
        self.newest.reserve_exact(variables);
        self.blocks.reserve_exact(pairs);
        self.pairs.reserve_exact(pairs);
    }

    /// Adds a variable, coupled with none, and names it.
    pub fn add_variable(&mut self) -> u32 {
        self.diagonal.push(SMatrix::zeros());
        self.newest.push(NONE);
        (self.newest.len() - 1) as u32
    }

    /// Adds a pair of different variables, and names it.
    pub fn add_pair(&mut self, a: u32, b: u32) -> u32 {
        let name = self.pairs.len() as u32;
        let before = [a, b].map(|end| std::mem::replace(&mut self.newest[end as usize], name));
        self.blocks.push(SMatrix::zeros());
        self.pairs.push(Pair {
            ends: [a, b],
            before,
        });
        name
    }

    /// Sets the diagonal to zero, to be added up again. Pairs keep their blocks until they are
    /// set.
    pub fn clear_diagonal(&mut self) {
        self.diagonal.fill(SMatrix::zeros());
    }

    /// The variables that a variable is coupled with, each with the pair, and whether its own
    /// coordinates are the columns of the pair's block.
    #[inline(always)]
    pub fn coupled(&self, variable: u32) -> impl Iterator<Item = (u32, usize, bool)> + '_ {
        let mut next = self.newest[variable as usize];
        std::iter::from_fn(move || {
            let name = next as usize;
            let pair = self.pairs.get(name)?;
            let second = pair.ends[1] == variable;
            next = pair.before[usize::from(second)];
            Some((pair.ends[usize::from(!second)], name, second))
        })
    }

    /// What a diagonal entry counts for at least when the diagonal is damped: a coordinate that
    /// nothing measures has a zero there and must still get a pivot.
    pub fn least_diagonal(&self) -> f64 {
        let entries = self.diagonal.iter().map(|block| {
            let entries = (0..B).map(|k| block[(k, k)].abs());
            entries.sum::<f64>()
        });
        let mean = entries.sum::<f64>() / (self.variables() * B).max(1) as f64;
        (1e-6 * mean).max(f64::MIN_POSITIVE)
    }
}
