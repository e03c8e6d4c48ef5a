//! What a PUT of a route sets, checked.

use serde::Deserialize;
use utoipa::ToSchema;

use super::problem::{Problem, ProblemKind};
use super::route_body::GeoAnchorBody;
use crate::model::Detector;
use crate::store::{GeoAnchor, RouteUpdate, SettingsUpdate};

const DISPLAY_NAME_CHARS_MAX: usize = 200;
const FALSE_ALARM_RATE_MAX: f64 = 1.0;
const HOLD_S_MAX: u32 = 7 * 24 * 3_600;
const MAX_SHIFT_MIN_M: f64 = 1e-3;
const MAX_SHIFT_MAX_M: f64 = 1.0;

/// What a PUT of a route sets; fields that are left out keep their value.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RoutePut {
    /// A name for people, up to 200 characters.
    #[schema(max_length = 200, pattern = r"^[^\x00-\x1f\x7f-\x9f]*$")]
    display_name: Option<String>,
    /// The map's place on the Earth.
    geo_anchor: Option<GeoAnchorBody>,
    /// Settings to change.
    settings: Option<RouteSettingsPut>,
}

/// Settings to change; fields that are left out keep their value.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct RouteSettingsPut {
    /// The rule that decides whether something changed.
    detector: Option<Detector>,
    /// The accepted number of false alerts per lap; 0.01 for a new route. A lap is as much driven distance as
    /// the route's reference is long.
    #[schema(exclusive_minimum = 0.0, maximum = 1.0, example = 0.01)]
    false_alarm_rate: Option<f64>,
    /// How long a batch waits for its predecessor, seconds.
    #[schema(minimum = 0, maximum = 604800)]
    hold_s: Option<u32>,
    /// How far a batch may move nodes of earlier batches, metres; 0.02 for a new route. A batch that would move
    /// one farther, and farther than three standard deviations of its pose, is quarantined.
    #[schema(minimum = 0.001, maximum = 1.0, example = 0.02)]
    max_shift_m: Option<f64>,
}

impl RoutePut {
    /// The update that the store carries out.
    ///
    /// # Errors
    /// 422 for a value out of range, at its JSON pointer.
    pub(super) fn check(self) -> Result<RouteUpdate, Problem> {
        if let Some(name) = &self.display_name
            && (name.chars().count() > DISPLAY_NAME_CHARS_MAX || name.chars().any(char::is_control))
        {
            let detail = "a display name has at most 200 characters and no control characters";
            return Err(refusal("/display_name", detail));
        }
        Ok(RouteUpdate {
            display_name: self.display_name,
            geo_anchor: self.geo_anchor.map(GeoAnchorBody::check).transpose()?,
            settings: self.settings.unwrap_or_default().check()?,
            expected: None,
        })
    }
}

impl GeoAnchorBody {
    fn check(self) -> Result<GeoAnchor, Problem> {
        for (pointer, value, low, high) in [
            ("/geo_anchor/latitude", self.latitude, -90.0, 90.0),
            ("/geo_anchor/longitude", self.longitude, -180.0, 180.0),
            ("/geo_anchor/heading", self.heading, 0.0, 360.0),
        ] {
            if !(low..=high).contains(&value) {
                let detail = format!("an angle from {low} to {high} degrees is expected");
                return Err(refusal(pointer, &detail));
            }
        }
        Ok(GeoAnchor {
            latitude: self.latitude,
            longitude: self.longitude,
            heading: self.heading,
        })
    }
}

impl RouteSettingsPut {
    fn check(self) -> Result<SettingsUpdate, Problem> {
        let is_rate = |rate: f64| rate > 0.0 && rate <= FALSE_ALARM_RATE_MAX;
        if self.false_alarm_rate.is_some_and(|rate| !is_rate(rate)) {
            let detail = "the number of false alerts per lap is in (0, 1]";
            return Err(refusal("/settings/false_alarm_rate", detail));
        }
        if self.hold_s.is_some_and(|hold_s| hold_s > HOLD_S_MAX) {
            let detail = "a batch is held for a week at most";
            return Err(refusal("/settings/hold_s", detail));
        }
        let is_shift = |shift_m: f64| (MAX_SHIFT_MIN_M..=MAX_SHIFT_MAX_M).contains(&shift_m);
        if self.max_shift_m.is_some_and(|shift_m| !is_shift(shift_m)) {
            let detail = "a batch may move a map by 0.001 m to 1 m";
            return Err(refusal("/settings/max_shift_m", detail));
        }
        Ok(SettingsUpdate {
            detector: self.detector,
            false_alarm_rate: self.false_alarm_rate,
            hold_s: self.hold_s,
            max_shift_m: self.max_shift_m,
        })
    }
}

fn refusal(pointer: &str, detail: &str) -> Problem {
    Problem::new(ProblemKind::OutOfRange, detail).at(pointer)
}
