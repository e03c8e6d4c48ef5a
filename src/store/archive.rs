//! Sums over the nodes and edges that have left the active graph, kept as they leave, so that
//! nobody who asks for a route's sub-graphs or residuals has to read its whole past.

use std::collections::BTreeMap;

use futures::TryStreamExt;
use sqlx::{Connection, Row, SqliteConnection};

use super::active_graph::ActiveEdges;
use super::columns::json_text;
use super::error::StoreError;
use super::graph::{edge_of, select_edges};
use super::query::Query;
use super::records::EdgeRecord;
use super::{Store, of_snapshot};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{NodeId, RouteId};

/// The key of what lies in no sub-graph.
const NO_SUBGRAPH: i64 = -1;

/// Sums over nodes and edges of a sub-graph: those that are active, those that have left the
/// active graph, or all of them. An edge has left once one of its nodes has.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SubgraphSums {
    /// Nodes.
    pub nodes: i64,
    /// Edges whose status is active.
    pub edges: i64,
    /// The loop closures among `edges`.
    pub loop_closures: i64,
    /// eᵀΩe summed over `edges` at the current poses; of those that have left, as it was then.
    pub total: f64,
    /// Edges of any status that are in the residual series.
    pub closures: i64,
    /// What those added to F, negative increases counted as 0.
    pub delta_f: f64,
    /// Those of `closures` for which two scans were matched.
    pub scan_closures: i64,
    /// The residuals of their all-points estimates.
    pub all_points: f64,
}

impl SubgraphSums {
    fn add_edge(&mut self, edge: &EdgeRecord) {
        if edge.status == EdgeStatus::Active {
            self.edges += 1;
            self.loop_closures += i64::from(edge.kind == EdgeKind::LoopClosure);
            self.total += edge.residual;
        }
        if let Some(delta_f) = edge.delta_f {
            self.closures += 1;
            self.delta_f += delta_f.max(0.0);
        }
        if let Some(closure) = edge.closure {
            self.scan_closures += 1;
            self.all_points += closure.all_points_residual.max(0.0);
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            nodes: self.nodes + other.nodes,
            edges: self.edges + other.edges,
            loop_closures: self.loop_closures + other.loop_closures,
            total: self.total + other.total,
            closures: self.closures + other.closures,
            delta_f: self.delta_f + other.delta_f,
            scan_closures: self.scan_closures + other.scan_closures,
            all_points: self.all_points + other.all_points,
        }
    }

    fn negated(self) -> Self {
        Self {
            nodes: -self.nodes,
            edges: -self.edges,
            loop_closures: -self.loop_closures,
            total: -self.total,
            closures: -self.closures,
            delta_f: -self.delta_f,
            scan_closures: -self.scan_closures,
            all_points: -self.all_points,
        }
    }
}

type BySubgraph = BTreeMap<i64, SubgraphSums>;

impl Store {
    /// Sums over each sub-graph of a route, what has left the active graph included.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn subgraph_sums(
        &self,
        route: &RouteId,
    ) -> Result<BTreeMap<i64, SubgraphSums>, StoreError> {
        let mut reader = self.reader().await?;
        let sums = read_all(&mut reader, route).await;
        of_snapshot(reader, sums)
    }
}

