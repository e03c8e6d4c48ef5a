//! Which point is compared with which.

use pulp::{Simd, WithSimd};

use super::{IcpParams, Neighbour, ReferenceCloud};
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

/// What was found when a point's neighbours were last searched.
#[derive(Debug, Clone, Copy)]
struct Known {
    /// Metres, reference frame.
    searched_at: Vector2<f64>,
    nearest: Option<u32>,
    /// No other point was nearer than this, metres.
    others_from_m: f64,
}

impl Known {
    const NOTHING: Self = Self {
        searched_at: Vector2::new(0.0, 0.0),
        nearest: None,
        others_from_m: f64::NEG_INFINITY,
    };

    /// The nearest neighbour within a distance of where the point is now, searched for only if
    /// another can have become the nearest since the last search.
    #[inline(always)]
    fn nearest<S: Simd>(
        &mut self,
        simd: S,
        reference: &ReferenceCloud,
        position: &Vector2<f64>,
        reach_m: f64,
        beside: Option<u32>,
    ) -> Option<Neighbour> {
        let others_from_m = self.others_from_m - (position - self.searched_at).norm();
        let hint = self.nearest.map(|k| k as usize);
        match hint {
            Some(index) => {
                let distance_squared_m2 = (reference.position(index) - position).norm_squared();
                let bound_m = others_from_m.min(reach_m);
                if bound_m > 0.0 && distance_squared_m2 <= bound_m * bound_m {
                    return Some(Neighbour {
                        index,
                        distance_squared_m2,
                    });
                }
            }
            None if reach_m <= others_from_m => return None,
            None => (),
        }
        let near = hint.or(beside.map(|k| k as usize));
        let found = reference.nearest_from(simd, position, reach_m, near);
        *self = Self {
            searched_at: *position,
            nearest: found.nearest.map(|n| n.index as u32),
            others_from_m: found.others_from_m,
        };
        found.nearest
    }
}

/// The pairs of a scan and a cloud, found again and again while the scan is moved.
pub(super) struct Pairing<'a> {
    reference: &'a ReferenceCloud,
    points: &'a [SurfacePoint],
    /// What is known of each point's nearest neighbour.
    known: Vec<Known>,
    pairs: Vec<Pair>,
    beyond_gate: Vec<Pair>,
}

impl<'a> Pairing<'a> {
    pub(super) fn new(reference: &'a ReferenceCloud, points: &'a [SurfacePoint]) -> Self {
        Self {
            reference,
            points,
            known: vec![Known::NOTHING; points.len()],
            pairs: Vec::with_capacity(points.len()),
            beyond_gate: Vec::new(),
        }
    }

    /// Pairs every point, or one in `stride`, with its nearest neighbour within the gate, at a pose
    /// `reference_from_base`; those within [`IcpParams::overlap_gate_m`] are found too. The search
    /// begins at the neighbour of the last time, or at the one of the beam beside.
    pub(super) fn look_up(&mut self, pose: &Pose2, gate_m: f64, params: &IcpParams, stride: usize) {
        pulp::Arch::new().dispatch(LookUp {
            pairing: self,
            pose,
            gate_m,
            params,
            stride,
        });
    }

    /// What they are compared with.
    pub(super) fn reference(&self) -> &'a ReferenceCloud {
        self.reference
    }

    /// The scan's points.
    pub(super) fn points(&self) -> &'a [SurfacePoint] {
        self.points
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

/// [`Pairing::look_up`], as wide as the machine is.
struct LookUp<'b, 'a> {
    pairing: &'b mut Pairing<'a>,
    pose: &'b Pose2,
    gate_m: f64,
    params: &'b IcpParams,
    stride: usize,
}

impl WithSimd for LookUp<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let pairing = self.pairing;
        let to_reference = self.pose.to_transform();
        let reach_m = self.gate_m.max(self.params.overlap_gate_m);
        pairing.pairs.clear();
        pairing.beyond_gate.clear();
        let mut beside = None;
        for (point, known) in pairing
            .points
            .iter()
            .zip(&mut pairing.known)
            .step_by(self.stride)
        {
            let position = to_reference.apply(&point.position);
            let reference = pairing.reference;
            let Some(found) = known.nearest(simd, reference, &position, reach_m, beside) else {
                continue;
            };
            beside = Some(found.index as u32);
            let pair = Pair {
                point: point.position,
                counterpart: pairing.reference.position(found.index),
                normal: pairing.reference.normal(found.index),
            };
            if !is_fit(&pair, point, &position, &to_reference, self.params) {
                continue;
            }
            if found.distance_squared_m2 <= self.gate_m * self.gate_m {
                pairing.pairs.push(pair);
            } else {
                pairing.beyond_gate.push(pair);
            }
        }
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
