//! The journal of inputs, and a map that is rebuilt from it.

use std::collections::BTreeSet;

use mapshift::ids::{BatchId, NodeId, OperationId, TripId};
use mapshift::model::BatchStatus;
use mapshift::store::{
    Adoption, Applied, ClaimedJob, Comparison, Input, InputRecord, Meant, NodeRecord,
    OperationRequest, OperationResult, Removal, RemovalRequest, RemovalResult, RouteSettings,
    RouteUpdate, SettingsUpdate, Store, compare, copy, fsck,
};

use crate::support::{Fixture, at, batch_id, by, open, route, upload};

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

/// Repeats, in a copy of the route, what it does not have yet, as if the batches had never come.
async fn make_in(copy: &Fixture, inputs: &[InputRecord], left_out: &BTreeSet<BatchId>) {
    let route = route();
    for record in inputs {
        let Input::Job(job) = &record.input else {
            continue;
        };
        let claimed = copy.store.claim_without(&route, job, left_out, record.at);
        if let Some(job) = claimed.await.unwrap() {
            process(copy, &job).await;
        }
    }
}

/// Takes a batch out, by an operation that goes on.
async fn removed(fixture: &Fixture, batch: &str) -> OperationId {
    let (store, operation) = (&fixture.store, OperationId(uuid::Uuid::from_u128(7)));
    let meant = Meant::Batches(vec![batch_id(batch)]);
    let request = RemovalRequest {
        meant: meant.clone(),
        dry_run: false,
        erase: false,
        note: None,
    };
    let request = OperationRequest::Removal(request);
    let route = route();
    let asked = store.ask_for(operation, Some(&route), request, by(), at(51));
    asked.await.unwrap();
    let result = RemovalResult {
        batches: 1,
        ..RemovalResult::default()
    };
    let removal = Removal {
        operation,
        route_id: route.clone(),
        base_revision: fixture.revision(&route).await,
        removable: store.removable(&route, &meant).await.unwrap(),
        changed_nodes: Vec::new(),
        changed_edges: Vec::new(),
        alerts: Vec::new(),
        reason: "bad".to_owned(),
        erase: false,
        result: result.clone(),
        ends: false,
        at: at(52),
    };
    assert!(store.apply_removal(removal).await.unwrap());
    let going_on = store.operation(operation).await.unwrap().unwrap();
    assert_eq!((going_on.removed, going_on.result), (Some(result), None));
    operation
}

#[tokio::test]
async fn a_map_is_made_anew_in_a_copy_of_the_route_while_uploads_go_on_and_adopted_whole() {
    let fixture = shaped().await;
    let (store, left_out) = (&fixture.store, BTreeSet::from([batch_id("b1")]));
    assert_eq!(store.merged_without_body(&route()).await.unwrap(), 0);
    assert_eq!(store.removed_batches(&route()).await.unwrap(), []);
    let operation = removed(&fixture, "b1").await;
    for begun in 1..3 {
        assert_eq!(store.begin_rebuilding(operation).await.unwrap(), begun);
    }
    assert!(store.has_room_for_copy(&route()).await.unwrap());
    let was_removed = fixture.status("b1").await;
    assert_eq!(was_removed, BatchStatus::Removed);
    let removed = (batch_id("b1"), TripId::new("t").unwrap());
    assert_eq!(store.removed_batches(&route()).await.unwrap(), [removed]);
    let directory = store.copy_directory().unwrap();
    assert!(directory.path().starts_with(fixture.directory.path()));
    let copy = Fixture {
        store: open(&directory).await,
        directory,
    };
    store.copy_route(&route(), &copy.store).await.unwrap();
    let journal = inputs(store).await;
    let begun = store.inputs_to_repeat(&route()).await.unwrap();
    assert_eq!(begun.count, journal.len() as u64);
    assert_eq!(begun.last, journal.last().unwrap().key);
    copy.store.begin_rebuild(&route()).await.unwrap();
    assert!(copy.store.nodes(&route()).await.unwrap().is_empty());
    make_in(&copy, &journal, &left_out).await;

    // Meanwhile the route goes on.
    fixture.journal(upload("b3", "t", 2)).await;
    let job = fixture.claim(60).await.unwrap();
    process(&fixture, &job).await;
    store.copy_route(&route(), &copy.store).await.unwrap();
    copy.store.go_on_with_rebuild(&route()).await.unwrap();
    let late = inputs(store).await.split_off(journal.len());
    assert_eq!(late.len(), 1);
    make_in(&copy, &late, &left_out).await;
    let made = copy.store.nodes(&route()).await.unwrap();
    let was = store.nodes(&route()).await.unwrap();
    let ids = |nodes: &[NodeRecord]| nodes.iter().map(|node| node.id).collect::<Vec<NodeId>>();
    assert_eq!(ids(&made), ids(&was), "nodes keep their ids");

    let Fixture {
        store: copied,
        directory,
    } = copy;
    let adoption = Adoption {
        operation,
        route_id: route(),
        base_revision: fixture.revision(&route()).await,
        made_in: copied.database_path().to_path_buf(),
        is_whole: true,
        alerts: Vec::new(),
        result: RemovalResult::default(),
        at: at(70),
    };
    copied.close().await.unwrap();
    let stale = Adoption {
        base_revision: adoption.base_revision - 1,
        ..adoption.clone()
    };
    assert!(!store.adopt(stale).await.unwrap());
    assert_eq!(store.nodes(&route()).await.unwrap(), was);
    assert!(store.adopt(adoption.clone()).await.unwrap());
    drop(directory);
    assert_eq!(store.nodes(&route()).await.unwrap(), made);
    assert_eq!(fixture.revision(&route()).await, adoption.base_revision + 1);
    let counted = store.route(&route()).await.unwrap().unwrap().counts.nodes;
    assert_eq!(counted, made.len() as i64);
    assert_eq!(fixture.status("waits").await, BatchStatus::Held);
    assert_eq!(fixture.status("bad").await, BatchStatus::Quarantined);
    let last = inputs(store).await.pop().unwrap();
    let rebuilt = Input::Rebuilt {
        operation: adoption.operation,
    };
    assert_eq!((last.input, last.at), (rebuilt, at(70)));
    let report = fsck(fixture.directory.path(), true, &|_, _| {}).await;
    let report = report.unwrap();
    assert!(report.sound, "{:?}", report.faults);
    let ended = store.operation(operation).await.unwrap().unwrap();
    let result = Some(OperationResult::Removal(RemovalResult::default()));
    assert_eq!((ended.removed, ended.result), (None, result));
    // Ids are never used again, and work goes on.
    fixture.journal(upload("b4", "t", 3)).await;
    let job = fixture.claim(80).await.unwrap();
    let first = fixture.chain(&job, 1).await.nodes[0].node.id;
    assert!(was.iter().all(|node| node.id < first));
}
