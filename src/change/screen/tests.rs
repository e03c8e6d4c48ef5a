use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::geometry::{Pose2, distance_to_polygon};
use crate::ids::{NodeId, StampNs, TripId};
use crate::observation::testing::{World, all_round};
use crate::scan::LaserScan;

const BEAMS: usize = 180;
/// Where the box stands.
const BOX: [[f64; 2]; 2] = [[2.6, 1.2], [3.0, 1.6]];
const PASS_S: i64 = 1_000;
const VIEWS: usize = 4;

fn room() -> World {
    World::default().with_rectangle([0.0, 0.0], [4.0, 3.0])
}

fn with_box() -> World {
    room().with_rectangle(BOX[0], BOX[1])
}

/// The sites to be judged if alerts with these regions wait.
fn touched_sites(screen: &Screen, regions: &[Vec<Vector2<f64>>]) -> Vec<CandidateSite> {
    let regions = regions.iter().map(Vec::as_slice);
    screen.touched_sites(regions.filter(|region| screen.is_touched(region)))
}

fn box_region() -> Vec<Vector2<f64>> {
    let [[x, y], [to_x, to_y]] = BOX;
    [[x, y], [to_x, y], [to_x, to_y], [x, to_y]]
        .map(Vector2::from)
        .to_vec()
}

/// An observation as a map keeps it.
#[derive(Clone)]
struct Kept {
    key: ObservationKey,
    trip: TripId,
    stamp: StampNs,
    map_from_base: Pose2,
    scan: LaserScan,
}

impl Kept {
    fn moved(&self, x: f64, y: f64) -> Self {
        let pose = self.map_from_base;
        Self {
            map_from_base: Pose2::new(pose.x + x, pose.y + y, pose.theta),
            ..self.clone()
        }
    }
}

/// A few views of a world, each pass of a trip of its own.
fn pass(number: usize, world: &World) -> Vec<Kept> {
    let lidar = Arc::new(all_round(BEAMS));
    let view = |k: usize| {
        // On whole steps of the screen's poses.
        let map_from_base = Pose2::new(0.6 + 0.5 * k as f64, 0.6 + 0.04 * number as f64, 0.4);
        let seconds = PASS_S * number as i64 + k as i64;
        Kept {
            key: (NodeId((VIEWS * number) as i64), k as u32),
            trip: TripId::new(format!("trip-{number}")).unwrap(),
            stamp: StampNs(seconds * 1_000_000_000),
            map_from_base,
            scan: world.scan(&lidar, BEAMS, &map_from_base, || 0.0),
        }
    };
    (0..VIEWS).map(view).collect()
}

/// Two passes before the box came, two since.
fn appears() -> Vec<Kept> {
    let passes = [room(), room(), with_box(), with_box()];
    passes
        .iter()
        .enumerate()
        .flat_map(|(k, world)| pass(k, world))
        .collect()
}

fn update<'a>(screen: &mut Screen, observations: impl IntoIterator<Item = &'a Kept>) {
    screen.update(observations.into_iter().map(|kept| Screened {
        key: kept.key,
        trip: &kept.trip,
        stamp: kept.stamp,
        map_from_base: kept.map_from_base,
        scan: &kept.scan,
    }));
}

fn fresh<'a>(observations: impl IntoIterator<Item = &'a Kept>) -> Screen {
    let mut screen = Screen::default();
    update(&mut screen, observations);
    screen
}

type Counts = Vec<(i64, u32, [u32; 3])>;

/// All that is kept of every cell.
fn counts(screen: &Screen) -> Vec<(CellKey, u32, bool, Counts)> {
    let of_cell = |cell: &CountedCell| {
        let passes = cell.passes.iter();
        let passes = passes.map(|p| (p.pass.span, p.pass.trip, [p.hits, p.misses, p.no_returns]));
        (cell.key, cell.hit_by, cell.candidate, passes.collect())
    };
    screen.grid.cells().map(of_cell).collect()
}

/// Which observations are kept.
fn recorded(screen: &Screen) -> BTreeSet<ObservationKey> {
    let everywhere = Vector2::repeat(1e3);
    let recorded = screen.recorded.between(&-everywhere, &everywhere);
    recorded.map(|recorded| recorded.key).collect()
}

