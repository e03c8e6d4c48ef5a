//! Alerts: places where the world contradicts a route's map.
//!
//! `body` is an alert as clients see it, `list` the list of them, `decisions` and `bulk` what people decide,
//! `evidence` and `observations` what an alert rests on.

mod body;
mod bulk;
mod decisions;
mod evidence;
mod evidence_body;
mod evidence_picture;
mod geojson;
mod handling;
mod known;
mod list;
mod observations;
mod observations_body;
mod outcome;
mod pacing;
mod passes;
mod preview;
mod query;
mod reason;
mod sentence;
mod size;
mod stream;
mod suspect_body;
mod tangent_plane;

pub use body::alert_text;
pub(super) use bulk::*;
pub(super) use decisions::*;
pub(super) use evidence_body::*;
pub(super) use evidence_picture::*;
pub(super) use geojson::*;
pub(super) use handling::*;
pub(super) use known::*;
pub(super) use list::*;
pub(super) use observations_body::*;
pub(super) use outcome::*;
pub(super) use passes::*;
pub(super) use preview::*;
pub(super) use stream::*;
