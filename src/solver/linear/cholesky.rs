//! Sparse Cholesky factorisation by dense fronts, which may be done again in part.
//!
//! Multifrontal (Duff and Reid 1983): a front is a dense matrix in which some variables are
//! eliminated; what that leaves for the others is its update, which its parent adds in. When
//! variables or couplings are added, only the fronts between the touched variables and the root
//! change; all others stay, as in the Bayes tree of iSAM2 (Kaess et al. 2012).

use pulp::Arch;

use super::aligned::Aligned;
use super::arena::Arena;
use super::block_matrix::BlockMatrix;
use super::elimination::{Part, eliminate, operations_to_eliminate};
use super::front::{Front, NONE};
use super::multifrontal::{Factorise, Scratch, SolveLower, SolveUpper};
use super::ordering::DenseGraph;

#[cfg(test)]
mod tests;

/// A top with more variables than this is most of the graph, and ordered like one.
const TOP_VARIABLES_MAX: usize = 4096;

/// The factor L of A = LLᵀ, and what is needed to change it.
pub struct BlockCholesky<const B: usize> {
    pub(super) fronts: Vec<Front>,
    /// Places among the fronts that are not in use.
    free: Vec<u32>,
    /// The fronts that are in use, children first.
    pub(super) bottom_up: Vec<u32>,
    /// The front in which a variable is eliminated.
    front_of: Vec<u32>,
    column_arena: Arena,
    update_arena: Arena,
    pub(super) columns: Aligned,
    updates: Aligned,
    keeps_updates: bool,
    /// Memory: by variable, its place among the rows of the front that is worked on.
    place: Vec<u32>,
    scratch: Scratch,
    operations: f64,
}

impl<const B: usize> BlockCholesky<B> {
    /// Analyses a matrix whose variables are to be eliminated in the order of their numbers. If
    /// it is to be extended later, the fronts' updates are kept, which takes about as much memory
    /// again.
    pub fn analyse(matrix: &BlockMatrix<B>, keeps_updates: bool) -> Self {
        let order: Vec<u32> = (0..matrix.variables() as u32).collect();
        let mut cholesky = Self::empty(keeps_updates);
        cholesky.front_of = vec![NONE; order.len()];
        let parts = eliminate(matrix, &order, &[], &mut cholesky.place);
        cholesky.add_fronts(matrix, parts, &[]);
        cholesky
    }

    /// The factor of a matrix without variables.
    pub(crate) fn empty(keeps_updates: bool) -> Self {
        Self {
            fronts: Vec::new(),
            free: Vec::new(),
            bottom_up: Vec::new(),
            front_of: Vec::new(),
            column_arena: Arena::default(),
            update_arena: Arena::default(),
            columns: Aligned::default(),
            updates: Aligned::default(),
            keeps_updates,
            place: Vec::new(),
            scratch: Scratch::default(),
            operations: 0.0,
        }
    }

    /// How many multiplications factoring and solving have taken since this was asked last: by
    /// the structure, so that they are the same on every machine.
    pub(crate) fn take_operations(&mut self) -> f64 {
        std::mem::take(&mut self.operations)
    }

    /// Takes in variables and pairs that have been added to the matrix; `touched` are the
    /// variables whose diagonal or pairs are others now, new ones included. Returns the fronts
    /// that want factoring; `None` if the matrix should rather be analysed again.
    pub(crate) fn extend(&mut self, matrix: &BlockMatrix<B>, touched: &[u32]) -> Option<Vec<u32>> {
        if !self.keeps_updates {
            return None;
        }
        let known = self.front_of.len() as u32;
        self.front_of.resize(matrix.variables(), NONE);
        for &variable in touched.iter().filter(|&&v| v < known) {
            let mut front = self.front_of[variable as usize];
            while front != NONE && self.fronts[front as usize].is_in_use {
                self.fronts[front as usize].is_in_use = false;
                front = self.fronts[front as usize].parent;
            }
        }
        let (mut top, mut given) = (Vec::new(), Vec::new());
        for &f in &self.bottom_up {
            let front = &self.fronts[f as usize];
            if front.is_in_use {
                continue;
            }
            top.extend_from_slice(&front.rows[..front.width]);
            let children = front.children.iter().copied();
            given.extend(children.filter(|&c| self.fronts[c as usize].is_in_use));
            self.column_arena.give_back(front.columns::<B>());
            self.update_arena.give_back(front.update::<B>());
            self.free.push(f);
        }
        top.extend(known..matrix.variables() as u32);
        if top.len() > TOP_VARIABLES_MAX {
            return None;
        }
        let fronts = &self.fronts;
        self.bottom_up.retain(|&f| fronts[f as usize].is_in_use);
        let below: Vec<&[u32]> = given.iter().map(|&f| fronts[f as usize].below()).collect();
        let order = order_of_top(matrix, &top, &below, &mut self.place);
        let parts = eliminate(matrix, &order, &below, &mut self.place);
        Some(self.add_fronts(matrix, parts, &given))
    }

