//! Which point is compared with which.

use super::{IcpParams, ReferenceCloud};
use crate::geometry::{Pose2, Transform2, Vector2};
use crate::scan::SurfacePoint;

/// A point of the scan with its counterpart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    /// Metres, base frame.
    pub point: Vector2<f64>,
    /// Metres, reference frame.
    pub counterpart: Vector2<f64>,
    /// Of the counterpart's line, reference frame; `None` where it has none.
    pub normal: Option<Vector2<f64>>,
}

/// The pairs of a scan and a cloud, found again and again while the scan is moved.
pub(super) struct Pairing<'a> {
    reference: &'a ReferenceCloud,
    points: &'a [SurfacePoint],
    /// Each point's nearest neighbour when it was last looked up.
    nearest: Vec<Option<u32>>,
    pairs: Vec<Pair>,
    beyond_gate: Vec<Pair>,
}

impl<'a> Pairing<'a> {
    pub(super) fn new(reference: &'a ReferenceCloud, points: &'a [SurfacePoint]) -> Self {
        Self {
            reference,
            points,
            nearest: vec![None; points.len()],
            pairs: Vec::with_capacity(points.len()),
            beyond_gate: Vec::new(),
        }
    }

    /// Pairs every point, or one in `stride`, with its nearest neighbour within the gate, at a pose
    /// `reference_from_base`; those within [`IcpParams::overlap_gate_m`] are found too. The search
    /// begins at the neighbour of the last time, or at the one of the beam beside.
    pub(super) fn look_up(&mut self, pose: &Pose2, gate_m: f64, params: &IcpParams, stride: usize) {
        let to_reference = pose.to_transform();
        let reach_m = gate_m.max(params.overlap_gate_m);
        self.pairs.clear();
        self.beyond_gate.clear();
        let mut beside = None;
        for (point, near) in self.points.iter().zip(&mut self.nearest).step_by(stride) {
            let position = to_reference.apply(&point.position);
            let hint = near.map(|k| k as usize).or(beside);
            let Some(found) = self.reference.nearest_from(&position, reach_m, hint) else {
                continue;
            };
            *near = Some(found.index as u32);
            beside = Some(found.index);
            let pair = Pair {
                point: point.position,
                counterpart: self.reference.position(found.index),
                normal: self.reference.normal(found.index),
            };
            if !is_fit(&pair, point, &position, &to_reference, params) {
                continue;
            }
            if found.distance_squared_m2 <= gate_m * gate_m {
                self.pairs.push(pair);
            } else {
                self.beyond_gate.push(pair);
            }
        }
    }

    /// The pairs within the gate.
    pub(super) fn pairs(&self) -> &[Pair] {
        &self.pairs
    }

    /// Those farther apart.
    pub(super) fn beyond_gate(&self) -> &[Pair] {
        &self.beyond_gate
    }
}

/// Whether a point can be of its counterpart's line: neither turned away nor beside it.
fn is_fit(
    pair: &Pair,
    point: &SurfacePoint,
    position: &Vector2<f64>,
    to_reference: &Transform2,
    params: &IcpParams,
) -> bool {
    let Some(line_normal) = pair.normal else {
        return true;
    };
    let beside_max_m = params
        .beside_max_m
        .max(params.beside_max_range_share * point.range_m);
    let offset = position - pair.counterpart;
    let normal = point.normal.map(|n| to_reference.turn(&n));
    let turned_away = normal.is_some_and(|n| n.dot(&line_normal) < params.normal_cosine_min);
    !turned_away && line_normal.perp(&offset).abs() <= beside_max_m
}
