//! The ray test of a scan at its pose against a cell.

mod visibility;

use std::f64::consts::TAU;
use std::ops::Range;

pub use self::visibility::Visibility;
use super::cell::Cell;
use crate::geometry::{Pose2, Transform2, Vector2, direction_rad, wrap_angle};
use crate::scan::{INVALID_TICK, LaserScan, Lidar, NO_RETURN_TICK};

/// Cells farther than this from the lidar are unknown, metres: the error of the heading is too large.
pub const REACH_M: f64 = 14.0;
/// Up to this distance cells are tested whatever the spacing of the beams, metres; …
const REACH_SPARSE_M: f64 = 8.0;
/// … beyond it where neighbouring beams are no farther apart than this, metres.
const BEAM_SPACING_MAX_M: f64 = 0.07;
/// Cells nearer than this are unknown, metres.
const NEAREST_M: f64 = 0.2;
/// So are cells beyond this share of the lidar's range: surfaces there are often lost.
const RANGE_SHARE: f64 = 0.95;

/// A beam that ends this near to a cell's depth has hit it, metres: half a cell, …
const HIT_TOLERANCE_M: f64 = 0.07;
/// … plus this many standard deviations of the range …
const HIT_SIGMAS: f64 = 2.0;
/// … and, for each metre of range, the error of the heading at a slant.
const HIT_TOLERANCE_PER_RANGE: f64 = 0.006;
/// A beam must end this far behind a cell to miss it, metres; in between the cell is unknown.
const MISS_TOLERANCE_M: f64 = 0.10;
const MISS_SIGMAS: f64 = 3.0;
const MISS_TOLERANCE_PER_RANGE: f64 = 0.012;

/// Beams this far to each side of a cell's bearing test it, radians: the error of the heading, …
const BEARING_TOLERANCE_RAD: f64 = 0.008;
/// … and the width of a cell with the error of the position, metres.
const BEARING_TOLERANCE_M: f64 = 0.025;

/// Beams may miss a surface at a flatter angle than this (cosine to its normal).
const GRAZING_COSINE: f64 = 0.35;
/// A beam that comes from behind a surface (cosine to the side it was seen from) …
const BEHIND_COSINE: f64 = 0.2;
/// … and ends within this distance behind it, metres, has hit the other face of the same wall.
const BEHIND_M: f64 = 0.5;

/// Least spacing of beams, so that the number of beams in a turn stays finite.
const INCREMENT_MIN_RAD: f64 = 1e-12;

/// The outcome of a ray test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// A beam ended in the cell: it is occupied.
    Hit,
    /// The beams went through the cell and ended well behind it: it is free.
    Miss,
    /// The beams towards the cell gave no return: it is free if this lidar rarely loses a surface.
    NoReturn,
    /// Out of reach, outside the field of view, occluded, or unclear.
    Unknown,
}

/// A scan with the pose of its lidar.
#[derive(Debug, Clone)]
pub struct Observation {
    scan: LaserScan,
    eye: Vector2<f64>,
    map_from_lidar: Transform2,
    lidar_from_map: Transform2,
    reach_m: f64,
    /// Angle of the first beam, in [−π, π].
    angle_min_rad: f64,
    beams_per_rad: f64,
    beams_a_turn: i64,
    tolerances_m: (f64, f64),
    /// Cells can be missed between these distances from the lidar, metres.
    clear_m: (f64, f64),
}

impl Observation {
    /// A scan taken at `map_from_base`.
    pub fn new(scan: &LaserScan, map_from_base: &Pose2) -> Self {
        let lidar = scan.lidar();
        let map_from_lidar = map_from_base.compose(&lidar.mount);
        let increment_rad = lidar.angle_increment_rad.max(INCREMENT_MIN_RAD);
        Self {
            eye: map_from_lidar.translation(),
            map_from_lidar: map_from_lidar.to_transform(),
            lidar_from_map: map_from_lidar.inverse().to_transform(),
            reach_m: reach_m(lidar),
            angle_min_rad: wrap_angle(lidar.angle_min_rad),
            beams_per_rad: 1.0 / increment_rad,
            beams_a_turn: (TAU / increment_rad).round() as i64,
            tolerances_m: (
                HIT_TOLERANCE_M + HIT_SIGMAS * lidar.range_sigma_m,
                miss_tolerance(lidar.range_sigma_m).0,
            ),
            clear_m: lidar.band.map_or((0.0, f64::INFINITY), |view| {
                (view.clear_from_m, view.clear_to_m)
            }),
            scan: scan.clone(),
        }
    }

