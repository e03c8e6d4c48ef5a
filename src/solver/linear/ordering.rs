//! Elimination orders that keep the Cholesky factor sparse.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// No variable.
const NONE: u32 = u32::MAX;

/// An order of `variables` variables by approximate minimum degree (Amestoy, Davis and Duff
/// 1996), for those coupled in these pairs; `None` if memory runs out.
///
/// Those coupled with at most two others have the minimum degree, and go first: most of a drive's
/// poses do, and the rest is ordered in half the time.
pub fn approximate_minimum_degree(variables: usize, pairs: &[(u32, u32)]) -> Option<Vec<u32>> {
    let mut graph = Neighbours::of(variables, pairs);
    let mut order = graph.eliminate_chains();
    order.extend(graph.minimum_degree()?);
    Some(order)
}

/// By variable, those that it is coupled with, each once.
struct Neighbours {
    starts: Vec<u32>,
    /// [`NONE`] for a variable that is eliminated.
    degrees: Vec<u32>,
    others: Vec<u32>,
}

impl Neighbours {
    fn of(variables: usize, pairs: &[(u32, u32)]) -> Self {
        let mut starts = vec![0_u32; variables + 1];
        for &(a, b) in pairs {
            starts[a as usize + 1] += 1;
            starts[b as usize + 1] += 1;
        }
        for v in 0..variables {
            starts[v + 1] += starts[v];
        }
        let mut graph = Self {
            starts,
            degrees: vec![0; variables],
            others: vec![0; 2 * pairs.len()],
        };
        for &(a, b) in pairs {
            graph.push(a, b);
            graph.push(b, a);
        }
        graph.drop_repeated();
        graph
    }

    fn push(&mut self, v: u32, other: u32) {
        let degree = &mut self.degrees[v as usize];
        self.others[(self.starts[v as usize] + *degree) as usize] = other;
        *degree += 1;
    }

    fn drop_repeated(&mut self) {
        let mut seen_by = vec![NONE; self.degrees.len()];
        for v in 0..self.degrees.len() {
            let (start, mut degree) = (self.starts[v] as usize, 0);
            for at in start..start + self.degrees[v] as usize {
                let other = self.others[at];
                if std::mem::replace(&mut seen_by[other as usize], v as u32) != v as u32 {
                    self.others[start + degree] = other;
                    degree += 1;
                }
            }
            self.degrees[v] = degree as u32;
        }
    }

    fn of_variable(&self, v: u32) -> &[u32] {
        let start = self.starts[v as usize] as usize;
        &self.others[start..start + self.degrees[v as usize] as usize]
    }

    /// Eliminates variables with at most two neighbours as long as there are any. Goes along
    /// chains, so that their variables can be eliminated together.
    fn eliminate_chains(&mut self) -> Vec<u32> {
        let variables = self.degrees.len();
        let mut order = Vec::with_capacity(variables);
        let mut open: Vec<u32> = (0..variables as u32).rev().collect();
        while let Some(v) = open.pop() {
            if self.degrees[v as usize] > 2 {
                // Or eliminated already.
                continue;
            }
            let (mut ends, mut count) = ([NONE; 2], 0);
            for &end in self.of_variable(v) {
                ends[count] = end;
                count += 1;
            }
            self.degrees[v as usize] = NONE;
            order.push(v);
            for (end, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
                if end != NONE {
                    self.replace(end, v, other);
                    open.push(end);
                }
            }
        }
        order
    }

    /// Puts a neighbour in place of another, unless there is none or it is there already.
    fn replace(&mut self, v: u32, gone: u32, new: u32) {
        let start = self.starts[v as usize] as usize;
        let others = &mut self.others[start..start + self.degrees[v as usize] as usize];
        let Some(at) = others.iter().position(|&other| other == gone) else {
            return;
        };
        if new != NONE && !others.contains(&new) {
            others[at] = new;
        } else {
            others.swap(at, others.len() - 1);
            self.degrees[v as usize] -= 1;
        }
    }

    /// An order of what is left.
    fn minimum_degree(&self) -> Option<Vec<u32>> {
        let is_left = |&v: &u32| self.degrees[v as usize] != NONE;
        let left: Vec<u32> = (0..self.degrees.len() as u32).filter(is_left).collect();
        let mut number = vec![NONE; self.degrees.len()];
        for (k, &v) in left.iter().enumerate() {
            number[v as usize] = k as u32;
        }
        // By columns of the upper triangle: the later variable is the column.
        let (mut columns, mut rows) = (vec![0_u32], Vec::new());
        for (k, &v) in left.iter().enumerate() {
            let start = rows.len();
            let others = self.of_variable(v).iter();
            let others = others.map(|&other| number[other as usize]);
            rows.extend(others.filter(|&other| (other as usize) < k));
            rows[start..].sort_unstable();
            columns.push(rows.len() as u32);
        }
        let (size, pairs) = (left.len(), rows.len());
        let upper = SymbolicSparseColMatRef::new_checked(size, size, &columns, None, &rows);
        let mut memory = MemBuffer::try_new(amd::order_scratch::<u32>(size, pairs)).ok()?;
        let (mut order, mut position) = (vec![0; size], vec![0; size]);
        let (control, memory) = (amd::Control::default(), MemStack::new(&mut memory));
        amd::order(&mut order, &mut position, upper, control, memory).ok()?;
        Some(order.into_iter().map(|k| left[k as usize]).collect())
    }
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

    /// A tree with a ring is all chains; a clique is not.
    #[test]
    fn chains_go_before_the_rest() {
        let mut pairs: Vec<(u32, u32)> = (1..40).map(|k| ((k - 1) / 3, k)).collect();
        // A ring, and a pair that comes twice.
        pairs.extend([(37, 38), (12, 3)]);
        let order = Neighbours::of(40, &pairs).eliminate_chains();
        assert!(is_permutation(order.iter().map(|&v| v as usize), 40));
        for a in 40..45 {
            pairs.extend((a + 1..45).map(|b| (a, b)));
            pairs.push((a - 5, a));
        }
        let order = Neighbours::of(45, &pairs).eliminate_chains();
        assert!(
            order.len() > 20 && order.iter().all(|&v| v < 40),
            "{order:?}"
        );
        let whole = approximate_minimum_degree(45, &pairs).unwrap();
        assert_eq!(whole[..order.len()], order);
        assert!(is_permutation(whole.iter().map(|&v| v as usize), 45));
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
