//! Counters and states against what the tables say, after random work.
//!
//! With SQL past the store, for SQLite: what the tables say.

use mapshift::graph::EdgeKind;
use mapshift::ids::VehicleId;
use mapshift::model::BatchStatus;
use mapshift::store::{BatchContent, ClaimedJob, RouteCounts, fsck};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use sqlx::SqliteConnection;

use crate::support::{Fixture, LEASE, at, edge, route, upload};

fn below(random: &mut ChaCha8Rng, bound: u32) -> i64 {
    i64::from(random.next_u32() % bound)
}

async fn number(connection: &mut SqliteConnection, query: &'static str) -> i64 {
    sqlx::query_scalar(query)
        .fetch_one(connection)
        .await
        .unwrap()
}

async fn journal(fixture: &Fixture, random: &mut ChaCha8Rng, seconds: i64) {
    let (trip, sequence) = (below(random, 6), below(random, 12));
    let mut batch = upload(
        &format!("b{}", below(random, 500)),
        &format!("t{trip}"),
        sequence,
    );
    // Now and then a vehicle that does not own the trip.
    let vehicle = if below(random, 20) == 0 { 9 } else { trip % 3 };
    batch.vehicle_id = VehicleId::new(format!("v{vehicle}")).unwrap();
    batch.received_at = at(seconds);
    batch.content = BatchContent::Scans {
        sequence,
        scans: below(random, 9),
    };
    fixture.journal(batch).await;
}

async fn work(fixture: &Fixture, random: &mut ChaCha8Rng, seconds: i64) {
    let claimed = fixture.store.claim_job(at(seconds), LEASE).await.unwrap();
    let Some(job) = claimed else { return };
    let store = &fixture.store;
    match below(random, 8) {
        0 => {} // The worker dies.
        1 => store
            .fail_job(job.job_id, job.generation, "unlucky", at(seconds))
            .await
            .unwrap(),
        2 => apply(fixture, random, &job, BatchStatus::Quarantined).await,
        3 | 4 => apply(fixture, random, &job, BatchStatus::Unanchored).await,
        _ => apply(fixture, random, &job, BatchStatus::Merged).await,
    }
}

async fn apply(fixture: &Fixture, random: &mut ChaCha8Rng, job: &ClaimedJob, end: BatchStatus) {
    let mut result = fixture.result(job, end).await;
    if end == BatchStatus::Merged {
        result = fixture.chain(job, below(random, 12)).await;
        let graph = fixture.store.load_graph(&route()).await.unwrap().unwrap();
        let own = &job.entries.last().unwrap().batch;
        let first = graph.nodes.first().map(|with_scan| with_scan.node.id.0);
        if let (Some(from), Some(to)) = (first, result.nodes.last()) {
            let mut closure = edge(own, graph.next_edge_id.0 + 100, from, to.node.id.0);
            closure.kind = EdgeKind::LoopClosure;
            closure.subgraph_id = Some(below(random, 4));
            result.edges.push(closure);
        }
        for edge in graph.edges.iter().step_by(3) {
            result.changed_edges.push(mapshift::store::EdgeChange {
                id: edge.id,
                status: if below(random, 4) == 0 {
                    mapshift::graph::EdgeStatus::Retired
                } else {
                    edge.status
                },
                subgraph_id: (below(random, 2) == 0).then_some(below(random, 5)),
            });
        }
    }
    fixture.store.apply_result(result).await.unwrap();
}

async fn check(fixture: &Fixture, raw: &mut SqliteConnection) {
    let record = fixture.store.route(&route()).await.unwrap().unwrap();
    let counts = RouteCounts {
        batches: number(raw, "SELECT count(*) FROM batches").await,
        scans: number(raw, "SELECT coalesce(sum(scans), 0) FROM batches").await,
        nodes: number(raw, "SELECT count(*) FROM nodes").await,
        edges: number(raw, "SELECT count(*) FROM edges").await,
        loop_closures: number(
            raw,
            "SELECT count(*) FROM edges WHERE kind = 'loop_closure'",
        )
        .await,
        subgraphs: number(
            raw,
            "SELECT count(DISTINCT subgraph_id) FROM edges WHERE status = 'active'",
        )
        .await,
        vehicles: number(raw, "SELECT count(DISTINCT vehicle_id) FROM batches").await,
        open_alerts: 0,
    };
    assert_eq!(record.counts, counts);
    let pending = "SELECT count(*) FROM batches WHERE status IN ('queued', 'processing')";
    assert_eq!(record.pending_batches, number(raw, pending).await);
    for never in [
        // A job for every batch that is queued or processing, and for no other.
        "SELECT count(*) FROM batches LEFT JOIN jobs USING (batch_key) WHERE \
         (job_id IS NOT NULL) <> (status IN ('queued', 'processing'))",
        "SELECT count(*) FROM batches JOIN jobs USING (batch_key) \
         WHERE (state = 'running') <> (status = 'processing')",
        // Nobody is held whose turn it is.
        "SELECT count(*) FROM batches JOIN trips USING (route_key, trip_id) \
         WHERE status = 'held' AND sequence <= next_sequence",
        // Every sequence is used once.
        "SELECT count(*) FROM (SELECT 1 FROM batches WHERE status <> 'quarantined' \
         GROUP BY route_key, trip_id, sequence HAVING count(*) > 1)",
        // What is given up says why.
        "SELECT count(*) FROM batches \
         WHERE status = 'quarantined' AND reason IS NULL AND processed_at_us IS NULL",
        "SELECT count(*) FROM batches LEFT JOIN batch_bodies USING (batch_key) \
         WHERE body IS NULL",
    ] {
        assert_eq!(number(raw, never).await, 0, "{never}");
    }
}

#[tokio::test]
async fn counters_and_states_agree_with_the_tables_after_random_work() {
    for seed in 0..4 {
        let fixture = Fixture::new().await;
        let mut raw = fixture.raw().await;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for step in 0..400 {
            let seconds = step * 5;
            match below(&mut random, 10) {
                0 => {
                    fixture.store.release_overdue(at(seconds)).await.unwrap();
                }
                1..=5 => journal(&fixture, &mut random, seconds).await,
                _ => work(&fixture, &mut random, seconds).await,
            }
            if step % 20 == 19 {
                check(&fixture, &mut raw).await;
            }
        }
        let record = fixture.store.route(&route()).await.unwrap().unwrap();
        assert!(record.counts.nodes > 20 && record.counts.loop_closures > 2);
        let report = fsck(fixture.directory.path(), true, &|_, _| {}).await;
        let report = report.unwrap();
        assert!(report.sound, "{:?}", report.faults);
        fixture.store.close().await.unwrap();
    }
}
