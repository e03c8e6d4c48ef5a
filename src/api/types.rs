//! Values that several resources share.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::geometry::{Pose2, PoseSigma};
use crate::ids::StampNs;

/// A planar pose as in `geometry_msgs/Pose2D`: metres, radians, counter-clockwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Pose)]
pub(super) struct PoseBody {
    /// Metres.
    #[schema(example = 3.5, minimum = -1e6, maximum = 1e6)]
    pub x: f64,
    /// Metres.
    #[schema(example = 3.4, minimum = -1e6, maximum = 1e6)]
    pub y: f64,
    /// Radians.
    #[schema(example = 0.02, minimum = -1e4, maximum = 1e4)]
    pub theta: f64,
}

/// A name chosen by a client, for lists of names in the OpenAPI document.
#[derive(ToSchema)]
#[schema(as = Name, value_type = String, pattern = "^[A-Za-z0-9._-]{1,64}$")]
#[allow(dead_code)]
pub(super) struct NameText(String);

/// The bytes of a file.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code)]
pub(super) struct Binary(Vec<u8>);

impl From<Pose2> for PoseBody {
    fn from(pose: Pose2) -> Self {
        Self {
            x: pose.x,
            y: pose.y,
            theta: pose.theta,
        }
    }
}

impl From<PoseSigma> for PoseBody {
    fn from(sigma: PoseSigma) -> Self {
        Self {
            x: sigma.x_m,
            y: sigma.y_m,
            theta: sigma.theta_rad,
        }
    }
}

/// The hexadecimal text of a hash.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A stamp as a time. Every `i64` of nanoseconds is within the range of jiff.
pub(super) fn timestamp(stamp: StampNs) -> Timestamp {
    Timestamp::from_nanosecond(i128::from(stamp.0)).unwrap_or_default()
}
