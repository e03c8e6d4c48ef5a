//! Sums over each sub-graph of a route: what is active, and what has been archived.

use std::collections::BTreeMap;

use sqlx::SqliteConnection;

use super::Store;
use super::active_graph::ActiveEdges;
use super::archive::{ArchivedSums, SubgraphSums};
use super::error::StoreError;
use super::query::Query;
use crate::ids::RouteId;

impl Store {
    /// Sums over each sub-graph of a route, what has left the active graph included.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn subgraph_sums(
        &self,
        route: &RouteId,
    ) -> Result<BTreeMap<i64, SubgraphSums>, StoreError> {
        self.read(Subgraphs(route)).await
    }
}

/// Sums over each sub-graph of a route.
struct Subgraphs<'a>(&'a RouteId);

impl Query for Subgraphs<'_> {
    type Answer = BTreeMap<i64, SubgraphSums>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let archived = ArchivedSums(self.0).answer(reader).await?;
        let edges = ActiveEdges(self.0).answer(reader).await?;
        let mut sums = active_nodes(reader, self.0).await?;
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
}

/// The active nodes of each sub-graph, counted.
async fn active_nodes(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<BTreeMap<i64, SubgraphSums>, StoreError> {
    let counts: Vec<(i64, i64)> = sqlx::query_as(
        "SELECT subgraph_id, count(*) FROM routes \
         CROSS JOIN nodes INDEXED BY nodes_active \
             ON nodes.route_key = routes.route_key AND nodes.active = 1 \
         WHERE routes.id = $1 AND subgraph_id IS NOT NULL GROUP BY subgraph_id",
    )
    .bind(route.as_str())
    .fetch_all(reader)
    .await?;
    let of_nodes = |nodes| SubgraphSums {
        nodes,
        ..SubgraphSums::default()
    };
    let counts = counts.into_iter();
    Ok(counts
        .map(|(subgraph, nodes)| (subgraph, of_nodes(nodes)))
        .collect())
}
