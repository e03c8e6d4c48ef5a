//! A zone as clients send and see it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::schema::{Array, ArrayBuilder, ObjectBuilder, Type};

use super::note::checked_note;
use super::problem::{Problem, ProblemKind};
use crate::geometry::{Vector2, is_simple_polygon, polygon_area};
use crate::model::{ChangeKind, ZonePurpose};
use crate::store::{ZoneEdit, ZoneRecord};

const CORNERS_MAX: usize = 100;
/// No map reaches farther than this from its origin, metres.
const REACH_M: f64 = 1e6;
/// The smallest zone, square metres.
const AREA_MIN_M2: f64 = 0.01;

/// A zone to create, or to replace another with.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ZoneEdit, example = json!({"polygon": [[4.0, 1.0], [9.0, 1.0], [9.0, 5.0], [4.0, 5.0]], "purpose": "mute", "kinds": ["appeared"], "until": "2026-11-20T14:00:00Z", "note": "pallets until the shift ends"}))]
pub(super) struct ZonePut {
    /// Corners x, y of a simple polygon in the map frame, metres, not closed; its area is at least 0.01 m².
    #[schema(schema_with = polygon)]
    polygon: Vec<[f64; 2]>,
    /// Its effect.
    purpose: ZonePurpose,
    /// The kinds of alerts that it applies to; all if null or left out.
    #[schema(min_items = 1)]
    kinds: Option<Vec<ChangeKind>>,
    /// When it ends by itself, a time in the future; never if null or left out.
    #[schema(value_type = Option<String>, format = DateTime)]
    until: Option<Timestamp>,
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

/// A part of a route's map where alerts are treated differently.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Zone)]
pub(super) struct ZoneBody {
    /// UUID of version 7: sorts by the time of creation.
    #[schema(format = "uuid")]
    id: String,
    /// The route.
    route_id: String,
    /// Corners x, y, map frame, metres, not closed.
    #[schema(schema_with = polygon)]
    polygon: Vec<[f64; 2]>,
    /// Its effect.
    purpose: ZonePurpose,
    /// The kinds of alerts that it applies to; null for all.
    #[schema(required)]
    kinds: Option<Vec<ChangeKind>>,
    /// When it ends by itself; null if it does not.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    until: Option<Timestamp>,
    /// When it ended; null while it is in effect.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    ended_at: Option<Timestamp>,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
    /// When it was created.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// Who created it.
    created_by: String,
    /// When it was last edited.
    #[schema(value_type = String, format = DateTime)]
    updated_at: Timestamp,
}

impl From<ZoneRecord> for ZoneBody {
    fn from(zone: ZoneRecord) -> Self {
        let edit = zone.edit;
        let corners = edit.polygon.iter().map(|corner| [corner.x, corner.y]);
        Self {
            id: zone.id.to_string(),
            route_id: zone.route_id.to_string(),
            polygon: corners.collect(),
            purpose: edit.purpose,
            kinds: edit.kinds,
            until: edit.until,
            ended_at: zone.ended_at,
            note: edit.note,
            created_at: zone.created_at,
            created_by: zone.created_by,
            updated_at: zone.updated_at,
        }
    }
}

/// The schema of a polygon: a list of corners, each an x and a y.
fn polygon() -> Array {
    let number = ObjectBuilder::new().schema_type(Type::Number);
    let corner = ArrayBuilder::new()
        .items(number)
        .min_items(Some(2))
        .max_items(Some(2));
    ArrayBuilder::new()
        .items(corner)
        .min_items(Some(3))
        .max_items(Some(CORNERS_MAX))
        .build()
}

impl ZonePut {
    /// The zone that the store keeps.
    ///
    /// # Errors
    /// 422 for a value out of range, at its JSON pointer.
    pub(super) fn check(self, now: Timestamp) -> Result<ZoneEdit, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        let polygon = checked_polygon(self.polygon)?;
        if self.until.is_some_and(|until| until <= now) {
            return refuse(
                "/until",
                "until is in the past: send a future time, or null",
            );
        }
        let mut kinds = self.kinds;
        if let Some(kinds) = &mut kinds {
            kinds.sort_unstable();
            kinds.dedup();
            if kinds.is_empty() {
                return refuse("/kinds", "name at least one kind, or send null for all");
            }
        }
        Ok(ZoneEdit {
            polygon,
            purpose: self.purpose,
            kinds,
            until: self.until,
            note: checked_note(self.note)?,
        })
    }
}

fn checked_polygon(corners: Vec<[f64; 2]>) -> Result<Vec<Vector2<f64>>, Problem> {
    let refuse = |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at("/polygon"));
    let polygon: Vec<_> = corners.into_iter().map(Vector2::from).collect();
    if !(3..=CORNERS_MAX).contains(&polygon.len()) {
        return refuse("a polygon has 3 to 100 corners");
    }
    let mut values = polygon.iter().flat_map(|corner| corner.iter());
    if values.any(|value| value.is_nan() || value.abs() > REACH_M) {
        return refuse("corners are metres in the map frame, at most 1e6");
    }
    if !is_simple_polygon(&polygon) {
        return refuse(
            "the sides of a polygon may meet only at its corners: send the corners in order around it, \
             each once, without repeating the first at the end",
        );
    }
    if polygon_area(&polygon) < AREA_MIN_M2 {
        return refuse("the area of a zone is at least 0.01 m²");
    }
    Ok(polygon)
}