fn is_at_the_box(site: &CandidateSite) -> bool {
    let near = |cell: &Vector2<f64>| distance_to_polygon(cell, &box_region()) < 0.15;
    site.cells.iter().all(near)
}

#[test]
fn an_unchanged_room_has_no_site() {
    let passes = (0..4).flat_map(|k| pass(k, &room()));
    assert_eq!(fresh(&passes.collect::<Vec<_>>()).all_sites(), []);
    assert_eq!(Screen::default().all_sites(), []);
}

#[test]
fn a_box_that_appears_or_disappears_is_a_site() {
    let mut disappears = Vec::new();
    for (k, world) in [with_box(), with_box(), room(), room()].iter().enumerate() {
        disappears.extend(pass(k, world));
    }
    for observations in [appears(), disappears] {
        let sites = fresh(&observations).all_sites();
        assert_eq!(sites.len(), 1, "{sites:?}");
        assert!(is_at_the_box(&sites[0]), "{sites:?}");
        assert!(sites[0].cells.len() >= 4);
    }
}

#[test]
fn everyone_who_may_have_seen_a_site_is_asked_about_it() {
    let observations = appears();
    let screen = fresh(&observations);
    let mut asked = screen.observations_of(&screen.all_sites()[0]);
    asked.sort_unstable();
    let all: Vec<ObservationKey> = observations.iter().map(|kept| kept.key).collect();
    assert_eq!(asked, all);
}

#[test]
fn what_is_touched_is_named_until_it_is_settled() {
    let observations = appears();
    let mut screen = fresh(&observations[..2 * VIEWS]);
    assert_eq!(touched_sites(&screen, &[]), []);
    assert!(
        screen.is_touched(&[Vector2::new(1.0, 0.1)]),
        "a wall is new too"
    );
    screen.mark_judged();
    assert!(!screen.is_touched(&[Vector2::new(1.0, 0.1)]));
    update(&mut screen, &observations);
    let sites = touched_sites(&screen, &[]);
    assert_eq!(sites, screen.all_sites());
    assert_eq!(sites.len(), 1);
    // It stays touched until somebody has judged it.
    update(&mut screen, &observations);
    assert_eq!(touched_sites(&screen, &[]), sites);
    screen.mark_judged();
    assert_eq!(touched_sites(&screen, &[box_region()]), []);
    assert!(!screen.is_touched(&box_region()));
    // The same observations again are no news, nor is a pose that moves by a hair.
    update(&mut screen, &observations);
    let moved: Vec<Kept> = observations
        .iter()
        .map(|kept| kept.moved(1e-4, -1e-4))
        .collect();
    update(&mut screen, &moved);
    assert_eq!(touched_sites(&screen, &[box_region()]), []);
    assert_eq!(screen.all_sites(), sites);
}

#[test]
fn a_region_is_touched_by_what_is_near_and_by_nothing_else() {
    let observations = appears();
    let mut screen = fresh(&observations);
    screen.mark_judged();
    // A post where nothing was, half a metre from the box.
    let post = room().with_rectangle([2.2, 2.0], [2.3, 2.1]);
    let all: Vec<Kept> = observations.into_iter().chain(pass(4, &post)).collect();
    update(&mut screen, &all);
    let square = |x: f64, y: f64| {
        let corners = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]];
        corners
            .map(|c| Vector2::new(x, y) + Vector2::from(c))
            .to_vec()
    };
    assert!(screen.is_touched(&square(2.25, 2.05)), "on it");
    assert!(screen.is_touched(&square(1.95, 2.0)), "0.15 m beside it");
    assert!(!screen.is_touched(&square(1.2, 1.4)), "in the free space");
    assert!(!screen.is_touched(&square(30.0, 30.0)), "far away");
    assert!(!screen.is_touched(&[]));
}

#[test]
fn a_region_is_touched_when_all_that_was_hit_there_is_gone() {
    let observations = appears();
    let mut screen = fresh(&observations);
    screen.mark_judged();
    // Whoever saw the box leaves; then nothing is left to touch but its absence.
    update(&mut screen, &observations[..2 * VIEWS]);
    assert!(screen.is_touched(&box_region()));
    assert_eq!(touched_sites(&screen, &[box_region()]), []);
    screen.mark_judged();
    update(&mut screen, &observations);
    screen.mark_judged();
    // The like if a solve carries them away.
    let moves = observations.iter().enumerate();
    let carried = moves.map(|(k, kept)| kept.moved(if k < 2 * VIEWS { 0.0 } else { 40.0 }, 0.0));
    update(&mut screen, &carried.collect::<Vec<_>>());
    assert!(screen.is_touched(&box_region()));
}

