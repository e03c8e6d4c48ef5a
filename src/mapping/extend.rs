//! The walk of one drive through the map: this page is the method.

use super::anchor::{self, AnchorError};
use super::clock::TripClock;
use super::closure::{Closure, ClosureMeasurement};
use super::drift::{LOST_DRIFT_M, drift_of, drift_of_motion};
use super::drive::{Drive, DriveScan, InitialPose};
use super::front_end::{Motion, match_scans};
use super::intermediate::IntermediateScan;
use super::keyframe::Keyframe;
use super::local_map::{LocalCloud, LocalMap};
use super::moments::{Moment, Seen};
use super::odometry::OdometryMotion;
use super::partners;
use super::route_map::{RouteMap, Weighting};
use super::step::{Step, is_abrupt};
use crate::geometry::Pose2;
use crate::graph::{Edge, EdgeKind, EdgeStatus, GraphError};
use crate::ids::{EdgeId, NodeId};
use crate::scan::{KeyframeRule, is_standing};
use crate::solver::SolveOptions;

/// Keyframes that a new scan is matched against.
const LOCAL_MAP_KEYFRAMES: usize = 8;

/// A scan that fits nowhere is put off, so many times one after the other, before its trip is lost.
const PUT_OFF_MAX: usize = 3;

/// The offset between the clocks of scans and odometry is asked for anew after so many scans.
const SCANS_PER_OFFSET: usize = 60;

/// A trip that starts farther from the map than this, metres, is of another one.
const START_DISTANCE_MAX_M: f64 = 1_000.0;

/// How often a vehicle looks while it stands, seconds, and how many times at most.
const STANDING_INTERVAL_S: f64 = 0.3;
const STANDING_LOOKS_MAX: usize = 12;

/// What a drive added.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Extension {
    /// New nodes.
    pub nodes: Vec<NodeId>,
    /// New edges, closures among them.
    pub edges: Vec<EdgeId>,
    /// What the closures among them measured.
    pub closures: Vec<Closure>,
    /// New scans between keyframes: the keyframe that each follows, and its place among the
    /// keyframe's [`Keyframe::intermediate`].
    pub intermediate: Vec<(NodeId, usize)>,
}

/// Why a drive could not be used; the map is as it was if it is [`NotExtended::Unanchored`], and
/// lost else.
#[derive(Debug, thiserror::Error)]
pub enum NotExtended {
    /// The trip has no place in the map yet.
    #[error(transparent)]
    Unanchored(#[from] AnchorError),
    /// An id was used twice.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// Nobody waits for it any more.
    #[error("it was interrupted")]
    Interrupted,
}

impl RouteMap {
    /// Adds a drive: the first one of its trip, or its trip's next.
    ///
    /// # Errors
    /// [`NotExtended::Unanchored`] if it is the trip's first part, has no initial pose, and its
    /// place cannot be told from the map.
    pub fn extend(&mut self, drive: &Drive) -> Result<Extension, NotExtended> {
        let added = self.walk(drive);
        self.forget_solves();
        added
    }

    fn walk(&mut self, drive: &Drive) -> Result<Extension, NotExtended> {
        let mut added = Extension::default();
        let mut start = match self.trips.contains_key(&drive.trip) {
            true => None,
            false => Some(self.first_pose(drive)?),
        };
        let mut cloud = LocalCloud::default();
        let mut clock = TripClock::new(self, drive);
        for moments in self.moments(drive).chunks(SCANS_PER_OFFSET) {
            clock.adjust(self);
            for moment in moments {
                if self.interrupt.is_raised() {
                    return Err(NotExtended::Interrupted);
                }
                clock.follow(self);
                let seen = match moment {
                    Moment::Primary { scan, lent } => Seen::corrected(&clock, scan, lent),
                    Moment::Companion(scan) => {
                        self.add_companion(&drive.trip, &clock.corrected(scan), &mut added);
                        continue;
                    }
                };
                let known = added.nodes.len();
                match start.take() {
                    Some(initial) => self.start_trip(drive, &seen, &initial, &mut added)?,
                    None => self.continue_trip(drive, &seen, &mut cloud, &mut added)?,
                }
                if added.nodes.len() == known {
                    for scan in &seen.lent {
                        self.add_companion(&drive.trip, scan, &mut added);
                    }
                }
            }
        }
        clock.restore(self);
        Ok(added)
    }

    /// The given pose, the origin for the first trip, or the place that the scans tell.
    fn first_pose(&self, drive: &Drive) -> Result<InitialPose, AnchorError> {
        match drive.initial_pose {
            Some(given) => match self.distance_m(&given.pose) {
                far_m if far_m > START_DISTANCE_MAX_M => Err(AnchorError::TooFar(far_m)),
                _ => Ok(self.at_first_primary(drive, given)),
            },
            None if self.keyframes.is_empty() => Ok(anchor::ORIGIN),
            None => anchor::find(self, drive),
        }
    }

