//! Batches that could not be localised, tried again when the map has grown.

use sqlx::SqliteConnection;

use super::error::StoreError;
use super::trips::{Place, queue};

/// Queues the last unanchored batch of every trip (its job takes the earlier ones along) once the
/// route has a quarter and 20 nodes more than when it was tried: enough that the trip's place may be
/// among them, and so that the number of tries grows with the logarithm of the map. A trip that has
/// a job is left out: that job takes them along.
pub(super) async fn queue_unanchored(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: i64,
) -> Result<(), StoreError> {
    let rows = sqlx::query_as(
        "SELECT batch_key, trip_id, max(sequence) FROM batches \
         WHERE route_key = $1 AND status = 'unanchored' AND kind = 'scans' \
         AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.route_key = batches.route_key \
             AND jobs.trip_id = batches.trip_id) \
         GROUP BY trip_id HAVING 4 * $2 >= 5 * nodes_at_try + 80 ORDER BY batch_key",
    )
    .bind(route_key)
    .bind(nodes)
    .fetch_all(&mut *transaction)
    .await?;
    queue_all(transaction, route_key, rows).await
}

/// Queues the last batch of edges of every vehicle that could not be connected to the map (its job
/// takes the others along), by the same rule: they may name nodes that others have made.
pub(super) async fn queue_unanchored_edges(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: i64,
) -> Result<(), StoreError> {
    let rows = sqlx::query_as(
        "SELECT max(batch_key), trip_id, sequence FROM batches AS batch \
         WHERE route_key = $1 AND status = 'unanchored' AND kind = 'edges' \
         AND NOT EXISTS (SELECT 1 FROM jobs JOIN batches AS other USING (batch_key) \
             WHERE jobs.route_key = $1 AND other.kind = 'edges' \
             AND other.vehicle_id = batch.vehicle_id) \
         GROUP BY vehicle_id HAVING 4 * $2 >= 5 * nodes_at_try + 80 ORDER BY 1",
    )
    .bind(route_key)
    .bind(nodes)
    .fetch_all(&mut *transaction)
    .await?;
    queue_all(transaction, route_key, rows).await
}

/// Queues batches by key, trip and sequence.
async fn queue_all(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batches: Vec<(i64, String, i64)>,
) -> Result<(), StoreError> {
    for (batch_key, trip_id, sequence) in batches {
        let place = Place {
            batch_key,
            route_key,
            trip_id,
            sequence,
        };
        queue(transaction, &place).await?;
    }
    Ok(())
}
