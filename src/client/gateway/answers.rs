//! Responses of the service.

use reqwest::StatusCode;
use serde::Deserialize;

use crate::model::{BatchStatus, TextEnum as _};

/// The problem type for a body that does not match its digest.
const DAMAGED: &str = "/problems/digest-mismatch";

/// A route.
#[derive(Debug, Clone, Deserialize)]
pub struct RouteReport {
    pub stage: String,
    pub map_version: i64,
    pub counts: RouteCounts,
    pub pending_batches: i64,
}

/// Counts of a route.
#[derive(Debug, Clone, Deserialize)]
pub struct RouteCounts {
    pub nodes: i64,
    pub edges: i64,
    pub loop_closures: i64,
}

/// A batch.
#[derive(Debug, Clone, Deserialize)]
pub struct BatchReport {
    pub status: String,
    pub reason: Option<String>,
    pub nodes_added: i64,
    pub loop_closures: i64,
}

impl BatchReport {
    /// Whether the service will still process it by itself.
    pub fn is_under_way(&self) -> bool {
        BatchStatus::of_text(&self.status).is_ok_and(BatchStatus::is_pending)
    }
}

/// An alert.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct AlertReport {
    pub id: String,
    pub kind: String,
    pub status: String,
    /// Its title.
    pub title: String,
    /// The vehicles that saw it; for a faulty vehicle, that vehicle.
    pub vehicle_ids: Vec<String>,
    /// `None` without a place, as for a faulty vehicle.
    pub location: Option<AlertLocation>,
    pub confidence: Option<f64>,
}

/// Where an alert is, map frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct AlertLocation {
    pub x: f64,
    pub y: f64,
}

/// One page of a route's alerts, and the cursor of the next.
#[derive(Debug, Deserialize)]
pub(super) struct AlertPage {
    pub items: Vec<AlertReport>,
    pub next_cursor: Option<String>,
}

/// A problem as the service states it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    pub status: u16,
    problem: Problem,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
struct Problem {
    #[serde(rename = "type")]
    kind: String,
    title: String,
    detail: String,
    errors: Vec<FieldError>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
struct FieldError {
    pointer: String,
    detail: String,
}

impl Refusal {
    pub(super) fn read(status: StatusCode, body: &[u8]) -> Self {
        Self {
            status: status.as_u16(),
            problem: serde_json::from_slice(body).unwrap_or_default(),
        }
    }

    /// Whether the bytes arrived damaged: the same request may succeed.
    pub(super) fn is_damage(&self) -> bool {
        self.problem.kind == DAMAGED
    }
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Problem {
            title,
            detail,
            errors,
            ..
        } = &self.problem;
        write!(f, "{}", self.status)?;
        if !title.is_empty() {
            write!(f, " {title}")?;
        }
        if !detail.is_empty() && detail != title {
            write!(f, ": {detail}")?;
        }
        for error in errors {
            write!(f, " [at {}", error.pointer)?;
            if !error.detail.is_empty() && error.detail != *detail {
                write!(f, ": {}", error.detail)?;
            }
            write!(f, "]")?;
        }
        Ok(())
    }
}
