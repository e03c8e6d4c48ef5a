//! Solving a simulated drive over a grid of streets, and recorded graphs where `MAPSHIFT_DATA` is
//! set.
//!
//! A warm iteration is the difference between three and two iterations from the odometry.
//! `factorisation` compares one numeric factorisation and solution of H with faer's own, by
//! supernodes and column by column, for the same H in the same order of elimination.

// Clippy lets tests unwrap, and not yet benches.
#![allow(clippy::unwrap_used, missing_docs)]

use std::fs::File;
use std::hint::black_box;
use std::io::Read;
use std::path::Path;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::sparse::linalg::cholesky::{simplicial, supernodal};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Conj, MatMut, Par};
use flate2::read::GzDecoder;
use mapshift::geometry::{Information, Pose2, Vector3};
use mapshift::graph::{Edge, EdgeKind, EdgeStatus, Node, PoseGraph};
use mapshift::ids::{EdgeId, NodeId};
use mapshift::ingest::g2o::read_g2o;
use mapshift::solver::linear::{BlockCholesky, BlockMatrix, approximate_minimum_degree};
use mapshift::solver::{SolveOptions, Solver, solve, start_along_odometry};
use nalgebra::Matrix3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const NODES: usize = 3500;
/// Corners along a side of the town.
const SIDE: i64 = 40;

/// A drive at random from corner to corner, with a closure wherever it comes by a corner again.
fn town() -> PoseGraph {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut graph = PoseGraph::new();
    let mut seen = std::collections::BTreeMap::<(i64, i64), (NodeId, Pose2)>::new();
    let (mut corner, mut truth) = ((SIDE / 2, SIDE / 2), Pose2::IDENTITY);
    for k in 0..NODES {
        let id = NodeId(k as i64);
        if k == 0 {
            graph.add_node(Node { id, pose: truth }).unwrap();
        }
        if let Some(&(before, pose)) = seen.get(&corner) {
            let motion = pose.between(&truth);
            add_edge(
                &mut graph,
                &mut rng,
                before,
                id,
                motion,
                EdgeKind::LoopClosure,
            );
        }
        seen.insert(corner, (id, truth));
        if k + 1 == NODES {
            break;
        }
        let quarter = loop {
            let quarter = rng.random_range(0..4);
            let (dx, dy) = direction(quarter);
            let next = (corner.0 + dx, corner.1 + dy);
            if (0..SIDE).contains(&next.0) && (0..SIDE).contains(&next.1) {
                corner = next;
                break quarter;
            }
        };
        let (dx, dy) = direction(quarter);
        let theta = quarter as f64 * std::f64::consts::FRAC_PI_2;
        let next = Pose2::new(truth.x + dx as f64, truth.y + dy as f64, theta);
        let to = NodeId(k as i64 + 1);
        graph.add_node(Node { id: to, pose: next }).unwrap();
        add_edge(
            &mut graph,
            &mut rng,
            id,
            to,
            truth.between(&next),
            EdgeKind::Odometry,
        );
        truth = next;
    }
    graph
}

fn direction(quarter: i32) -> (i64, i64) {
    [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter as usize % 4]
}

fn add_edge(
    graph: &mut PoseGraph,
    rng: &mut ChaCha8Rng,
    from: NodeId,
    to: NodeId,
    motion: Pose2,
    kind: EdgeKind,
) {
    let mut noise = || (rng.random::<f64>() - 0.5) * 0.1;
    let noise = Vector3::new(noise(), noise(), noise());
    graph
        .add_edge(Edge {
            id: EdgeId(graph.edges().len() as i64),
            from,
            to,
            measurement: motion.compose(&Pose2::exp(&noise)),
            information: Information::from_sigmas(0.03, 0.03),
            kind,
            status: EdgeStatus::Active,
        })
        .unwrap();
}

