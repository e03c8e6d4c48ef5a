use std::time::Duration;

use mapshift::ids::RouteId;
use mapshift::model::BatchStatus::{Merged, Processing, Quarantined, Queued, Unanchored};
use mapshift::store::{Applied, StoreError};

use crate::support::{Fixture, LEASE, at, node, put_route, route, upload};

#[tokio::test]
async fn the_oldest_job_first_and_one_a_route() {
    let fixture = Fixture::new().await;
    put_route(&fixture.store, "q").await;
    fixture.journal(upload("z", "t1", 0)).await;
    fixture.journal(upload("a", "t2", 0)).await;
    let mut other = upload("m", "t1", 0);
    other.route_id = RouteId::new("q").unwrap();
    fixture.journal(other).await;
    let pending = || async {
        let routes = fixture.store.routes(None, 10).await.unwrap();
        let of_routes: i64 = routes.iter().map(|route| route.pending_batches).sum();
        let pending = fixture.store.pending_batches().await.unwrap();
        assert_eq!(pending, of_routes);
        pending
    };
    assert_eq!(pending().await, 3);
    let first = fixture.claim(1).await.unwrap();
    assert_eq!(first.entries[0].batch.id.as_str(), "z");
    assert_eq!(first.entries[0].body, b"z");
    assert_eq!((first.attempts, first.after_gap), (1, false));
    let second = fixture.claim(1).await.unwrap();
    assert_eq!(second.route_id.as_str(), "q");
    assert!(fixture.claim(1).await.is_none(), "both routes are held");
    let result = fixture.result(&first, Merged).await;
    fixture.store.apply_result(result).await.unwrap();
    assert_eq!(pending().await, 2);
    let third = fixture.claim(1).await.unwrap();
    assert_eq!(third.entries[0].batch.id.as_str(), "a");
}

#[tokio::test]
async fn a_lost_lease_is_fenced_off() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let lost = fixture.claim(0).await.unwrap();
    assert!(fixture.claim(59).await.is_none());
    let taken = fixture.claim(60).await.unwrap();
    assert_eq!(taken.job_id, lost.job_id);
    assert!(taken.generation > lost.generation);
    assert_eq!(taken.attempts, 2);

    let stale = fixture.chain(&lost, 3).await;
    assert_eq!(
        fixture.store.apply_result(stale).await.unwrap(),
        Applied::Stale
    );
    fixture
        .store
        .fail_job(lost.job_id, lost.generation, "late", at(61))
        .await
        .unwrap();
    assert_eq!(fixture.status("b").await, Processing);
    assert_eq!(fixture.store.nodes(&route()).await.unwrap(), vec![]);
    assert_eq!(fixture.revision(&route()).await, 0);

    let result = fixture.chain(&taken, 3).await;
    assert_eq!(
        fixture.store.apply_result(result.clone()).await.unwrap(),
        Applied::Committed
    );
    assert_eq!(
        fixture.store.apply_result(result).await.unwrap(),
        Applied::Stale
    );
    assert_eq!(fixture.store.nodes(&route()).await.unwrap().len(), 3);
}

#[tokio::test]
async fn a_result_from_another_revision_writes_nothing() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    for wrong in [-1, 1] {
        let mut result = fixture.chain(&job, 2).await;
        result.base_revision += wrong;
        assert_eq!(
            fixture.store.apply_result(result).await.unwrap(),
            Applied::Stale
        );
    }
    assert_eq!(fixture.store.nodes(&route()).await.unwrap(), vec![]);
    assert_eq!(fixture.status("b").await, Processing);
    let result = fixture.chain(&job, 2).await;
    assert_eq!(
        fixture.store.apply_result(result).await.unwrap(),
        Applied::Committed
    );
    assert_eq!(fixture.revision(&route()).await, 1);
}

