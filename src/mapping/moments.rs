//! The scans of a drive by what becomes of them: those of the primary lidar may become keyframes,
//! those of its companions never do.

use std::collections::BTreeMap;

use super::clock::TripClock;
use super::drive::{Drive, DriveScan, InitialPose};
use super::route_map::RouteMap;
use crate::change::layer_of;
use crate::ids::{LidarId, StampNs};

/// A companion's scan lends its points to a primary scan taken no more than this before or after,
/// nanoseconds: until then odometry errs by no more than a match does.
const LENDING_MAX_NS: u64 = 100_000_000;
/// No vehicle moves farther meanwhile, metres and radians: where odometry does, it has jumped.
const LENDING_MAX_M: f64 = 2.0;
const LENDING_MAX_RAD: f64 = 0.5;

/// A step of the walk through a drive.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Moment<'a> {
    /// A scan of the primary lidar, with those of companions that lend it their points: of each
    /// companion no more than one.
    Primary {
        scan: &'a DriveScan,
        lent: Vec<&'a DriveScan>,
    },
    /// A scan of a companion that lends its points to none.
    Companion(&'a DriveScan),
}

/// A scan of the primary lidar and those that lend it their points, with the clocks' offset and the
/// motion during them taken out.
pub(super) struct Seen {
    pub scan: DriveScan,
    pub lent: Vec<DriveScan>,
}

impl Seen {
    pub fn corrected(clock: &TripClock, scan: &DriveScan, lent: &[&DriveScan]) -> Self {
        Self {
            scan: clock.corrected(scan),
            lent: lent.iter().map(|lent| clock.corrected(lent)).collect(),
        }
    }
}

impl RouteMap {
    /// A drive, moment by moment, in the order of time. Where a trip begins, its first primary
    /// scan comes first: what companions saw before follows it.
    pub(super) fn moments<'a>(&self, drive: &'a Drive) -> Vec<Moment<'a>> {
        let is_primary = self.primary_of(drive);
        let mut moments = moments(&drive.scans, is_primary);
        if !self.trips.contains_key(&drive.trip) {
            let is_primary = |moment: &Moment<'_>| matches!(moment, Moment::Primary { .. });
            if let Some(first) = moments.iter().position(is_primary) {
                moments[..=first].rotate_right(1);
            }
        }
        moments
    }

    /// A pose given for a drive's first scan as one of the first that becomes a keyframe.
    pub(super) fn at_first_primary(&self, drive: &Drive, given: InitialPose) -> InitialPose {
        let moments = self.moments(drive);
        match (drive.scans.first(), moments.first()) {
            (Some(first), Some(Moment::Primary { scan, .. })) if !std::ptr::eq(first, *scan) => {
                let motion = first.odom_from_base.between(&scan.odom_from_base);
                let pose = given.pose.compose(&motion);
                InitialPose { pose, ..given }
            }
            _ => given,
        }
    }

    /// Whether a scan of a drive is one of the primary lidar: of that which took the trip's last
    /// keyframe, or of the first one with a scan in the drive if that has none. A scan without a
    /// lidar's name is always one.
    fn primary_of(&self, drive: &Drive) -> impl Fn(&DriveScan) -> bool + use<> {
        let last = self.trips.get(&drive.trip).and_then(|trip| trip.last());
        let last = last.and_then(|&k| self.keyframes[k].lidar.clone());
        let goes_on = drive.scans.iter().any(|scan| scan.lidar.name == last);
        let first = drive.scans.iter().min_by_key(|scan| scan.lidar.place);
        let primary = match goes_on {
            true => last,
            false => first.and_then(|scan| scan.lidar.name.clone()),
        };
        move |scan| scan.lidar.name.is_none() || scan.lidar.name == primary
    }
}

fn moments(scans: &[DriveScan], is_primary: impl Fn(&DriveScan) -> bool) -> Vec<Moment<'_>> {
    let primaries: Vec<&DriveScan> = scans.iter().filter(|scan| is_primary(scan)).collect();
    let companions = scans.iter().filter(|scan| !is_primary(scan));
    // By primary scan and companion: the companion's scan nearest in time, the earlier of two.
    let mut lent: BTreeMap<(usize, &LidarId), (u64, StampNs)> = BTreeMap::new();
    for scan in companions {
        if let Some(name) = &scan.lidar.name
            && let Some((primary, apart_ns)) = nearest(&primaries, scan)
        {
            let nearest = lent
                .entry((primary, name))
                .or_insert((apart_ns, scan.stamp));
            *nearest = (*nearest).min((apart_ns, scan.stamp));
        }
    }
    let lends = |scan: &DriveScan| {
        let (primary, _) = nearest(&primaries, scan)?;
        let (_, lending) = lent.get(&(primary, scan.lidar.name.as_ref()?))?;
        (*lending == scan.stamp).then_some(primary)
    };
    let mut lenders: Vec<Vec<&DriveScan>> = vec![Vec::new(); primaries.len()];
    for scan in scans.iter().filter(|scan| !is_primary(scan)) {
        if let Some(primary) = lends(scan) {
            lenders[primary].push(scan);
        }
    }
    let mut lenders = lenders.into_iter();
    let moment = |scan| match is_primary(scan) {
        true => Some(Moment::Primary {
            scan,
            lent: lenders.next().unwrap_or_default(),
        }),
        false => lends(scan).is_none().then_some(Moment::Companion(scan)),
    };
    scans.iter().filter_map(moment).collect()
}

/// The primary scan nearest in time, the earlier of two, and how far in time, if it is near enough
/// for points to be lent, and of the same height band: what two bands show is not one scan.
fn nearest(primaries: &[&DriveScan], scan: &DriveScan) -> Option<(usize, u64)> {
    let after = primaries.partition_point(|primary| primary.stamp < scan.stamp);
    let around = [after.checked_sub(1), Some(after)].into_iter().flatten();
    let apart = around.filter_map(|k| Some((primaries.get(k)?.stamp.0.abs_diff(scan.stamp.0), k)));
    let (apart_ns, k) = apart.min()?;
    let moved = primaries[k].odom_from_base.between(&scan.odom_from_base);
    let is_near = apart_ns <= LENDING_MAX_NS
        && layer_of(&primaries[k].scan) == layer_of(&scan.scan)
        && moved.translation().norm() <= LENDING_MAX_M
        && moved.theta.abs() <= LENDING_MAX_RAD;
    is_near.then_some((k, apart_ns))
}

#[cfg(test)]
mod tests;
