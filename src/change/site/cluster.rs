//! Groups of cells with the same change at the same time.

use super::answers::Answers;
use super::cells::SiteCells;
use super::timeline::Timeline;
use crate::change::history::{NATS_PER_OBSERVATION, NATS_PER_PASS, State};
use crate::change::pass::Standpoint;
use crate::ids::StampNs;

/// Fewest hits and misses of a cell with a history.
const HITS_MIN: usize = 2;
const MISSES_MIN: f64 = 2.0;
/// Cells this near to each other belong together, metres.
const LINK_M: f64 = 0.25;
/// A change is at least two neighbouring cells.
const CELLS_MIN: usize = 2;

/// Cells with the same change.
pub struct Cluster {
    /// Their first state.
    pub baseline: State,
    /// Ascending.
    pub cells: Vec<usize>,
}

/// The change of one cell.
struct CellChange {
    cell: usize,
    baseline: State,
    first: StampNs,
    last: StampNs,
}

/// The clusters of a site, by their first cells.
pub fn clusters(cells: &SiteCells, answers: &Answers) -> Vec<Cluster> {
    let changes: Vec<CellChange> = (0..cells.len())
        .filter_map(|cell| change_of(answers, cell))
        .collect();
    let mut group_of: Vec<usize> = (0..changes.len()).collect();
    for (k, change) in changes.iter().enumerate() {
        for (j, other) in changes[..k].iter().enumerate() {
            let alike = change.baseline == other.baseline
                && change.first.max(other.first) <= change.last.min(other.last);
            let offset = cells[change.cell].centre - cells[other.cell].centre;
            if alike && offset.norm_squared() <= LINK_M * LINK_M {
                let (a, b) = (root(&group_of, k), root(&group_of, j));
                group_of[a.max(b)] = a.min(b);
            }
        }
    }
    let mut clusters: Vec<(usize, Cluster)> = Vec::new();
    for (k, change) in changes.iter().enumerate() {
        let group = root(&group_of, k);
        match clusters.iter_mut().find(|(root, _)| *root == group) {
            Some((_, cluster)) => cluster.cells.push(change.cell),
            None => clusters.push((
                group,
                Cluster {
                    baseline: change.baseline,
                    cells: vec![change.cell],
                },
            )),
        }
    }
    let clusters = clusters.into_iter().map(|(_, cluster)| cluster);
    clusters
        .filter(|cluster| cluster.cells.len() >= CELLS_MIN)
        .collect()
}

fn root(group_of: &[usize], mut k: usize) -> usize {
    while group_of[k] != k {
        k = group_of[k];
    }
    k
}

fn change_of(answers: &Answers, cell: usize) -> Option<CellChange> {
    let about = answers.about(cell);
    let (hits, misses) = about.iter().fold((0.0, 0.0), |(hits, misses), answer| {
        let (hit, miss) = answers.counts(answer);
        (hits + hit, misses + miss)
    });
    if hits < HITS_MIN as f64 || misses < MISSES_MIN {
        return None;
    }
    let standpoints = about
        .iter()
        .map(|a| answers.standpoints[a.observation as usize]);
    let standpoints: Vec<Standpoint> = standpoints.collect();
    let nats = about.iter().map(|answer| {
        let (hit, miss) = answers.counts(answer);
        NATS_PER_OBSERVATION * (hit - miss)
    });
    let nats: Vec<f64> = nats.collect();
    let Timeline { passes, history } = Timeline::of(&standpoints, &nats, NATS_PER_PASS);
    let change = history.last_change()?;
    let stamp = |k: usize| standpoints[k].stamp;
    Some(CellChange {
        cell,
        baseline: history.baseline()?,
        first: stamp(passes[change.start].start),
        last: stamp(passes[change.end - 1].end - 1),
    })
}
