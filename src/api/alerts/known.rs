//! The alert that a request names.

use crate::api::ApiState;
use crate::api::problem::{Problem, ProblemKind};
use crate::ids::AlertId;
use crate::store::AlertRecord;

/// An alert as it is now.
///
/// # Errors
/// The [`Problem`] that there is none.
pub(in crate::api) async fn known_alert(
    state: &ApiState,
    id: AlertId,
) -> Result<AlertRecord, Problem> {
    state.store.alert(id).await?.ok_or_else(unknown_alert)
}

pub(in crate::api) fn unknown_alert() -> Problem {
    let detail = "there is no such alert: GET /v1/alerts lists them";
    Problem::new(ProblemKind::NotFound, detail)
}
