//! Elimination orders that keep the Cholesky factor sparse.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// An order of `variables` variables by approximate minimum degree (Amestoy, Davis and Duff
/// 1996), for those coupled in these pairs; `None` if memory runs out.
pub(super) fn approximate_minimum_degree(
    variables: usize,
    pairs: &[(u32, u32)],
) -> Option<Vec<u32>> {
    // By columns of the upper triangle: the later variable is the column.
    let mut entries: Vec<(u32, u32)> = pairs.iter().map(|&(a, b)| (a.max(b), a.min(b))).collect();
    entries.sort_unstable();
    entries.dedup();
    let mut column_pointers = vec![0_u32; variables + 1];
    for &(column, _) in &entries {
        column_pointers[column as usize + 1] += 1;
    }
    for c in 0..variables {
        column_pointers[c + 1] += column_pointers[c];
    }
    let row_indices: Vec<u32> = entries.iter().map(|&(_, row)| row).collect();
    let upper = SymbolicSparseColMatRef::new_checked(
        variables,
        variables,
        &column_pointers,
        None,
        &row_indices,
    );
    let scratch = amd::order_scratch::<u32>(variables, entries.len());
    let mut memory = MemBuffer::try_new(scratch).ok()?;
    let (mut order, mut position) = (vec![0; variables], vec![0; variables]);
    amd::order(
        &mut order,
        &mut position,
        upper,
        amd::Control::default(),
        MemStack::new(&mut memory),
    )
    .ok()?;
    Some(order)
}

/// A small graph that is eliminated variable by variable, as rows of bits.
pub(super) struct DenseGraph {
    words: usize,
    rows: Vec<u64>,
}

impl DenseGraph {
    /// A graph without edges.
    pub(super) fn new(variables: usize) -> Self {
        let words = variables.div_ceil(64);
        Self {
            words,
            rows: vec![0; words * variables],
        }
    }

    fn row(&self, variable: usize) -> &[u64] {
        &self.rows[variable * self.words..(variable + 1) * self.words]
    }

    fn insert(&mut self, row: usize, column: usize) {
        self.rows[row * self.words + column / 64] |= 1 << (column % 64);
    }

    fn remove(&mut self, row: usize, column: usize) {
        self.rows[row * self.words + column / 64] &= !(1 << (column % 64));
    }

    /// Couples two variables.
    pub(super) fn couple(&mut self, a: usize, b: usize) {
        self.insert(a, b);
        self.insert(b, a);
    }

    /// Couples every one of these variables with every other.
    pub(super) fn couple_all(&mut self, variables: &[usize]) {
        let mut together = vec![0_u64; self.words];
        for &v in variables {
            together[v / 64] |= 1 << (v % 64);
        }
        for &v in variables {
            let row = &mut self.rows[v * self.words..(v + 1) * self.words];
            for (word, new) in row.iter_mut().zip(&together) {
                *word |= new;
            }
        }
    }

    /// An order by exact minimum degree, the first of equals first. The variable `last` comes
    /// last, and so does whatever is left when everything is coupled.
    pub(super) fn minimum_degree(mut self, last: usize) -> Vec<usize> {
        let variables = self.rows.len() / self.words.max(1);
        for v in 0..variables {
            self.remove(v, v);
        }
        let degree = |row: &[u64]| row.iter().map(|word| word.count_ones()).sum::<u32>();
        let mut degrees: Vec<u32> = (0..variables).map(|v| degree(self.row(v))).collect();
        let mut waiting: Vec<usize> = (0..variables).filter(|&v| v != last).collect();
        let mut order = Vec::with_capacity(variables);
        while let Some(at) = (0..waiting.len()).min_by_key(|&at| degrees[waiting[at]]) {
            if degrees[waiting[at]] as usize == waiting.len() {
                break;
            }
            let v = waiting.remove(at);
            order.push(v);
            let coupled = self.row(v).to_vec();
            for u in ones(&coupled) {
                let row = &mut self.rows[u * self.words..(u + 1) * self.words];
                for (word, new) in row.iter_mut().zip(&coupled) {
                    *word |= new;
                }
                self.remove(u, u);
                self.remove(u, v);
                degrees[u] = degree(self.row(u));
            }
        }
        order.extend(waiting);
        if last < variables {
            order.push(last);
        }
        order
    }
}

fn ones(words: &[u64]) -> impl Iterator<Item = usize> + '_ {
    words.iter().enumerate().flat_map(|(k, &word)| {
        let mut rest = word;
        std::iter::from_fn(move || {
            let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
            rest &= rest - 1;
            Some(k * 64 + bit)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_permutation(order: impl IntoIterator<Item = usize>, length: usize) -> bool {
        let mut sorted: Vec<usize> = order.into_iter().collect();
        sorted.sort_unstable();
        sorted.into_iter().eq(0..length)
    }

    #[test]
    fn every_variable_is_eliminated_once() {
        let ring: Vec<(u32, u32)> = (0..90).map(|k| (k, (k + 1) % 90)).collect();
        let order = approximate_minimum_degree(90, &ring).unwrap();
        assert!(is_permutation(order.iter().map(|&v| v as usize), 90));
        assert!(approximate_minimum_degree(0, &[]).unwrap().is_empty());
    }

    /// A star with its hub in the middle of the numbers: the leaves go first, unless one is to
    /// go last.
    #[test]
    fn leaves_go_before_hubs() {
        let mut star = DenseGraph::new(100);
        for leaf in (0..100).filter(|&k| k != 40) {
            star.couple(leaf, 40);
        }
        let order = star.minimum_degree(7);
        assert!(is_permutation(order.iter().copied(), 100));
        assert_eq!(order[98..], [40, 7]);
        let mut cliques = DenseGraph::new(130);
        cliques.couple_all(&(0..65).collect::<Vec<_>>());
        cliques.couple_all(&(64..130).collect::<Vec<_>>());
        let order = cliques.minimum_degree(129);
        assert!(is_permutation(order.iter().copied(), 130));
        // The one that joins the cliques goes when the smaller one is gone.
        assert!(order.iter().position(|&v| v == 64) >= Some(64));
    }
}
