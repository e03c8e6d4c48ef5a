//! The pose of a scan within a window, without a good guess: branch and bound over a likelihood
//! grid (Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016, section V-B).

use super::LikelihoodGrid;
use crate::geometry::{Pose2, Vector2, angle_difference_rad};

/// Where to look: `reference_from_base` within a square and a turn around a centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchWindow {
    /// `reference_from_base` in the middle.
    pub centre: Pose2,
    /// Half the width of the square, metres.
    pub half_width_m: f64,
    /// Half the turn, radians; π for all directions.
    pub half_turn_rad: f64,
}

/// What counts as found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchParams {
    /// Least mean likelihood of the scan's points, in [0, 1].
    pub score_min: f64,
    /// Another pose counts as another place if it is farther than this, metres …
    pub distinct_distance_m: f64,
    /// … or turned by more than this, radians.
    pub distinct_turn_rad: f64,
    /// Another place is looked for down to this share of the best score.
    pub rival_share: f64,
    /// Whether the best such place is wanted; any is found sooner.
    pub wants_best_rival: bool,
}

/// The best pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchHit {
    /// `reference_from_base`, on the grid of the search.
    pub pose: Pose2,
    /// Mean likelihood of the scan's points, in [0, 1].
    pub score: f64,
    /// A pose elsewhere that reaches the stated share of the score: the best or any, as was wanted.
    pub rival: Option<(Pose2, f64)>,
}

impl SearchWindow {
    /// Everywhere on the grid, in all directions.
    pub fn everywhere(grid: &LikelihoodGrid) -> Self {
        let centre = grid.centre();
        let size = grid.size_m();
        Self {
            centre: Pose2::new(centre.x, centre.y, 0.0),
            half_width_m: 0.5 * size.x.max(size.y) + 1.0,
            half_turn_rad: std::f64::consts::PI,
        }
    }
}

#[derive(Clone, Copy)]
struct Candidate {
    bound: u32,
    turn: usize,
    x: i64,
    y: i64,
    level: usize,
}

/// The scan's points, turned and in cells, for every angle of the search.
struct Rotations {
    angles_rad: Vec<f64>,
    cells: Vec<Vec<(i64, i64)>>,
}

/// The pose within the window at which the points, in the base frame, fit the grid best.
///
/// `None` if no pose reaches `score_min`, and where so many come near it that looking at them all would
/// take too long: such points fit anywhere. With `rival`, it tells whether the place is unlike all others.
pub fn search(
    grid: &LikelihoodGrid,
    points: &[Vector2<f64>],
    window: &SearchWindow,
    params: &SearchParams,
) -> Option<SearchHit> {
    if points.is_empty() {
        return None;
    }
    let rotations = rotate(grid, points, window);
    let reach = (window.half_width_m / grid.resolution_m()).ceil() as i64;
    let to_pose = |c: &Candidate| {
        Pose2::new(
            window.centre.x + c.x as f64 * grid.resolution_m(),
            window.centre.y + c.y as f64 * grid.resolution_m(),
            rotations.angles_rad[c.turn],
        )
    };
    let full = 255.0 * points.len() as f64;
    let floor = (params.score_min * full) as u32;
    let best = descend(grid, &rotations, reach, floor, Wanted::Best, |_| true).ok()??;
    let pose = to_pose(&best);
    // Whether any pose of a candidate's square is: nothing is lost by passing over the hill of the
    // best pose, and along a corridor hills are long.
    let elsewhere = |c: &Candidate| {
        let farthest_cells = |from: i64, best: i64| {
            let to = from + (1 << c.level) - 1;
            (from - best).abs().max((to - best).abs()) as f64
        };
        let cells = farthest_cells(c.x, best.x).hypot(farthest_cells(c.y, best.y));
        let heading_rad = rotations.angles_rad[c.turn];
        cells * grid.resolution_m() > params.distinct_distance_m
            || angle_difference_rad(heading_rad, pose.theta) > params.distinct_turn_rad
    };
    let rival_floor = (params.rival_share * f64::from(best.bound)) as u32;
    // Nothing beats the best: a rival that must is not looked for.
    let rival = if rival_floor < best.bound {
        let wanted = match params.wants_best_rival {
            true => Wanted::Best,
            false => Wanted::Any,
        };
        descend(grid, &rotations, reach, rival_floor, wanted, elsewhere).ok()?
    } else {
        None
    };
    Some(SearchHit {
        pose,
        score: f64::from(best.bound) / full,
        rival: rival.map(|c| (to_pose(&c), f64::from(c.bound) / full)),
    })
}

/// Most angles on each side; points too far away for so many are compared more coarsely.
const HALF_TURN_STEPS_MAX: i64 = 4_096;

