//! The scans that a map is drawn of.

use crate::geometry::Pose2;
use crate::ids::{StampNs, TripId};
use crate::render::{PosedScan, untied_trips};
use crate::scan::{CodecError, LaserScan};
use crate::store::NodeWithScan;

/// The scans of the nodes that are localised, decoded.
pub struct DrawnScans<'a>(Vec<DrawnScan<'a>>);

struct DrawnScan<'a> {
    stamp: StampNs,
    map_from_base: Pose2,
    scan: LaserScan,
    /// See [`PosedScan::untied`].
    untied: Option<&'a TripId>,
}

impl<'a> DrawnScans<'a> {
    /// Of these nodes.
    ///
    /// # Errors
    /// [`CodecError`] if a stored scan does not decode.
    pub fn of(nodes: &'a [NodeWithScan]) -> Result<Self, CodecError> {
        let localised = || nodes.iter().filter(|node| node.node.is_localised());
        let drifts_m = localised().map(|node| (&node.node.trip_id, node.node.drift_m));
        let untied_trips = untied_trips(drifts_m);
        let mut scans = Vec::with_capacity(nodes.len());
        for node in localised() {
            let untied = untied_trips.get(&node.node.trip_id).copied();
            let decoded = node.decoded_scans()?.into_iter();
            scans.extend(decoded.map(|(stamp, map_from_base, scan)| DrawnScan {
                stamp,
                map_from_base,
                scan,
                untied,
            }));
        }
        Ok(Self(scans))
    }

    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Where each was taken.
    pub fn posed(&self) -> impl Iterator<Item = PosedScan<'_>> {
        self.0.iter().map(|drawn| PosedScan {
            stamp: drawn.stamp,
            map_from_base: drawn.map_from_base,
            scan: &drawn.scan,
            untied: drawn.untied,
        })
    }
}