    /// Makes fronts of parts whose given fronts are these.
    fn add_fronts(&mut self, matrix: &BlockMatrix<B>, parts: Vec<Part>, given: &[u32]) -> Vec<u32> {
        let mut new: Vec<u32> = Vec::with_capacity(parts.len());
        if self.fronts.is_empty() {
            self.fronts.reserve_exact(parts.len());
        }
        for part in parts {
            let kept: Vec<u32> = part.given.iter().map(|&g| given[g as usize]).collect();
            let mut front = Front::new::<B>(part);
            for child in &mut front.children {
                *child = new[*child as usize];
            }
            front.children.extend(kept);
            let place = &mut self.place;
            for (k, &variable) in front.rows.iter().enumerate() {
                place[variable as usize] = k as u32;
            }
            front.find_couplings(matrix, place);
            for &child in &front.children {
                self.fronts[child as usize].find_in_parent::<B>(front.width, place);
            }
            front.columns_at = self.column_arena.take(front.columns::<B>().len());
            front.update_at = self.update_arena.take(front.update::<B>().len());
            if !self.keeps_updates {
                for &child in &front.children {
                    let used = self.fronts[child as usize].update::<B>();
                    self.update_arena.give_back(used);
                }
            }
            new.push(self.add_front(front));
        }
        self.bottom_up.extend_from_slice(&new);
        self.columns.grow(self.column_arena.end());
        self.updates.grow(self.update_arena.end());
        new
    }

    fn add_front(&mut self, front: Front) -> u32 {
        let name = self.free.pop().unwrap_or(self.fronts.len() as u32);
        for &child in &front.children {
            self.fronts[child as usize].parent = name;
        }
        for &variable in &front.rows[..front.width] {
            self.front_of[variable as usize] = name;
        }
        match self.fronts.get_mut(name as usize) {
            Some(unused) => *unused = front,
            None => self.fronts.push(front),
        }
        name
    }

    /// Factors the matrix, its diagonal damped by this part of itself; `false` if that is not
    /// positive definite, and the factor is of no use then. On the way, L y = x is solved for
    /// a right-hand side, if there is any.
    pub fn factorise(&mut self, matrix: &BlockMatrix<B>, damping: f64, x: &mut [f64]) -> bool {
        let fronts = std::mem::take(&mut self.bottom_up);
        let is_done = self.factorise_with(&fronts, matrix, damping, x);
        self.bottom_up = fronts;
        is_done
    }

    /// The same for these fronts only, children first; all others must be factored already.
    pub(crate) fn factorise_fronts(
        &mut self,
        fronts: &[u32],
        matrix: &BlockMatrix<B>,
        damping: f64,
    ) -> bool {
        self.factorise_with(fronts, matrix, damping, &mut [])
    }

    fn factorise_with(
        &mut self,
        fronts: &[u32],
        matrix: &BlockMatrix<B>,
        damping: f64,
        x: &mut [f64],
    ) -> bool {
        let least = matrix.least_diagonal();
        let of_front = |&f: &u32| {
            let front = &self.fronts[f as usize];
            operations_to_eliminate::<B>(front.rows.len(), front.width)
        };
        self.operations += fronts.iter().map(of_front).sum::<f64>();
        Arch::new().dispatch(Factorise {
            fronts: &self.fronts,
            columns: self.columns.as_mut_slice(),
            updates: self.updates.as_mut_slice(),
            path: fronts,
            matrix,
            damping: (damping, least),
            x,
        })
    }

