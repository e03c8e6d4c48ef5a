//! Copies of one route's uploads in a database of their own, where its map is made anew while the
//! service goes on.

use std::path::Path;

use sqlx::{Connection, SqliteConnection};

use super::Store;
use super::connection::detach;
use super::error::StoreError;
use super::query::Query;
use crate::ids::RouteId;

/// How the directories of such copies begin, within the data directory.
const PREFIX: &str = "rebuild-";

/// What a copy does not have yet. What was computed stays behind, but for the ids of nodes and edges.
const COPY: [&str; 7] = [
    "INSERT INTO other.routes SELECT * FROM main.routes \
     WHERE route_key = $1 AND NOT EXISTS (SELECT 1 FROM other.routes)",
    "INSERT OR IGNORE INTO other.trips SELECT * FROM main.trips WHERE route_key = $1",
    "UPDATE other.trips SET corrections = NULL, clock_ahead_ns = 0 WHERE route_key = $1 \
     AND NOT EXISTS (SELECT 1 FROM other.batches \
         WHERE batches.route_key = $1 AND batches.trip_id = trips.trip_id)",
    "CREATE TABLE IF NOT EXISTS other.rebuild_ids \
     (batch_key INTEGER PRIMARY KEY, node_id INTEGER, edge_id INTEGER) STRICT",
    "INSERT INTO other.batches SELECT * FROM main.batches WHERE route_key = $1 \
     AND batch_key > (SELECT coalesce(max(batch_key), 0) FROM other.batches)",
    "INSERT INTO other.batch_bodies SELECT bodies.* FROM main.batch_bodies AS bodies \
     JOIN main.batches AS of USING (batch_key) WHERE of.route_key = $1 \
     AND batch_key > (SELECT coalesce(max(batch_key), 0) FROM other.batch_bodies)",
    "INSERT OR REPLACE INTO other.rebuild_ids \
     SELECT batch_key, (SELECT min(node_id) FROM main.nodes WHERE nodes.batch_key = batches.batch_key), \
         (SELECT min(edge_id) FROM main.edges WHERE edges.batch_key = batches.batch_key) \
     FROM main.batches WHERE route_key = $1 AND status = 'merged' \
     AND batch_key NOT IN (SELECT batch_key FROM other.rebuild_ids)",
];

impl Store {
    /// A new directory for a copy, within the data directory; it is removed with the value, or when the store
    /// is opened the next time.
    ///
    /// # Errors
    /// [`StoreError::Directory`].
    pub fn copy_directory(&self) -> Result<tempfile::TempDir, StoreError> {
        let within = &self.shared.data_dir;
        let made = tempfile::Builder::new().prefix(PREFIX).tempdir_in(within);
        made.map_err(|source| StoreError::Directory {
            path: within.clone(),
            source,
        })
    }

    /// Copies what a store does not have yet of a route: its settings, trips and uploads, and nothing that was
    /// computed from them. The other store holds this route alone. Nobody waits for it: it is one
    /// long read.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn copy_route(&self, route: &RouteId, into: &Store) -> Result<(), StoreError> {
        let copied = self.copy_route_unnamed(route, into).await;
        copied.map_err(StoreError::named)
    }

    /// Whether there is room on the disk for a copy of a route, and for a map of about that length.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn has_room_for_copy(&self, route: &RouteId) -> Result<bool, StoreError> {
        let bytes = self.read(BodyBytes(route)).await?;
        Ok(self.shared.space.has_room_for(bytes.saturating_mul(2)))
    }

    async fn copy_route_unnamed(&self, route: &RouteId, into: &Store) -> Result<(), StoreError> {
        let mut connection = self.shared.database.open_copier().await?;
        into.shared.database.attach_to(&mut connection).await?;
        // It only reads from its own database, and does not keep the writer waiting.
        let mut transaction = connection.begin().await?;
        let route_key: Option<i64> =
            sqlx::query_scalar("SELECT route_key FROM main.routes WHERE id = $1")
                .bind(route.as_str())
                .fetch_optional(&mut *transaction)
                .await?;
        let route_key = route_key.ok_or(StoreError::UnknownRoute)?;
        for statement in COPY {
            sqlx::query(statement)
                .bind(route_key)
                .execute(&mut *transaction)
                .await?;
        }
        transaction.commit().await?;
        detach(&mut connection).await?;
        Ok(connection.close().await?)
    }
}

/// How long a route's kept bodies are together.
struct BodyBytes<'a>(&'a RouteId);

impl Query for BodyBytes<'_> {
    type Answer = u64;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let bytes: i64 = sqlx::query_scalar(
            "SELECT coalesce(sum(length(body)), 0) FROM routes JOIN batches USING (route_key) \
             JOIN batch_bodies USING (batch_key) WHERE routes.id = $1",
        )
        .bind(self.0.as_str())
        .fetch_one(reader)
        .await?;
        Ok(bytes.unsigned_abs())
    }
}

/// Removes the copies that a process left behind.
pub(super) fn remove_copies(data_dir: &Path) {
    let entries = std::fs::read_dir(data_dir).into_iter().flatten().flatten();
    let is_copy = |entry: &std::fs::DirEntry| {
        let name = entry.file_name();
        name.to_string_lossy().starts_with(PREFIX) && entry.path().is_dir()
    };
    for entry in entries.filter(is_copy) {
        let path = entry.path();
        if let Err(error) = std::fs::remove_dir_all(&path) {
            tracing::warn!(path = %path.display(), %error, "a copy of a route could not be removed");
        }
    }
}
