//! One scan at its pose, asked about a cell.

use std::f64::consts::TAU;
use std::ops::Range;

use super::cell::Cell;
use crate::geometry::{Pose2, Transform2, Vector2, direction_rad, wrap_angle};
use crate::scan::{INVALID_TICK, LaserScan, Lidar, NO_RETURN_TICK};

/// Farther than this from the lidar no cell is asked about, metres: the error of a heading is too
/// large.
pub const REACH_M: f64 = 14.0;
/// Up to this distance cells are asked about however far apart the beams are, metres; …
const REACH_SPARSE_M: f64 = 8.0;
/// … beyond it where neighbouring beams are no farther apart than this, metres.
const BEAM_SPACING_MAX_M: f64 = 0.07;
/// No cell is asked about from nearer than this, metres.
const NEAREST_M: f64 = 0.2;
/// Nor beyond this share of the lidar's range: a surface there is often lost.
const RANGE_SHARE: f64 = 0.95;

/// A beam that ends this near to a cell's depth has hit it, metres: half a cell, …
const HIT_TOLERANCE_M: f64 = 0.07;
/// … with so many standard deviations of the range …
const HIT_SIGMAS: f64 = 2.0;
/// … and, for each metre of range, the error of the heading at a slant.
const HIT_TOLERANCE_PER_RANGE: f64 = 0.006;
/// A beam must end this far behind a cell to have missed it: between the two it says nothing.
const MISS_TOLERANCE_M: f64 = 0.10;
const MISS_SIGMAS: f64 = 3.0;
const MISS_TOLERANCE_PER_RANGE: f64 = 0.012;

/// Beams this far to each side of a cell's bearing answer for it, radians: the error of the
/// heading, …
const BEARING_TOLERANCE_RAD: f64 = 0.008;
/// … and the width of a cell with the error of the position, metres.
const BEARING_TOLERANCE_M: f64 = 0.025;

/// A surface seen at a flatter angle than this (cosine to its normal) may be passed by unseen.
const GRAZING_COSINE: f64 = 0.35;
/// A beam that comes from behind a surface (cosine to the side it was seen from) …
const BEHIND_COSINE: f64 = 0.2;
/// … and ends sooner than this after it, metres, has met the same wall's other face.
const BEHIND_M: f64 = 0.5;

/// Beams nearer to each other than this are one direction: with it a turn can be counted in beams.
const INCREMENT_MIN_RAD: f64 = 1e-12;

/// What an observation says about a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// A beam ended there: something stands there.
    Hit,
    /// The beams went through it and ended well behind: nothing stands there.
    Miss,
    /// The beams towards it gave no return: free space, if this lidar rarely loses a surface.
    NoReturn,
    /// Out of reach, outside the field of view, occluded, or in doubt.
    Unknown,
}

/// What an observation may say about a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Visibility {
    /// Beams reached it: it may have hit or missed something.
    Reached,
    /// No beam reached it, but some gave no return.
    NoReturns,
    /// All beams ended before it, or it is out of reach: it says nothing.
    Hidden,
}

/// A scan with the pose of its lidar.
#[derive(Debug, Clone)]
pub struct Observation {
    scan: LaserScan,
    eye: Vector2<f64>,
    map_from_lidar: Transform2,
    lidar_from_map: Transform2,
    reach_m: f64,
    /// Of the first beam, in [−π, π].
    angle_min_rad: f64,
    beams_per_rad: f64,
    beams_a_turn: i64,
    tolerances_m: (f64, f64),
    /// Between these distances from the lidar it says where nothing stands, metres.
    clear_m: (f64, f64),
}

impl Observation {
    /// Of a scan taken at `map_from_base`.
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

    /// Where the lidar was, map frame, metres.
    pub fn eye(&self) -> Vector2<f64> {
        self.eye
    }

    /// Its scan.
    pub fn scan(&self) -> &LaserScan {
        &self.scan
    }

