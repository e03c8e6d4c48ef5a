//! Which variables are eliminated together, and the fill-in of their columns.

use super::block_matrix::BlockMatrix;

/// No variable, part or list entry.
const NONE: u32 = u32::MAX;

/// Columns of L that are eliminated together: a dense trapezium.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// The part's own variables, then those below, each in the order of elimination.
    pub(super) rows: Vec<u32>,
    /// How many of them are its own.
    pub(super) width: usize,
    /// Earlier parts whose rows below end here first.
    pub(super) children: Vec<u32>,
    /// The given fronts (by their places in the list) whose rows below end here first.
    pub(super) given: Vec<u32>,
}

/// Eliminates variables in an order. `given` are the rows below fronts that were eliminated
/// before and stay; all of them are in the order. `place_in_order` is memory: by variable, and
/// afterwards the place of each variable of the order.
///
/// The parts come children first.
pub(super) fn eliminate<const B: usize>(
    matrix: &BlockMatrix<B>,
    order: &[u32],
    given: &[&[u32]],
    place_in_order: &mut Vec<u32>,
) -> Vec<Part> {
    place_in_order.clear();
    place_in_order.resize(matrix.variables(), NONE);
    for (k, &variable) in order.iter().enumerate() {
        place_in_order[variable as usize] = k as u32;
    }
    let mut columns = Columns::new(order.len(), given.len());
    for (k, rows) in given.iter().enumerate() {
        if let Some(first) = rows.iter().map(|&v| place_in_order[v as usize]).min() {
            columns.given_at.push(first, k as u32);
        }
    }
    for (k, &variable) in order.iter().enumerate() {
        let coupled = matrix.coupled(variable);
        let later = coupled
            .map(|(other, ..)| place_in_order[other as usize])
            .filter(|&place| place != NONE && place > k as u32);
        columns.eliminate(k as u32, later, |g| {
            given[g as usize]
                .iter()
                .map(|&v| place_in_order[v as usize])
        });
    }
    columns.into_parts(order)
}

/// How many multiplications factoring a matrix takes whose variables are eliminated in the order of
/// their numbers.
pub fn operations_to_factor<const B: usize>(matrix: &BlockMatrix<B>) -> f64 {
    let order: Vec<u32> = (0..matrix.variables() as u32).collect();
    let parts = eliminate(matrix, &order, &[], &mut Vec::new());
    let of_part = |part: &Part| operations_to_eliminate::<B>(part.rows.len(), part.width);
    parts.iter().map(of_part).sum()
}

/// How many multiplications it takes to eliminate the first `width` of a dense front's `rows` variables.
pub(super) fn operations_to_eliminate<const B: usize>(rows: usize, width: usize) -> f64 {
    // Σ k² from 1 to n, half of it by symmetry.
    let of_triangle = |n: f64| n * (n + 1.0) * (2.0 * n + 1.0) / 12.0;
    of_triangle((rows * B) as f64) - of_triangle(((rows - width) * B) as f64)
}

/// Lists of numbers, each number in at most one list.
struct Lists {
    first: Vec<u32>,
    last: Vec<u32>,
    next: Vec<u32>,
}

impl Lists {
    fn new(lists: usize, numbers: usize) -> Self {
        Self {
            first: vec![NONE; lists],
            last: vec![NONE; lists],
            next: vec![NONE; numbers],
        }
    }

    fn add_list(&mut self) {
        self.first.push(NONE);
        self.last.push(NONE);
    }

    fn push(&mut self, list: u32, number: u32) {
        let list = list as usize;
        if self.last[list] == NONE {
            self.first[list] = number;
        } else {
            self.next[self.last[list] as usize] = number;
        }
        self.last[list] = number;
    }

    fn take(&mut self, list: u32) -> (u32, u32) {
        let ends = (self.first[list as usize], self.last[list as usize]);
        (self.first[list as usize], self.last[list as usize]) = (NONE, NONE);
        ends
    }

    fn append(&mut self, list: u32, (first, last): (u32, u32)) {
        if first == NONE {
            return;
        }
        let list = list as usize;
        if self.last[list] == NONE {
            self.first[list] = first;
        } else {
            self.next[self.last[list] as usize] = first;
        }
        self.last[list] = last;
    }

    fn iter(&self, list: u32) -> impl Iterator<Item = u32> + '_ {
        let mut at = self.first[list as usize];
        std::iter::from_fn(move || {
            let number = (at != NONE).then_some(at)?;
            at = self.next[at as usize];
            Some(number)
        })
    }
}

/// The parts as they come about. Variables are named by their places in the order.
struct Columns {
    /// By part: its own variables.
    own: Lists,
    children: Lists,
    given: Lists,
    /// By variable: the parts, and the given fronts, whose rows below begin there.
    parts_at: Lists,
    given_at: Lists,
    /// By part: where its rows below are, in no order.
    below: Vec<(usize, usize)>,
    width: Vec<u32>,
    rows: Vec<u32>,
    /// By variable: the last variable whose column was seen to fill it.
    seen: Vec<u32>,
}

impl Columns {
    fn new(variables: usize, given: usize) -> Self {
        Self {
            own: Lists::new(0, variables),
            children: Lists::new(0, variables),
            given: Lists::new(0, given),
            parts_at: Lists::new(variables, variables),
            given_at: Lists::new(variables, given),
            below: Vec::new(),
            width: Vec::new(),
            rows: Vec::new(),
            seen: vec![NONE; variables],
        }
    }

