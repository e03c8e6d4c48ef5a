//! The nodes at a place that show it before a change and since.

use sqlx::SqliteConnection;

use super::Store;
use super::error::StoreError;
use super::export::Within;
use super::query::Query;
use crate::ids::{NodeId, RouteId, StampNs};
use crate::mapping::LOST_DRIFT_M;

/// The times at which a place shows its state before a change and since.
#[derive(Debug, Clone, Copy)]
pub struct TimesOfChange {
    /// Observations before this are out of date.
    pub from: StampNs,
    /// When the new state was first observed.
    pub since: StampNs,
    /// When the old state was observed again; `None` while the new one lasts.
    pub until: Option<StampNs>,
}

impl Store {
    /// The localised nodes within a rectangle, active or not, nearest to a change in time, by id: the last
    /// `side_max` before it, and since then the first and the last half as many.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes_about_change(
        &self,
        route: &RouteId,
        within: Within,
        times: TimesOfChange,
        side_max: u32,
    ) -> Result<Vec<NodeId>, StoreError> {
        let nodes = NodesAboutChange {
            route,
            within,
            times,
            side_max,
        };
        self.read(nodes).await
    }
}

struct NodesAboutChange<'a> {
    route: &'a RouteId,
    within: Within,
    times: TimesOfChange,
    side_max: u32,
}

impl Query for NodesAboutChange<'_> {
    type Answer = Vec<NodeId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Vec<NodeId>, StoreError> {
        let Within { x, y } = self.within;
        let ids: Vec<i64> = sqlx::query_scalar(
            "WITH here AS MATERIALIZED ( \
                 SELECT node_id, stamp_ns FROM routes CROSS JOIN nodes USING (route_key) \
                 WHERE routes.id = $1 AND x BETWEEN $2 AND $3 AND y BETWEEN $4 AND $5 \
                     AND drift_m < $6 AND stamp_ns >= $7 AND ($8 IS NULL OR stamp_ns < $8)) \
             SELECT node_id FROM (SELECT node_id FROM here WHERE stamp_ns < $9 \
                 ORDER BY stamp_ns DESC, node_id DESC LIMIT $10) \
             UNION SELECT node_id FROM (SELECT node_id FROM here WHERE stamp_ns >= $9 \
                 ORDER BY stamp_ns, node_id LIMIT $10 / 2) \
             UNION SELECT node_id FROM (SELECT node_id FROM here WHERE stamp_ns >= $9 \
                 ORDER BY stamp_ns DESC, node_id DESC LIMIT $10 / 2) \
             ORDER BY node_id",
        )
        .bind(self.route.as_str())
        .bind(x[0])
        .bind(x[1])
        .bind(y[0])
        .bind(y[1])
        .bind(LOST_DRIFT_M)
        .bind(self.times.from.0)
        .bind(self.times.until.map(|until| until.0))
        .bind(self.times.since.0)
        .bind(self.side_max)
        .fetch_all(reader)
        .await?;
        Ok(ids.into_iter().map(NodeId).collect())
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use sqlx::Connection;

    use super::*;

    struct Node {
        id: i64,
        stamp: i64,
        x: f64,
        drift_m: f64,
    }

    async fn store_of(nodes: &[Node]) -> SqliteConnection {
        let mut connection = SqliteConnection::connect("sqlite::memory:").await.unwrap();
        for statement in [
            "CREATE TABLE routes (route_key INTEGER PRIMARY KEY, id TEXT)",
            "CREATE TABLE nodes (route_key INTEGER, node_id INTEGER, stamp_ns INTEGER, x REAL, y REAL, drift_m REAL)",
            "INSERT INTO routes VALUES (1, 'hall'), (2, 'other')",
        ] {
            sqlx::query(statement)
                .execute(&mut connection)
                .await
                .unwrap();
        }
        for (route_key, of_other) in [(1, 0), (2, 1_000)] {
            for node in nodes {
                sqlx::query("INSERT INTO nodes VALUES ($1, $2, $3, $4, 0.0, $5)")
                    .bind(route_key)
                    .bind(node.id + of_other)
                    .bind(node.stamp)
                    .bind(node.x)
                    .bind(node.drift_m)
                    .execute(&mut connection)
                    .await
                    .unwrap();
            }
        }
        connection
    }

    /// The same selection in memory.
    fn selected(nodes: &[Node], times: TimesOfChange, side_max: usize) -> Vec<i64> {
        let mut here: Vec<&Node> = nodes.iter().filter(|node| node.x.abs() <= 1.0).collect();
        here.retain(|node| node.drift_m < LOST_DRIFT_M && node.stamp >= times.from.0);
        here.retain(|node| times.until.is_none_or(|until| node.stamp < until.0));
        here.sort_by_key(|node| (node.stamp, node.id));
        let (before, mut since): (Vec<&Node>, Vec<&Node>) =
            here.iter().partition(|node| node.stamp < times.since.0);
        if since.len() > side_max {
            since.drain(side_max / 2..since.len() - side_max / 2);
        }
        let last = before.len().saturating_sub(side_max);
        let mut ids: Vec<i64> = before[last..].iter().chain(&since).map(|n| n.id).collect();
        ids.sort_unstable();
        ids
    }

    #[tokio::test]
    async fn the_nodes_nearest_to_the_change_are_those_of_a_selection_in_memory() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for round in 0..20 {
            let nodes: Vec<Node> = (0..60)
                .map(|id| Node {
                    id,
                    stamp: rng.random_range(0..40),
                    x: rng.random_range(-1.5..1.5),
                    drift_m: if rng.random_range(0..10) == 0 {
                        LOST_DRIFT_M
                    } else {
                        0.1
                    },
                })
                .collect();
            let mut reader = store_of(&nodes).await;
            let times = TimesOfChange {
                from: StampNs(rng.random_range(0..10)),
                since: StampNs(rng.random_range(10..30)),
                until: (round % 2 == 0).then_some(StampNs(35)),
            };
            for side_max in [2, 8, 100] {
                let query = NodesAboutChange {
                    route: &RouteId::new("hall").unwrap(),
                    within: Within {
                        x: [-1.0, 1.0],
                        y: [-1.0, 1.0],
                    },
                    times,
                    side_max,
                };
                let found = query.answer(&mut reader).await.unwrap();
                let found: Vec<i64> = found.iter().map(|id| id.0).collect();
                let expected = selected(&nodes, times, side_max as usize);
                assert_eq!(found, expected, "round {round}, {side_max} a side");
            }
        }
    }
}