    /// Position of the lidar, map frame, metres.
    pub fn eye(&self) -> Vector2<f64> {
        self.eye
    }

    /// Its scan.
    pub fn scan(&self) -> &LaserScan {
        &self.scan
    }

    /// Cells farther than this from the lidar are unknown, metres.
    pub fn reach_m(&self) -> f64 {
        self.reach_m
    }

    /// The end of a beam, map frame, metres; `None` without a range.
    pub fn end_of(&self, beam: usize) -> Option<Vector2<f64>> {
        let range_m = self.scan.range_m(beam)?;
        let (sin, cos) = self.scan.lidar().beam_angle_rad(beam).sin_cos();
        let in_lidar = range_m * Vector2::new(cos, sin);
        Some(self.map_from_lidar.apply(&in_lidar))
    }

    /// The ends of its beams within reach, map frame, metres.
    pub fn hits(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let directions = self.scan.lidar().beam_directions(self.scan.beam_count());
        directions.enumerate().filter_map(|(beam, direction)| {
            let range_m = self.scan.range_m(beam)?;
            (range_m < self.reach_m).then(|| self.map_from_lidar.apply(&(range_m * direction)))
        })
    }

    /// Its hits within a distance of a point. Cost: the beams towards it.
    pub fn hits_near(
        &self,
        centre: &Vector2<f64>,
        within_m: f64,
    ) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let towards = centre - self.eye;
        let range_m = towards.norm();
        let count = self.scan.beam_count() as i64;
        let (first, last) = if range_m <= within_m {
            (0, count - 1)
        } else {
            let half_rad = (within_m / range_m).asin();
            let bearing = self.bearing(&self.lidar_from_map.turn(&towards));
            let half = half_rad * self.beams_per_rad;
            (floor(bearing - half), floor(bearing + half) + 1)
        };
        let centre = *centre;
        let beams = self.parts(first, last).into_iter().flatten().flatten();
        let hits = beams.filter_map(move |index| {
            let range_m = self.scan.range_m(index).filter(|r| *r < self.reach_m)?;
            let (sin, cos) = self.scan.lidar().beam_angle_rad(index).sin_cos();
            Some(
                self.map_from_lidar
                    .apply(&(range_m * Vector2::new(cos, sin))),
            )
        });
        hits.filter(move |hit| (hit - centre).norm_squared() <= within_m * within_m)
    }

    /// The ray test of a cell. Cost: the beams across the cell.
    ///
    /// One beam that ends in the cell is a hit; a miss requires all to go through: beams pass beside thin
    /// objects, and a beam at a depth edge ends anywhere. In a height band there is no miss where the lidar
    /// does not see enough of the band.
    pub fn test(&self, cell: &Cell) -> Outcome {
        let Some(Target {
            towards,
            range_m,
            beams,
            depth,
        }) = self.target(cell)
        else {
            return Outcome::Unknown;
        };
        let seen = self.readings(&beams, &depth);
        if seen.is_hit {
            return Outcome::Hit;
        }
        let is_clear = self.clear_m.0 <= range_m && range_m <= self.clear_m.1;
        if seen.nearest_m < depth.miss_from_m || !is_clear {
            return Outcome::Unknown;
        }
        let tested = beams.last - beams.first + 1;
        let outside = tested - seen.ranges - seen.without_return;
        if 2 * (tested - seen.ranges) <= tested && self.has_central_ranges(&beams, range_m) {
            let nearest_behind_m = seen.nearest_m - range_m;
            let is_unclear = self.may_miss_surface(cell, &towards, range_m, nearest_behind_m);
            return if is_unclear {
                Outcome::Unknown
            } else {
                Outcome::Miss
            };
        }
        if outside == 0 && seen.without_return == tested {
            return Outcome::NoReturn;
        }
        Outcome::Unknown
    }

    /// Whether something nearer hides a cell.
    pub fn hides(&self, cell: &Cell) -> bool {
        self.target(cell).is_some_and(|target| {
            let seen = self.readings(&target.beams, &target.depth);
            !seen.is_hit && seen.nearest_m < target.depth.hit_from_m
        })
    }

    /// The beams and ranges by which a cell is tested; `None` if it is out of reach.
    fn target(&self, cell: &Cell) -> Option<Target> {
        let towards = cell.centre - self.eye;
        let range_squared = towards.norm_squared();
        if !(NEAREST_M * NEAREST_M..=self.reach_m * self.reach_m).contains(&range_squared) {
            return None;
        }
        let range_m = range_squared.sqrt();
        let hit_within_m = self.hit_within_m(range_m, cell.half_width_m);
        let miss_beyond_m =
            self.tolerances_m.1 + cell.half_width_m + MISS_TOLERANCE_PER_RANGE * range_m;
        Some(Target {
            towards,
            range_m,
            beams: self.beams_towards(&self.lidar_from_map.turn(&towards), range_m, cell),
            depth: Depth {
                hit_from_m: range_m - hit_within_m,
                hit_to_m: range_m + hit_within_m,
                miss_from_m: range_m + miss_beyond_m,
            },
        })
    }

    /// How near to a cell's depth a beam must end to have hit it, metres.
    fn hit_within_m(&self, range_m: f64, half_width_m: f64) -> f64 {
        self.tolerances_m.0 + half_width_m + HIT_TOLERANCE_PER_RANGE * range_m
    }

    /// The readings of the beams towards a cell.
    fn readings(&self, beams: &Beams, depth: &Depth) -> Readings {
        let per_m = 1.0 / self.scan.tick_m();
        let tick = |range_m: f64| (range_m * per_m).clamp(1.0, f64::from(INVALID_TICK - 1));
        let hit_from = tick(depth.hit_from_m).ceil() as u16;
        let hit_to = tick(depth.hit_to_m) as u16;
        let width = hit_to.saturating_sub(hit_from);
        // Branch-free sums of one integer width: compiled to vector instructions.
        let (mut hits, mut nearest, mut without_return, mut ranges) = (0_u16, INVALID_TICK, 0, 0);
        for part in self.parts(beams.first, beams.last).into_iter().flatten() {
            for &tick in &self.scan.ticks()[part] {
                hits |= u16::from(tick.wrapping_sub(hit_from) <= width);
                without_return += u16::from(tick == NO_RETURN_TICK);
                ranges += u16::from(is_range(tick));
                nearest = nearest.min(if is_range(tick) { tick } else { INVALID_TICK });
            }
        }
        Readings {
            is_hit: hits != 0 && hit_from <= hit_to,
            nearest_m: match ranges {
                0 => f64::INFINITY,
                _ => f64::from(nearest) * self.scan.tick_m(),
            },
            without_return: i64::from(without_return),
            ranges: i64::from(ranges),
        }
    }

    /// Whether one of the beams next to a cell's bearing has a range; where they are far apart, whether all have:
    /// on a slanted surface one ends nearer and the other farther away.
    fn has_central_ranges(&self, beams: &Beams, range_m: f64) -> bool {
        let first = (-floor(1.0 - beams.bearing)).max(beams.first);
        let last = floor(beams.bearing + 1.0).min(beams.last);
        let parts = self.parts(first, last).into_iter().flatten();
        let mut ticks = parts.flat_map(|part| &self.scan.ticks()[part]);
        match range_m <= BEAM_SPACING_MAX_M * self.beams_per_rad {
            true => ticks.any(|tick| is_range(*tick)),
            false => ticks.all(|tick| is_range(*tick)),
        }
    }

    /// The beams between two indices, which may be before the first or after the last: across the seam of a full
    /// turn.
    fn parts(&self, first: i64, last: i64) -> [Option<Range<usize>>; 3] {
        let (count, turn) = (self.scan.beam_count() as i64, self.beams_a_turn);
        let part = |from: i64, to: i64| {
            let (from, to) = (from.max(0), to.min(count - 1));
            (from <= to).then(|| from as usize..to as usize + 1)
        };
        [
            part(first, last),
            (first < 0)
                .then(|| part(first + turn, last.min(-1) + turn))
                .flatten(),
            (last >= count)
                .then(|| part(first.max(count) - turn, last - turn))
                .flatten(),
        ]
    }

    /// Whether there may be a surface although beams went past.
    fn may_miss_surface(
        &self,
        cell: &Cell,
        towards: &Vector2<f64>,
        range_m: f64,
        nearest_behind_m: f64,
    ) -> bool {
        let grazes = |normal: &Vector2<f64>| normal.dot(towards).abs() < GRAZING_COSINE * range_m;
        let from_behind = cell.seen_from.dot(towards) > BEHIND_COSINE * range_m;
        cell.normal.as_ref().is_some_and(grazes) || (from_behind && nearest_behind_m < BEHIND_M)
    }

    fn beams_towards(&self, in_lidar: &Vector2<f64>, range_m: f64, cell: &Cell) -> Beams {
        let bearing = self.bearing(in_lidar);
        let tolerance_rad = bearing_tolerance_rad(range_m, cell.half_width_m);
        let beams_max = self.scan.beam_count() as f64;
        let beside = (tolerance_rad * self.beams_per_rad).max(1.0).min(beams_max);
        Beams {
            bearing,
            first: floor(bearing - beside) + 1,
            last: floor(bearing + beside),
        }
    }

    /// A direction as an index of beams from the first.
    fn bearing(&self, in_lidar: &Vector2<f64>) -> f64 {
        let from_first_rad = direction_rad(in_lidar) - self.angle_min_rad;
        let turns = if from_first_rad < 0.0 { TAU } else { 0.0 };
        (from_first_rad + turns) * self.beams_per_rad
    }
}