    /// The next variable: its column is filled by its couplings, and by what is below the parts
    /// and fronts that end at it. It joins the part of which it has all rows.
    fn eliminate<I: Iterator<Item = u32>>(
        &mut self,
        k: u32,
        coupled: impl Iterator<Item = u32>,
        rows_of_given: impl Fn(u32) -> I,
    ) {
        let start = self.rows.len();
        self.seen[k as usize] = k;
        let (seen, rows) = (&mut self.seen, &mut self.rows);
        let mut fill = |rows: &mut Vec<u32>, row: u32| {
            if std::mem::replace(&mut seen[row as usize], k) != k {
                rows.push(row);
            }
        };
        for row in coupled {
            fill(rows, row);
        }
        for given in self.given_at.iter(k) {
            for row in rows_of_given(given) {
                fill(rows, row);
            }
        }
        let mut tallest = None;
        for part in self.parts_at.iter(k) {
            let (from, to) = self.below[part as usize];
            for at in from..to {
                let row = rows[at];
                fill(rows, row);
            }
            if tallest.is_none_or(|(height, _)| to - from > height) {
                tallest = Some((to - from, part));
            }
        }
        let count = rows.len() - start;
        let part = match tallest {
            Some((height, part)) if height == count + 1 => {
                let (from, to) = self.below[part as usize];
                self.rows.truncate(start);
                self.below[part as usize] = (from, to - 1);
                if let Some(at) = self.rows[from..to].iter().position(|&row| row == k) {
                    self.rows.swap(from + at, to - 1);
                }
                part
            }
            _ => self.add_part(start),
        };
        self.width[part as usize] += 1;
        self.own.push(part, k);
        let mut child = self.parts_at.take(k).0;
        while child != NONE {
            let next = std::mem::replace(&mut self.parts_at.next[child as usize], NONE);
            if child != part {
                self.children.push(part, child);
            }
            child = next;
        }
        let given = self.given_at.take(k);
        let mut front = given.0;
        while front != NONE {
            let next = std::mem::replace(&mut self.given_at.next[front as usize], NONE);
            self.given.push(part, front);
            front = next;
        }
        let (from, to) = self.below[part as usize];
        if let Some(&first) = self.rows[from..to].iter().min() {
            self.parts_at.push(first, part);
        }
    }

    fn add_part(&mut self, start: usize) -> u32 {
        self.own.add_list();
        self.children.add_list();
        self.given.add_list();
        self.below.push((start, self.rows.len()));
        self.width.push(0);
        (self.width.len() - 1) as u32
    }

    /// Puts parts together where the dense work on zeros costs less than keeping them apart.
    fn into_parts(mut self, order: &[u32]) -> Vec<Part> {
        let bottom_up = self.bottom_up();
        let mut is_merged = vec![false; self.width.len()];
        let mut place = vec![NONE; self.width.len()];
        let mut parts = Vec::with_capacity(self.width.len());
        for &part in &bottom_up {
            self.merge_children(part, &mut is_merged);
        }
        for &part in bottom_up.iter().filter(|&&p| !is_merged[p as usize]) {
            place[part as usize] = parts.len() as u32;
            let (from, to) = self.below[part as usize];
            self.rows[from..to].sort_unstable();
            let own = self.own.iter(part);
            let rows = own.chain(self.rows[from..to].iter().copied());
            parts.push(Part {
                rows: rows.map(|k| order[k as usize]).collect(),
                width: self.width[part as usize] as usize,
                children: self
                    .children
                    .iter(part)
                    .map(|c| place[c as usize])
                    .collect(),
                given: self.given.iter(part).collect(),
            });
        }
        parts
    }

    fn bottom_up(&self) -> Vec<u32> {
        let parts = self.width.len() as u32;
        let mut has_parent = vec![false; parts as usize];
        for part in 0..parts {
            for child in self.children.iter(part) {
                has_parent[child as usize] = true;
            }
        }
        // Roots first, then turned around: children come before their parents.
        let mut order = Vec::with_capacity(parts as usize);
        let mut open: Vec<u32> = (0..parts).filter(|&p| !has_parent[p as usize]).collect();
        while let Some(part) = open.pop() {
            order.push(part);
            open.extend(self.children.iter(part));
        }
        order.reverse();
        order
    }

    fn merge_children(&mut self, part: u32, is_merged: &mut [bool]) {
        let mut child = self.children.take(part).0;
        let p = part as usize;
        let below = (self.below[p].1 - self.below[p].0) as u32;
        while child != NONE {
            let next = std::mem::replace(&mut self.children.next[child as usize], NONE);
            let c = child as usize;
            let below_child = (self.below[c].1 - self.below[c].0) as u32;
            let width = self.width[c] + self.width[p];
            let apart = work(self.width[c], below_child) + work(self.width[p], below);
            if work(width, below) < apart {
                is_merged[c] = true;
                self.width[p] = width;
                // The child's variables come first.
                let (first, then) = (self.own.take(child), self.own.take(part));
                self.own.append(part, first);
                self.own.append(part, then);
                let grandchildren = self.children.take(child);
                self.children.append(part, grandchildren);
                let given = self.given.take(child);
                self.given.append(part, given);
            } else {
                self.children.push(part, child);
            }
            child = next;
        }
    }
}

/// About how many nanoseconds a part costs: for itself, for the blocks of its update that go into
/// another part, and for its columns, whose rows are worked on eight at a time.
fn work(width: u32, below: u32) -> f64 {
    let vectors = f64::from((3 * (width + below)).div_ceil(8));
    let (width, below) = (f64::from(width), f64::from(below));
    let updates = 0.5 * below * (below + 1.0);
    let products = 3.0 * width * vectors * (3.0 * below + 1.5 * width);
    80.0 + 8.0 * updates + 3.0 * width * vectors + 0.3 * products
}
