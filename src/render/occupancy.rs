//! Where a map is occupied, free or unknown.

use std::collections::{BTreeMap, BTreeSet};

use super::cells::for_each_cell_before_end;
use super::decided::{Decided, Step, What, steps};
use crate::change::{ACCEPTED_MARGIN_M, AcceptedChange, Layer, layer_of};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{StampNs, TripId};
use crate::scan::{BandView, LaserScan};

/// Most cells of a grid: a map that needs more is drawn with coarser cells.
pub const CELLS_MAX: usize = 24_000_000;
/// A cell is occupied if at least this share of the scans that reached it ended in it.
const OCCUPIED_SHARE_MIN: f64 = 0.15;
/// Cells around everything that was observed.
const MARGIN_CELLS: f64 = 8.0;
/// Marks a cell in which the scan at hand has a return.
const HIT_MARK: u16 = 1 << 15;
/// Counters are halved before one of them passes this, which keeps their ratio.
const COUNT_MAX: u16 = HIT_MARK - 1;

/// Whether something is in a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Occupancy {
    /// No beam reached it.
    Unknown,
    /// Beams went through.
    Free,
    /// Beams ended there.
    Occupied,
}

/// A scan with its pose and time.
#[derive(Debug, Clone, Copy)]
pub struct PosedScan<'a> {
    /// When it was taken.
    pub stamp: StampNs,
    /// Where it was taken.
    pub map_from_base: Pose2,
    /// The ranges.
    pub scan: &'a LaserScan,
    /// Its trip, if nothing has ever tied that to the map: it is where it says it is, or not.
    pub untied: Option<&'a TripId>,
}

/// A grid over the map frame that counts beams.
///
/// A return adds a hit to the cell it lies in and a pass to every cell between it and the lidar.
/// Where a scan has a return, its other beams add no pass: a beam that grazes a wall does not
/// wear it away. A beam without a return is evidence of nothing and adds nothing (REP-117).
///
/// Scans of different height bands are counted separately, since one may see under what the other hits. A
/// cell shows the band in which it is occupied, else the one in which it is free.
#[derive(Debug, Clone, PartialEq)]
pub struct OccupancyGrid {
    resolution_m: f64,
    origin: Vector2<f64>,
    width: usize,
    height: usize,
    hits: Vec<u16>,
    passes: Vec<u16>,
}

impl OccupancyGrid {
    /// Draws scans, each with its `map_from_base`, into cells of `resolution_m`.
    ///
    /// Cell borders are whole multiples of the resolution, so that grids of the same map align. The
    /// resolution is doubled until the grid has at most [`CELLS_MAX`] cells.
    /// Scans at poses that are not finite are left out. Cost: beams × cells a beam.
    pub fn from_scans<'a>(
        scans: impl IntoIterator<Item = (Pose2, &'a LaserScan)>,
        resolution_m: f64,
    ) -> Self {
        let scans: Vec<_> = scans.into_iter().filter(|(p, _)| p.is_finite()).collect();
        let empty = Self::covering(&extent(&scans), resolution_m);
        let layers = layers_of(scans, |(_, scan)| scan).into_iter();
        let layers = layers.map(|scans| {
            let mut grid = empty.clone();
            let mut returns = Vec::new();
            for (map_from_base, scan) in &scans {
                grid.draw(map_from_base, scan, &mut returns);
            }
            grid
        });
        layers.reduce(Self::merged).unwrap_or(empty)
    }

