//! Errors that all scans of one lap have in common.
//!
//! In recordings errors are correlated: the lidar's plane is slightly tilted that day, its ranges are slightly
//! long, and edges and grazing walls deceive every scan from the same side. Independent noise for each beam
//! does not model that.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, normal, stream};
use crate::geometry::{Pose2, Vector2};

/// Neighbouring beams that end this far apart in depth lie on two sides of an edge, metres.
const EDGE_M: f64 = 0.1;
/// A beam grazes a surface if the cosine of its angle to the normal is less.
const GRAZING_COSINE: f64 = 0.2;

/// Magnitudes of the common errors. Each lap draws its own values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PassErrors {
    /// Standard deviation of a lap's range bias, metres.
    pub range_bias_sigma_m: f64,
    /// Standard deviation of the turn of the lidar on its mount, radians.
    pub heading_sigma_rad: f64,
    /// Standard deviation of the tilt of the lidar's plane about either horizontal axis of the
    /// vehicle, radians.
    pub tilt_sigma_rad: f64,
    /// Standard deviation, over the objects of a scene, of how far a surface lies farther back
    /// for each metre of height.
    pub lean_sigma: f64,
    /// Width of a beam, radians: one that lies across an edge returns a range between the two.
    pub beam_width_rad: f64,
    /// Share of the beams without a return, of those that graze a surface.
    pub grazing_dropout_rate: f64,
}

impl PassErrors {
    /// No common errors: those of all beams are independent.
    pub const NONE: Self = Self {
        range_bias_sigma_m: 0.0,
        heading_sigma_rad: 0.0,
        tilt_sigma_rad: 0.0,
        lean_sigma: 0.0,
        beam_width_rad: 0.0,
        grazing_dropout_rate: 0.0,
    };

    /// Chosen so that contradictions between passes are as correlated as in recordings, and about half as
    /// frequent: with more the map itself becomes wrong, which it does not in recordings. Tilt and lean are
    /// larger than those of a real vehicle, since they represent causes that are not modelled. See
    /// `docs/explanation/detection.md`.
    pub const AS_RECORDED: Self = Self {
        range_bias_sigma_m: 0.01,
        heading_sigma_rad: 0.003,
        tilt_sigma_rad: 0.02,
        lean_sigma: 1.0,
        beam_width_rad: 0.003,
        grazing_dropout_rate: 0.5,
    };

    /// The errors of a lap. `seed` is the drive's, `scene_seed` that of the scene of `objects`
    /// objects: they lean alike in all laps.
    pub(super) fn draw(&self, seed: u64, lap: usize, scene_seed: u64, objects: usize) -> LapErrors {
        let mut rng = stream(seed, Purpose::PassErrors { lap });
        let tilt_rad = Vector2::new(
            normal(&mut rng, self.tilt_sigma_rad),
            normal(&mut rng, self.tilt_sigma_rad),
        );
        let range_bias_m = normal(&mut rng, self.range_bias_sigma_m);
        let mount = Pose2::new(0.0, 0.0, normal(&mut rng, self.heading_sigma_rad));
        let mut lean = stream(scene_seed, Purpose::Leans);
        LapErrors {
            errors: *self,
            range_bias_m,
            mount,
            tilt_rad,
            leans: (0..objects)
                .map(|_| normal(&mut lean, self.lean_sigma))
                .collect(),
        }
    }
}

/// The errors of one lap.
#[derive(Debug, Clone)]
pub(super) struct LapErrors {
    errors: PassErrors,
    range_bias_m: f64,
    /// `mount_from_lidar`, beside the lidar's own error.
    pub mount: Pose2,
    /// How far the plane rises for each metre ahead and to the left, base frame.
    tilt_rad: Vector2<f64>,
    leans: Vec<f64>,
}

impl LapErrors {
    /// How much longer a range is: by the bias, and because the tilted plane meets the object at
    /// another height. `direction` is the beam's, base frame.
    pub(super) fn longer_m(
        &self,
        range_m: f64,
        direction: &Vector2<f64>,
        object: Option<usize>,
    ) -> f64 {
        let height_m = range_m * self.tilt_rad.dot(direction);
        let lean = object.and_then(|object| self.leans.get(object));
        self.range_bias_m + lean.map_or(0.0, |lean| lean * height_m)
    }

