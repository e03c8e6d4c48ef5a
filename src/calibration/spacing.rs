//! How far a lidar's beams truly are apart, by two witnesses.

use serde::{Deserialize, Serialize};

use super::{Combined, Estimate, Quantity, ScanPair, spacing_by_matches, spacing_by_walls};
use crate::scan::LaserScan;

/// What a trip says of [`Quantity::BeamSpacing`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Spacing {
    /// By matched pairs of scans.
    pub by_matches: Option<Estimate>,
    /// By straight walls.
    pub by_walls: Option<Estimate>,
}

/// Two witnesses agree within so many standard deviations.
const AGREE_SIGMAS: f64 = 3.0;
/// A spacing of fewer standard errors is none.
const SIGNIFICANT_SIGMAS: f64 = 3.0;

impl Spacing {
    /// Of a trip's scans and pairs of them, in the order of time.
    pub fn of<'a>(scans: impl IntoIterator<Item = &'a LaserScan>, pairs: &[ScanPair<'_>]) -> Self {
        Self {
            by_matches: spacing_by_matches(pairs),
            by_walls: spacing_by_walls(scans),
        }
    }

    /// The value of both together, where both know it and agree.
    pub fn agreed(&self) -> Option<Estimate> {
        let (matches, walls) = (self.by_matches?, self.by_walls?);
        let agree = matches.distance(&walls) <= AGREE_SIGMAS;
        let combined = Combined::of(&[matches, walls])?.floored(Quantity::BeamSpacing);
        agree.then_some(combined.estimate)
    }

    /// [`Spacing::agreed`] where it is more than its error: what scans are to be corrected by before
    /// they are matched.
    pub fn significant(&self) -> Option<Estimate> {
        let agreed = self.agreed()?;
        (agreed.significance() > SIGNIFICANT_SIGMAS).then_some(agreed)
    }

    /// What the spacing may be off by in scans that were corrected so, as a standard deviation: all
    /// of what is known of it where nothing was corrected.
    pub(super) fn left(&self) -> f64 {
        match (self.significant(), self.agreed()) {
            (Some(corrected), _) => corrected.sigma,
            (None, Some(agreed)) => agreed.value.hypot(agreed.sigma),
            (None, None) => Quantity::BeamSpacing.floor(),
        }
    }

    /// Whether both know it and contradict each other: then something else bends what the lidar
    /// sees, which no spacing corrects.
    pub fn disagrees(&self) -> bool {
        let (Some(matches), Some(walls)) = (self.by_matches, self.by_walls) else {
            return false;
        };
        matches.distance(&walls) > AGREE_SIGMAS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_witness_is_not_enough() {
        let of = |value| {
            Some(Estimate {
                value,
                sigma: 0.002,
            })
        };
        let spacing = |by_matches, by_walls| Spacing {
            by_matches,
            by_walls,
        };
        let both = spacing(of(-0.05), of(-0.048));
        assert!((both.agreed().unwrap().value + 0.049).abs() < 1e-12);
        assert!(!both.disagrees());
        let apart = spacing(of(-0.05), of(-0.03));
        assert!(apart.disagrees() && apart.agreed().is_none());
        let alone = spacing(of(-0.05), None);
        assert!(!alone.disagrees() && alone.agreed().is_none());
        let small = spacing(of(0.004), of(0.003));
        assert!(both.significant().is_some() && small.significant().is_none());
        assert!(both.left() < 0.007 && small.left() > 0.003);
    }
}