    /// As [`OccupancyGrid::from_scans`], in the order of time. In the region of an accepted change only
    /// scans since then count, in that of a pending one only those before it. An untied trip is left out
    /// if it contradicts the others.
    pub fn from_posed_scans<'a>(
        scans: impl IntoIterator<Item = PosedScan<'a>>,
        decided: Decided<'_>,
        resolution_m: f64,
    ) -> Self {
        let scans = scans.into_iter();
        let mut scans: Vec<_> = scans.filter(|s| s.map_from_base.is_finite()).collect();
        scans.sort_by_key(|scan| scan.stamp);
        let (untied, tied): (Vec<_>, Vec<_>) =
            (scans.iter().copied()).partition(|scan| scan.untied.is_some());
        if !untied.is_empty() && !tied.is_empty() {
            let contradicting = contradicting_trips(&tied, &untied, decided, resolution_m);
            scans.retain(|scan| !scan.untied.is_some_and(|trip| contradicting.contains(trip)));
        }
        Self::of_sorted(scans, decided, resolution_m)
    }

    /// Of scans in the order of time.
    fn of_sorted(scans: Vec<PosedScan<'_>>, decided: Decided<'_>, resolution_m: f64) -> Self {
        let steps = steps(decided);
        let poses: Vec<_> = scans.iter().map(|s| (s.map_from_base, s.scan)).collect();
        let empty = Self::covering(&extent(&poses), resolution_m);
        let layers = layers_of(scans, |scan| scan.scan).into_iter();
        let layers = layers.map(|scans| empty.clone().with_scans(&scans, &steps, decided));
        layers.reduce(Self::merged).unwrap_or(empty)
    }

    /// Draws scans and applies the steps of changes, both in the order of time.
    fn with_scans(
        mut self,
        scans: &[PosedScan<'_>],
        steps: &[Step<'_>],
        decided: Decided<'_>,
    ) -> Self {
        let mut steps = steps.iter().peekable();
        let mut before = vec![Vec::new(); decided.pending.len()];
        let mut returns = Vec::new();
        for scan in scans {
            while let Some(step) = steps.next_if(|step| step.at.is_some_and(|at| at <= scan.stamp))
            {
                self.take(step, &mut before, decided.accepted);
            }
            self.draw(&scan.map_from_base, scan.scan, &mut returns);
        }
        steps.for_each(|step| self.take(step, &mut before, decided.accepted));
        self
    }

    fn take(&mut self, step: &Step<'_>, before: &mut [Vec<Counted>], accepted: &[AcceptedChange]) {
        match step.what {
            What::Forget(change) => {
                for cell in self.cells_of(&change.region, |point| change.covers(point)) {
                    self.hits[cell] = 0;
                    self.passes[cell] = 0;
                }
            }
            What::Remember(k, change) => {
                let cells = self.cells_of(&change.region, |point| change.covers(point, accepted));
                let counted = |cell| (cell, self.hits[cell], self.passes[cell]);
                before[k] = cells.into_iter().map(counted).collect();
            }
            What::Restore(k) => {
                for (cell, hits, passes) in std::mem::take(&mut before[k]) {
                    (self.hits[cell], self.passes[cell]) = (hits, passes);
                }
            }
        }
    }

    /// The counts, in each cell, of that grid in which it is occupied, else free.
    fn merged(mut self, other: Self) -> Self {
        let shown = |hits: u16, passes: u16| (shown_by(hits, passes), hits, passes);
        for cell in 0..self.hits.len() {
            let own = shown(self.hits[cell], self.passes[cell]);
            let others = shown(other.hits[cell], other.passes[cell]);
            (_, self.hits[cell], self.passes[cell]) = own.max(others);
        }
        self
    }

    /// The cells within [`ACCEPTED_MARGIN_M`] of a region whose centres are covered.
    fn cells_of(
        &self,
        region: &[Vector2<f64>],
        covers: impl Fn(&Vector2<f64>) -> bool,
    ) -> Vec<usize> {
        let (mut low, mut high) = (
            Vector2::repeat(f64::INFINITY),
            Vector2::repeat(f64::NEG_INFINITY),
        );
        for corner in region {
            low = low.inf(corner);
            high = high.sup(corner);
        }
        let to_cells = |v: f64, origin: f64| (v - origin) / self.resolution_m;
        // Conversion saturates: a region outside the grid gives an empty range.
        let first = |v: f64, origin| to_cells(v - ACCEPTED_MARGIN_M, origin).floor() as usize;
        let end = |v: f64, origin| to_cells(v + ACCEPTED_MARGIN_M, origin).ceil() as usize;
        let columns = first(low.x, self.origin.x)..end(high.x, self.origin.x).min(self.width);
        let rows = first(low.y, self.origin.y)..end(high.y, self.origin.y).min(self.height);
        let cells = rows.flat_map(|row| columns.clone().map(move |column| (column, row)));
        let covered = cells.filter(|(column, row)| {
            let in_cells = Vector2::new(*column as f64 + 0.5, *row as f64 + 0.5);
            covers(&(self.origin + in_cells * self.resolution_m))
        });
        covered
            .map(|(column, row)| row * self.width + column)
            .collect()
    }

    fn covering(extent: &Extent, resolution_m: f64) -> Self {
        let mut resolution_m = resolution_m;
        loop {
            let first = extent
                .low
                .map(|v| (v / resolution_m).floor() - MARGIN_CELLS);
            let last = extent
                .high
                .map(|v| (v / resolution_m).floor() + MARGIN_CELLS);
            let size = (last - first).map(|v| v + 1.0);
            if size.x * size.y <= CELLS_MAX as f64 {
                let (width, height) = (size.x as usize, size.y as usize);
                return Self {
                    resolution_m,
                    origin: first * resolution_m,
                    width,
                    height,
                    hits: vec![0; width * height],
                    passes: vec![0; width * height],
                };
            }
            resolution_m *= 2.0;
        }
    }

    fn draw(&mut self, map_from_base: &Pose2, scan: &LaserScan, returns: &mut Vec<Vector2<f64>>) {
        let to_cells = |p: Vector2<f64>| (p - self.origin) / self.resolution_m;
        let map_from_lidar = map_from_base.compose(&scan.lidar().mount);
        let eye = to_cells(map_from_lidar.translation());
        returns.clear();
        returns.extend(end_points(&map_from_lidar, scan).map(to_cells));
        for end in returns.iter() {
            let cell = self.index_of(end);
            self.hits[cell] |= HIT_MARK;
        }
        let view = scan.lidar().band;
        for end in returns.iter() {
            let cell = self.index_of(end);
            self.add_hit(cell);
            match view {
                None => self.add_passes(&eye, end),
                Some(view) => self.add_clear_passes(&eye, end, &view),
            }
        }
        for end in returns.iter() {
            let cell = self.index_of(end);
            self.hits[cell] &= !HIT_MARK;
        }
    }

    fn index_of(&self, point_cells: &Vector2<f64>) -> usize {
        let column = (point_cells.x as usize).min(self.width - 1);
        let row = (point_cells.y as usize).min(self.height - 1);
        row * self.width + column
    }

    fn add_hit(&mut self, cell: usize) {
        if self.hits[cell] & COUNT_MAX == COUNT_MAX {
            self.hits[cell] = HIT_MARK | (COUNT_MAX / 2);
            self.passes[cell] /= 2;
        }
        self.hits[cell] += 1;
    }

    /// Adds passes where a beam of a height band shows it free.
    fn add_clear_passes(&mut self, eye: &Vector2<f64>, end: &Vector2<f64>, view: &BandView) {
        let way = end - eye;
        let range_m = way.norm() * self.resolution_m;
        if view.clear_from_m < range_m {
            let start = eye + way * (view.clear_from_m / range_m);
            let stop = eye + way * (view.clear_to_m / range_m).min(1.0);
            self.add_passes(&start, &stop);
        }
    }

    fn add_passes(&mut self, eye: &Vector2<f64>, end: &Vector2<f64>) {
        let width = self.width;
        for_each_cell_before_end(eye, end, |column, row| {
            let cell = row * width + column;
            if self.hits[cell] & HIT_MARK != 0 {
                return;
            }
            if self.passes[cell] == COUNT_MAX {
                self.passes[cell] /= 2;
                self.hits[cell] /= 2;
            }
            self.passes[cell] += 1;
        });
    }

    /// Edge of a cell, metres.
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// The lower left corner of cell (0, 0), metres, map frame.
    pub fn origin(&self) -> Vector2<f64> {
        self.origin
    }

    /// Cells along x.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Cells along y.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Beams that ended in a cell (hits) and beams that went through it (passes); `None` outside the grid.
    /// Beyond 32,767 both counts are halved.
    pub fn counts(&self, column: usize, row: usize) -> Option<(u16, u16)> {
        let inside = column < self.width && row < self.height;
        let cell = row * self.width + column;
        inside.then(|| (self.hits[cell], self.passes[cell]))
    }

    /// The occupancy of a cell; column 0 is the lowest x, row 0 the lowest y. Unknown outside the grid.
    pub fn occupancy(&self, column: usize, row: usize) -> Occupancy {
        match self.counts(column, row) {
            None => Occupancy::Unknown,
            Some((hits, passes)) => shown_by(hits, passes),
        }
    }

    /// What is shown where a point of the map frame lies: occupied if one of the cells next to its own is.
    fn shown_round(&self, point: &Vector2<f64>) -> Occupancy {
        let Some((column, row)) = self.cell_at(point) else {
            return Occupancy::Unknown;
        };
        let columns = column.saturating_sub(1)..=column + 1;
        let mut cells = columns.flat_map(|column| {
            let rows = row.saturating_sub(1)..=row + 1;
            rows.map(move |row| (column, row))
        });
        let is_occupied = |(column, row)| self.occupancy(column, row) == Occupancy::Occupied;
        match cells.any(is_occupied) {
            true => Occupancy::Occupied,
            false => self.occupancy(column, row),
        }
    }

    /// The cell that holds a point of the map frame (column, row); `None` outside the grid.
    pub fn cell_at(&self, point: &Vector2<f64>) -> Option<(usize, usize)> {
        let cells = (point - self.origin) / self.resolution_m;
        let inside = cells.x >= 0.0
            && cells.y >= 0.0
            && cells.x < self.width as f64
            && cells.y < self.height as f64;
        inside.then_some((cells.x as usize, cells.y as usize))
    }
}

/// The untied trips most of whose returns lie where the tied ones of their layer know that nothing stands.
/// Scans come in the order of time.
fn contradicting_trips<'a>(
    tied: &[PosedScan<'_>],
    untied: &[PosedScan<'a>],
    decided: Decided<'_>,
    resolution_m: f64,
) -> BTreeSet<&'a TripId> {
    let mut counts: BTreeMap<&TripId, (usize, usize)> = BTreeMap::new();
    for untied in layers_of(untied.to_vec(), |scan| scan.scan) {
        let layer = untied.first().map(|scan| layer_of(scan.scan));
        let of_layer = |scan: &&PosedScan<'_>| Some(layer_of(scan.scan)) == layer;
        let known = tied.iter().filter(of_layer).copied().collect();
        let known = OccupancyGrid::of_sorted(known, decided, resolution_m);
        for PosedScan {
            map_from_base,
            scan,
            untied,
            ..
        } in untied
        {
            let Some(trip) = untied else {
                continue;
            };
            let (fitting, contradicting) = counts.entry(trip).or_default();
            let map_from_lidar = map_from_base.compose(&scan.lidar().mount);
            for end in end_points(&map_from_lidar, scan) {
                match known.shown_round(&end) {
                    Occupancy::Occupied => *fitting += 1,
                    Occupancy::Free => *contradicting += 1,
                    Occupancy::Unknown => {}
                }
            }
        }
    }
    let counts = counts.into_iter();
    let contradicting = counts.filter(|(_, (fitting, contradicting))| contradicting > fitting);
    contradicting.map(|(trip, _)| trip).collect()
}

/// A cell with its hits and passes.
type Counted = (usize, u16, u16);

/// What hits and passes of a cell show.
fn shown_by(hits: u16, passes: u16) -> Occupancy {
    let (hits, passes) = (f64::from(hits), f64::from(passes));
    if hits + passes == 0.0 {
        Occupancy::Unknown
    } else if hits > 0.0 && hits >= OCCUPIED_SHARE_MIN * (hits + passes) {
        Occupancy::Occupied
    } else {
        Occupancy::Free
    }
}

/// The trips that nothing has tied to the map, of keyframes with the way that each trip has drifted
/// since it was, metres.
pub fn untied_trips<'a>(
    drifts_m: impl IntoIterator<Item = (&'a TripId, f64)>,
) -> BTreeSet<&'a TripId> {
    let mut least_m: BTreeMap<&TripId, f64> = BTreeMap::new();
    for (trip, drift_m) in drifts_m {
        let least_m = least_m.entry(trip).or_insert(drift_m);
        *least_m = least_m.min(drift_m);
    }
    let untied = least_m.into_iter().filter(|(_, least_m)| *least_m > 0.0);
    untied.map(|(trip, _)| trip).collect()
}