    /// How far a pose is from the nearest node; 0 for an empty map.
    fn distance_m(&self, pose: &Pose2) -> f64 {
        let nodes = self.graph.nodes().iter();
        let away_m = nodes.map(|node| (node.pose.translation() - pose.translation()).norm());
        away_m.reduce(f64::min).unwrap_or(0.0)
    }

    fn start_trip(
        &mut self,
        drive: &Drive,
        seen: &Seen,
        initial: &InitialPose,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        let drift_m = if self.keyframes.is_empty() {
            0.0
        } else {
            drift_of(initial.sigma_xy_m, initial.sigma_theta_rad)
        };
        let keyframe = self.new_keyframe(drive, seen, drift_m);
        let index = self.insert_new(keyframe, initial.pose, added)?;
        self.close_loops(index, added)
    }

    fn continue_trip(
        &mut self,
        drive: &Drive,
        seen: &Seen,
        cloud: &mut LocalCloud,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        let scan = &seen.scan;
        let Some(&last) = self.trips.get(&drive.trip).and_then(|trip| trip.last()) else {
            return Ok(());
        };
        let Keyframe {
            node: last_node,
            odom_from_base: odom_from_last,
            drift_m: last_drift_m,
            ..
        } = self.keyframes[last];
        let by_odometry = odom_from_last.between(&scan.odom_from_base);
        let rule = KeyframeRule::for_range(scan.scan.lidar().range_max_m);
        let is_due = rule.is_due(&by_odometry);
        let is_silent = !is_due && self.moves_unreported(last, scan);
        if !is_due && !is_silent && !self.looks_again(last, scan) {
            self.add_intermediate(last, scan, cloud, added);
            return Ok(());
        }
        let odometry = match is_silent {
            false => OdometryMotion::told(&by_odometry),
            true => OdometryMotion::not_told(&self.keyframes[last].last_scan(&rule).pose),
        };
        let mut keyframe = self.new_keyframe(drive, seen, last_drift_m);
        let motion = match self.weighting {
            Weighting::Robust | Weighting::AllPointsIdentity => self
                .step(last, &keyframe, &odometry, &rule, cloud, is_silent)
                .measure(),
            Weighting::Paper => {
                let (last, new) = (&self.keyframes[last].points, &keyframe.points);
                let sigma_m = keyframe.range_sigma_m().unwrap_or(0.0);
                Some(match_scans(last, new, &odometry, sigma_m))
            }
        };
        let last_pose = self.graph.nodes()[last].pose;
        let Some(motion) = motion else {
            if self.keyframes[last].put_off_count(&rule) < PUT_OFF_MAX {
                let placed = IntermediateScan::unseen(odometry.motion, scan);
                self.keep_intermediate(last, placed, added);
                return Ok(());
            }
            keyframe.drift_m = keyframe.drift_m.max(LOST_DRIFT_M);
            let pose = last_pose.compose(&odometry.motion);
            let index = self.insert_new(keyframe, pose, added)?;
            return self.close_loops(index, added);
        };
        let moved = &motion.measurement;
        if is_silent && !rule.is_due(moved) {
            let placed = IntermediateScan::at(*moved, scan, &self.keyframes[last]);
            self.keep_intermediate(last, placed, added);
            return Ok(());
        }
        if !is_due && !is_silent && !is_standing(moved) {
            self.add_intermediate(last, scan, cloud, added);
            return Ok(());
        }
        keyframe.drift_m += drift_of_motion(&motion, &odometry.sigmas);
        let pose = last_pose.compose(moved);
        let index = self.insert_new(keyframe, pose, added)?;
        self.add_odometry(last_node, index, &motion, added)?;
        self.lose_if_carried(index);
        self.close_loops(index, added)
    }