#[test]
fn a_cell_that_becomes_a_candidate_is_news_though_its_counts_hardly_change() {
    let with_misses = |misses: u32| {
        let counts = |span, hits, misses| PassCounts {
            pass: PassKey { span, trip: 0 },
            hits,
            misses,
            no_returns: 0,
        };
        let mut cell = CountedCell::new((0, 0));
        cell.passes = vec![counts(0, 0, 8), counts(1, 6, misses)];
        cell.candidate = cell.has_change();
        cell
    };
    let (doubtful, clear) = (with_misses(3), with_misses(2));
    assert!(clear.candidate && !doubtful.candidate);
    assert_ne!(clear.signature(), doubtful.signature());
}

/// How a set of observations came to be what it is.
#[derive(Debug, Clone)]
struct Way {
    /// For each update: which observations are there, and where to they are moved, in steps of
    /// 5 cm.
    updates: Vec<Vec<(bool, i8, i8)>>,
    settles: Vec<bool>,
    /// The last set.
    last: Vec<bool>,
    order: Vec<usize>,
}

fn any_way() -> impl Strategy<Value = Way> {
    let count = 4 * VIEWS;
    let update = proptest::collection::vec((any::<bool>(), -2..=2_i8, -2..=2_i8), count);
    (
        proptest::collection::vec(update, 0..4),
        proptest::collection::vec(any::<bool>(), 4),
        proptest::collection::vec(proptest::bool::weighted(0.8), count),
        Just((0..count).collect::<Vec<usize>>()).prop_shuffle(),
    )
        .prop_map(|(updates, settles, last, order)| Way {
            updates,
            settles,
            last,
            order,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever came, went and moved in between.
    #[test]
    fn counts_are_a_function_of_the_set_of_observations(way in any_way()) {
        let observations = appears();
        let mut screen = Screen::default();
        for (update_of, settles) in way.updates.iter().zip(&way.settles) {
            let there = observations.iter().zip(update_of).filter(|(_, (is_there, ..))| *is_there);
            let moved = there.map(|(kept, (_, x, y))| {
                kept.moved(0.05 * f64::from(*x), 0.05 * f64::from(*y))
            });
            update(&mut screen, &moved.collect::<Vec<_>>());
            if *settles {
                screen.mark_judged();
            }
        }
        let is_there = |k: &&usize| way.last[**k];
        let shuffled = way.order.iter().filter(is_there).map(|&k| &observations[k]);
        update(&mut screen, shuffled);
        let expected = fresh((0..observations.len()).filter(|k| way.last[*k]).map(|k| &observations[k]));
        prop_assert_eq!(counts(&screen), counts(&expected));
        prop_assert_eq!(screen.all_sites(), expected.all_sites());
        prop_assert_eq!(recorded(&screen), recorded(&expected));
        update(&mut screen, []);
        prop_assert!(counts(&screen).is_empty() && recorded(&screen).is_empty());
    }

    /// A site that is there now and was not when the last ones were judged, or has other cells, is
    /// named.
    #[test]
    fn sites_that_are_new_are_among_those_touched(way in any_way()) {
        let observations = appears();
        let mut screen = Screen::default();
        let mut before = Vec::new();
        let lists = way.updates.iter().map(|update_of| {
            update_of.iter().map(|(is_there, ..)| *is_there).collect::<Vec<bool>>()
        });
        for is_there in lists.chain([way.last.clone()]) {
            let there = observations.iter().zip(&is_there).filter(|(_, is_there)| **is_there);
            update(&mut screen, there.map(|(kept, _)| kept));
            let touched: BTreeSet<CellKey> = touched_sites(&screen, &[]).iter()
                .flat_map(|site| site.cells.iter().map(key_of))
                .collect();
            let after: Vec<CellKey> = screen.all_sites().iter()
                .flat_map(|site| site.cells.iter().map(key_of))
                .collect();
            for cell in after.iter().filter(|cell| !before.contains(*cell)) {
                prop_assert!(touched.contains(cell), "{cell:?}");
            }
            before = after;
            screen.mark_judged();
            prop_assert_eq!(touched_sites(&screen, &[box_region()]), vec![]);
        }
    }
}

/// Of the fit of an observation that is held to have been taken elsewhere.
fn fit_of_misplaced(x: f64, y: f64, turn_rad: f64) -> (Fit, Pose2) {
    let observations: Vec<Kept> = (0..3).flat_map(|k| pass(k, &room())).collect();
    let screen = fresh(&observations);
    let kept = &observations[6];
    let right = kept.map_from_base;
    let given = Pose2::new(right.x + x, right.y + y, right.theta + turn_rad);
    (screen.fit(&kept.key, &kept.scan, &given), right)
}

#[test]
fn an_observation_that_fits_stays_where_it_is() {
    let (fit, right) = fit_of_misplaced(0.0, 0.0, 0.0);
    assert_eq!(fit.map_from_base, right);
    assert!(
        fit.agreement.is_known() && !fit.agreement.is_wrong(),
        "{fit:?}"
    );
}

#[test]
fn a_wrong_pose_near_the_right_one_is_mended() {
    for (x, y) in [(0.28, 0.0), (0.0, -0.28)] {
        let (fit, right) = fit_of_misplaced(x, y, 0.0);
        let off = right.between(&fit.map_from_base);
        assert!(!fit.agreement.is_wrong(), "{fit:?}");
        assert!(
            off.translation().norm() < 0.12 && off.theta.abs() < 0.04,
            "{off:?}"
        );
    }
}

#[test]
fn a_pose_that_is_far_off_is_wrong_and_stays() {
    let (fit, right) = fit_of_misplaced(1.1, 0.9, 0.6);
    assert!(fit.agreement.is_wrong(), "{fit:?}");
    assert_eq!(
        fit.map_from_base,
        Pose2::new(right.x + 1.1, right.y + 0.9, right.theta + 0.6)
    );
}

#[test]
fn in_a_place_of_which_much_is_gone_an_observation_is_not_wrong() {
    // Boxes before most of the walls, which nobody sees until they are gone.
    let crowded = [0.2, 1.0, 1.8, 2.6, 3.3].iter().fold(room(), |world, &x| {
        let world = world.with_rectangle([x, 2.4], [x + 0.5, 2.9]);
        world.with_rectangle([x, 0.1], [x + 0.5, 0.25])
    });
    let mut observations: Vec<Kept> = (0..3).flat_map(|k| pass(k, &crowded)).collect();
    observations.extend(pass(3, &room()));
    let screen = fresh(&observations);
    for kept in &observations[3 * VIEWS..] {
        let fit = screen.fit(&kept.key, &kept.scan, &kept.map_from_base);
        let Agreement { asked, hits } = fit.agreement;
        assert!(asked >= 15 && 4 * hits < 3 * asked, "{fit:?}");
        assert!(!fit.agreement.is_wrong(), "{fit:?}");
        assert_eq!(fit.map_from_base, kept.map_from_base);
    }
}

#[test]
fn what_only_its_own_pass_saw_says_nothing_about_an_observation() {
    let observations = pass(0, &room());
    let kept = &observations[3];
    let fit = fresh(&observations).fit(&kept.key, &kept.scan, &kept.map_from_base);
    assert_eq!(fit.agreement, Agreement::default());
}

#[test]
fn a_pass_that_contradicts_both_neighbours_errs_and_a_change_does_not() {
    let contradictions = |hits_of_passes: &[u32]| {
        let mut cell = CountedCell::new((0, 0));
        let counts = |(span, &hits): (usize, &u32)| PassCounts {
            pass: PassKey {
                span: span as i64,
                trip: 0,
            },
            hits,
            misses: 8 - hits,
            no_returns: 0,
        };
        cell.passes = hits_of_passes.iter().enumerate().map(counts).collect();
        cell.contradictions()
    };
    assert_eq!(contradictions(&[8, 0, 8, 8]), (1, 2));
    assert_eq!(contradictions(&[8, 8, 0, 0]), (0, 2));
    // One that is undecided is no pass, and two tell nothing.
    assert_eq!(contradictions(&[8, 4, 8]), (0, 0));
}