fn rotate(grid: &LikelihoodGrid, points: &[Vector2<f64>], window: &SearchWindow) -> Rotations {
    let farthest_m = points.iter().map(|p| p.norm()).fold(0.0, f64::max);
    let step_rad = (grid.resolution_m() / farthest_m.max(grid.resolution_m())).min(0.2);
    let steps = ((window.half_turn_rad / step_rad).ceil() as i64).min(HALF_TURN_STEPS_MAX);
    let all_round = window.half_turn_rad >= std::f64::consts::PI;
    let range = if all_round {
        -steps..=steps - 1
    } else {
        -steps..=steps
    };
    let angles_rad: Vec<f64> = range
        .map(|k| window.centre.theta + k as f64 * window.half_turn_rad / steps.max(1) as f64)
        .collect();
    let centre = window.centre.translation();
    let cells = angles_rad
        .iter()
        .map(|&angle| {
            let turned = Pose2::new(centre.x, centre.y, angle).to_transform();
            points
                .iter()
                .map(|p| grid.cell_of(&turned.apply(p)))
                .collect()
        })
        .collect();
    Rotations { angles_rad, cells }
}

/// Which leaf is wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Wanted {
    Best,
    Any,
}

/// So many candidates may be branched for each search, and as many more as there are squares to begin with.
/// Searches in real buildings take some hundred, at most 100,000.
const BRANCHES_MAX: usize = 200_000;

/// Too many candidates are about as good as the best.
struct Exhausted;

/// Depth-first branch and bound: the leaf with the greatest sum above `floor`, or any with one,
/// that is `allowed`, as is every candidate that has such a leaf.
fn descend(
    grid: &LikelihoodGrid,
    rotations: &Rotations,
    reach: i64,
    floor: u32,
    wanted: Wanted,
    allowed: impl Fn(&Candidate) -> bool,
) -> Result<Option<Candidate>, Exhausted> {
    let mut top = grid.level_count() - 1;
    while top > 0 && (1i64 << top) > 2 * reach + 1 {
        top -= 1;
    }
    let side = 1i64 << top;
    let mut roots = Vec::new();
    let mut branches_left = BRANCHES_MAX;
    for turn in 0..rotations.cells.len() {
        for x in (-reach..=reach).step_by(side as usize) {
            for y in (-reach..=reach).step_by(side as usize) {
                branches_left += 1;
                let bound = sum(grid, &rotations.cells[turn], x, y, top, floor);
                if bound > floor {
                    roots.push(Candidate {
                        bound,
                        turn,
                        x,
                        y,
                        level: top,
                    });
                }
            }
        }
    }
    roots.sort_by(|a, b| (b.bound, a.turn, a.x, a.y).cmp(&(a.bound, b.turn, b.x, b.y)));
    let (mut best, mut floor) = (None, floor);
    let mut stack: Vec<Candidate> = Vec::new();
    for root in roots {
        if root.bound <= floor {
            break;
        }
        stack.push(root);
        while let Some(candidate) = stack.pop() {
            if candidate.bound <= floor || !allowed(&candidate) {
                continue;
            }
            if candidate.level == 0 {
                if wanted == Wanted::Any {
                    return Ok(Some(candidate));
                }
                floor = candidate.bound;
                best = Some(candidate);
                continue;
            }
            branches_left = branches_left.checked_sub(1).ok_or(Exhausted)?;
            branch(grid, rotations, reach, floor, &candidate, &mut stack);
        }
    }
    Ok(best)
}

/// Pushes the four children of a candidate that may beat the floor, the best last.
fn branch(
    grid: &LikelihoodGrid,
    rotations: &Rotations,
    reach: i64,
    floor: u32,
    parent: &Candidate,
    stack: &mut Vec<Candidate>,
) {
    let level = parent.level - 1;
    let half = 1i64 << level;
    let first = stack.len();
    for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
        let (x, y) = (parent.x + dx, parent.y + dy);
        if x > reach || y > reach {
            continue;
        }
        let bound = sum(grid, &rotations.cells[parent.turn], x, y, level, floor);
        if bound > floor {
            stack.push(Candidate {
                bound,
                x,
                y,
                level,
                ..*parent
            });
        }
    }
    stack[first..].sort_by_key(|c| c.bound);
}

/// So many cells are summed before it is asked whether the others can still lift the sum above
/// the floor.
const CELLS_TOGETHER: usize = 32;

