//! The laws that the tables keep, each with the statement that finds what breaks it.

use futures::TryStreamExt;
use sqlx::SqliteConnection;

use super::error::StoreError;

/// What holds in a sound database, and the statement whose rows each name one fault.
pub(super) type Law = (&'static str, &'static str);

/// The laws of the present schema.
pub(super) const LAWS: [Law; 8] = [
    (
        "what a row refers to is there",
        "SELECT format('row %s of %s has no %s', rowid, \"table\", parent) \
         FROM pragma_foreign_key_check",
    ),
    (
        "a batch has a job while it is queued or processing, and then alone",
        "SELECT format('job %d', job_id) FROM jobs LEFT JOIN batches USING (batch_key) \
         WHERE status IS NULL OR status NOT IN ('queued', 'processing') \
         UNION ALL SELECT format('batch %s of trip %s', id, trip_id) FROM batches \
         WHERE status IN ('queued', 'processing') \
         AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.batch_key = batches.batch_key)",
    ),
    (
        "a merged batch has as many nodes as it says",
        "SELECT format('batch %s of trip %s', id, trip_id) FROM batches \
         WHERE status = 'merged' AND nodes_added <> \
             (SELECT count(*) FROM nodes WHERE nodes.batch_key = batches.batch_key)",
    ),
    (
        "a route has as many rows as it says",
        "SELECT format('route %s', id) FROM routes WHERE (batches, nodes, edges) <> ( \
             (SELECT count(*) FROM batches AS b WHERE b.route_key = routes.route_key), \
             (SELECT count(*) FROM nodes AS n WHERE n.route_key = routes.route_key), \
             (SELECT count(*) FROM edges AS e WHERE e.route_key = routes.route_key))",
    ),
    (
        "poses are finite",
        "SELECT format('node %d of route %s', node_id, id) FROM nodes JOIN routes USING (route_key) \
         WHERE NOT (abs(x) < 9e999 AND abs(y) < 9e999 AND abs(theta) < 3.1415927)",
    ),
    (
        "the sums over what has left count what has left",
        "SELECT format('route %s', id) FROM routes WHERE \
         (SELECT coalesce(sum(nodes), 0) FROM archive_sums AS s \
             WHERE s.route_key = routes.route_key) <> \
         (SELECT count(*) FROM nodes AS n WHERE n.route_key = routes.route_key AND n.active = 0)",
    ),
    (
        "the edges of an alert are there",
        "SELECT format('edge %s of alert %s', named.value, alerts.id) \
         FROM alerts, json_each(alerts.edges) AS named WHERE NOT EXISTS (SELECT 1 FROM edges \
             WHERE edges.route_key = alerts.route_key AND edges.edge_id = named.value)",
    ),
    (
        "a map has a picture of each version before the present one",
        "SELECT format('route %s', id) FROM routes WHERE map_version - 1 <> \
             (SELECT count(*) FROM map_versions AS v WHERE v.route_key = routes.route_key)",
    ),
];

/// The law of the file itself, whatever its schema; to check it is one long read.
pub(super) const FILE_IS_SOUND: Law = (
    "the file is sound",
    "SELECT integrity_check FROM pragma_integrity_check WHERE integrity_check <> 'ok'",
);

/// Hands the faults against a law on, one by one, as they are found.
///
/// # Errors
/// [`StoreError`]; the faults before it were handed on.
pub(super) async fn for_each_fault(
    reader: &mut SqliteConnection,
    (_, statement): Law,
    mut note: impl FnMut(String),
) -> Result<(), StoreError> {
    let mut faults = sqlx::query_scalar::<_, String>(statement).fetch(reader);
    while let Some(what) = faults.try_next().await? {
        note(what);
    }
    Ok(())
}
