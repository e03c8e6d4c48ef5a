//! The paper's rule on recordings.
//!
//! Rozsa, Golarits, Szirányi, *Localization of map changes by exploiting SLAM residuals*. The map
//! is made as by the service's detector `seed`, of all-points estimates with Ω = I, and its
//! closures are read as one series by the printed rule (sections 4.1 and 4.2). Where a trip starts
//! and where a closure lies is taken from the service's own map, so that a bent map is not held
//! against the rule.

use std::collections::BTreeMap;

use crate::change::paper::{ClosurePlace, PaperChange, PaperParams, paper_changes};
use crate::change::series::{ClosureSample, residual_series};
use crate::change::{ChangeKind, region_round};
use crate::experiments::alert::ScoredAlert;
use crate::experiments::recording::Recording;
use crate::geometry::{Pose2, Vector2};
use crate::ids::StampNs;
use crate::mapping::{Closure, Drive, DriveScan, InitialPose, RouteMap, Weighting};
use crate::scan::LaserScan;

/// The rule names a closure, not a place: so much about its two nodes is meant, metres.
const REGION_M: f64 = 1.0;

/// What it raises, given `map_from_base` of the scans in the service's map.
///
/// # Errors
/// If a scan does not fit its lidar, or the graph refuses an id.
pub(in crate::experiments) fn alerts(
    recordings: &[Recording],
    poses: &BTreeMap<StampNs, Pose2>,
) -> anyhow::Result<Vec<ScoredAlert>> {
    let mut map = RouteMap::new(Weighting::AllPointsIdentity);
    let mut closures = Vec::new();
    for recording in recordings {
        if let Some(drive) = drive_of(recording, poses)? {
            closures.extend(map.extend(&drive)?.closures);
        }
    }
    let ends: Option<Vec<Ends>> = closures.iter().map(|c| Ends::of(&map, c, poses)).collect();
    let ends = ends.unwrap_or_default();
    // A lap is over when as many keyframes have come as there are references.
    let references = map.keyframes().iter().filter(|k| k.reference).count();
    let place = |ends: &Ends| ClosurePlace {
        position: 0.5 * (ends.positions[0] + ends.positions[1]),
        lap: ends.newest / references.max(1),
    };
    let places: Vec<ClosurePlace> = ends.iter().map(place).collect();
    let sample = |closure: &Closure| ClosureSample {
        edge_id: closure.edge,
        delta_f: closure.delta_f,
    };
    let samples: Vec<ClosureSample> = closures.iter().map(sample).collect();
    let params = PaperParams::for_laps(&places, 1.0);
    let series = residual_series(&samples, &params.series);
    let changes = paper_changes(&series, &places, &params);
    Ok(changes.iter().map(|change| alert(change, &ends)).collect())
}

/// A recording from its first scan that has a place in the service's map.
fn drive_of(
    recording: &Recording,
    poses: &BTreeMap<StampNs, Pose2>,
) -> anyhow::Result<Option<Drive>> {
    let placed = (recording.scans.iter().enumerate())
        .find_map(|(k, scan)| Some((k, *poses.get(&scan.stamp)?)));
    let Some((first, pose)) = placed else {
        return Ok(None);
    };
    let scans = recording.scans[first..].iter().map(|scan| {
        Ok(DriveScan {
            beam_interval_s: 0.0,
            lidar: Default::default(),
            stamp: scan.stamp,
            odom_from_base: scan.odom_from_base,
            scan: LaserScan::new(recording.lidar.clone(), scan.ranges_m.iter().copied())?,
        })
    });
    Ok(Some(Drive {
        wheels: Default::default(),
        trip: recording.trip.clone(),
        initial_pose: Some(InitialPose {
            pose,
            sigma_xy_m: 0.01,
            sigma_theta_rad: 0.002,
        }),
        scans: scans.collect::<anyhow::Result<_>>()?,
    }))
}

/// The two nodes of a closure.
struct Ends {
    /// In the service's map, metres.
    positions: [Vector2<f64>; 2],
    /// The newer one's place among the keyframes …
    newest: usize,
    /// … and when the vehicle was there.
    stamp: StampNs,
}

impl Ends {
    fn of(map: &RouteMap, closure: &Closure, poses: &BTreeMap<StampNs, Pose2>) -> Option<Self> {
        let graph = map.graph();
        let (from, to) = graph.ends()[graph.edge_position(closure.edge)?];
        let position = |k: usize| {
            let own = graph.nodes()[k].pose;
            let service = poses.get(&map.keyframes()[k].stamp);
            service.copied().unwrap_or(own).translation()
        };
        let newest = from.max(to);
        Some(Self {
            positions: [position(from), position(to)],
            newest,
            stamp: map.keyframes()[newest].stamp,
        })
    }
}

fn alert(change: &PaperChange, ends: &[Ends]) -> ScoredAlert {
    let closure = &ends[change.first.n - 1];
    ScoredAlert {
        kind: ChangeKind::Residual,
        location: change.first.place.position,
        region: region_round(&closure.positions, REGION_M),
        counterpart: None,
        tier: None,
        passes_when_raised: None,
        batch_when_raised: None,
        since: closure.stamp,
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{posed, room};
    use super::*;
    use crate::sim::Shape;

    #[test]
    fn a_wardrobe_is_raised_where_its_closures_lie_and_nothing_without_it() {
        // Four times to and fro; it comes after the second.
        let wardrobe = Shape::rectangle(&Pose2::new(4.0, -1.2, 0.0), 1.5, 0.8);
        let changed = room(480, Some(&wardrobe));
        let raised = alerts(&changed, &posed(&changed)).unwrap();
        let half = changed[0].scans[240].stamp;
        let late: Vec<_> = raised.iter().filter(|a| a.since >= half).collect();
        assert!(!late.is_empty());
        for alert in &late {
            assert_eq!(alert.kind, ChangeKind::Residual);
            assert!(alert.location.y.abs() < 0.3, "{}", alert.location);
        }
        let unchanged = room(480, None);
        let without = alerts(&unchanged, &posed(&unchanged)).unwrap();
        assert!(without.len() <= raised.len() - late.len());
    }

    #[test]
    fn without_places_nothing_is_raised() {
        assert!(
            alerts(&room(120, None), &BTreeMap::new())
                .unwrap()
                .is_empty()
        );
    }
}
