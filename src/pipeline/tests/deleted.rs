//! A route that is deleted while a batch of it is computed.

use std::sync::{Arc, Barrier};
use std::time::Duration;

use jiff::Timestamp;

use super::super::engine::Engine;
use super::super::watch::Watch;
use super::super::worker::compute;
use super::bench::{Bench, at, route, upload};
use crate::model::Actor;
use crate::solver::Interrupt;
use crate::store::{ClaimedJob, RouteUpdate, Store};

const POLL: Duration = Duration::from_millis(5);

async fn claim(store: &Store) -> Option<ClaimedJob> {
    let lease = Duration::from_secs(60);
    store.claim_job(Timestamp::now(), lease).await.unwrap()
}

/// Keeps the engine's threads busy until somebody else waits at the barrier.
async fn occupy(engine: &Engine) -> Arc<Barrier> {
    let [begun, done] = [(); 2].map(|()| Arc::new(Barrier::new(Engine::threads() + 1)));
    for _ in 0..Engine::threads() {
        let (begun, done) = (Arc::clone(&begun), Arc::clone(&done));
        let engine = engine.clone();
        let work = move || {
            begun.wait();
            done.wait();
        };
        tokio::spawn(async move { engine.compute(work).await });
    }
    wait_at(begun).await;
    done
}

async fn wait_at(barrier: Arc<Barrier>) {
    let waiting = tokio::task::spawn_blocking(move || barrier.wait());
    waiting.await.unwrap();
}

async fn delete(store: &Store) {
    store
        .delete_route(&route(), None, &Actor::System, at(2))
        .await
        .unwrap();
}

/// A job with its map loaded, a thread for which is not free before its route is deleted and, if `again`,
/// created once more: what becomes of it, and the bench.
async fn interrupted(again: bool) -> (Bench, String) {
    let bench = Bench::new().await;
    bench.lap("before", 0, 1, |_| Vec::new()).await;
    let (store, engine) = (bench.engine.store.clone(), bench.engine.clone());
    store.journal_batch(upload("after", 1, 1)).await.unwrap();
    let job = Arc::new(claim(&store).await.unwrap());
    let interrupt = Interrupt::default();
    let watch = Watch {
        store: store.clone(),
        job: Arc::clone(&job),
        interrupt: interrupt.clone(),
    };
    let occupied = occupy(&engine).await;
    let watching = tokio::spawn(watch.keep());
    assert_eq!(engine.workspaces.held(), ["workshop"]);
    let heeded = interrupt.clone();
    let computing = {
        let engine = engine.clone();
        tokio::spawn(async move { compute(&engine, &job, &heeded).await.err() })
    };
    while !engine.workspaces.held().is_empty() {
        tokio::time::sleep(POLL).await;
    }
    delete(&store).await;
    if again {
        let update = RouteUpdate::default();
        store
            .put_route(&route(), update, &Actor::System, at(3))
            .await
            .unwrap();
    }
    watching.await.unwrap();
    assert!(interrupt.is_raised());
    wait_at(occupied).await;
    let error = computing.await.unwrap().unwrap();
    drop(engine);
    (bench, format!("{error:#}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_of_a_deleted_route_stops_and_is_not_taken_up_again() {
    let (bench, error) = interrupted(false).await;
    assert!(error.contains("it was interrupted"), "{error}");
    let bench = bench.restarted().await;
    let store = &bench.engine.store;
    assert!(store.route(&route()).await.unwrap().is_none());
    assert!(claim(store).await.is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_of_a_deleted_route_stops_though_another_has_its_name() {
    let (bench, error) = interrupted(true).await;
    assert!(error.contains("it was interrupted"), "{error}");
    let store = &bench.engine.store;
    assert_eq!(
        store.route(&route()).await.unwrap().unwrap().counts.nodes,
        0
    );
    assert!(claim(store).await.is_none());
}
