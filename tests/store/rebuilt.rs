//! The journal of inputs, and a map that is rebuilt from it.

use mapshift::ids::BatchId;
use mapshift::model::BatchStatus;
use mapshift::store::{
    Applied, ClaimedJob, Comparison, Input, InputRecord, RouteSettings, RouteUpdate,
    SettingsUpdate, Store, compare, copy,
};

use crate::support::{Fixture, at, by, route, upload};

/// A result that depends on nothing but the job.
async fn process(fixture: &Fixture, job: &ClaimedJob) {
    let mut result = match job.entries.last().unwrap().batch.id.as_str() {
        "b2" => fixture.result(job, BatchStatus::Unanchored).await,
        _ => fixture.chain(job, 3).await,
    };
    result.processed_at = job.at;
    assert_eq!(
        fixture.store.apply_result(result).await.unwrap(),
        Applied::Committed
    );
}

/// Three batches that are processed, one that is given up, one that waits for it, and a setting.
async fn shaped() -> Fixture {
    let fixture = Fixture::new().await;
    for (id, trip, sequence) in [
        ("b0", "t", 0),
        ("b1", "t", 1),
        ("b2", "u", 0),
        ("bad", "w", 0),
    ] {
        fixture.journal(upload(id, trip, sequence)).await;
    }
    for second in [10, 20, 30] {
        let job = fixture.claim(second).await.unwrap();
        process(&fixture, &job).await;
    }
    let job = fixture.claim(40).await.unwrap();
    let (id, generation) = (job.job_id, job.generation);
    let given_up = fixture.store.give_up_job(id, generation, "broken", at(41));
    given_up.await.unwrap();
    let update = RouteUpdate {
        settings: SettingsUpdate {
            hold_s: Some(7),
            ..SettingsUpdate::default()
        },
        ..RouteUpdate::default()
    };
    let put = fixture
        .store
        .put_route(&route(), update, by(), at(50))
        .await;
    put.unwrap();
    fixture.journal(upload("waits", "x", 4)).await;
    fixture
}

async fn inputs(store: &Store) -> Vec<InputRecord> {
    let mut inputs: Vec<InputRecord> = Vec::new();
    loop {
        let after = inputs.last().map_or(0, |last| last.key);
        let part = store.inputs(&route(), after, 2).await.unwrap();
        if part.is_empty() {
            return inputs;
        }
        assert!(part.windows(2).all(|pair| pair[0].key < pair[1].key));
        inputs.extend(part);
    }
}

/// An input in short.
fn in_short(record: &InputRecord) -> String {
    match &record.input {
        Input::Settings(settings) => format!("hold {}", settings.hold_s),
        Input::Job(job) => job.batches.iter().map(BatchId::as_str).collect(),
        Input::KeptOut { batch, status, .. } => format!("{batch} {}", status.name()),
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn the_journal_names_in_order_what_shaped_a_map() {
    let fixture = shaped().await;
    let inputs = inputs(&fixture.store).await;
    let found: Vec<String> = inputs.iter().map(in_short).collect();
    assert_eq!(
        found,
        ["hold 600", "b0", "b1", "b2", "bad quarantined", "hold 7"]
    );
    let times: Vec<_> = inputs.iter().map(|input| input.at).collect();
    assert_eq!(times, [0, 10, 20, 30, 41, 50].map(at));
}

async fn repeat(fixture: &Fixture, record: InputRecord, hold_s: Option<u32>) {
    let store = &fixture.store;
    match record.input {
        Input::Settings(settings) => {
            let settings = RouteSettings {
                hold_s: hold_s.unwrap_or(settings.hold_s),
                ..settings
            };
            store
                .set_again(&route(), settings, record.at)
                .await
                .unwrap();
        }
        Input::Job(job) => {
            let job = store.claim_again(&route(), &job, record.at).await.unwrap();
            process(fixture, &job.unwrap()).await;
        }
        Input::KeptOut {
            batch,
            status,
            reason,
        } => {
            let (route, at) = (route(), record.at);
            let kept_out = store.keep_out_again(&route, &batch, status, reason, at);
            kept_out.await.unwrap();
        }
        other => panic!("{other:?}"),
    }
}

/// Repeats the inputs of a route and compares it with what it was.
async fn rebuilt(hold_s: Option<u32>) -> (Fixture, Comparison) {
    let fixture = shaped().await;
    let before = tempfile::tempdir().unwrap();
    copy(fixture.directory.path(), before.path()).await.unwrap();
    let journal = inputs(&fixture.store).await;
    let to_repeat = fixture.store.begin_rebuild(&route()).await.unwrap();
    assert_eq!(to_repeat.count, journal.len() as u64);
    assert_eq!(to_repeat.last, journal.last().unwrap().key);
    assert!(fixture.store.nodes(&route()).await.unwrap().is_empty());
    for record in journal.clone() {
        repeat(&fixture, record, hold_s).await;
    }
    fixture.store.end_rebuild(&route()).await.unwrap();
    assert_eq!(inputs(&fixture.store).await, journal);
    let compared = compare(fixture.directory.path(), before.path(), &route()).await;
    (fixture, compared.unwrap())
}

#[tokio::test]
async fn a_rebuilt_map_is_the_same_to_the_bit_and_waiting_batches_still_wait() {
    let (fixture, comparison) = rebuilt(None).await;
    assert!(comparison.same, "{comparison:?}");
    assert_eq!(fixture.status("waits").await, BatchStatus::Held);
    assert_eq!(fixture.status("bad").await, BatchStatus::Quarantined);
    // Work goes on where it was.
    fixture.journal(upload("b3", "t", 2)).await;
    assert_eq!(
        fixture.claim(60).await.unwrap().entries[0]
            .batch
            .id
            .as_str(),
        "b3"
    );
}

#[tokio::test]
async fn a_map_rebuilt_from_other_inputs_differs() {
    let (_fixture, comparison) = rebuilt(Some(8)).await;
    assert!(!comparison.same);
    assert!(comparison.tables.contains_key("routes"), "{comparison:?}");
}
