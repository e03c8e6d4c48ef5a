//! A route in memory: recordings become a map and its alerts as in the service.
//!
//! All that this room knows of [`RouteMap`] stands here. What the service does beside it, nodes
//! that are archived and closures without scans, is left out.

use std::collections::{BTreeMap, BTreeSet};

use super::alert::ScoredAlert;
use super::cpu::CpuWatch;
use super::recording::Recording;
use crate::change::{
    AlertState, AlertStatus, AlertUpdate, FALSE_ALERTS_PER_LAP, Finding, fold, stays_untouched,
};
use crate::geometry::{Information, Pose2, PoseSigma};
use crate::graph::{EdgeKind, EdgeStatus, Node};
use crate::ids::StampNs;
use crate::mapping::{
    Drive, DriveScan, InitialPose, Keyframe, Mending, RouteMap, Scope, Sites, Weighting,
};
use crate::scan::LaserScan;

/// Scans in a batch, as a gateway sends them.
const BATCH_SCANS: usize = 60;

/// What became of some recordings.
pub(super) struct RouteRun {
    /// `map_from_base` of every scan that has a place.
    pub poses: BTreeMap<StampNs, Pose2>,
    /// Scans whose observations the map keeps: those between that repeat the one before are not.
    pub observed: BTreeSet<StampNs>,
    /// Every alert ever raised.
    pub alerts: Vec<RouteAlert>,
    /// Segments that were moved, in their order.
    pub mendings: Vec<Mending>,
    /// Scans that were given.
    pub scans: usize,
    /// CPU time of map and alerts, seconds.
    pub cpu_s: f64,
    /// Batches that were given.
    pub batches: usize,
    /// Those of them that never found a place in the map.
    pub batches_not_merged: usize,
}

/// An alert at the end of a run.
pub(super) struct RouteAlert {
    /// As it is now.
    pub state: AlertState,
    /// When it was first open; `None` if it never was.
    pub raised: Option<Raised>,
}

/// When an alert was first open.
#[derive(Debug, Clone, Copy)]
pub(super) struct Raised {
    /// The batch, counted from 0 over the whole run.
    pub batch: usize,
    /// Passes that had shown the new state by then.
    pub passes: usize,
}

impl RouteRun {
    /// Runs the recordings in their order. With `known_start`, the map's frame is the first
    /// recording's odometry frame.
    ///
    /// # Errors
    /// If a scan does not fit its lidar, or the graph refuses an id.
    pub(super) fn of(recordings: &[Recording], known_start: bool) -> anyhow::Result<Self> {
        let mut route = Route::new();
        for recording in recordings {
            route.drive(recording, known_start)?;
        }
        Ok(route.finish(recordings))
    }

    /// The alerts that stand, as they are scored.
    pub(super) fn open_alerts(&self) -> Vec<ScoredAlert> {
        let open = self.alerts.iter().filter(|a| a.state.status.is_pending());
        open.map(RouteAlert::scored).collect()
    }
}

/// Some recordings mapped; nothing was asked of the map.
pub(super) struct MapRun {
    /// `map_from_base` of every scan that has a place.
    pub poses: BTreeMap<StampNs, Pose2>,
    /// Those of keyframes.
    pub keyframes: BTreeMap<StampNs, Pose2>,
    /// How uncertain these are, where the map says it.
    pub sigmas: BTreeMap<StampNs, PoseSigma>,
    /// The map's loop closures.
    pub closures: Vec<MeasuredClosure>,
    /// Batches that never found a place in the map.
    pub batches_not_merged: usize,
}

/// A loop closure between two scans.
pub(super) struct MeasuredClosure {
    /// The older scan …
    pub from: StampNs,
    /// … and the newer one.
    pub to: StampNs,
    /// `from_base_from_to_base`, as it was measured.
    pub measurement: Pose2,
    /// Of the measurement.
    pub information: Information,
}