#[tokio::test]
async fn a_job_that_fails_is_tried_five_times() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    fixture.journal(upload("b1", "t", 1)).await;
    let mut now = 0;
    for pause in [1, 4, 16, 64] {
        let job = fixture.claim(now).await.unwrap();
        fixture
            .store
            .fail_job(job.job_id, job.generation, "no luck", at(now))
            .await
            .unwrap();
        let batch = fixture.batch("b0").await;
        assert_eq!(batch.status, Queued);
        assert_eq!(batch.reason.as_deref(), Some("no luck"));
        assert!(fixture.claim(now + pause - 1).await.is_none());
        now += pause;
    }
    let job = fixture.claim(now).await.unwrap();
    assert_eq!(job.attempts, 5);
    fixture
        .store
        .fail_job(job.job_id, job.generation, "no luck at all", at(now))
        .await
        .unwrap();
    let batch = fixture.batch("b0").await;
    assert_eq!(batch.status, Quarantined);
    assert_eq!(batch.reason.as_deref(), Some("no luck at all"));
    let job = fixture.claim(now).await.unwrap();
    assert_eq!(job.entries[0].batch.id.as_str(), "b1");
    assert!(job.after_gap);
}

#[tokio::test]
async fn a_job_that_loses_its_worker_five_times_is_given_up() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    fixture.journal(upload("b1", "t", 1)).await;
    for k in 0..5 {
        let job = fixture.claim(60 * k).await.unwrap();
        assert_eq!(job.entries[0].batch.id.as_str(), "b0");
    }
    let job = fixture.claim(300).await.unwrap();
    assert_eq!(job.entries[0].batch.id.as_str(), "b1");
    let lost = fixture.batch("b0").await;
    assert_eq!(lost.status, Quarantined);
    assert_eq!(
        lost.reason.as_deref(),
        Some("processing was broken off 5 times")
    );
}

#[tokio::test]
async fn a_batch_waits_while_an_earlier_one_of_its_trip_is_tried_again() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let result = fixture.result(&job, Unanchored).await;
    fixture.store.apply_result(result).await.unwrap();
    grow(&fixture, "big", 20).await;
    // The unanchored batch is queued again; it fails and pauses; its successor must wait.
    let job = fixture.claim(0).await.unwrap();
    assert_eq!(job.entries[0].batch.id.as_str(), "b0");
    fixture
        .store
        .fail_job(job.job_id, job.generation, "no luck", at(0))
        .await
        .unwrap();
    fixture.journal(upload("b1", "t", 1)).await;
    assert_eq!(fixture.status("b1").await, Queued);
    assert!(fixture.claim(0).await.is_none());
    let job = fixture.claim(1).await.unwrap();
    assert_eq!(job.entries[0].batch.id.as_str(), "b0");
}

/// Merges a batch with `count` nodes from a trip of its own.
async fn grow(fixture: &Fixture, id: &str, count: i64) {
    fixture.journal(upload(id, id, 0)).await;
    let job = fixture.claim(1).await.unwrap();
    assert_eq!(job.entries[0].batch.id.as_str(), id);
    let result = fixture.chain(&job, count).await;
    let applied = fixture.store.apply_result(result).await.unwrap();
    assert_eq!(applied, Applied::Committed);
}

#[tokio::test]
async fn unanchored_batches_go_along_and_are_tried_again_when_the_map_has_grown() {
    let fixture = Fixture::new().await;
    grow(&fixture, "base", 40).await;
    for sequence in 0..3 {
        fixture
            .journal(upload(&format!("b{sequence}"), "t", sequence))
            .await;
        let job = fixture.claim(1).await.unwrap();
        let sequences: Vec<_> = job.entries.iter().map(|e| e.batch.sequence).collect();
        assert_eq!(sequences, (0..=sequence).collect::<Vec<_>>());
        let mut result = fixture.result(&job, Unanchored).await;
        for outcome in &mut result.outcomes {
            outcome.reason = Some("no place fits".to_owned());
            outcome.flags = vec!["noted".to_owned(), "lost".to_owned()];
        }
        fixture.store.apply_result(result).await.unwrap();
    }
    assert_eq!(fixture.batch("b0").await.flags, ["noted", "lost"]);
    // 1.25 · 40 + 20 = 70 nodes are wanted.
    grow(&fixture, "little", 29).await;
    assert_eq!(fixture.status("b2").await, Unanchored);
    assert!(fixture.claim(1).await.is_none());
    grow(&fixture, "enough", 1).await;
    assert_eq!(fixture.status("b2").await, Queued);
    assert_eq!(fixture.status("b1").await, Unanchored);
    let record = fixture.store.route(&route()).await.unwrap().unwrap();
    assert_eq!(record.pending_batches, 1);
    let job = fixture.claim(1).await.unwrap();
    let sequences: Vec<_> = job.entries.iter().map(|e| e.batch.sequence).collect();
    assert_eq!(sequences, [0, 1, 2]);
    let mut result = fixture.result(&job, Merged).await;
    let base = fixture.store.load_graph(&route()).await.unwrap().unwrap();
    for (k, entry) in job.entries.iter().enumerate() {
        let id = base.next_node_id.0 + k as i64;
        result.nodes.push(node(&entry.batch, id));
    }
    let applied = fixture.store.apply_result(result).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    for id in ["b0", "b1", "b2"] {
        assert_eq!(fixture.status(id).await, Merged);
    }
    fixture.journal(upload("b3", "t", 3)).await;
    let job = fixture.claim(1).await.unwrap();
    assert_eq!((job.entries.len(), job.after_gap), (1, false));
}