    /// How far from the lidar cells are asked about, metres.
    pub fn reach_m(&self) -> f64 {
        self.reach_m
    }

    /// Where a beam ended, map frame, metres; `None` without a range.
    pub fn end_of(&self, beam: usize) -> Option<Vector2<f64>> {
        let range_m = self.scan.range_m(beam)?;
        let (sin, cos) = self.scan.lidar().beam_angle_rad(beam).sin_cos();
        let in_lidar = range_m * Vector2::new(cos, sin);
        Some(self.map_from_lidar.apply(&in_lidar))
    }

    /// Where its beams ended within reach, map frame, metres.
    pub fn hits(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let directions = self.scan.lidar().beam_directions(self.scan.beam_count());
        directions.enumerate().filter_map(|(beam, direction)| {
            let range_m = self.scan.range_m(beam)?;
            (range_m < self.reach_m).then(|| self.map_from_lidar.apply(&(range_m * direction)))
        })
    }

    /// Those of its hits that lie within a distance of a place. Cost: the beams towards it.
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

    /// What it says about a cell. Cost: the beams across the cell.
    ///
    /// One beam that ends there makes a hit, all must go by for a miss: beams pass beside thin
    /// things, and a beam at a depth edge ends anywhere. Of a height band nothing is missed where the
    /// lidar does not see enough of the band.
    pub fn test(&self, cell: &Cell) -> Outcome {
        let Some(Asked {
            towards,
            range_m,
            beams,
            depth,
        }) = self.ask(cell)
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
        let asked = beams.last - beams.first + 1;
        let outside = asked - seen.ranges - seen.without_return;
        if 2 * (asked - seen.ranges) <= asked && self.has_central_ranges(&beams, range_m) {
            let nearest_behind_m = seen.nearest_m - range_m;
            let in_doubt = self.may_pass_by(cell, &towards, range_m, nearest_behind_m);
            return if in_doubt {
                Outcome::Unknown
            } else {
                Outcome::Miss
            };
        }
        if outside == 0 && seen.without_return == asked {
            return Outcome::NoReturn;
        }
        Outcome::Unknown
    }

    /// Whether something nearer hides a cell.
    pub fn hides(&self, cell: &Cell) -> bool {
        self.ask(cell).is_some_and(|asked| {
            let seen = self.readings(&asked.beams, &asked.depth);
            !seen.is_hit && seen.nearest_m < asked.depth.hit_from_m
        })
    }