impl MapRun {
    /// Maps the recordings in their order; the map's frame is the first one's odometry frame.
    ///
    /// # Errors
    /// If a scan does not fit its lidar, or the graph refuses an id.
    pub(super) fn of(recordings: &[Recording]) -> anyhow::Result<Self> {
        let mut route = Route::new();
        route.is_asked = false;
        for recording in recordings {
            route.drive(recording, true)?;
        }
        let of_node = |(keyframe, node): (&Keyframe, &Node)| (keyframe.stamp, node.pose);
        let keyframes = route.map.keyframes().iter();
        let stamps = keyframes.clone().map(|keyframe| keyframe.stamp);
        let sigmas = stamps.zip(route.map.pose_sigmas());
        Ok(Self {
            sigmas: sigmas
                .filter_map(|(stamp, sigma)| Some((stamp, sigma?)))
                .collect(),
            keyframes: keyframes
                .zip(route.map.graph().nodes())
                .map(of_node)
                .collect(),
            closures: route.closures(),
            batches_not_merged: route.batches_not_merged,
            poses: route
                .placed()
                .map(|(stamp, pose, _)| (stamp, pose))
                .collect(),
        })
    }
}

impl RouteAlert {
    pub(super) fn scored(&self) -> ScoredAlert {
        let Finding {
            kind,
            location,
            region,
            counterpart,
            tier,
            since,
            ..
        } = self.state.evidence.clone();
        ScoredAlert {
            kind,
            location,
            region,
            counterpart,
            tier: Some(tier),
            passes_when_raised: self.raised.map(|raised| raised.passes),
            batch_when_raised: self.raised.map(|raised| raised.batch),
            since,
        }
    }
}

pub(super) struct Route {
    map: RouteMap,
    alerts: Vec<RouteAlert>,
    mendings: Vec<Mending>,
    batch: usize,
    batches_not_merged: usize,
    cpu_s: f64,
    /// Whether alerts are raised.
    is_asked: bool,
    /// Whether segments that lie wrong are moved.
    pub(super) mends: bool,
}

impl Route {
    pub(super) fn new() -> Self {
        Self {
            map: RouteMap::new(Weighting::Robust),
            alerts: Vec::new(),
            mendings: Vec::new(),
            batch: 0,
            batches_not_merged: 0,
            cpu_s: 0.0,
            is_asked: true,
            mends: true,
        }
    }

    /// Batches that cannot be placed wait for the trip's next.
    pub(super) fn drive(&mut self, recording: &Recording, known_start: bool) -> anyhow::Result<()> {
        let (mut waiting, mut batches_waiting) = (Vec::new(), 0);
        for batch in recording.scans.chunks(BATCH_SCANS) {
            for scan in batch {
                let ranges_m = scan.ranges_m.iter().copied();
                waiting.push(DriveScan {
                    beam_interval_s: 0.0,
                    lidar: Default::default(),
                    stamp: scan.stamp,
                    odom_from_base: scan.odom_from_base,
                    scan: LaserScan::new(recording.lidar.clone(), ranges_m)?,
                });
            }
            batches_waiting += 1;
            let knows_start = known_start && self.map.keyframes().is_empty();
            let drive = Drive {
                wheels: Default::default(),
                trip: recording.trip.clone(),
                initial_pose: batch
                    .first()
                    .filter(|_| knows_start)
                    .map(|first| InitialPose {
                        pose: first.odom_from_base,
                        sigma_xy_m: 0.01,
                        sigma_theta_rad: 0.002,
                    }),
                scans: waiting.clone(),
            };
            let watch = CpuWatch::start();
            if self.map.extend(&drive).is_ok() {
                if self.is_asked {
                    self.raise(Sites::Touched)?;
                }
                waiting.clear();
                batches_waiting = 0;
            }
            self.cpu_s += watch.seconds();
            self.batch += 1;
        }
        self.batches_not_merged += batches_waiting;
        Ok(())
    }

    /// Maps a recording without a question.
    pub(super) fn drive_unasked(&mut self, recording: &Recording) -> anyhow::Result<()> {
        self.is_asked = false;
        let driven = self.drive(recording, true);
        self.is_asked = true;
        driven
    }

