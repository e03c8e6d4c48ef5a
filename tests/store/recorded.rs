//! Recordings: all batches of one are journalled, or none.

use std::io::{Read, Seek, Write};

use mapshift::model::BatchStatus;
use mapshift::store::{
    BatchFilter, NewBatch, RecordedBatches, RecordingJournaled, Store, StoreError,
};

use crate::support::{Fixture, batch_id, route, upload};

/// A recording of three batches of a trip; the last one bears its name.
fn recording(name: &str, trip: &str) -> Vec<NewBatch> {
    let part = |sequence: i64| format!("{name}.{sequence}");
    let mut batches: Vec<NewBatch> = (0..2)
        .map(|sequence| upload(&part(sequence), trip, sequence))
        .collect();
    batches.push(upload(name, trip, 2));
    batches
}

async fn put(store: &Store, batches: Vec<NewBatch>, identity: u8) -> RecordingJournaled {
    let mut recorded = RecordedBatches::default();
    for batch in batches {
        recorded.push(batch).unwrap();
    }
    let journaled = store.journal_recording(recorded, [identity; 32]).await;
    journaled.unwrap()
}

async fn names(store: &Store) -> Vec<(String, BatchStatus)> {
    let all = BatchFilter::default();
    let found = store.batches(&route(), &all, None, 100).await;
    let found = found.unwrap().into_iter();
    found
        .map(|batch| (batch.id.to_string(), batch.status))
        .collect()
}

#[tokio::test]
async fn a_recording_is_stored_once_and_whole() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let known = |identity: u8| async move {
        let (route, name) = (route(), batch_id("rec"));
        let known = store.recording(&route, &name, &[identity; 32]).await;
        known.unwrap()
    };
    assert_eq!(known(1).await, None);
    assert_eq!(
        put(store, recording("rec", "t"), 1).await,
        RecordingJournaled::Stored
    );
    let stored = names(store).await;
    let expected = [
        ("rec.0", BatchStatus::Queued),
        ("rec.1", BatchStatus::Held),
        ("rec", BatchStatus::Held),
    ];
    assert_eq!(
        stored,
        expected.map(|(name, status)| (name.to_owned(), status))
    );

    assert_eq!(known(1).await, Some(RecordingJournaled::Replayed));
    assert_eq!(known(2).await, Some(RecordingJournaled::Conflict));
    for (batches, identity, became) in [
        (recording("rec", "t"), 1, RecordingJournaled::Replayed),
        (recording("rec", "t"), 2, RecordingJournaled::Conflict),
        // One of its names is another upload's.
        (recording("rec.1", "u"), 3, RecordingJournaled::Conflict),
        (recording("other", "t"), 4, RecordingJournaled::TripTaken),
    ] {
        assert_eq!(put(store, batches, identity).await, became);
        assert_eq!(names(store).await, stored);
    }
}

#[tokio::test]
async fn a_recording_of_no_route_or_of_nothing_is_refused() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let empty = store.journal_recording(RecordedBatches::default(), [0; 32]);
    assert!(matches!(empty.await, Err(StoreError::InvalidResult(_))));
    let mut elsewhere = RecordedBatches::default();
    let mut batch = upload("b0", "t", 0);
    batch.route_id = mapshift::ids::RouteId::new("elsewhere").unwrap();
    elsewhere.push(batch).unwrap();
    let unknown = store.journal_recording(elsewhere, [0; 32]).await;
    assert!(matches!(unknown, Err(StoreError::UnknownRoute)));
    assert_eq!(names(store).await, []);
}

/// The file that a recording is received into has no name, so that a crash leaves nothing behind.
#[tokio::test]
async fn a_temporary_file_holds_what_is_written_and_has_no_name() {
    let fixture = Fixture::new().await;
    let files = || std::fs::read_dir(fixture.directory.path()).unwrap().count();
    let before = files();
    let mut file = fixture.store.temporary_file(1_000).await.unwrap();
    assert_eq!(files(), before);
    file.write_all(b"scans").unwrap();
    file.rewind().unwrap();
    let mut text = String::new();
    file.read_to_string(&mut text).unwrap();
    assert_eq!(text, "scans");
}
