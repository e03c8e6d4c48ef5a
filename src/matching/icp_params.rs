//! How an alignment goes about it.

/// How points are paired and weighed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IcpParams {
    /// Farthest counterpart in the first iteration, metres.
    pub gate_start_m: f64,
    /// Farthest counterpart in the end, metres.
    pub gate_end_m: f64,
    /// What an iteration leaves of the gate.
    pub gate_factor: f64,
    /// Scale of the Cauchy weight 1 / (1 + (r/c)²), metres; `None` weighs all points alike.
    pub cauchy_scale_m: Option<f64>,
    /// Least cosine between two points' normals.
    pub normal_cosine_min: f64,
    /// How far a point may lie beside its counterpart, along the counterpart's line, metres; one
    /// farther off lies beyond the end of what the reference shows.
    pub beside_max_m: f64,
    /// The same for far points, as a share of their range: neighbouring beams lie far apart there.
    pub beside_max_range_share: f64,
    /// Largest number of iterations.
    pub iterations_max: usize,
    /// Distance to a counterpart within which a point counts as overlapping, metres.
    pub overlap_gate_m: f64,
    /// Distance to a line within which a point counts as agreeing, metres.
    pub inlier_gate_m: f64,
    /// Whether the last steps compare each point with all of the reference that is around it, so
    /// that little noise moves the result little.
    pub ends_smoothly: bool,
}

impl IcpParams {
    /// For the map: what disagrees is weighed down (method: "robust").
    pub const ROBUST: Self = Self {
        gate_start_m: 1.0,
        gate_end_m: 0.15,
        gate_factor: 0.75,
        cauchy_scale_m: Some(0.03),
        normal_cosine_min: 0.7,
        beside_max_m: 0.1,
        beside_max_range_share: 0.02,
        iterations_max: 40,
        overlap_gate_m: 0.5,
        inlier_gate_m: 0.08,
        ends_smoothly: true,
    };
    /// For the residual: every point takes part (paper, section 4), so a changed place pulls the
    /// estimate away from the robust one.
    pub const ALL_POINTS: Self = Self {
        gate_start_m: 3.0,
        gate_end_m: 3.0,
        gate_factor: 1.0,
        cauchy_scale_m: None,
        normal_cosine_min: -1.0,
        beside_max_m: f64::INFINITY,
        beside_max_range_share: 0.02,
        iterations_max: 30,
        overlap_gate_m: 0.5,
        inlier_gate_m: 0.08,
        ends_smoothly: false,
    };
}
