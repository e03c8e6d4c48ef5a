//! What is drawn, and how large.

use crate::change::series::SeriesEntry;
use crate::change::{ChangeKind, JudgedBeam};
use crate::geometry::{Pose2, Vector2};
use crate::ids::EdgeId;

/// Size of the picture, pixels.
pub(super) const WIDTH_PX: f64 = 1080.0;
pub(super) const HEIGHT_PX: f64 = 850.0;
/// Space left free at both sides, pixels.
pub(super) const MARGIN_PX: f64 = 24.0;

/// What the picture shows.
#[derive(Debug, Clone)]
pub struct EvidencePicture<'a> {
    /// What changed.
    pub kind: ChangeKind,
    /// The route's name.
    pub route: &'a str,
    /// The alert's status.
    pub status: &'a str,
    /// Centre of the change, map frame, metres.
    pub location: Vector2<f64>,
    /// Standard deviation of the location, metres.
    pub sigma_m: f64,
    /// A simple polygon round it, map frame, metres.
    pub region: &'a [Vector2<f64>],
    /// Passes by the place that saw the new state.
    pub laps: usize,
    /// Scans that show the new state.
    pub views: usize,
    /// Probability that the alert is true, in [0, 1].
    pub confidence: f64,
    /// The old and the new scan; `None` where the upload had no scans.
    pub scans: Option<[EvidenceScan<'a>; 2]>,
    /// Without scans: the ends of the contradicted closure (`map_from_base`), the old one first.
    pub tied: Option<[Pose2; 2]>,
    /// The residuals; `None` if the alert names no closure.
    pub curve: Option<Curve<'a>>,
}

/// A scan in the map frame.
#[derive(Debug, Clone, Copy)]
pub struct EvidenceScan<'a> {
    /// Who took it and when, for people.
    pub caption: &'a str,
    /// `map_from_base`.
    pub map_from_base: Pose2,
    /// Its beams, ends in the map frame.
    pub beams: &'a [JudgedBeam],
}

/// A part of the residual series.
#[derive(Debug, Clone, Copy)]
pub struct Curve<'a> {
    /// The closures, in order.
    pub entries: &'a [SeriesEntry],
    /// The paper's threshold on ΔF; `None` until f has converged.
    pub threshold: Option<f64>,
    /// The alert's closure.
    pub edge: EdgeId,
}
