//! The size of a change.

use serde::Serialize;
use utoipa::ToSchema;

use crate::geometry::{Vector2, rectangle_round};

/// The smallest rectangle around an alert's region, at any angle.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[schema(as = AlertSize)]
pub(super) struct Size {
    /// Its longer side, metres.
    pub length: f64,
    /// Its shorter side, metres.
    pub width: f64,
}

impl Size {
    /// Of a region, to the centimetre; `None` without one.
    pub fn of(region: &[Vector2<f64>]) -> Option<Self> {
        let to_centimetre = |value: f64| (1e2 * value).round() / 1e2;
        rectangle_round(region).map(|(length, width)| Self {
            length: to_centimetre(length),
            width: to_centimetre(width),
        })
    }
}