    /// Solves A x = b in place: B numbers for each variable.
    pub fn solve(&mut self, x: &mut [f64]) {
        self.solve_lower(x);
        self.solve_upper(x);
    }

    /// Solves L y = b in place: the first half of [`Self::solve`].
    pub(crate) fn solve_lower(&mut self, x: &mut [f64]) {
        let fronts = std::mem::take(&mut self.bottom_up);
        self.solve_lower_along(&fronts, x);
        self.bottom_up = fronts;
    }

    /// The same for a b that is zero but where a path eliminates.
    pub(crate) fn solve_lower_along(&mut self, path: &[u32], x: &mut [f64]) {
        let columns = path.iter().map(|&f| self.fronts[f as usize].columns::<B>());
        self.operations += columns.map(|columns| columns.len() as f64).sum::<f64>();
        Arch::new().dispatch(SolveLower::<B> {
            fronts: &self.fronts,
            columns: self.columns.as_slice(),
            path,
            scratch: &mut self.scratch,
            x,
        });
    }

    /// The fronts between some variables and the root, children first.
    pub(crate) fn path_of(&self, variables: impl Iterator<Item = u32>) -> Vec<u32> {
        let mut is_on_path = vec![false; self.fronts.len()];
        for variable in variables {
            let mut front = self.front_of[variable as usize];
            while front != NONE && !std::mem::replace(&mut is_on_path[front as usize], true) {
                front = self.fronts[front as usize].parent;
            }
        }
        let bottom_up = self.bottom_up.iter().copied();
        bottom_up.filter(|&f| is_on_path[f as usize]).collect()
    }

    /// The matrix's pairs that are filled in at these fronts.
    pub(crate) fn pairs_of<'a>(&'a self, fronts: &'a [u32]) -> impl Iterator<Item = usize> + 'a {
        let fronts = fronts.iter().map(|&f| &self.fronts[f as usize]);
        fronts.flat_map(|front| front.couplings.iter().map(|c| c.pair as usize))
    }

    /// The variables that a path eliminates.
    pub(crate) fn variables_of<'a>(&'a self, path: &'a [u32]) -> impl Iterator<Item = u32> + 'a {
        let fronts = path.iter().map(|&f| &self.fronts[f as usize]);
        fronts.flat_map(|front| front.rows[..front.width].iter().copied())
    }

    /// Solves Lᵀ x = y in place: the second half of [`Self::solve`].
    pub fn solve_upper(&mut self, x: &mut [f64]) {
        self.operations += self.columns.as_slice().len() as f64;
        Arch::new().dispatch(SolveUpper::<B> {
            fronts: &self.fronts,
            columns: self.columns.as_slice(),
            bottom_up: &self.bottom_up,
            scratch: &mut self.scratch,
            x,
        });
    }
}

/// An order of the top's variables: minimum degree among what couples them, the newest last,
/// since what comes next is most often coupled with it.
fn order_of_top<const B: usize>(
    matrix: &BlockMatrix<B>,
    top: &[u32],
    below: &[&[u32]],
    place: &mut Vec<u32>,
) -> Vec<u32> {
    place.clear();
    place.resize(matrix.variables(), NONE);
    for (k, &variable) in top.iter().enumerate() {
        place[variable as usize] = k as u32;
    }
    let mut graph = DenseGraph::new(top.len());
    for (k, &variable) in top.iter().enumerate() {
        for (other, ..) in matrix.coupled(variable) {
            if place[other as usize] != NONE {
                graph.couple(k, place[other as usize] as usize);
            }
        }
    }
    let mut clique = Vec::new();
    for rows in below {
        clique.clear();
        clique.extend(rows.iter().map(|&v| place[v as usize] as usize));
        graph.couple_all(&clique);
    }
    let newest = (0..top.len()).max_by_key(|&k| top[k]).unwrap_or(0);
    let order = graph.minimum_degree(newest);
    order.into_iter().map(|k| top[k]).collect()
}
