//! Batches of edges in the journal and the queue.

use mapshift::ids::VehicleId;
use mapshift::model::{BatchKind, BatchStatus};
use mapshift::store::{Applied, BatchContent, NewBatch};

use crate::support::{Fixture, upload};

fn edges(id: &str, trip: &str, vehicle: &str) -> NewBatch {
    NewBatch {
        vehicle_id: VehicleId::new(vehicle).unwrap(),
        content: BatchContent::Edges,
        ..upload(id, trip, 0)
    }
}

#[tokio::test]
async fn batches_of_edges_are_numbered_as_they_arrive_and_none_is_held() {
    let fixture = Fixture::new().await;
    for id in ["b0", "b1", "b2"] {
        fixture.journal(edges(id, "t", "v")).await;
    }
    for (k, id) in ["b0", "b1", "b2"].into_iter().enumerate() {
        let batch = fixture.batch(id).await;
        assert_eq!((batch.kind, batch.sequence), (BatchKind::Edges, k as i64));
        assert_eq!((batch.status, batch.scans), (BatchStatus::Queued, 0));
        let job = fixture.claim(0).await.unwrap();
        assert_eq!(job.entries.len(), 1);
        assert_eq!(job.entries[0].batch.id, batch.id);
        assert!(!job.after_gap);
        let result = fixture.chain(&job, 3).await;
        let applied = fixture.store.apply_result(result).await.unwrap();
        assert_eq!(applied, Applied::Committed);
    }
}

#[tokio::test]
async fn a_job_takes_along_what_its_vehicle_could_not_tie() {
    let fixture = Fixture::new().await;
    // Scans of the same vehicle and edges of another one are no business of its.
    fixture.journal(upload("scans", "s", 0)).await;
    for (id, vehicle) in [("a0", "v"), ("b0", "w"), ("a1", "v")] {
        fixture.journal(edges(id, id, vehicle)).await;
    }
    for _ in 0..3 {
        let job = fixture.claim(0).await.unwrap();
        let unanchored = fixture.result(&job, BatchStatus::Unanchored).await;
        fixture.store.apply_result(unanchored).await.unwrap();
    }
    let job = fixture.claim(0).await.unwrap();
    let ids: Vec<&str> = job.entries.iter().map(|e| e.batch.id.as_str()).collect();
    assert_eq!(ids, ["a0", "a1"], "the job's own is the last");
    let merged = fixture.result(&job, BatchStatus::Merged).await;
    let applied = fixture.store.apply_result(merged).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    assert_eq!(fixture.status("a0").await, BatchStatus::Merged);
    assert_eq!(fixture.status("b0").await, BatchStatus::Unanchored);
}

#[tokio::test]
async fn a_trip_has_scans_or_edges() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("s0", "scans", 0)).await;
    fixture.journal(edges("e0", "edges", "v")).await;
    fixture.journal(edges("e1", "scans", "v")).await;
    fixture.journal(upload("s1", "edges", 1)).await;
    for (id, what) in [("e1", "has scans"), ("s1", "has edges")] {
        let batch = fixture.batch(id).await;
        assert_eq!(batch.status, BatchStatus::Quarantined);
        assert!(batch.reason.unwrap().contains(what));
    }
    // What was refused on arrival takes no place.
    fixture.journal(edges("e2", "edges", "v")).await;
    assert_eq!(fixture.status("e2").await, BatchStatus::Queued);
}
