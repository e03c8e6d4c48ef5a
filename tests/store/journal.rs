//! Uploads: stored once, replayed without a trace, listed, and read back to the bit.
//!
//! With SQL past the store, for SQLite: a body that is not what was written.

use std::collections::BTreeMap;

use mapshift::ids::{RouteId, VehicleId};
use mapshift::model::BatchStatus;
use mapshift::store::{
    BatchContent, BatchFilter, Corruption, Journaled, OutOfRange, Store, StoreError,
};
use sqlx::SqliteConnection;
use tokio::task::JoinSet;

use crate::support::{Fixture, at, batch_id, route, upload};

async fn put_all(
    store: &Store,
    batches: Vec<mapshift::store::NewBatch>,
) -> Vec<(String, Vec<u8>, Journaled)> {
    let mut tasks = JoinSet::new();
    for batch in batches {
        let store = store.clone();
        tasks.spawn(async move {
            let (id, body) = (batch.id.to_string(), batch.body.clone());
            (id, body, store.journal_batch(batch).await.unwrap())
        });
    }
    tasks.join_all().await
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_upload_200_times_at_once_is_stored_once() {
    let fixture = Fixture::new().await;
    let answers = put_all(&fixture.store, vec![upload("b", "t", 0); 200]).await;
    let count = |wanted| answers.iter().filter(|answer| answer.2 == wanted).count();
    assert_eq!(count(Journaled::Stored), 1);
    assert_eq!(count(Journaled::Replayed), 199);
    let record = fixture.store.route(&route()).await.unwrap().unwrap();
    assert_eq!(record.counts.batches, 1);
    assert_eq!(record.counts.scans, 3);
    assert_eq!(record.counts.vehicles, 1);
    assert_eq!(record.pending_batches, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn of_200_uploads_with_50_ids_the_first_bytes_win() {
    let fixture = Fixture::new().await;
    let batches = (0..200).map(|k| {
        let mut batch = upload(&format!("b{}", k % 50), &format!("t{}", k % 50), 0);
        batch.body = vec![u8::from(k % 3 == 0)];
        batch
    });
    let answers = put_all(&fixture.store, batches.collect()).await;
    let mut winners = BTreeMap::new();
    for (id, body, answer) in &answers {
        if *answer == Journaled::Stored {
            assert!(winners.insert(id, body).is_none(), "{id} was stored twice");
        }
    }
    assert_eq!(winners.len(), 50);
    for (id, body, answer) in &answers {
        if winners[id] != body {
            assert_eq!(*answer, Journaled::Conflict, "{id}");
        } else {
            assert_ne!(*answer, Journaled::Conflict, "{id}");
        }
        let entry = fixture.store.journal_entry(&route(), &batch_id(id)).await;
        assert_eq!(entry.unwrap().unwrap().body, *winners[id]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_faulty_write_does_not_spoil_its_group() {
    let fixture = Fixture::new().await;
    let mut tasks = JoinSet::new();
    for k in 0..100 {
        let store = fixture.store.clone();
        let mut batch = upload(&format!("b{k}"), &format!("t{k}"), 0);
        match k % 10 {
            3 => {
                batch.content = BatchContent::Scans {
                    sequence: -1,
                    scans: 3,
                }
            }
            7 => batch.route_id = RouteId::new("nowhere").unwrap(),
            _ => {}
        }
        tasks.spawn(async move { (k, store.journal_batch(batch).await) });
    }
    while let Some(answer) = tasks.join_next().await {
        let (k, answer) = answer.unwrap();
        match (k % 10, answer) {
            (3, Err(StoreError::Database(_))) | (7, Err(StoreError::UnknownRoute)) => {}
            (3 | 7, answer) => panic!("{k}: {answer:?}"),
            (_, answer) => assert_eq!(answer.unwrap(), Journaled::Stored),
        }
    }
    let record = fixture.store.route(&route()).await.unwrap().unwrap();
    assert_eq!(record.counts.batches, 80);
    fixture.store.check_ready().await.unwrap();
}

#[tokio::test]
async fn a_batch_is_read_back_as_it_was_sent() {
    let fixture = Fixture::new().await;
    let mut sent = upload("b", "t", 0);
    sent.out_of_range = Some(OutOfRange {
        above_range_max: 7,
        below_range_min: 0,
    });
    sent.extensions = Some(r#"{"firmware": 1.50}"#.to_owned());
    sent.body = (0..100_000_u32).map(|k| (k % 7) as u8).collect();
    fixture.journal(sent.clone()).await;
    let entry = fixture.store.journal_entry(&route(), &sent.id).await;
    let entry = entry.unwrap().unwrap();
    assert_eq!(entry.body, sent.body);
    assert_eq!(entry.batch, fixture.batch("b").await);
    assert_eq!(entry.batch.flags, sent.flags);
    assert_eq!(entry.batch.out_of_range, sent.out_of_range);
    assert_eq!(entry.batch.extensions, sent.extensions);
    assert_eq!(entry.batch.received_at, sent.received_at);
    assert_eq!(entry.batch.status, BatchStatus::Queued);
    assert_eq!((entry.batch.scans, entry.batch.sequence), (3, 0));
    assert_eq!(entry.batch.processed_at, None);
    let unknown = fixture.store.batch(&route(), &batch_id("x")).await;
    assert_eq!(unknown.unwrap(), None);
}

async fn rot(connection: &mut SqliteConnection, id: &str) {
    // The last byte of the compressed frame, inverted.
    let (key, mut body): (i64, Vec<u8>) = sqlx::query_as(
        "SELECT batch_key, body FROM batch_bodies JOIN batches USING (batch_key) WHERE id = ?",
    )
    .bind(id)
    .fetch_one(&mut *connection)
    .await
    .unwrap();
    *body.last_mut().unwrap() ^= 0xff;
    sqlx::query("UPDATE batch_bodies SET body = ? WHERE batch_key = ?")
        .bind(body)
        .bind(key)
        .execute(connection)
        .await
        .unwrap();
}

#[tokio::test]
async fn rot_in_a_body_is_found_and_the_trip_goes_on() {
    let fixture = Fixture::new().await;
    for sequence in 0..2 {
        fixture
            .journal(upload(&format!("b{sequence}"), "t", sequence))
            .await;
    }
    rot(&mut fixture.raw().await, "b0").await;
    let read = fixture.store.journal_entry(&route(), &batch_id("b0")).await;
    let Err(StoreError::Corrupt(Corruption::Body { route_id, batch_id })) = read else {
        panic!("{read:?}");
    };
    assert_eq!((route_id.as_str(), batch_id.as_str()), ("r", "b0"));
    let job = fixture.claim(1).await.unwrap();
    assert_eq!(job.entries.len(), 1);
    assert_eq!(job.entries[0].batch.id.as_str(), "b1");
    assert!(job.after_gap, "its predecessor is not in the trip");
    let rotten = fixture.batch("b0").await;
    assert_eq!(rotten.status, BatchStatus::Quarantined);
    assert!(rotten.reason.unwrap().contains("corrupt"));
}

#[tokio::test]
async fn rot_in_an_earlier_unanchored_body_does_not_stop_the_job() {
    let fixture = Fixture::new().await;
    for sequence in 0..3 {
        fixture
            .journal(upload(&format!("b{sequence}"), "t", sequence))
            .await;
    }
    for _ in 0..2 {
        let job = fixture.claim(1).await.unwrap();
        let result = fixture.result(&job, BatchStatus::Unanchored).await;
        fixture.store.apply_result(result).await.unwrap();
    }
    rot(&mut fixture.raw().await, "b0").await;
    let job = fixture.claim(2).await.unwrap();
    let ids: Vec<_> = job.entries.iter().map(|e| e.batch.id.as_str()).collect();
    assert_eq!(ids, ["b1", "b2"]);
    assert_eq!(job.attempts, 1, "the job itself did not fail");
    assert_eq!(fixture.status("b0").await, BatchStatus::Quarantined);
}

#[tokio::test]
async fn pages_and_filters_keep_the_order_of_arrival() {
    let fixture = Fixture::new().await;
    // Ids against the order of arrival; two vehicles; the second of each trip is held.
    for k in 0..20 {
        let mut batch = upload(&format!("b{}", 99 - k), &format!("t{}", k / 2), k % 2);
        batch.vehicle_id = VehicleId::new(format!("v{}", k / 2 % 2)).unwrap();
        batch.received_at = at(-k);
        fixture.journal(batch).await;
    }
    let mut pages = vec![];
    let filter = BatchFilter::default();
    loop {
        let after = pages.last().cloned();
        let page = fixture
            .store
            .batches(&route(), &filter, after.as_ref(), 7)
            .await
            .unwrap();
        if page.is_empty() {
            break;
        }
        pages.extend(page.into_iter().map(|batch| batch.id));
    }
    let wanted: Vec<_> = (0..20).map(|k| batch_id(&format!("b{}", 99 - k))).collect();
    assert_eq!(pages, wanted);
    let filter = BatchFilter {
        ids: None,
        vehicle_id: Some(VehicleId::new("v1").unwrap()),
        status: Some(BatchStatus::Held),
    };
    let found = fixture.store.batches(&route(), &filter, None, 100).await;
    let found: Vec<_> = found.unwrap().into_iter().map(|b| b.id).collect();
    let wanted: Vec<_> = [3, 7, 11, 15, 19]
        .map(|k| batch_id(&format!("b{}", 99 - k)))
        .into();
    assert_eq!(found, wanted);
    let after_nothing = fixture
        .store
        .batches(&route(), &BatchFilter::default(), Some(&batch_id("x")), 9)
        .await;
    assert_eq!(after_nothing.unwrap(), vec![]);
}

#[tokio::test]
async fn the_figures_count_what_is_not_in_a_map() {
    let fixture = Fixture::new().await;
    let nothing = fixture.store.figures().await.unwrap();
    assert_eq!(nothing.oldest_queued, None);
    assert_eq!(nothing.routes.values().sum::<i64>(), 1);
    // 0 is queued, 2 is held, and another 0 is quarantined.
    fixture.journal(upload("first", "t", 0)).await;
    fixture.journal(upload("third", "t", 2)).await;
    fixture.journal(upload("again", "t", 0)).await;
    let figures = fixture.store.figures().await.unwrap();
    let count = |status| figures.batches.get(&status).copied();
    use BatchStatus::{Held, Merged, Processing, Quarantined, Queued};
    assert_eq!(count(Queued), Some(1));
    assert_eq!(count(Held), Some(1));
    assert_eq!(count(Quarantined), Some(1));
    assert_eq!(count(Processing), Some(0));
    assert_eq!(count(Merged), None, "those in a map are too many");
    let first = fixture.batch("first").await;
    assert_eq!(figures.oldest_queued, Some(first.received_at));
    // What is tried again arrived long ago, and does not make the queue old.
    let job = fixture.claim(0).await.unwrap();
    let failed = fixture
        .store
        .fail_job(job.job_id, job.generation, "so", at(1));
    failed.await.unwrap();
    let figures = fixture.store.figures().await.unwrap();
    assert_eq!(figures.oldest_queued, None);
    let disk = fixture.store.disk_use();
    assert!(disk.database > 0 && disk.free.unwrap() > 0);
}