async fn read_all(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<BySubgraph, StoreError> {
    let mut snapshot = reader.begin().await?;
    let archived = of_route(&mut snapshot, route).await?;
    let edges = ActiveEdges(route).answer(&mut snapshot).await?;
    let nodes: Vec<(i64, i64)> = sqlx::query_as(
        "SELECT subgraph_id, count(*) FROM routes \
         CROSS JOIN nodes INDEXED BY nodes_active \
             ON nodes.route_key = routes.route_key AND nodes.active = 1 \
         WHERE routes.id = $1 AND subgraph_id IS NOT NULL GROUP BY subgraph_id",
    )
    .bind(route.as_str())
    .fetch_all(&mut *snapshot)
    .await?;
    snapshot.commit().await?;
    let mut sums = BySubgraph::new();
    for (subgraph, nodes) in nodes {
        sums.entry(subgraph).or_default().nodes = nodes;
    }
    for edge in &edges {
        if let Some(subgraph) = edge.subgraph_id {
            sums.entry(subgraph).or_default().add_edge(edge);
        }
    }
    for (subgraph, archived) in archived {
        if let Some(subgraph) = subgraph {
            let sum = sums.entry(subgraph).or_default();
            *sum = sum.plus(archived);
        }
    }
    Ok(sums)
}

/// Counts nodes among what has left, with their edges: to be called while they are still active.
pub(super) async fn add_leaving(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: &[NodeId],
) -> Result<(), StoreError> {
    let sums = sums_at(transaction, route_key, nodes).await?;
    add(transaction, route_key, sums).await
}

/// The opposite of [`add_leaving`]: to be called when the nodes are active again.
pub(super) async fn take_reactivated(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: &[NodeId],
) -> Result<(), StoreError> {
    let mut sums = sums_at(transaction, route_key, nodes).await?;
    for sum in sums.values_mut() {
        *sum = sum.negated();
    }
    add(transaction, route_key, sums).await
}

/// The sums of every sub-graph of a route that something has left; `None` for what lay in none.
pub(super) async fn of_route(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<BTreeMap<Option<i64>, SubgraphSums>, StoreError> {
    let rows = sqlx::query(
        "SELECT subgraph_id, archive_sums.nodes, archive_sums.edges, archive_sums.loop_closures, \
             total, closures, delta_f, scan_closures, all_points \
         FROM routes JOIN archive_sums USING (route_key) WHERE routes.id = $1",
    )
    .bind(route.as_str())
    .fetch_all(reader)
    .await?;
    let mut sums = BTreeMap::new();
    for row in &rows {
        let subgraph: i64 = row.try_get("subgraph_id")?;
        let of_subgraph = SubgraphSums {
            nodes: row.try_get("nodes")?,
            edges: row.try_get("edges")?,
            loop_closures: row.try_get("loop_closures")?,
            total: row.try_get("total")?,
            closures: row.try_get("closures")?,
            delta_f: row.try_get("delta_f")?,
            scan_closures: row.try_get("scan_closures")?,
            all_points: row.try_get("all_points")?,
        };
        sums.insert((subgraph != NO_SUBGRAPH).then_some(subgraph), of_subgraph);
    }
    Ok(sums)
}

/// Sums up what had left before there were sums: all of it, or after a failure nothing.
pub(super) async fn fill_if_missing(writer: &mut SqliteConnection) -> Result<(), StoreError> {
    let mut transaction = writer.begin().await?;
    let missing: bool = sqlx::query_scalar(
        "SELECT NOT EXISTS (SELECT 1 FROM archive_sums) \
         AND EXISTS (SELECT 1 FROM nodes WHERE NOT active)",
    )
    .fetch_one(&mut *transaction)
    .await?;
    if missing {
        let routes: Vec<i64> = sqlx::query_scalar("SELECT route_key FROM routes")
            .fetch_all(&mut *transaction)
            .await?;
        for route_key in routes {
            fill(&mut transaction, route_key).await?;
        }
    }
    transaction.commit().await?;
    Ok(())
}

async fn fill(transaction: &mut SqliteConnection, route_key: i64) -> Result<(), StoreError> {
    let mut sums = archived_nodes(transaction, route_key).await?;
    let mut rows = sqlx::query(select_edges!(
        "CROSS JOIN edges USING (route_key)",
        "ORDER BY edges.edge_id",
        "routes.route_key = $1 AND NOT (a.active AND b.active)"
    ))
    .bind(route_key)
    .fetch(&mut *transaction);
    while let Some(row) = rows.try_next().await? {
        let edge = edge_of(&row)?;
        of_subgraph(&mut sums, edge.subgraph_id).add_edge(&edge);
    }
    drop(rows);
    add(transaction, route_key, sums).await
}

fn of_subgraph(sums: &mut BySubgraph, subgraph: Option<i64>) -> &mut SubgraphSums {
    sums.entry(subgraph.unwrap_or(NO_SUBGRAPH)).or_default()
}

async fn archived_nodes(
    writer: &mut SqliteConnection,
    route_key: i64,
) -> Result<BySubgraph, StoreError> {
    let counts: Vec<(Option<i64>, i64)> = sqlx::query_as(
        "SELECT subgraph_id, count(*) FROM nodes WHERE route_key = $1 AND NOT active \
         GROUP BY subgraph_id",
    )
    .bind(route_key)
    .fetch_all(writer)
    .await?;
    let mut sums = BySubgraph::new();
    for (subgraph, nodes) in counts {
        of_subgraph(&mut sums, subgraph).nodes = nodes;
    }
    Ok(sums)
}

/// What active nodes and their edges to other active nodes amount to.
async fn sums_at(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: &[NodeId],
) -> Result<BySubgraph, StoreError> {
    let mut sums = BySubgraph::new();
    if nodes.is_empty() {
        return Ok(sums);
    }
    let ids = json_text(nodes)?;
    let counts: Vec<(Option<i64>, i64)> = sqlx::query_as(
        "SELECT subgraph_id, count(*) FROM nodes WHERE route_key = $1 AND active \
         AND node_id IN (SELECT value FROM json_each($2)) GROUP BY subgraph_id",
    )
    .bind(route_key)
    .bind(&ids)
    .fetch_all(&mut *transaction)
    .await?;
    for (subgraph, nodes) in counts {
        of_subgraph(&mut sums, subgraph).nodes = nodes;
    }
    // UNION, so that an edge between two of them counts once.
    let rows = sqlx::query(select_edges!(
        "CROSS JOIN edges USING (route_key)",
        "ORDER BY edges.edge_id",
        "routes.route_key = $1 AND a.active AND b.active AND edges.edge_id IN ( \
             SELECT edge_id FROM edges INDEXED BY edges_by_from WHERE route_key = $1 \
                 AND from_node IN (SELECT value FROM json_each($2)) \
             UNION SELECT edge_id FROM edges INDEXED BY edges_by_to WHERE route_key = $1 \
                 AND to_node IN (SELECT value FROM json_each($2)))"
    ))
    .bind(route_key)
    .bind(&ids)
    .fetch_all(transaction)
    .await?;
    for row in &rows {
        let edge = edge_of(row)?;
        of_subgraph(&mut sums, edge.subgraph_id).add_edge(&edge);
    }
    Ok(sums)
}

async fn add(
    transaction: &mut SqliteConnection,
    route_key: i64,
    sums: BySubgraph,
) -> Result<(), StoreError> {
    for (subgraph, sum) in sums {
        // An edge that comes back takes away what it amounts to by now, which may be more than it
        // brought.
        sqlx::query(
            "INSERT INTO archive_sums (route_key, subgraph_id, nodes, edges, loop_closures, total, \
                 closures, delta_f, scan_closures, all_points) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) \
             ON CONFLICT DO UPDATE SET nodes = nodes + excluded.nodes, \
                 edges = edges + excluded.edges, \
                 loop_closures = loop_closures + excluded.loop_closures, \
                 total = max(0.0, total + excluded.total), \
                 closures = closures + excluded.closures, \
                 delta_f = max(0.0, delta_f + excluded.delta_f), \
                 scan_closures = scan_closures + excluded.scan_closures, \
                 all_points = max(0.0, all_points + excluded.all_points)",
        )
        .bind(route_key)
        .bind(subgraph)
        .bind(sum.nodes)
        .bind(sum.edges)
        .bind(sum.loop_closures)
        .bind(sum.total)
        .bind(sum.closures)
        .bind(sum.delta_f)
        .bind(sum.scan_closures)
        .bind(sum.all_points)
        .execute(&mut *transaction)
        .await?;
    }
    Ok(())
}