    /// Lets beams at edges return a range between, and beams that graze none. `met` has, for each
    /// beam, the true range, metres, and what it met.
    pub(super) fn disturb<T: Copy + PartialEq>(
        &self,
        met: &mut [Option<(f64, T)>],
        angle_increment_rad: f64,
        rng: &mut ChaCha8Rng,
    ) {
        if self.errors.beam_width_rad <= 0.0 && self.errors.grazing_dropout_rate <= 0.0 {
            return;
        }
        let truth = met.to_vec();
        let edge_rate = (self.errors.beam_width_rad / angle_increment_rad).min(1.0);
        for (k, beam) in met.iter_mut().enumerate() {
            // Drawn for every beam, so that a change in the world leaves the others as they were.
            let (chance, share) = (rng.random::<f64>(), rng.random::<f64>());
            let at = |k: Option<usize>| truth.get(k?).copied().flatten();
            let Some((range_m, what)) = truth[k] else {
                continue;
            };
            let (before, after) = (at(k.checked_sub(1)), at(Some(k + 1)));
            if let Some((next_m, next)) = after
                && next != what
                && (next_m - range_m).abs() > EDGE_M
            {
                if chance < edge_rate {
                    *beam = Some((range_m + share * (next_m - range_m), what));
                }
            } else if let (Some((before_m, a)), Some((after_m, b))) = (before, after)
                && a == what
                && b == what
                && grazes(range_m, after_m - before_m, angle_increment_rad)
                && chance < self.errors.grazing_dropout_rate
            {
                *beam = None;
            }
        }
    }
}

/// Whether a beam grazes the surface on which its two neighbours end so far apart in depth.
fn grazes(range_m: f64, apart_m: f64, angle_increment_rad: f64) -> bool {
    let slope = apart_m / (2.0 * angle_increment_rad * range_m);
    1.0 < GRAZING_COSINE * slope.hypot(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_errors_change_nothing() {
        let lap = PassErrors::NONE.draw(3, 1, 5, 4);
        let ahead = Vector2::new(1.0, 0.0);
        assert_eq!(lap.longer_m(7.0, &ahead, Some(2)), 0.0);
        assert_eq!(lap.mount, Pose2::IDENTITY);
        let truth = vec![Some((2.0, 1)), Some((9.0, 2)), None];
        let mut met = truth.clone();
        lap.disturb(&mut met, 0.01, &mut stream(1, Purpose::World));
        assert_eq!(met, truth);
    }

    #[test]
    fn a_lap_errs_as_one_and_the_next_lap_otherwise() {
        let errors = PassErrors::AS_RECORDED;
        let (first, second) = (errors.draw(3, 0, 5, 40), errors.draw(3, 1, 5, 40));
        assert_eq!(first.range_bias_m, errors.draw(3, 0, 5, 40).range_bias_m);
        assert_ne!(first.range_bias_m, second.range_bias_m);
        assert_ne!(first.tilt_rad, second.tilt_rad);
        assert_eq!(first.leans, second.leans, "the world leans alike");
        // Twice as far away the plane is twice as high.
        let ahead = Vector2::new(1.0, 0.0);
        let shift = |range_m| first.longer_m(range_m, &ahead, Some(7)) - first.range_bias_m;
        assert!((shift(8.0) - 2.0 * shift(4.0)).abs() < 1e-12);
        assert_eq!(first.longer_m(8.0, &ahead, None), first.range_bias_m);
    }

    #[test]
    fn edges_are_mixed_and_grazing_beams_lost() {
        let lap = PassErrors {
            beam_width_rad: 0.01,
            grazing_dropout_rate: 1.0,
            ..PassErrors::NONE
        }
        .draw(1, 0, 1, 0);
        // A post before a wall that runs away from the lidar.
        let mut met = vec![Some((2.0, 'p')), Some((5.0, 'w')), Some((5.5, 'w'))];
        met.push(Some((6.1, 'w')));
        lap.disturb(&mut met, 0.01, &mut stream(1, Purpose::World));
        let (mixed_m, what) = met[0].unwrap();
        assert!(mixed_m > 2.0 && mixed_m < 5.0 && what == 'p');
        assert_eq!(met[1], Some((5.0, 'w')), "no surface to both sides");
        assert_eq!(met[2], None);
        assert!(!grazes(5.0, 0.01, 0.01));
    }
}
