//! Why the body of an upload is refused.

use super::json::{JsonError, JsonMistake};

/// What kind of mistake a body holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BatchProblem {
    /// Not JSON, or unknown or repeated fields.
    MalformedJson,
    /// A field is missing, or has the wrong type or form.
    InvalidField,
    /// Beams, angles or ranges that fit no lidar.
    ScanGeometry,
    /// A number or a time beyond belief.
    OutOfRange,
    /// Stamps that do not increase.
    TimestampOrder,
    /// Nodes and edges that make no graph.
    EdgeGraph,
    /// More than a batch may have.
    TooLarge,
}

/// Why a body was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{pointer}: {detail}")]
pub struct BatchBodyError {
    /// The kind of mistake.
    pub problem: BatchProblem,
    /// JSON pointer (RFC 6901) to the first faulty field.
    pub pointer: String,
    /// For the sender: what is wrong and what to send instead.
    pub detail: String,
}

impl From<JsonError> for BatchBodyError {
    fn from(error: JsonError) -> Self {
        Self {
            problem: match error.mistake {
                JsonMistake::Malformed => BatchProblem::MalformedJson,
                JsonMistake::Field => BatchProblem::InvalidField,
                JsonMistake::Range => BatchProblem::OutOfRange,
            },
            pointer: error.pointer,
            detail: error.detail,
        }
    }
}

/// What was checked, or the first mistake.
pub(in crate::ingest) type Checked<T> = Result<T, BatchBodyError>;

pub(in crate::ingest) fn refuse<T>(
    problem: BatchProblem,
    pointer: impl Into<String>,
    detail: String,
) -> Checked<T> {
    Err(BatchBodyError {
        problem,
        pointer: pointer.into(),
        detail,
    })
}
