//! What one trip says of its vehicle.

use serde::{Deserialize, Serialize};

use super::range_scale::{MapScan, range_scale};
use super::{Estimates, MapFit, Motions, Quantity, Spacing, fit_motions};

/// Residuals of the motions so many times as large as usual are none of wheels and matches.
const EXCESS_MAX: f64 = 4.0;

/// What one trip says of its vehicle, as stored.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TripCalibration {
    /// By all of the trip.
    pub estimates: Estimates,
    /// What the two witnesses of the beam spacing say.
    pub spacing: Spacing,
    /// Faults that no correction mends, as texts.
    pub faults: Vec<String>,
    /// How it fits other vehicles' map; `None` where that was not compared.
    #[serde(default)]
    pub map_fit: Option<MapFit>,
}

impl TripCalibration {
    /// Of a trip's motions and of what its scans say of the beams.
    ///
    /// Where the spacing is wrong, motions matched with the stated lidar are wrong too: they are to
    /// be matched with the corrected one ([`super::Corrections::lidar`] with
    /// [`Spacing::significant`] in it), and with the stated mount, odometry and clock.
    pub fn of(motions: &Motions, spacing: Option<&Spacing>) -> Self {
        let fit = fit_motions(motions);
        let mut estimates = fit
            .as_ref()
            .map_or_else(Estimates::new, |fit| fit.estimates.clone());
        let mut faults = Vec::new();
        if let Some(fit) = fit.filter(|fit| fit.excess > EXCESS_MAX) {
            estimates.clear();
            faults.push(format!(
                "wheels and scans disagree {:.0} times as much as is usual ({:.0} mm, {:.1}° a \
                 motion), whatever is corrected",
                fit.excess,
                1e3 * fit.noise[0].hypot(fit.noise[1]),
                fit.noise[2].to_degrees(),
            ));
        }
        if let Some(agreed) = spacing.and_then(Spacing::agreed) {
            estimates.insert(Quantity::BeamSpacing, agreed);
        }
        if let Some(Spacing {
            by_matches: Some(matches),
            by_walls: Some(walls),
        }) = spacing.filter(|spacing| spacing.disagrees())
        {
            faults.push(format!(
                "the beam spacing is {:.2} % off by matches and {:.2} % by walls: something else \
                 bends the scans",
                100.0 * matches.value,
                100.0 * walls.value,
            ));
        }
        let spacing_left = spacing.copied().unwrap_or_default().left();
        // Beams by a per cent too far apart make all turns by scans a per cent too large.
        if let Some(turn) = estimates.get_mut(&Quantity::TurnScale) {
            turn.sigma = turn.sigma.hypot(spacing_left);
        }
        Self {
            estimates,
            spacing: spacing.copied().unwrap_or_default(),
            faults,
            map_fit: None,
        }
    }

    /// The same with what a map that other vehicles have made says of the ranges, and how the trip
    /// fits it.
    #[must_use]
    pub fn beside_others(mut self, map_fit: MapFit, scans: &[MapScan<'_>]) -> Self {
        self.map_fit = Some(map_fit);
        if let Some(range_scale) = range_scale(scans) {
            self.estimates.insert(Quantity::RangeScale, range_scale);
        }
        self
    }
}
