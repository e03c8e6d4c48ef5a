//! Whether a job's result fits the route that it is applied to.

use sqlx::SqliteConnection;

use super::error::StoreError;
use super::members::Members;
use super::records::{BatchOutcome, JobResult};
use super::trips::Place;
use crate::model::BatchStatus;

/// The lowest ids that no node and no edge of a route ever had.
pub(super) struct Marks {
    next_node_id: i64,
    next_edge_id: i64,
}

/// The route's marks, if it still has the revision that the result was computed from.
pub(super) async fn marks(
    transaction: &mut SqliteConnection,
    place: &Place,
    result: &JobResult,
) -> Result<Option<Marks>, StoreError> {
    let marks: Option<(i64, i64)> = sqlx::query_as(
        "SELECT next_node_id, next_edge_id FROM routes \
         WHERE route_key = $1 AND id = $2 AND revision = $3",
    )
    .bind(place.route_key)
    .bind(result.route_id.as_str())
    .bind(result.base_revision)
    .fetch_optional(transaction)
    .await?;
    Ok(marks.map(|(next_node_id, next_edge_id)| Marks {
        next_node_id,
        next_edge_id,
    }))
}

/// Checks what the constraints of the tables do not.
///
/// # Errors
/// [`StoreError::InvalidResult`].
pub(super) fn check(
    result: &JobResult,
    place: &Place,
    members: &Members,
    marks: &Marks,
) -> Result<(), StoreError> {
    let invalid = |what: String| Err(StoreError::InvalidResult(what));
    let mut ends_its_batch = false;
    for BatchOutcome {
        batch_id, status, ..
    } in &result.outcomes
    {
        use BatchStatus::{Merged, Quarantined, Unanchored};
        let Some(member) = members.get(batch_id) else {
            return invalid(format!("batch {batch_id} is not one of its batches"));
        };
        if !matches!(status, Merged | Unanchored | Quarantined) {
            return invalid(format!(
                "batch {batch_id} does not end as {}",
                status.name()
            ));
        }
        ends_its_batch |= member.batch_key == place.batch_key;
    }
    if !ends_its_batch {
        return invalid("it does not end the job's own batch".to_owned());
    }
    for node in result.nodes.iter().map(|with_scan| &with_scan.node) {
        if node.id.0 < marks.next_node_id {
            return invalid(format!("node id {} was used before", node.id));
        }
        let of_batch = members.get(&node.batch_id).is_some_and(|member| {
            member.vehicle_id == node.vehicle_id && member.trip_id == node.trip_id
        });
        if !of_batch {
            return invalid(format!("node {} is not of one of its batches", node.id));
        }
    }
    for edge in &result.edges {
        if edge.id.0 < marks.next_edge_id {
            return invalid(format!("edge id {} was used before", edge.id));
        }
        if !members.contains_key(&edge.batch_id) {
            return invalid(format!("edge {} is not of one of its batches", edge.id));
        }
    }
    Ok(())
}
