//! Opening, closing, dying.

use mapshift::ids::{EdgeId, NodeId, TripId};
use mapshift::model::BatchStatus;
use mapshift::store::{BatchFilter, Deleted, EdgeFilter, Journaled, RouteGraph, Store, StoreError};
use tokio::runtime::Runtime;

use crate::support::{Fixture, LEASE, at, batch_id, by, open, options, put_route, route, upload};

#[test]
fn a_killed_process_loses_nothing_and_its_jobs_are_free_again() {
    let directory = tempfile::tempdir().unwrap();
    let first = Runtime::new().unwrap();
    let lost = first.block_on(async {
        let store = open(&directory).await;
        put_route(&store, "r").await;
        for sequence in 0..3 {
            let batch = upload(&format!("b{sequence}"), "t", sequence);
            store.journal_batch(batch).await.unwrap();
        }
        store.claim_job(at(0), LEASE).await.unwrap().unwrap()
    });
    // The writer and everything else stop where they stand.
    drop(first);

    Runtime::new().unwrap().block_on(async {
        let store = open(&directory).await;
        let fixture = Fixture { store, directory };
        assert_eq!(fixture.status("b0").await, BatchStatus::Queued);
        assert_eq!(fixture.status("b1").await, BatchStatus::Held);
        let again = fixture.journal(upload("b2", "t", 2)).await;
        assert_eq!(again, Journaled::Replayed);
        let job = fixture.claim_lost().await;
        assert_eq!(job.job_id, lost.job_id);
        assert!(job.generation > lost.generation);
        assert_eq!(job.entries[0].body, b"b0");
        let stale = fixture.result(&lost, BatchStatus::Merged).await;
        let stale = fixture.store.apply_result(stale).await.unwrap();
        assert_eq!(stale, mapshift::store::Applied::Stale);
    });
}

#[tokio::test]
async fn one_store_a_directory() {
    let fixture = Fixture::new().await;
    let second = Store::open(options(&fixture.directory)).await;
    assert!(matches!(second, Err(StoreError::Locked(_))));
    fixture.store.close().await.unwrap();
    open(&fixture.directory).await.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn closing_writes_what_was_taken_and_refuses_the_rest() {
    let fixture = Fixture::new().await;
    let tasks: Vec<_> = (0..100)
        .map(|k| {
            let store = fixture.store.clone();
            let batch = upload(&format!("b{k}"), &format!("t{k}"), 0);
            tokio::spawn(async move { store.journal_batch(batch).await })
        })
        .collect();
    let other = fixture.store.clone();
    tokio::task::yield_now().await;
    fixture.store.close().await.unwrap();
    let mut stored = vec![];
    for (k, task) in tasks.into_iter().enumerate() {
        match task.await.unwrap() {
            Ok(Journaled::Stored) => stored.push(k),
            Err(StoreError::Unavailable) => {}
            answer => panic!("{answer:?}"),
        }
    }
    assert!(matches!(
        other.check_ready().await,
        Err(StoreError::Unavailable)
    ));
    assert!(matches!(
        other.route(&route()).await,
        Err(StoreError::Unavailable)
    ));
    let refused = other.journal_batch(upload("late", "t", 0)).await;
    assert!(matches!(refused, Err(StoreError::Unavailable)));
    assert!(
        other.clone().close().await.is_ok(),
        "closing twice is harmless"
    );
    drop(other);

    let store = open(&fixture.directory).await;
    for k in &stored {
        let id = batch_id(&format!("b{k}"));
        assert!(store.batch(&route(), &id).await.unwrap().is_some(), "{k}");
    }
    let record = store.route(&route()).await.unwrap().unwrap();
    assert_eq!(record.counts.batches, stored.len() as i64);
}

#[tokio::test]
async fn the_log_is_gone_after_a_close() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    fixture.store.close().await.unwrap();
    let log = fixture.directory.path().join("mapshift.db-wal");
    assert!(std::fs::metadata(log).map_or(0, |log| log.len()) == 0);
}

#[tokio::test]
async fn every_statement_runs_on_a_fresh_database() {
    let Fixture { store, directory } = Fixture::new().await;
    let (route, trip) = (route(), TripId::new("t").unwrap());
    store.check_ready().await.unwrap();
    assert!(store.claim_job(at(0), LEASE).await.unwrap().is_none());
    store.fail_job(1, 1, "nobody's", at(0)).await.unwrap();
    assert_eq!(store.release_overdue(at(0)).await.unwrap(), 0);
    let filter = BatchFilter {
        ids: None,
        vehicle_id: Some("v".parse().unwrap()),
        status: Some(BatchStatus::Merged),
    };
    let after = batch_id("b");
    let page = store.batches(&route, &filter, Some(&after), 5).await;
    assert_eq!(page.unwrap(), vec![]);
    assert!(store.batch(&route, &after).await.unwrap().is_none());
    assert!(store.journal_entry(&route, &after).await.unwrap().is_none());
    let graph = store.load_graph(&route).await.unwrap().unwrap();
    let RouteGraph { nodes, edges, .. } = graph;
    assert!(nodes.is_empty() && edges.is_empty());
    assert_eq!(store.nodes(&route).await.unwrap(), vec![]);
    assert_eq!(store.node_page(&route, None, 5).await.unwrap(), vec![]);
    assert_eq!(store.node(&route, NodeId(1)).await.unwrap(), None);
    assert_eq!(store.node_scan(&route, NodeId(1)).await.unwrap(), None);
    assert_eq!(store.nodes_with_scans(&route).await.unwrap(), vec![]);
    assert_eq!(store.trip_nodes(&route, &trip).await.unwrap(), vec![]);
    assert_eq!(store.trajectory(&route, &trip).await.unwrap(), vec![]);
    assert_eq!(store.edges(&route).await.unwrap(), vec![]);
    assert_eq!(
        store
            .edge_page(&route, EdgeFilter::default(), None, 5)
            .await
            .unwrap(),
        vec![]
    );
    assert_eq!(store.edge(&route, EdgeId(1)).await.unwrap(), None);
    assert_eq!(store.routes(None, 5).await.unwrap().len(), 1);
    assert_eq!(
        store.delete_route(&route, None, by(), at(9)).await.unwrap(),
        Deleted::Done
    );
    assert!(store.route(&route).await.unwrap().is_none());
    store.close().await.unwrap();
    // Opening again runs the statements of the recovery.
    open(&directory).await.close().await.unwrap();
}
