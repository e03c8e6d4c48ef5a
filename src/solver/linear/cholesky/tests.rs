//! Sparse factorisations against dense ones.

use nalgebra::{DMatrix, DVector, SMatrix};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::super::block_matrix::BlockMatrix;
use super::BlockCholesky;

fn random_block<const B: usize>(rng: &mut impl Rng) -> SMatrix<f64, B, B> {
    SMatrix::from_fn(|_, _| rng.random::<f64>() - 0.5)
}

/// Adds a pair with a random block, and as much to the diagonal as keeps the matrix definite.
fn couple<const B: usize>(matrix: &mut BlockMatrix<B>, rng: &mut impl Rng, a: u32, b: u32) {
    let pair = matrix.add_pair(a, b) as usize;
    matrix.blocks[pair] = random_block(rng);
    for end in [a, b] {
        matrix.diagonal[end as usize] += SMatrix::identity() * B as f64;
    }
}

fn add_variable<const B: usize>(matrix: &mut BlockMatrix<B>, rng: &mut impl Rng) -> u32 {
    let variable = matrix.add_variable();
    let root = random_block::<B>(rng);
    matrix.diagonal[variable as usize] = root * root.transpose() + SMatrix::identity();
    variable
}

/// A chain with pairs at random, some of them more than once.
fn random_matrix<const B: usize>(rng: &mut impl Rng, variables: u32, pairs: u32) -> BlockMatrix<B> {
    let mut matrix = BlockMatrix::default();
    for variable in 0..variables {
        add_variable(&mut matrix, rng);
        if variable > 0 {
            couple(&mut matrix, rng, variable, variable - 1);
        }
    }
    for _ in 0..pairs {
        let (a, b) = (
            rng.random_range(0..variables),
            rng.random_range(0..variables),
        );
        if a != b {
            couple(&mut matrix, rng, a, b);
        }
    }
    matrix
}

fn dense<const B: usize>(matrix: &BlockMatrix<B>) -> DMatrix<f64> {
    let n = matrix.variables() * B;
    let mut whole = DMatrix::zeros(n, n);
    for (v, block) in matrix.diagonal.iter().enumerate() {
        whole.view_mut((v * B, v * B), (B, B)).copy_from(block);
        for (other, pair, is_column) in matrix.coupled(v as u32) {
            let block = &matrix.blocks[pair];
            let turned = block.transpose();
            let block = if is_column { block } else { &turned };
            let mut target = whole.view_mut((other as usize * B, v * B), (B, B));
            target += block;
        }
    }
    whole
}

/// How far off the solution is, relative to the dense one.
fn gap<const B: usize>(
    matrix: &BlockMatrix<B>,
    cholesky: &mut BlockCholesky<B>,
    rng: &mut impl Rng,
) -> f64 {
    let whole = dense(matrix);
    let right = DVector::from_fn(whole.nrows(), |_, _| rng.random::<f64>() - 0.5);
    let mut x: Vec<f64> = right.iter().copied().collect();
    cholesky.solve(&mut x);
    let expected = whole.cholesky().unwrap().solve(&right);
    (DVector::from_vec(x) - &expected).norm() / expected.norm()
}

