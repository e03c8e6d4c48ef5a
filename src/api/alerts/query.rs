//! Which alerts to list.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::api::bounding_box::BoundingBox;
use crate::api::filters::{checked_route, checked_time, checked_vehicle};
use crate::api::problem::Problem;
use crate::model::{AlertStatus, ChangeKind, Clearance, Tier};
use crate::store::AlertFilter;

/// Which alerts to list; all given conditions must hold.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::api) struct AlertQuery {
    /// Only alerts of this route.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    route_id: Option<String>,
    /// Only alerts with this status.
    #[param(nullable = false, inline)]
    status: Option<AlertStatus>,
    /// Only alerts of this kind.
    #[param(nullable = false, inline)]
    kind: Option<ChangeKind>,
    /// Only alerts of this tier.
    #[param(nullable = false, inline)]
    tier: Option<Tier>,
    /// Only alerts that changed at this time or later, RFC 3339.
    #[param(nullable = false, format = DateTime, example = "2026-11-20T06:00:00Z")]
    since: Option<String>,
    /// Only alerts located within `x0,y0,x1,y1`: map frame, metres.
    #[param(
        pattern = r"^-?[0-9]+(\.[0-9]+)?(,-?[0-9]+(\.[0-9]+)?){3}$",
        nullable = false,
        example = "-5,-5,20,15"
    )]
    bbox: Option<String>,
    /// Only alerts with at least this confidence.
    #[param(minimum = 0, maximum = 1, nullable = false)]
    min_confidence: Option<f64>,
    /// Only alerts whose new state this vehicle observed.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<String>,
    /// Only alerts this near to the path that vehicles took before the change.
    #[param(nullable = false, inline)]
    blocking: Option<Clearance>,
    /// Only alerts that a zone mutes (`true`), or only the others (`false`).
    #[param(nullable = false)]
    muted: Option<bool>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    pub limit: Option<u32>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    pub cursor: Option<String>,
}

impl AlertQuery {
    /// The conditions, checked.
    ///
    /// # Errors
    /// 400 for a value that is not a name, time, box or probability.
    pub(super) fn filter(&self) -> Result<AlertFilter, Problem> {
        let bbox: Option<BoundingBox> = self.bbox.as_deref().map(str::parse).transpose()?;
        if self
            .min_confidence
            .is_some_and(|c| !(0.0..=1.0).contains(&c))
        {
            let detail = "min_confidence is a probability, 0 to 1";
            return Err(Problem::parameter("min_confidence", detail));
        }
        Ok(AlertFilter {
            route_id: checked_route(self.route_id.as_deref())?,
            among: None,
            status: self.status,
            kind: self.kind,
            tier: self.tier,
            since: checked_time("since", self.since.as_deref())?,
            bbox: bbox.map(|bbox| bbox.bounds()),
            min_confidence: self.min_confidence,
            vehicle_id: checked_vehicle(self.vehicle_id.as_deref())?,
            blocking: self.blocking,
            muted: self.muted,
        })
    }
}