#[tokio::test]
async fn a_result_that_contradicts_itself_is_refused_whole() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    fixture.journal(upload("other", "u", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    type Spoiler = fn(&mut mapshift::store::JobResult);
    let spoilers: [Spoiler; 8] = [
        |r| r.outcomes.clear(),
        |r| r.outcomes[0].status = Processing,
        |r| r.outcomes[0].batch_id = crate::support::batch_id("other"),
        |r| r.nodes[0].node.id = mapshift::ids::NodeId(0),
        |r| r.nodes[0].node.batch_id = crate::support::batch_id("other"),
        |r| r.nodes[0].node.trip_id = "u".parse().unwrap(),
        |r| r.edges[0].id = mapshift::ids::EdgeId(0),
        |r| {
            r.changed_nodes.push(mapshift::store::NodeChange {
                id: mapshift::ids::NodeId(77),
                pose: mapshift::geometry::Pose2::IDENTITY,
                sigma: None,
                subgraph_id: None,
                drift_m: 0.0,
                reference: false,
                active: true,
            });
        },
    ];
    for (k, spoil) in spoilers.iter().enumerate() {
        let mut result = fixture.chain(&job, 3).await;
        spoil(&mut result);
        let answer = fixture.store.apply_result(result).await;
        assert!(
            matches!(answer, Err(StoreError::InvalidResult(_))),
            "{k}: {answer:?}"
        );
        assert_eq!(fixture.store.nodes(&route()).await.unwrap(), vec![], "{k}");
        assert_eq!(fixture.status("b").await, Processing, "{k}");
    }
    let result = fixture.chain(&job, 3).await;
    assert_eq!(
        fixture.store.apply_result(result).await.unwrap(),
        Applied::Committed
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn everyone_who_waits_hears_of_a_job() {
    let fixture = Fixture::new().await;
    let waiters: Vec<_> = (0..3)
        .map(|_| {
            let store = fixture.store.clone();
            tokio::spawn(async move {
                // A worker's loop: look, else wait.
                while store.claim_job(at(1), LEASE).await.unwrap().is_none() {
                    store.job_hint().await;
                }
            })
        })
        .collect();
    for name in ["q0", "q1", "q2"] {
        put_route(&fixture.store, name).await;
        let mut batch = upload("b", "t", 0);
        batch.route_id = RouteId::new(name).unwrap();
        fixture.journal(batch).await;
    }
    let all = futures::future::join_all(waiters);
    let all = tokio::time::timeout(Duration::from_secs(30), all).await;
    assert!(all.unwrap().iter().all(Result::is_ok));
}

/// A passing fault of the store is no try of the batch.
#[tokio::test]
async fn a_job_that_is_returned_has_as_many_tries_as_before() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    for turn in 0..8 {
        let job = fixture.claim(turn * 10).await.unwrap();
        assert_eq!(job.attempts, 1);
        let now = at(turn * 10);
        let returned = fixture.store.return_job(job.job_id, job.generation, now);
        returned.await.unwrap();
        assert_eq!(fixture.status("b").await, Queued);
        assert!(fixture.claim(turn * 10).await.is_none(), "not at once");
    }
}