/// The sum of a level's values at cells that are moved by `(x, y)`; 0 where it is not above the
/// floor.
fn sum(
    grid: &LikelihoodGrid,
    cells: &[(i64, i64)],
    x: i64,
    y: i64,
    level: usize,
    floor: u32,
) -> u32 {
    let mut sum = 0;
    let mut left = cells.len();
    for together in cells.chunks(CELLS_TOGETHER) {
        let values = together.iter();
        sum += values
            .map(|&(cx, cy)| u32::from(grid.value(level, cx + x, cy + y)))
            .sum::<u32>();
        left -= together.len();
        if sum + 255 * left as u32 <= floor {
            return 0;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const PARAMS: SearchParams = SearchParams {
        score_min: 0.3,
        distinct_distance_m: 0.5,
        distinct_turn_rad: 0.3,
        rival_share: 0.9,
        wants_best_rival: true,
    };

    fn corner(x: f64, y: f64) -> impl Iterator<Item = Vector2<f64>> {
        (0..30).map(move |k| {
            let s = k as f64 * 0.1;
            if k % 2 == 0 {
                Vector2::new(x + s, y)
            } else {
                Vector2::new(x, y + 0.7 * s)
            }
        })
    }

    #[test]
    fn branch_and_bound_finds_what_brute_force_finds() {
        let reference: Vec<_> = corner(1.0, 2.0)
            .chain(corner(-3.0, 1.0).map(|p| Vector2::new(p.y, -p.x)))
            .collect();
        let grid = LikelihoodGrid::new(reference.iter().copied(), 0.1, 0.15, 5).unwrap();
        let truth = Pose2::new(0.4, -0.3, 0.5);
        let points: Vec<_> = reference
            .iter()
            .map(|p| truth.inverse().transform(p))
            .collect();
        let window = SearchWindow {
            centre: Pose2::IDENTITY,
            half_width_m: 1.0,
            half_turn_rad: 0.8,
        };
        let hit = search(&grid, &points, &window, &PARAMS).unwrap();
        let rotations = rotate(&grid, &points, &window);
        let brute = (0..rotations.cells.len())
            .flat_map(|t| (-10..=10).flat_map(move |x| (-10..=10).map(move |y| (t, x, y))))
            .map(|(t, x, y)| sum(&grid, &rotations.cells[t], x, y, 0, 0))
            .max()
            .unwrap();
        assert_eq!(
            (hit.score * 255.0 * points.len() as f64).round() as u32,
            brute
        );
        assert!((hit.pose.translation() - truth.translation()).norm() < 0.15);
        assert!(hit.rival.is_none());
    }

    #[test]
    fn two_like_places_are_told() {
        let reference: Vec<_> = corner(0.0, 0.0).chain(corner(8.0, 0.0)).collect();
        let grid = LikelihoodGrid::new(reference.iter().copied(), 0.1, 0.15, 6).unwrap();
        let points: Vec<_> = corner(0.0, 0.0).collect();
        let hit = search(&grid, &points, &SearchWindow::everywhere(&grid), &PARAMS).unwrap();
        let (rival, score) = hit.rival.unwrap();
        assert!(score >= 0.9 * hit.score);
        assert!(((rival.x - hit.pose.x).abs() - 8.0).abs() < 0.3);
    }

    #[test]
    fn what_fits_anywhere_is_found_nowhere() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut anywhere = |count: usize, reach_m: f64| -> Vec<Vector2<f64>> {
            let mut coordinate = || rng.random_range(-reach_m..reach_m);
            (0..count)
                .map(|_| Vector2::new(coordinate(), coordinate()))
                .collect()
        };
        let grid = LikelihoodGrid::new(anywhere(4_000, 12.0).into_iter(), 0.1, 0.15, 5).unwrap();
        let points = anywhere(180, 8.0);
        let window = SearchWindow {
            centre: Pose2::IDENTITY,
            half_width_m: 4.0,
            half_turn_rad: 0.8,
        };
        let cells = rotate(&grid, &points, &window).cells;
        let floor = (PARAMS.score_min * 255.0 * 180.0) as u32;
        assert!(
            cells
                .iter()
                .any(|cells| sum(&grid, cells, 0, 0, 0, floor) > floor)
        );
        assert!(search(&grid, &points, &window, &PARAMS).is_none());
    }

    #[test]
    fn nothing_alike_is_no_hit() {
        let reference: Vec<_> = corner(0.0, 0.0).collect();
        let grid = LikelihoodGrid::new(reference.iter().copied(), 0.1, 0.1, 4).unwrap();
        let points: Vec<_> = (0..40)
            .map(|k| Vector2::new(k as f64 * 0.9, (k % 7) as f64 * 3.0))
            .collect();
        assert!(search(&grid, &points, &SearchWindow::everywhere(&grid), &PARAMS).is_none());
    }
}
