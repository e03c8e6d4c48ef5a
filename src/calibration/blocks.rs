//! Errors of an estimate from what its blocks of data say by themselves.

use nalgebra::{SMatrix, SVector};

/// The normal equations of one block of a drive, at the estimate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block<const N: usize> {
    /// Σ JᵀWJ.
    pub hessian: SMatrix<f64, N, N>,
    /// Σ JᵀWe.
    pub gradient: SVector<f64, N>,
}

impl<const N: usize> Block<N> {
    /// Of nothing.
    pub const EMPTY: Self = Self {
        hessian: SMatrix::from_array_storage(nalgebra::ArrayStorage([[0.0; N]; N])),
        gradient: SVector::from_array_storage(nalgebra::ArrayStorage([[0.0; N]; 1])),
    };

    /// Both together.
    pub fn add(&mut self, other: &Self) {
        self.hessian += other.hessian;
        self.gradient += other.gradient;
    }
}

/// Standard errors of an estimate that solves the sum of blocks and a prior (its information,
/// diagonal): by the cluster jackknife, and not below those that follow from the weights alone.
///
/// Errors of neighbouring motions are correlated and have heavy tails; those of blocks that are
/// long enough are not correlated, and how far the estimate moves without one of them shows their
/// size (MacKinnon, Nielsen, Webb: *Leverage, influence, and the jackknife in clustered regression
/// models*, 2023). Infinite where nothing can be said.
pub(super) fn sigmas<const N: usize>(
    blocks: &[Block<N>],
    prior: &SVector<f64, N>,
) -> SVector<f64, N> {
    let nothing = SVector::repeat(f64::INFINITY);
    let mut whole = SMatrix::<f64, N, N>::from_diagonal(prior);
    for block in blocks {
        whole += block.hessian;
    }
    let count = blocks.len() as f64;
    let (Some(by_weights), true) = (whole.try_inverse(), blocks.len() >= 2) else {
        return nothing;
    };
    let mut variances = SVector::<f64, N>::zeros();
    for block in blocks {
        let Some(without) = (whole - block.hessian).try_inverse() else {
            return nothing;
        };
        let moved = without * block.gradient;
        variances += moved.component_mul(&moved) * ((count - 1.0) / count);
    }
    variances
        .sup(&by_weights.diagonal())
        .map(|v| v.max(0.0).sqrt())
}

/// How many blocks so many pieces of data make.
pub(super) fn block_count(pieces: usize) -> usize {
    (pieces / 10).clamp(6, 24)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::sim::normal;

    /// Means of blocks whose members share most of their error: what independent members would
    /// have is far too small.
    #[test]
    fn shared_errors_count_once() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut normalised = 0.0;
        for _ in 0..200 {
            let sums: Vec<f64> = (0..12).map(|_| 10.0 * normal(&mut rng, 5.0)).collect();
            let mean = sums.iter().sum::<f64>() / 120.0;
            let blocks: Vec<Block<1>> = sums
                .iter()
                .map(|sum| Block {
                    hessian: SMatrix::repeat(10.0),
                    gradient: SVector::repeat(10.0 * mean - sum),
                })
                .collect();
            let sigma = sigmas(&blocks, &SVector::repeat(1e-9)).x;
            normalised += (mean / sigma).powi(2) / 200.0;
        }
        assert!((0.7..1.6).contains(&normalised), "{normalised}");
    }

    #[test]
    fn a_single_block_says_nothing_of_its_error() {
        let one = Block::<1> {
            hessian: SMatrix::repeat(10.0),
            gradient: SVector::repeat(0.0),
        };
        assert_eq!(sigmas(&[one], &SVector::repeat(1.0)).x, f64::INFINITY);
    }
}