    /// The step of a trip from its last keyframe to a new one.
    fn step<'a>(
        &'a self,
        last: usize,
        new: &'a Keyframe,
        odometry: &'a OdometryMotion,
        rule: &KeyframeRule,
        cloud: &'a mut LocalCloud,
        is_silent: bool,
    ) -> Step<'a> {
        let keyframe = &self.keyframes[last];
        let before = keyframe.last_scan(rule);
        let since = before.odom_from_base.between(&new.odom_from_base);
        let elapsed_s = new.stamp.seconds() - before.stamp.seconds();
        let trip = self.trip_up_to(last).iter().map(|&k| &self.keyframes[k]);
        let local_map = self.local_map(last);
        cloud.follow(keyframe.node, &local_map);
        Step {
            last: keyframe,
            new,
            local_map,
            cloud,
            odometry,
            before: before.pose,
            is_abrupt: is_abrupt(&since, elapsed_s, trip),
            is_silent,
        }
    }

    /// Keeps a scan that makes no keyframe.
    fn add_intermediate(
        &mut self,
        last: usize,
        scan: &DriveScan,
        cloud: &mut LocalCloud,
        added: &mut Extension,
    ) {
        let local_map = self.local_map(last);
        let keyframe = &self.keyframes[last];
        cloud.follow(keyframe.node, &local_map);
        let placed = IntermediateScan::place(scan, keyframe, &local_map, cloud);
        self.keep_intermediate(last, placed, added);
    }

    pub(super) fn keep_intermediate(
        &mut self,
        last: usize,
        placed: IntermediateScan,
        added: &mut Extension,
    ) {
        let keyframe = &mut self.keyframes[last];
        added
            .intermediate
            .push((keyframe.node, keyframe.intermediate.len()));
        keyframe.intermediate.push(placed);
    }

    /// Whether the scans show a motion since the last keyframe, of a trip the odometry of which has
    /// never reported any. Where wheels have, a vehicle that stands by them is believed: a lorry
    /// that passes close by changes most of what it sees.
    fn moves_unreported(&self, last: usize, scan: &DriveScan) -> bool {
        let trip = self.trip_up_to(last);
        let newest = &trip[trip.len().saturating_sub(LOCAL_MAP_KEYFRAMES)..];
        let stands = |&k: &usize| {
            let keyframe = &self.keyframes[k];
            is_standing(&keyframe.odom_from_base.between(&scan.odom_from_base))
        };
        let is_of_lidar = self.keyframes[last].lidar == scan.lidar.name;
        let seen = self.keyframes[last].scan.as_ref().filter(|_| is_of_lidar);
        newest.iter().chain(trip.first()).all(stands)
            && seen.is_some_and(|seen| seen.differs_from(&scan.scan))
    }

    /// Whether a vehicle that has not moved since its trip began looks once more: one look at
    /// what changed meanwhile would not be believed.
    fn looks_again(&self, last: usize, scan: &DriveScan) -> bool {
        let trip = &self.trips[&self.keyframes[last].trip];
        let stands = |&k: &usize| {
            let motion = self.keyframes[k]
                .odom_from_base
                .between(&scan.odom_from_base);
            is_standing(&motion)
        };
        let waited_s = scan.stamp.seconds() - self.keyframes[last].stamp.seconds();
        trip.len() < STANDING_LOOKS_MAX
            && waited_s >= STANDING_INTERVAL_S
            && trip.iter().all(stands)
    }

    /// A keyframe that would be the next node.
    fn new_keyframe(&self, drive: &Drive, seen: &Seen, drift_m: f64) -> Keyframe {
        let Seen { scan, lent } = seen;
        let node = self.next_node_id();
        let (trip, stamp) = (drive.trip.clone(), scan.stamp);
        let mut keyframe = Keyframe::new(node, trip, stamp, scan.odom_from_base, scan.scan.clone());
        keyframe.drift_m = drift_m;
        keyframe.lidar.clone_from(&scan.lidar.name);
        let lent = lent.iter();
        let lent = lent.filter_map(|lent| IntermediateScan::lending(lent, scan));
        keyframe.with_intermediate(lent.collect())
    }

    fn insert_new(
        &mut self,
        keyframe: Keyframe,
        pose: Pose2,
        added: &mut Extension,
    ) -> Result<usize, GraphError> {
        let node = self.take_node_id();
        added.nodes.push(node);
        let lent = 0..keyframe.intermediate.len();
        added.intermediate.extend(lent.map(|place| (node, place)));
        self.insert_keyframe(pose, keyframe)
    }

    pub(super) fn add_odometry(
        &mut self,
        last: NodeId,
        index: usize,
        motion: &Motion,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        let edge = Edge {
            id: self.take_edge_id(),
            from: last,
            to: self.keyframes[index].node,
            measurement: motion.measurement,
            information: self.weighting.information(motion.information),
            kind: EdgeKind::Odometry,
            status: EdgeStatus::Active,
        };
        self.graph.add_edge(edge)?;
        added.edges.push(edge.id);
        Ok(())
    }

    /// The newest keyframes of a trip, in the base frame of the one at `last`; of a trip that was
    /// lost since only those after.
    pub(super) fn local_map(&self, last: usize) -> LocalMap<'_> {
        let nodes = self.graph.nodes();
        let trip = self.trip_up_to(last);
        let newest = &trip[trip.len().saturating_sub(LOCAL_MAP_KEYFRAMES)..];
        let last_pose = nodes[last].pose;
        let lost = self.is_lost(last).then(|| self.lost_segment(last));
        let together = |k: &&usize| match &lost {
            Some(segment) => segment.contains(k),
            None => !self.is_lost(**k),
        };
        let scans = newest.iter().filter(together).map(|&k| {
            let last_from_base = last_pose.between(&nodes[k].pose);
            (last_from_base, self.keyframes[k].points.as_slice())
        });
        LocalMap::new(scans.collect())
    }

    /// The keyframes of a trip up to one of them, in the order of the drive.
    pub(super) fn trip_up_to(&self, last: usize) -> &[usize] {
        let trip = &self.trips[&self.keyframes[last].trip];
        let end = trip.iter().rposition(|&k| k == last);
        &trip[..end.map_or(trip.len(), |k| k + 1)]
    }

    /// Ties a new node to the reference, then decides whether it becomes part of it.
    pub(super) fn close_loops(
        &mut self,
        index: usize,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        if self.is_lost(index) {
            return self.find_segment(index, added);
        }
        let found = self.find_closures(index);
        if !found.is_empty() {
            let found = found.iter();
            let found = found.map(|(partner, measurement)| ([*partner, index], measurement));
            let closures = self.insert_closures(found)?;
            added
                .edges
                .extend(closures.iter().map(|closure| closure.edge));
            added.closures.extend(closures);
            self.keyframes[index].drift_m = 0.0;
        }
        let pose = self.graph.nodes()[index].pose;
        let layer = self.keyframes[index].layer();
        let references = (0..index)
            .filter(|&k| self.is_reference_with_scan(k) && self.keyframes[k].layer() == layer)
            .map(|k| self.graph.nodes()[k].pose);
        self.keyframes[index].reference = !partners::is_covered(&pose, references);
        match found.is_empty() && self.weighting != Weighting::Paper {
            true => self.find_astray(index, added),
            false => Ok(()),
        }
    }

    /// Whether later scans can be matched with a node.
    pub(super) fn is_reference_with_scan(&self, k: usize) -> bool {
        self.keyframes[k].reference && self.keyframes[k].scan.is_some()
    }

    /// Adds closures, each with the places of its older end and of its newer one, and solves the
    /// graph.
    pub(super) fn insert_closures<'a>(
        &mut self,
        found: impl Iterator<Item = ([usize; 2], &'a ClosureMeasurement)>,
    ) -> Result<Vec<Closure>, GraphError> {
        let (mut edges, mut measured) = (Vec::new(), Vec::new());
        for (ends, measurement) in found {
            edges.push(self.add_closure(ends, measurement)?);
            measured.push((ends, measurement));
        }
        let options = SolveOptions::default();
        let growths = self
            .solver
            .solve_closures(&mut self.graph, &edges, &options);
        let closures = edges.into_iter().zip(measured).zip(growths);
        let closures = closures.map(|((edge, (ends, measurement)), delta_f)| {
            self.closure(edge, ends, measurement, delta_f)
        });
        Ok(closures.collect())
    }

    fn add_closure(
        &mut self,
        [partner, index]: [usize; 2],
        measurement: &ClosureMeasurement,
    ) -> Result<EdgeId, GraphError> {
        let optimised = match self.weighting {
            Weighting::Robust => &measurement.robust,
            Weighting::AllPointsIdentity | Weighting::Paper => &measurement.all_points,
        };
        let edge = Edge {
            id: self.take_edge_id(),
            from: self.keyframes[partner].node,
            to: self.keyframes[index].node,
            measurement: optimised.pose,
            information: self.weighting.information(optimised.information),
            kind: EdgeKind::LoopClosure,
            status: EdgeStatus::Active,
        };
        self.graph.add_edge(edge)?;
        Ok(edge.id)
    }

    /// What a closure says now that the graph is solved with it.
    fn closure(
        &self,
        edge: EdgeId,
        [partner, index]: [usize; 2],
        measurement: &ClosureMeasurement,
        delta_f: f64,
    ) -> Closure {
        let all_points_measurement = measurement.all_points.pose;
        let all_points_information = self
            .weighting
            .information(measurement.all_points.information);
        let nodes = self.graph.nodes();
        let (from, to) = (nodes[partner].pose, nodes[index].pose);
        let error = Pose2::edge_error(&from, &to, &all_points_measurement);
        Closure {
            edge,
            robust: measurement.robust,
            all_points_measurement,
            all_points_information,
            delta_f,
            all_points_residual: all_points_information.squared_norm(&error),
        }
    }
}
