//! The square root of an information matrix: what errors are multiplied by to have covariance I.

use nalgebra::{Matrix3, SymmetricEigen};

use crate::geometry::Information;

/// Eigenvalues of an information matrix below this part of the largest count as zero.
const RANK_TOLERANCE: f64 = 1e-9;

/// The symmetric square root, and the rank.
pub(crate) fn square_root(information: &Information) -> (Matrix3<f64>, usize) {
    let eigen = SymmetricEigen::new(*information.matrix());
    let zero_below = RANK_TOLERANCE * eigen.eigenvalues.max();
    let roots = eigen.eigenvalues.map(|value| {
        if value > zero_below {
            value.sqrt()
        } else {
            0.0
        }
    });
    let rank = roots.iter().filter(|&&root| root > 0.0).count();
    let vectors = eigen.eigenvectors;
    (
        vectors * Matrix3::from_diagonal(&roots) * vectors.transpose(),
        rank,
    )
}