/// What belongs to each layer, in the order given.
fn layers_of<'a, T>(all: Vec<T>, scan_of: impl Fn(&T) -> &'a LaserScan) -> Vec<Vec<T>> {
    let mut layers: BTreeMap<Layer, Vec<T>> = BTreeMap::new();
    for one in all {
        layers.entry(layer_of(scan_of(&one))).or_default().push(one);
    }
    layers.into_values().collect()
}

struct Extent {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

fn extent(scans: &[(Pose2, &LaserScan)]) -> Extent {
    let mut low = Vector2::repeat(f64::INFINITY);
    let mut high = Vector2::repeat(f64::NEG_INFINITY);
    for (map_from_base, scan) in scans {
        let map_from_lidar = map_from_base.compose(&scan.lidar().mount);
        let eye = std::iter::once(map_from_lidar.translation());
        for point in eye.chain(end_points(&map_from_lidar, scan)) {
            low = low.inf(&point);
            high = high.sup(&point);
        }
    }
    if scans.is_empty() {
        (low, high) = (Vector2::zeros(), Vector2::zeros());
    }
    Extent { low, high }
}

/// Where the beams ended, metres, map frame; beams without a return are left out.
fn end_points<'a>(
    map_from_lidar: &Pose2,
    scan: &'a LaserScan,
) -> impl Iterator<Item = Vector2<f64>> + 'a {
    let eye = map_from_lidar.translation();
    let heading_rad = map_from_lidar.theta;
    scan.ranges_m()
        .enumerate()
        .filter_map(move |(beam, range)| {
            let range_m = range?;
            let (sin, cos) = (heading_rad + scan.lidar().beam_angle_rad(beam)).sin_cos();
            Some(eye + Vector2::new(range_m * cos, range_m * sin))
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::PendingChange;
    use crate::scan::Lidar;
    use std::f64::consts::{FRAC_PI_2, PI};
    use std::sync::Arc;

    fn lidar(beams: usize, mount: Pose2) -> Arc<Lidar> {
        Arc::new(Lidar {
            angle_min_rad: -PI,
            angle_increment_rad: 2.0 * PI / beams as f64,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount,
            range_sigma_m: 0.01,
            band: None,
        })
    }

    /// A full scan from inside the square |x| ≤ 1.025, |y| ≤ 1.025.
    fn square_room(lidar: &Arc<Lidar>, beams: usize, at: &Pose2) -> LaserScan {
        let eye = at.compose(&lidar.mount);
        let ranges = (0..beams).map(|k| {
            let (sin, cos) = (eye.theta + lidar.beam_angle_rad(k)).sin_cos();
            let to_wall = |p: f64, d: f64| (1.025_f64.copysign(d) - p) / d;
            Some(to_wall(eye.x, cos).min(to_wall(eye.y, sin)))
        });
        LaserScan::new(lidar.clone(), ranges).unwrap()
    }

    #[test]
    fn a_square_room_has_four_closed_walls() {
        let lidar = lidar(2000, Pose2::new(0.3, 0.1, 0.7));
        let poses = [Pose2::new(0.1, -0.2, 0.4), Pose2::new(-0.4, 0.5, -2.0)];
        let scans: Vec<_> = poses.map(|p| square_room(&lidar, 2000, &p)).into();
        let grid = OccupancyGrid::from_scans(poses.into_iter().zip(&scans), 0.05);
        assert_eq!(grid.resolution_m(), 0.05);
        let mut counted = [0; 3];
        for row in 0..grid.height() {
            for column in 0..grid.width() {
                let centre =
                    grid.origin() + Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * 0.05;
                let reach = centre.abs().max();
                let expected = if reach < 1.0 {
                    Occupancy::Free
                } else if reach < 1.05 {
                    Occupancy::Occupied
                } else {
                    Occupancy::Unknown
                };
                assert_eq!(grid.occupancy(column, row), expected, "{centre:?}");
                counted[expected as usize] += 1;
            }
        }
        assert_eq!(counted[1], 40 * 40);
        assert_eq!(counted[2], 42 * 42 - 40 * 40);
    }

    #[test]
    fn later_grazing_beams_do_not_punch_a_wall() {
        // A long wall, seen once squarely, then many times at a flat angle by a lidar whose
        // pose is 2 cm off, so that its beams run along inside the wall's cells.
        let beams = 720;
        let lidar = lidar(beams, Pose2::IDENTITY);
        let scan = |at: Pose2| {
            let ranges = (0..beams).map(|k| {
                let sin = (at.theta + lidar.beam_angle_rad(k)).sin();
                (sin > 0.02).then(|| (2.02 - at.y) / sin)
            });
            LaserScan::new(lidar.clone(), ranges).unwrap()
        };
        let mut scans = vec![(Pose2::IDENTITY, scan(Pose2::IDENTITY))];
        for k in 0..30 {
            let at = Pose2::new(-4.0 - 0.1 * f64::from(k), 0.0, 0.0);
            scans.push((Pose2::new(at.x, 0.02, 0.0), scan(at)));
        }
        let grid = OccupancyGrid::from_scans(scans.iter().map(|(p, s)| (*p, s)), 0.05);
        for k in -15..15 {
            let x = 0.05 * f64::from(k) + 0.025;
            let (column, row) = grid.cell_at(&Vector2::new(x, 2.025)).unwrap();
            assert_eq!(grid.occupancy(column, row), Occupancy::Occupied, "x = {x}");
        }
    }

    #[test]
    fn a_passer_by_is_not_drawn_and_no_return_is_not_free() {
        let lidar = lidar(4, Pose2::IDENTITY);
        // The beams point along −x, −y, +x, +y.
        let empty = LaserScan::new(lidar.clone(), [None, None, Some(5.0), None]).unwrap();
        let person = LaserScan::new(lidar, [None, None, Some(2.0), None]).unwrap();
        let pose = Pose2::new(0.025, 0.025, 0.0);
        let scans = std::iter::repeat_n((pose, &empty), 20).chain([(pose, &person)]);
        let grid = OccupancyGrid::from_scans(scans, 0.05);
        let at = |x: f64, y: f64| {
            let (column, row) = grid.cell_at(&Vector2::new(x, y)).unwrap();
            (
                grid.counts(column, row).unwrap(),
                grid.occupancy(column, row),
            )
        };
        assert_eq!(at(1.025, 0.025), ((0, 21), Occupancy::Free));
        assert_eq!(at(2.025, 0.025), ((1, 20), Occupancy::Free));
        assert_eq!(at(3.025, 0.025), ((0, 20), Occupancy::Free));
        assert_eq!(at(5.025, 0.025), ((20, 0), Occupancy::Occupied));
        assert_eq!(at(0.025, 0.325).1, Occupancy::Unknown);
    }

    #[test]
    fn what_one_band_shows_another_does_not_wear_away() {
        use crate::scan::HeightBand;

        let of_band = |band: Option<(f64, f64)>, range_m: f64| {
            let band = band.map(|(from_m, to_m)| BandView {
                band: HeightBand::new(from_m, to_m).unwrap(),
                clear_from_m: 0.5,
                clear_to_m: 3.0,
            });
            let lidar = Lidar {
                band,
                ..(*lidar(4, Pose2::IDENTITY)).clone()
            };
            LaserScan::new(Arc::new(lidar), [None, None, Some(range_m), None]).unwrap()
        };
        let pose = Pose2::new(0.025, 0.025, 0.0);
        let under = of_band(Some((0.1, 0.4)), 5.0);
        let top = of_band(Some((0.6, 1.0)), 2.0);
        let scans = std::iter::repeat_n((pose, &under), 20).chain([(pose, &top)]);
        let grid = OccupancyGrid::from_scans(scans.clone(), 0.05);
        let at = |grid: &OccupancyGrid, x: f64| {
            let (column, row) = grid.cell_at(&Vector2::new(x, 0.025)).unwrap();
            grid.occupancy(column, row)
        };
        assert_eq!(
            at(&grid, 2.025),
            Occupancy::Occupied,
            "the top of the table"
        );
        assert_eq!(at(&grid, 5.025), Occupancy::Occupied, "the wall behind it");
        assert_eq!(at(&grid, 1.025), Occupancy::Free);
        // Free space is drawn where the band is seen, and no farther.
        assert_eq!(at(&grid, 0.225), Occupancy::Unknown);
        assert_eq!(at(&grid, 4.025), Occupancy::Unknown);
        let posed = scans.map(|(map_from_base, scan)| PosedScan {
            stamp: StampNs(0),
            map_from_base,
            scan,
            untied: None,
        });
        assert_eq!(
            OccupancyGrid::from_posed_scans(posed, Decided::default(), 0.05),
            grid
        );
    }

    /// A wall at 2 m; later something stands at 1 m before it; then it is gone again.
    #[test]
    fn an_accepted_change_makes_earlier_looks_count_no_more() {
        use crate::ids::{AlertId, EdgeId};

        let lidar = lidar(4, Pose2::IDENTITY);
        let scan =
            |range_m| LaserScan::new(lidar.clone(), [None, None, Some(range_m), None]).unwrap();
        let (wall, thing) = (scan(2.0), scan(1.0));
        let at = |stamp: i64| PosedScan {
            stamp: StampNs(stamp),
            map_from_base: Pose2::new(0.025, 0.025, 0.0),
            scan: if (100..200).contains(&stamp) {
                &thing
            } else {
                &wall
            },
            untied: None,
        };
        let accepted = |since: i64, version| AcceptedChange {
            alert_id: AlertId(uuid::Uuid::nil()),
            region: [[0.95, -0.1], [1.1, -0.1], [1.1, 0.1], [0.95, 0.1]]
                .map(Vector2::from)
                .to_vec(),
            since: StampNs(since),
            map_version: version,
            nodes: Vec::new(),
            first_edge_id: EdgeId(1),
        };
        let seen = |stamps: &[i64], changes: &[AcceptedChange]| {
            let scans = stamps.iter().map(|&stamp| at(stamp));
            let decided = Decided {
                accepted: changes,
                ..Decided::default()
            };
            let grid = OccupancyGrid::from_posed_scans(scans, decided, 0.05);
            [0.525, 1.025, 1.525].map(|x| {
                let (column, row) = grid.cell_at(&Vector2::new(x, 0.025)).unwrap();
                grid.counts(column, row).unwrap()
            })
        };
        let before: Vec<i64> = (0..30).collect();
        let with_thing: Vec<i64> = before.iter().copied().chain([100, 101]).collect();
        assert_eq!(seen(&with_thing, &[]), [(0, 32), (2, 30), (0, 30)]);
        let change = [accepted(100, 2)];
        assert_eq!(seen(&with_thing, &change), [(0, 32), (2, 0), (0, 30)]);
        // Whatever the order in which scans and changes come.
        let mut late = with_thing.clone();
        late.reverse();
        assert_eq!(seen(&late, &change), [(0, 32), (2, 0), (0, 30)]);
        // Gone again, and that accepted too.
        late.extend([200, 201, 202]);
        let both = [accepted(200, 3), accepted(100, 2)];
        assert_eq!(seen(&late, &both), [(0, 35), (0, 3), (0, 33)]);
        // Nobody has looked since: nothing is known there.
        assert_eq!(seen(&before, &change)[1], (0, 0));
        let outside = AcceptedChange {
            region: vec![Vector2::new(-90.0, 70.0)],
            ..accepted(100, 2)
        };
        assert_eq!(seen(&with_thing, &[outside]), seen(&with_thing, &[]));
    }

    #[test]
    fn a_pending_change_is_not_shown_and_neither_is_what_was_over() {
        let lidar = lidar(4, Pose2::IDENTITY);
        let scan =
            |range_m| LaserScan::new(lidar.clone(), [None, None, Some(range_m), None]).unwrap();
        let (wall, thing) = (scan(2.0), scan(1.0));
        let pending = |since: i64, until: Option<i64>| PendingChange {
            region: [[0.95, -0.1], [1.1, -0.1], [1.1, 0.1], [0.95, 0.1]]
                .map(Vector2::from)
                .to_vec(),
            since: StampNs(since),
            until: until.map(StampNs),
        };
        // The thing stands from 100 to 199.
        let seen = |stamps: std::ops::Range<i64>, pending: &[PendingChange]| {
            let scans = stamps.map(|stamp| PosedScan {
                stamp: StampNs(stamp),
                map_from_base: Pose2::new(0.025, 0.025, 0.0),
                scan: if (100..200).contains(&stamp) {
                    &thing
                } else {
                    &wall
                },
                untied: None,
            });
            let decided = Decided {
                pending,
                ..Decided::default()
            };
            let grid = OccupancyGrid::from_posed_scans(scans, decided, 0.05);
            let (column, row) = grid.cell_at(&Vector2::new(1.025, 0.025)).unwrap();
            grid.counts(column, row).unwrap()
        };
        assert_eq!(seen(0..100, &[]), (0, 100));
        assert_eq!(seen(0..150, &[]), (50, 100));
        assert_eq!(seen(0..150, &[pending(100, None)]), (0, 100));
        assert_eq!(seen(0..300, &[pending(100, Some(200))]), (0, 200));
        // One on top of the other, in whatever order they come.
        let both = [pending(120, None), pending(100, None)];
        assert_eq!(seen(0..150, &both), (0, 100));
        assert_eq!(seen(0..150, &[both[1].clone(), both[0].clone()]), (0, 100));
    }

    #[test]
    fn an_untied_trip_is_drawn_unless_it_contradicts_the_others() {
        let beams = 720;
        let lidar = lidar(beams, Pose2::IDENTITY);
        let room = square_room(&lidar, beams, &Pose2::IDENTITY);
        // As far as the walls by every fourth beam, half as far by the others.
        let ranges = room
            .ranges_m()
            .enumerate()
            .map(|(beam, range_m)| match beam % 4 {
                0 => range_m,
                _ => range_m.map(|range_m| 0.5 * range_m),
            });
        let strange = LaserScan::new(lidar, ranges.collect::<Vec<_>>()).unwrap();
        let trip = TripId::new("untied").unwrap();
        let posed = |stamp: i64, x: f64, scan| PosedScan {
            stamp: StampNs(stamp),
            map_from_base: Pose2::new(x, 0.0, 0.0),
            scan,
            untied: (stamp > 0).then_some(&trip),
        };
        let drawn = |scans: &[PosedScan<'_>]| {
            OccupancyGrid::from_posed_scans(scans.iter().copied(), Decided::default(), 0.05)
        };
        let tied = posed(0, 0.0, &room);
        let alone = drawn(&[tied]);
        assert!(drawn(&[tied, posed(1, 0.0, &strange)]) == alone);
        assert!(drawn(&[posed(1, 0.0, &strange)]) != drawn(&[]), "the first");
        // What it says of its room elsewhere nobody can gainsay, nor what agrees.
        for (x, scan) in [(9.0, &strange), (0.0, &room)] {
            let both = drawn(&[tied, posed(1, x, scan)]);
            let of_both = OccupancyGrid::from_scans(
                [(tied.map_from_base, &room), (Pose2::new(x, 0.0, 0.0), scan)],
                0.05,
            );
            assert!(both == of_both, "{x}");
        }
        // The whole trip counts.
        let mixed = [tied, posed(1, 0.0, &strange), posed(2, 9.0, &strange)];
        assert!(drawn(&mixed) == alone);
    }

    #[test]
    fn of_a_trip_one_keyframe_that_is_tied_suffices() {
        let [tied, untied] = ["tied", "untied"].map(|id| TripId::new(id).unwrap());
        let drifts_m = [(&tied, 9.0), (&untied, 3.0), (&tied, 0.0), (&untied, 1e-9)];
        assert_eq!(untied_trips(drifts_m), BTreeSet::from([&untied]));
    }

    #[test]
    fn nothing_seen_and_too_much_seen_are_bounded() {
        let none = OccupancyGrid::from_scans(std::iter::empty(), 0.05);
        assert_eq!((none.width(), none.height()), (17, 17));
        assert_eq!(none.occupancy(8, 8), Occupancy::Unknown);
        assert_eq!(none.occupancy(99, 0), Occupancy::Unknown);

        let scan = LaserScan::new(lidar(4, Pose2::IDENTITY), [Some(1.0); 4]).unwrap();
        let far = [Pose2::IDENTITY, Pose2::new(3000.0, 3000.0, FRAC_PI_2)];
        let grid = OccupancyGrid::from_scans(far.map(|p| (p, &scan)), 0.05);
        assert!(grid.width() * grid.height() <= CELLS_MAX);
        assert_eq!(grid.resolution_m(), 0.8);
        let lost = Pose2 {
            x: f64::NAN,
            ..Pose2::IDENTITY
        };
        let same = OccupancyGrid::from_scans([far[0], lost, far[1]].map(|p| (p, &scan)), 0.05);
        assert_eq!(same, grid);
    }

    #[test]
    fn full_counters_keep_their_ratio() {
        let scan =
            LaserScan::new(lidar(4, Pose2::IDENTITY), [None, None, Some(1.0), None]).unwrap();
        let scans = std::iter::repeat_n((Pose2::new(0.01, 0.01, 0.0), &scan), 70_000);
        let grid = OccupancyGrid::from_scans(scans, 0.05);
        let (column, row) = grid.cell_at(&Vector2::new(1.01, 0.01)).unwrap();
        let (hits, passes) = grid.counts(column, row).unwrap();
        assert!((16_000..=32_767).contains(&hits) && passes == 0);
        assert_eq!(grid.occupancy(column - 1, row), Occupancy::Free);
    }
}
