//! Whether the observations of the old state and those of the new one agree about the surroundings.

use super::Site;
use super::answers::Answers;
use super::cells::SiteCells;
use super::pooled::Pooled;
use crate::change::nearness::Nearness;
use crate::geometry::Vector2;
use crate::observation::Outcome;

/// Distance from the cluster at which its surroundings begin and, at first, end, metres. They reach farther
/// if there are too few cells.
const FROM_M: f64 = 0.15;
const NEAR_M: f64 = 1.5;
/// Cells nearer than this to a candidate may have changed with it, metres.
const CHANGED_M: f64 = 0.12;
/// Fewest cells to compare.
const ASKED_MIN: usize = 8;
/// Share of one side's occupied cells that the other side must confirm.
const AGREEING_SHARE_MIN: f64 = 0.6;
/// A cell is occupied for a side that hits it at least twice …
const SOLID_HITS_MIN: u32 = 2;
/// … and more often than this, …
const SOLID_SHARE: f64 = 0.7;
/// … and agrees if the other side hits it more often than this.
const AGREES_SHARE: f64 = 0.5;
/// Fewest cells across a direction that constrain it.
const FIXING_MIN: usize = 3;
/// Share of them that must agree.
const FIXED_SHARE_MIN: f64 = 0.7;
/// A surface constrains directions near its normal (cosine).
const ACROSS_COSINE: f64 = 0.5;

/// How many of one side's occupied cells the other side confirms.
#[derive(Debug, Clone, Copy, Default)]
struct Confirmed {
    asked: usize,
    agreeing: usize,
}

impl Confirmed {
    fn share(&self, asked_min: usize) -> Option<f64> {
        (self.asked >= asked_min).then(|| self.agreeing as f64 / self.asked as f64)
    }
}

/// A cell that is occupied for one side and was observed by the other.
struct Witness {
    normal: Option<Vector2<f64>>,
    is_near: bool,
    /// For cells occupied for the old and for the new side: whether the other side agrees.
    agrees: [Option<bool>; 2],
}

/// How well surroundings constrain a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fixing {
    /// In every direction.
    Fixed,
    /// Least along this direction.
    Loose(Vector2<f64>),
    /// Too few cells.
    Unknown,
}

/// The cells round a cluster that both sides observed.
pub struct Surroundings {
    witnesses: Vec<Witness>,
}

impl Surroundings {
    /// The surroundings of changed cells.
    pub fn of(
        site: &Site<'_>,
        cells: &SiteCells,
        answers: &Answers,
        changed: &[Vector2<f64>],
        pooled: &Pooled,
    ) -> Self {
        let mut side_of = vec![None; answers.standpoints.len()];
        for view in &pooled.views {
            side_of[view.observation] = Some(usize::from(view.in_change));
        }
        let (to_cluster, to_changed) = (Nearness::to(changed), Nearness::to(site.changed_around));
        let witnesses = (0..cells.len()).filter_map(|cell| {
            let mut seen = [(0_u32, 0_u32); 2];
            for answer in answers.about(cell) {
                let Some(side) = side_of[answer.observation as usize] else {
                    continue;
                };
                match answer.outcome {
                    Outcome::Hit => seen[side].0 += 1,
                    Outcome::Miss => seen[side].1 += 1,
                    Outcome::NoReturn | Outcome::Unknown => {}
                }
            }
            let agrees = agreement(&seen)?;
            let centre = &cells[cell].centre;
            if to_cluster.holds(centre, FROM_M) || to_changed.holds(centre, CHANGED_M) {
                return None;
            }
            Some(Witness {
                normal: cells[cell].normal,
                is_near: to_cluster.holds(centre, NEAR_M),
                agrees,
            })
        });
        Self {
            witnesses: witnesses.collect(),
        }
    }

    fn confirmed(&self, side: usize, only_near: bool) -> Confirmed {
        let near = self.witnesses.iter().filter(|w| w.is_near || !only_near);
        confirmed(near.filter_map(|w| w.agrees[side]))
    }

    /// Whether the two sides agree, as far as there are cells to compare.
    pub fn agree(&self) -> bool {
        let near = [0, 1].map(|side| self.confirmed(side, true));
        let of_sides = if near.iter().any(|side| side.asked < ASKED_MIN) {
            [0, 1].map(|side| self.confirmed(side, false))
        } else {
            near
        };
        let mut shares = of_sides.iter().filter_map(|side| side.share(ASKED_MIN));
        shares.all(|share| share >= AGREEING_SHARE_MIN)
    }

    /// How well the surroundings constrain the poses of both sides.
    pub fn fixing(&self) -> Fixing {
        let normals: Vec<Vector2<f64>> = self.witnesses.iter().filter_map(|w| w.normal).collect();
        let without_face = self.witnesses.len() - normals.len();
        if normals.len() < FIXING_MIN {
            return if without_face >= FIXING_MIN {
                Fixing::Fixed
            } else {
                Fixing::Unknown
            };
        }
        let loose = least_fixed(&normals);
        let is_across = |normal: &Vector2<f64>| normal.dot(&loose).abs() > ACROSS_COSINE;
        let across = |w: &Witness| w.normal.as_ref().is_some_and(is_across);
        let of_sides = |counts: &dyn Fn(&Witness) -> bool| {
            [0, 1].map(|side| {
                let fixing = self.witnesses.iter().filter(|w| counts(w));
                confirmed(fixing.filter_map(|w| w.agrees[side]))
            })
        };
        let fixed = of_sides(&across);
        let shares = fixed.iter().filter_map(|side| side.share(FIXING_MIN));
        let shares: Vec<f64> = shares.collect();
        if !shares.is_empty() && shares.iter().all(|share| *share >= FIXED_SHARE_MIN) {
            Fixing::Fixed
        } else {
            Fixing::Loose(loose)
        }
    }

    /// Whether both sides observed enough of the surroundings.
    pub fn are_known(&self) -> bool {
        [0, 1]
            .iter()
            .any(|&side| self.confirmed(side, false).asked >= ASKED_MIN)
    }
}

fn confirmed(agreeing: impl Iterator<Item = bool>) -> Confirmed {
    agreeing.fold(Confirmed::default(), |sum, agrees| Confirmed {
        asked: sum.asked + 1,
        agreeing: sum.agreeing + usize::from(agrees),
    })
}

/// From the hits and misses of the old and the new side: whether each confirms the other's occupied cell;
/// `None` if it is occupied for neither, or one has not observed it.
fn agreement(seen: &[(u32, u32); 2]) -> Option<[Option<bool>; 2]> {
    let share = |&(hits, misses): &(u32, u32)| {
        let all = hits + misses;
        (all > 0).then(|| f64::from(hits) / f64::from(all))
    };
    let shares = [share(&seen[0])?, share(&seen[1])?];
    let agrees = [0, 1].map(|side| {
        let is_solid = seen[side].0 >= SOLID_HITS_MIN && shares[side] > SOLID_SHARE;
        is_solid.then(|| shares[1 - side] > AGREES_SHARE)
    });
    agrees.iter().any(Option::is_some).then_some(agrees)
}

/// The direction that surfaces with these normals constrain least.
fn least_fixed(normals: &[Vector2<f64>]) -> Vector2<f64> {
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for normal in normals {
        xx += normal.x * normal.x;
        xy += normal.x * normal.y;
        yy += normal.y * normal.y;
    }
    let most_rad = 0.5 * (2.0 * xy).atan2(xx - yy);
    let (sin, cos) = most_rad.sin_cos();
    Vector2::new(-sin, cos)
}