fn agrees<const B: usize>(seed: u64, variables: u32, pairs: u32) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let matrix = random_matrix::<B>(&mut rng, variables, pairs);
    let mut cholesky = BlockCholesky::analyse(&matrix, false);
    assert!(cholesky.factorise(&matrix, 0.0, &mut []));
    // A second time over the first one's numbers.
    assert!(cholesky.factorise(&matrix, 0.0, &mut []));
    gap(&matrix, &mut cholesky, &mut rng)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn agrees_with_a_dense_factorisation(
        seed in any::<u64>(), variables in 1..60_u32, pairs in 0..90_u32,
    ) {
        prop_assert!(agrees::<3>(seed, variables, pairs) < 1e-12);
        prop_assert!(agrees::<2>(seed, variables, pairs) < 1e-12);
    }

    /// Grown piece by piece, only what is touched factored again.
    #[test]
    fn grows_with_the_matrix(seed in any::<u64>(), pieces in 1..12_usize) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut matrix = random_matrix::<3>(&mut rng, 20, 12);
        let mut cholesky = BlockCholesky::analyse(&matrix, true);
        prop_assert!(cholesky.factorise(&matrix, 0.0, &mut []));
        for _ in 0..pieces {
            let mut touched = Vec::new();
            for _ in 0..rng.random_range(0..4_u32) {
                let new = add_variable(&mut matrix, &mut rng);
                couple(&mut matrix, &mut rng, new - 1, new);
                touched.extend([new - 1, new]);
            }
            let count = matrix.variables() as u32;
            let (a, b) = (rng.random_range(0..count - 1), count - 1);
            couple(&mut matrix, &mut rng, a, b);
            touched.extend([a, b]);
            let fronts = cholesky.extend(&matrix, &touched).unwrap();
            prop_assert!(cholesky.factorise_fronts(&fronts, &matrix, 0.0));
            prop_assert!(gap(&matrix, &mut cholesky, &mut rng) < 1e-12);
        }
        // What was grown can be factored as a whole.
        prop_assert!(cholesky.factorise(&matrix, 0.0, &mut []));
        prop_assert!(gap(&matrix, &mut cholesky, &mut rng) < 1e-12);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Other numbers in the same places: only the paths to the root are factored again.
    #[test]
    fn other_numbers_want_their_paths(seed in any::<u64>(), changes in 1..6_usize) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut matrix = random_matrix::<3>(&mut rng, 40, 25);
        let mut cholesky = BlockCholesky::analyse(&matrix, true);
        prop_assert!(cholesky.factorise(&matrix, 0.0, &mut []));
        for _ in 0..changes {
            let variable = rng.random_range(0..40_u32);
            let (other, pair, _) = matrix.coupled(variable).next().unwrap();
            matrix.blocks[pair] = random_block(&mut rng);
            matrix.diagonal[variable as usize] += SMatrix::identity();
            let path = cholesky.path_of([variable, other].into_iter());
            prop_assert!(cholesky.factorise_fronts(&path, &matrix, 0.0));
            prop_assert!(gap(&matrix, &mut cholesky, &mut rng) < 1e-12);
        }
    }
}

/// Wide fronts, and heights around every multiple of the vectors' length.
#[test]
fn cliques_of_all_sizes_are_factored() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for variables in (1..24).chain([47]) {
        let mut matrix = BlockMatrix::<3>::default();
        for variable in 0..variables {
            add_variable(&mut matrix, &mut rng);
            for other in 0..variable {
                couple(&mut matrix, &mut rng, variable, other);
            }
        }
        let mut cholesky = BlockCholesky::analyse(&matrix, false);
        assert!(cholesky.factorise(&matrix, 0.0, &mut []));
        assert!(gap(&matrix, &mut cholesky, &mut rng) < 1e-12, "{variables}");
    }
}

#[test]
fn what_is_not_definite_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut matrix = random_matrix::<3>(&mut rng, 12, 8);
    let mut cholesky = BlockCholesky::analyse(&matrix, false);
    for bad in [-1e9, f64::NAN, f64::INFINITY] {
        let entry = std::mem::replace(&mut matrix.diagonal[5][(1, 1)], bad);
        assert!(!cholesky.factorise(&matrix, 0.0, &mut []));
        matrix.diagonal[5][(1, 1)] = entry;
        assert!(cholesky.factorise(&matrix, 0.0, &mut []));
        assert!(gap(&matrix, &mut cholesky, &mut rng) < 1e-12);
    }
}

/// Bit for bit.
#[test]
fn the_same_matrix_gives_the_same_numbers() {
    let solve = || {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let matrix = random_matrix::<3>(&mut rng, 50, 60);
        let mut cholesky = BlockCholesky::analyse(&matrix, false);
        assert!(cholesky.factorise(&matrix, 1e-9, &mut []));
        let mut x = vec![1.0; 150];
        cholesky.solve(&mut x);
        x.into_iter().map(f64::to_bits).collect::<Vec<_>>()
    };
    assert_eq!(solve(), solve());
}

#[test]
fn nothing_is_factored_at_once() {
    let mut cholesky = BlockCholesky::<3>::empty(false);
    assert!(cholesky.factorise(&BlockMatrix::default(), 0.0, &mut []));
    cholesky.solve(&mut []);
}
