//! Uploads a pose graph in batches of edges.

use std::path::Path;

use super::args::Args;
use super::tally::{Tally, advice};
use crate::cli::progress::{Progress, say};
use crate::client::GraphParts;
use crate::client::{Gateway, GatewayError, Outcome};
use crate::graph::{EdgeKind, PoseGraph};

/// Sends a pose graph in batches of edges.
///
/// # Errors
/// If a batch could not be sent; a refusal is noted in the tally.
pub(super) async fn upload(
    gateway: &Gateway,
    args: &Args,
    path: &Path,
    graph: &PoseGraph,
    tally: &mut Tally,
) -> anyhow::Result<()> {
    let closures = graph.edges().iter();
    let closures = closures.filter(|edge| edge.kind == EdgeKind::LoopClosure);
    say(&format!(
        "{}: {} nodes, {} edges, {} of them loop closures",
        path.display(),
        graph.nodes().len(),
        graph.edges().len(),
        closures.count(),
    ));
    let parts = GraphParts::of(graph, args.batch_nodes.into())?;
    let trip = args.trip_of(path)?;
    tally.ensure_route(gateway, &args.route).await?;
    let progress = Progress::new(graph.nodes().len() as u64, "nodes");
    let gateway = gateway.notifying(progress.speaker());
    for part in parts.encode(&args.vehicle, &trip) {
        let (batch, nodes) = part?;
        match gateway.put_batch(&args.route, &batch).await {
            Ok(Outcome::Stored) => {
                tally.stored += 1;
                tally.nodes_stored += nodes;
            }
            Ok(Outcome::Replayed) => tally.replayed += 1,
            Err(error @ GatewayError::Refused { .. }) => {
                let advice = advice(&error);
                let failure = format!(
                    "{}: {error}{advice}; its rest is not stored",
                    path.display()
                );
                tally.failures.push(failure);
                break;
            }
            Err(error) => return Err(error.into()),
        }
        tally.batches.push(batch.id);
        progress.advance(nodes as u64);
    }
    progress.finish();
    Ok(())
}