/// A cell as an observation tests it.
struct Target {
    /// From the lidar to the cell, map frame, metres.
    towards: Vector2<f64>,
    range_m: f64,
    beams: Beams,
    depth: Depth,
}

/// Ranges at which a beam hits or misses a cell, metres.
struct Depth {
    hit_from_m: f64,
    hit_to_m: f64,
    miss_from_m: f64,
}

/// Readings of some beams.
struct Readings {
    /// Whether one of them ended at the cell's depth.
    is_hit: bool,
    /// Shortest range, metres.
    nearest_m: f64,
    /// Beams without a return.
    without_return: i64,
    /// Beams with a range.
    ranges: i64,
}

/// The beams that test a cell.
struct Beams {
    /// Bearing of the cell, as an index of beams from the first.
    bearing: f64,
    first: i64,
    last: i64,
}

/// How far behind a surface a beam must end to miss it, for a standard deviation of the ranges in metres: in
/// metres, and metres for each metre of range.
pub fn miss_tolerance(range_sigma_m: f64) -> (f64, f64) {
    let at_no_range_m = MISS_TOLERANCE_M + MISS_SIGMAS * range_sigma_m;
    (at_no_range_m, MISS_TOLERANCE_PER_RANGE)
}

/// How far to each side of a cell's bearing beams test it, radians.
fn bearing_tolerance_rad(range_m: f64, half_width_m: f64) -> f64 {
    BEARING_TOLERANCE_RAD + (BEARING_TOLERANCE_M + 0.5 * half_width_m) / range_m
}

fn is_range(tick: u16) -> bool {
    tick != NO_RETURN_TICK && tick != INVALID_TICK
}

/// Without the library call that `f64::floor` is on older machines.
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole - i64::from(whole as f64 > value)
}

/// Cells farther than this from such a lidar are unknown, metres.
pub fn reach_m(lidar: &Lidar) -> f64 {
    let dense_m = BEAM_SPACING_MAX_M / lidar.angle_increment_rad;
    dense_m
        .clamp(REACH_SPARSE_M, REACH_M)
        .min(RANGE_SHARE * lidar.range_max_m)
}

#[cfg(test)]
mod tests;