    /// Puts another map in the place of the route's, and raises what all of it says.
    pub(super) fn replace_map(
        &mut self,
        other: impl FnOnce(&RouteMap) -> anyhow::Result<RouteMap>,
    ) -> anyhow::Result<()> {
        self.map = other(&self.map)?;
        self.raise(Sites::All)
    }

    /// Mends the map where it can be, and folds what it says then into the alerts.
    fn raise(&mut self, sites: Sites) -> anyhow::Result<()> {
        let findings = self.findings(sites)?;
        let states: Vec<AlertState> = self.alerts.iter().map(|a| a.state.clone()).collect();
        for update in fold(&states, &findings) {
            self.take(update);
        }
        Ok(())
    }

    fn findings(&mut self, sites: Sites) -> anyhow::Result<Vec<Finding>> {
        let known = self.alerts.iter().map(|alert| alert.state.evidence.clone());
        let known: Vec<Finding> = known.collect();
        let states = self.alerts.iter().map(|alert| &alert.state);
        let pending = states.filter(|state| stays_untouched(state.status, &state.evidence));
        let pending: Vec<_> = pending.map(|state| state.evidence.clone()).collect();
        let scope = Scope {
            sites,
            pending: &pending,
            false_alerts_per_lap: FALSE_ALERTS_PER_LAP,
            accepted: &[],
            vehicles: &BTreeMap::new(),
            suspects: &[],
        };
        if !self.mends {
            return Ok(self.map.findings(&scope));
        }
        let (findings, mendings) = self.map.findings_and_mendings(&scope, &known)?;
        self.mendings.extend(mendings);
        Ok(findings)
    }

    fn take(&mut self, update: AlertUpdate) {
        let raised = (update.state.status == AlertStatus::Open).then_some(Raised {
            batch: self.batch,
            passes: update.state.evidence.laps,
        });
        match update.existing {
            Some(k) => {
                let alert = &mut self.alerts[k];
                alert.state = update.state;
                alert.raised = alert.raised.or(raised);
            }
            None => self.alerts.push(RouteAlert {
                state: update.state,
                raised,
            }),
        }
    }

    /// `map_from_base` of every scan that has a place, and whether the map keeps what it saw.
    fn placed(&self) -> impl Iterator<Item = (StampNs, Pose2, bool)> {
        let keyframes = self.map.keyframes().iter();
        keyframes
            .zip(self.map.graph().nodes())
            .flat_map(|(keyframe, node)| {
                let between = keyframe.intermediate.iter().map(|scan| {
                    let map_from_base = node.pose.compose(&scan.keyframe_from_base);
                    (scan.stamp, map_from_base, scan.scan.is_some())
                });
                std::iter::once((keyframe.stamp, node.pose, true)).chain(between)
            })
    }

    fn closures(&self) -> Vec<MeasuredClosure> {
        let (graph, keyframes) = (self.map.graph(), self.map.keyframes());
        let closures = graph.edges().iter().zip(graph.ends()).filter(|(edge, _)| {
            edge.kind == EdgeKind::LoopClosure && edge.status == EdgeStatus::Active
        });
        let measured = closures.map(|(edge, (from, to))| MeasuredClosure {
            from: keyframes[*from].stamp,
            to: keyframes[*to].stamp,
            measurement: edge.measurement,
            information: edge.information,
        });
        measured.collect()
    }

    pub(super) fn finish(self, recordings: &[Recording]) -> RouteRun {
        let observed = self.placed().filter(|(.., is_kept)| *is_kept);
        RouteRun {
            poses: self
                .placed()
                .map(|(stamp, pose, _)| (stamp, pose))
                .collect(),
            observed: observed.map(|(stamp, ..)| stamp).collect(),
            alerts: self.alerts,
            mendings: self.mendings,
            scans: recordings.iter().map(|r| r.scans.len()).sum(),
            cpu_s: self.cpu_s,
            batches: self.batch,
            batches_not_merged: self.batches_not_merged,
        }
    }
}