    /// Which beams answer for a cell, and how; `None` if it is out of reach.
    fn ask(&self, cell: &Cell) -> Option<Asked> {
        let towards = cell.centre - self.eye;
        let range_squared = towards.norm_squared();
        if !(NEAREST_M * NEAREST_M..=self.reach_m * self.reach_m).contains(&range_squared) {
            return None;
        }
        let range_m = range_squared.sqrt();
        let hit_within_m = self.hit_within_m(range_m, cell.half_width_m);
        let miss_beyond_m =
            self.tolerances_m.1 + cell.half_width_m + MISS_TOLERANCE_PER_RANGE * range_m;
        Some(Asked {
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

    /// What the beams towards a cell read.
    fn readings(&self, beams: &Beams, depth: &Depth) -> Readings {
        let per_m = 1.0 / self.scan.tick_m();
        let tick = |range_m: f64| (range_m * per_m).clamp(1.0, f64::from(INVALID_TICK - 1));
        let hit_from = tick(depth.hit_from_m).ceil() as u16;
        let hit_to = tick(depth.hit_to_m) as u16;
        let width = hit_to.saturating_sub(hit_from);
        // Sums of one width and without branches: several beams at a time.
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

    /// Whether one of the beams next to a cell's bearing reads a range; where they are far apart,
    /// whether all of them do: on a slanted surface one ends nearer and the other farther away.
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

    /// Beams of the scan between two places, which may lie before its first and after its last:
    /// across the seam of a full turn.
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

    /// What it may say about cells (of this half width) in a circle.
    pub fn visibility_of(
        &self,
        centre: &Vector2<f64>,
        radius_m: f64,
        half_width_m: f64,
    ) -> Visibility {
        let towards = centre - self.eye;
        let range_m = towards.norm();
        let nearest_m = range_m - radius_m;
        if nearest_m > self.reach_m {
            return Visibility::Hidden;
        }
        if nearest_m < NEAREST_M {
            return Visibility::Reached;
        }
        let half_rad = (radius_m / range_m).asin() + bearing_tolerance_rad(nearest_m, half_width_m);
        let half = (half_rad * self.beams_per_rad).max(1.0) + 1.0;
        let bearing = self.bearing(&self.lidar_from_map.turn(&towards));
        let hit_from_m = nearest_m - self.hit_within_m(range_m + radius_m, half_width_m);
        let (mut longest, mut no_return) = (0, false);
        for part in self
            .parts(floor(bearing - half), floor(bearing + half) + 1)
            .into_iter()
            .flatten()
        {
            for &tick in &self.scan.ticks()[part] {
                longest = longest.max(if is_range(tick) { tick } else { 0 });
                no_return |= tick == NO_RETURN_TICK;
            }
        }
        if f64::from(longest) * self.scan.tick_m() >= hit_from_m {
            Visibility::Reached
        } else if no_return {
            Visibility::NoReturns
        } else {
            Visibility::Hidden
        }
    }

    /// Whether a surface may stand there although beams went by.
    fn may_pass_by(
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

    /// Where a direction lies, in beams from the first.
    fn bearing(&self, in_lidar: &Vector2<f64>) -> f64 {
        let from_first_rad = direction_rad(in_lidar) - self.angle_min_rad;
        let turns = if from_first_rad < 0.0 { TAU } else { 0.0 };
        (from_first_rad + turns) * self.beams_per_rad
    }
}

/// What is asked of an observation about a cell.
struct Asked {
    /// From the lidar to the cell, map frame, metres.
    towards: Vector2<f64>,
    range_m: f64,
    beams: Beams,
    depth: Depth,
}

/// Ranges by which a beam answers for a cell, metres.
struct Depth {
    hit_from_m: f64,
    hit_to_m: f64,
    miss_from_m: f64,
}

/// What some beams read.
struct Readings {
    /// Whether one of them ended at the depth asked for.
    is_hit: bool,
    /// Shortest range, metres.
    nearest_m: f64,
    /// Beams without a return.
    without_return: i64,
    /// Beams with a range.
    ranges: i64,
}

/// Beams that answer for a cell.
struct Beams {
    /// Where the cell is, in beams from the first.
    bearing: f64,
    first: i64,
    last: i64,
}

/// How far behind a surface a beam must end to have missed it, for a standard deviation of the
/// ranges in metres: metres, and metres for each metre of range.
pub fn miss_tolerance(range_sigma_m: f64) -> (f64, f64) {
    let at_no_range_m = MISS_TOLERANCE_M + MISS_SIGMAS * range_sigma_m;
    (at_no_range_m, MISS_TOLERANCE_PER_RANGE)
}

/// How far to each side of a cell's bearing beams answer for it, radians.
fn bearing_tolerance_rad(range_m: f64, half_width_m: f64) -> f64 {
    BEARING_TOLERANCE_RAD + (BEARING_TOLERANCE_M + 0.5 * half_width_m) / range_m
}

fn is_range(tick: u16) -> bool {
    tick != NO_RETURN_TICK && tick != INVALID_TICK
}

/// Without a call into a library, as `f64::floor` is on older machines.
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole - i64::from(whole as f64 > value)
}

/// How far from such a lidar cells are asked about, metres.
pub fn reach_m(lidar: &Lidar) -> f64 {
    let dense_m = BEAM_SPACING_MAX_M / lidar.angle_increment_rad;
    dense_m
        .clamp(REACH_SPARSE_M, REACH_M)
        .min(RANGE_SHARE * lidar.range_max_m)
}

#[cfg(test)]
mod tests;