fn batch(criterion: &mut Criterion, name: &str, mut graph: PoseGraph) {
    start_along_odometry(&mut graph);
    let mut group = criterion.benchmark_group(name);
    for iterations_max in [2, 3] {
        let options = SolveOptions {
            iterations_max,
            ..SolveOptions::default()
        };
        group.bench_function(format!("{iterations_max}_iterations"), |bencher| {
            bencher.iter_batched_ref(
                || graph.clone(),
                |graph| black_box(solve(graph, &options)),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

/// The last closure of a graph that is at its optimum without it, by a solver that knows the rest.
fn closure(criterion: &mut Criterion, name: &str, whole: &PoseGraph) {
    let options = SolveOptions::default();
    let edges = whole.edges();
    let is_closure = |edge: &&Edge| edge.kind == EdgeKind::LoopClosure;
    let last = *edges.iter().rev().find(is_closure).unwrap();
    let mut before = PoseGraph::new();
    for node in whole.nodes() {
        before.add_node(*node).unwrap();
    }
    for edge in edges.iter().filter(|edge| edge.id != last.id) {
        before.add_edge(*edge).unwrap();
    }
    let known: Vec<EdgeId> = before.edges().iter().map(|edge| edge.id).collect();
    criterion.bench_function(&format!("{name}/closure"), |bencher| {
        bencher.iter_batched_ref(
            || {
                let (mut graph, mut solver) = (before.clone(), Solver::new());
                solver.solve_touched(&mut graph, &known, &options);
                graph.add_edge(last).unwrap();
                (graph, solver)
            },
            |(graph, solver)| black_box(solver.solve_touched(graph, &[last.id], &options)),
            BatchSize::LargeInput,
        );
    });
}

/// H = Σ JᵀΩJ of a connected graph at its optimum, with the first node held: a diagonal block for
/// each other node, and a block for each edge between two of them (first one's rows, second one's
/// columns), numbered in an order of elimination.
struct Hessian {
    diagonal: Vec<Matrix3<f64>>,
    pairs: Vec<(usize, usize, Matrix3<f64>)>,
}

impl Hessian {
    fn of(graph: &PoseGraph) -> Self {
        let free = graph.nodes().len() - 1;
        let ends = graph.ends().iter();
        let between = ends.filter(|&&(from, to)| from != 0 && to != 0);
        let coupled: Vec<(u32, u32)> = between
            .map(|&(from, to)| (from as u32 - 1, to as u32 - 1))
            .collect();
        let number = postordered(
            &approximate_minimum_degree(free, &coupled).unwrap(),
            &coupled,
        );
        let mut hessian = Self {
            diagonal: vec![Matrix3::zeros(); free],
            pairs: Vec::new(),
        };
        for (edge, &(from, to)) in graph.edges().iter().zip(graph.ends()) {
            let [a, b] = [from, to].map(|place| graph.nodes()[place].pose);
            let at = Pose2::edge_error_with_jacobians(&a, &b, &edge.measurement);
            let weighted =
                [at.jacobian_from, at.jacobian_to].map(|j| edge.information.matrix() * j);
            let numbers = [from, to].map(|place| place.checked_sub(1).map(|k| number[k]));
            for ((number, j), weighted) in numbers
                .iter()
                .zip([at.jacobian_from, at.jacobian_to])
                .zip(weighted)
            {
                if let Some(k) = *number {
                    hessian.diagonal[k] += j.transpose() * weighted;
                }
            }
            if let [Some(from), Some(to)] = numbers {
                let block = at.jacobian_from.transpose() * weighted[1];
                hessian.pairs.push((from, to, block));
            }
        }
        hessian
    }

    fn dimension(&self) -> usize {
        self.diagonal.len() * 3
    }

    fn in_blocks(&self) -> BlockMatrix<3> {
        let mut matrix = BlockMatrix::default();
        for block in &self.diagonal {
            let variable = matrix.add_variable();
            matrix.diagonal[variable as usize] = *block;
        }
        for &(from, to, block) in &self.pairs {
            let pair = matrix.add_pair(from as u32, to as u32);
            matrix.blocks[pair as usize] = block;
        }
        matrix
    }

    /// The lower triangle by columns.
    fn lower_triangle(&self) -> SparseColMat<usize, f64> {
        let mut entries = Vec::new();
        for (k, block) in self.diagonal.iter().enumerate() {
            for (r, c) in (0..3).flat_map(|c| (c..3).map(move |r| (r, c))) {
                entries.push(Triplet::new(3 * k + r, 3 * k + c, block[(r, c)]));
            }
        }
        for &(from, to, block) in &self.pairs {
            for (r, c) in (0..3).flat_map(|c| (0..3).map(move |r| (r, c))) {
                let (row, column) = (3 * from + r, 3 * to + c);
                entries.push(Triplet::new(
                    row.max(column),
                    row.min(column),
                    block[(r, c)],
                ));
            }
        }
        SparseColMat::try_new_from_triplets(self.dimension(), self.dimension(), &entries).unwrap()
    }
}

/// For each variable its number in an order that eliminates children before parents and each
/// subtree without a break. Fill-in is that of the given order; supernodes are consecutive.
fn postordered(order: &[u32], coupled: &[(u32, u32)]) -> Vec<usize> {
    const NONE: usize = usize::MAX;
    let count = order.len();
    let mut place = vec![0; count];
    for (k, &variable) in order.iter().enumerate() {
        place[variable as usize] = k;
    }
    let mut earlier = vec![Vec::new(); count];
    for &(a, b) in coupled {
        let (a, b) = (place[a as usize], place[b as usize]);
        earlier[a.max(b)].push(a.min(b));
    }
    // Liu 1986, with ancestors shortened on the way.
    let (mut parent, mut ancestor) = (vec![NONE; count], vec![NONE; count]);
    for (k, starts) in earlier.iter().enumerate() {
        for &start in starts {
            let mut at = start;
            while at != NONE && at != k {
                let next = std::mem::replace(&mut ancestor[at], k);
                if next == NONE {
                    parent[at] = k;
                }
                at = next;
            }
        }
    }
    let mut children = vec![Vec::new(); count];
    let mut open = Vec::new();
    for (k, &parent) in parent.iter().enumerate() {
        match parent {
            NONE => open.push(k),
            parent => children[parent].push(k),
        }
    }
    // Parents first from the last number down, so that children get smaller ones.
    let (mut number, mut next) = (vec![0; count], count);
    while let Some(k) = open.pop() {
        next -= 1;
        number[order[k] as usize] = next;
        open.extend(&children[k]);
    }
    number
}

/// One numeric factorisation with its solution: here, and by faer into memory that it had before.
fn factorisation(criterion: &mut Criterion, name: &str, graph: &PoseGraph) {
    let mut graph = graph.clone();
    start_along_odometry(&mut graph);
    solve(&mut graph, &SolveOptions::default());
    let hessian = Hessian::of(&graph);
    let right: Vec<f64> = (0..hessian.dimension()).map(|k| (k as f64).sin()).collect();
    let mut x = right.clone();
    let mut group = criterion.benchmark_group(format!("factorisation/{name}"));

    let matrix = hessian.in_blocks();
    let mut cholesky = BlockCholesky::analyse(&matrix, false);
    let mut here = |x: &mut [f64]| {
        x.copy_from_slice(&right);
        assert!(cholesky.factorise(&matrix, 0.0, x));
        cholesky.solve_upper(x);
    };
    here(&mut x);
    let expected = x.clone();
    let is_expected = |x: &[f64]| {
        let scale = expected.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        let gaps = x.iter().zip(&expected).map(|(x, e)| (x - e).abs());
        gaps.fold(0.0, f64::max) < 1e-6 * scale
    };
    group.bench_function("here", |bencher| bencher.iter(|| here(black_box(&mut x))));

    let n = hessian.dimension();
    let lower = hessian.lower_triangle();
    let upper = lower.transpose().to_col_major().unwrap();
    let mut memory = MemBuffer::new(StackReq::any_of(&[
        simplicial::prefactorize_symbolic_cholesky_scratch::<usize>(
            n,
            upper.as_ref().compute_nnz(),
        ),
        simplicial::factorize_simplicial_symbolic_cholesky_scratch::<usize>(n),
        supernodal::factorize_supernodal_symbolic_cholesky_scratch::<usize>(n),
    ]));
    let stack = MemStack::new(&mut memory);
    let (mut tree, mut counts) = (vec![0; n], vec![0; n]);
    let tree =
        simplicial::prefactorize_symbolic_cholesky(&mut tree, &mut counts, upper.symbolic(), stack);
    let supernodes = supernodal::factorize_supernodal_symbolic_cholesky(
        upper.symbolic(),
        tree,
        &counts,
        stack,
        Default::default(),
    )
    .unwrap();
    let columns =
        simplicial::factorize_simplicial_symbolic_cholesky(upper.symbolic(), tree, &counts, stack)
            .unwrap();
    let mut memory = MemBuffer::new(StackReq::any_of(&[
        supernodal::factorize_supernodal_numeric_llt_scratch::<usize, f64>(
            &supernodes,
            Par::Seq,
            Default::default(),
        ),
        supernodes.solve_in_place_scratch::<f64>(1, Par::Seq),
        simplicial::factorize_simplicial_numeric_llt_scratch::<usize, f64>(n),
        columns.solve_in_place_scratch::<f64>(1),
    ]));
    let mut values = vec![0.0; supernodes.len_val()];
    let mut by_supernodes = |x: &mut [f64]| {
        let stack = MemStack::new(&mut memory);
        x.copy_from_slice(&right);
        supernodal::factorize_supernodal_numeric_llt(
            &mut values,
            lower.as_ref(),
            Default::default(),
            &supernodes,
            Par::Seq,
            stack,
            Default::default(),
        )
        .unwrap();
        let x = MatMut::from_column_major_slice_mut(x, n, 1);
        supernodal::SupernodalLltRef::new(&supernodes, &values).solve_in_place_with_conj(
            Conj::No,
            x,
            Par::Seq,
            stack,
        );
    };
    by_supernodes(&mut x);
    assert!(is_expected(&x));
    group.bench_function("faer_supernodal", |bencher| {
        bencher.iter(|| by_supernodes(black_box(&mut x)));
    });
    let mut values = vec![0.0; columns.len_val()];
    let mut by_columns = |x: &mut [f64]| {
        let stack = MemStack::new(&mut memory);
        x.copy_from_slice(&right);
        simplicial::factorize_simplicial_numeric_llt(
            &mut values,
            upper.as_ref(),
            Default::default(),
            &columns,
            stack,
        )
        .unwrap();
        let x = MatMut::from_column_major_slice_mut(x, n, 1);
        simplicial::SimplicialLltRef::new(&columns, &values).solve_in_place_with_conj(
            Conj::No,
            x,
            Par::Seq,
            stack,
        );
    };
    by_columns(&mut x);
    assert!(is_expected(&x));
    group.bench_function("faer_simplicial", |bencher| {
        bencher.iter(|| by_columns(black_box(&mut x)));
    });
    group.finish();
}

fn recorded(name: &str) -> Option<PoseGraph> {
    let data = std::env::var_os("MAPSHIFT_DATA")?;
    let path = Path::new(&data).join(format!("graphs/{name}.g2o.gz"));
    let mut text = String::new();
    GzDecoder::new(File::open(path).ok()?)
        .read_to_string(&mut text)
        .unwrap();
    Some(read_g2o(&text).unwrap().graph)
}

fn benches(criterion: &mut Criterion) {
    let town = town();
    batch(criterion, "town", town.clone());
    closure(criterion, "town", &town);
    if let Some(graph) = recorded("M3500") {
        batch(criterion, "M3500", graph.clone());
        closure(criterion, "M3500", &graph);
    }
    factorisation(criterion, "town", &town);
    for name in ["intel", "M3500", "city10000", "kitti_00"] {
        if let Some(graph) = recorded(name) {
            factorisation(criterion, name, &graph);
        }
    }
}

criterion_group!(solver, benches);
criterion_main!(solver);
