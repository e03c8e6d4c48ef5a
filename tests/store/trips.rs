use mapshift::ids::{RouteId, VehicleId};
use mapshift::model::BatchStatus::{Held, Merged, Processing, Quarantined, Queued, Unanchored};
use mapshift::store::{Journaled, RouteUpdate, SettingsUpdate};

use crate::support::{Fixture, at, by, put_route, route, upload};

async fn finish(fixture: &Fixture, status: mapshift::model::BatchStatus) -> String {
    let job = fixture.claim(1).await.unwrap();
    let result = fixture.result(&job, status).await;
    let id = job.entries.last().unwrap().batch.id.to_string();
    assert_eq!(
        fixture.store.apply_result(result).await.unwrap(),
        mapshift::store::Applied::Committed
    );
    id
}

#[tokio::test]
async fn batches_of_a_trip_have_their_turn_one_after_the_other() {
    let fixture = Fixture::new().await;
    for sequence in [2, 0, 1, 4] {
        fixture
            .journal(upload(&format!("b{sequence}"), "t", sequence))
            .await;
    }
    assert_eq!(fixture.status("b0").await, Queued);
    for later in ["b1", "b2", "b4"] {
        assert_eq!(fixture.status(later).await, Held, "{later}");
    }
    assert_eq!(finish(&fixture, Merged).await, "b0");
    assert_eq!(fixture.status("b1").await, Queued);
    assert_eq!(finish(&fixture, Quarantined).await, "b1");
    assert_eq!(finish(&fixture, Unanchored).await, "b2");
    assert_eq!(fixture.status("b4").await, Held, "3 is missing");
    assert!(fixture.claim(1).await.is_none());
    fixture.journal(upload("b3", "t", 3)).await;
    assert_eq!(finish(&fixture, Merged).await, "b3");
    assert_eq!(finish(&fixture, Merged).await, "b4");
    assert_eq!(fixture.status("b2").await, Merged, "it went along with 3");
}

#[tokio::test]
async fn a_gap_is_skipped_when_its_time_is_over() {
    let fixture = Fixture::new().await;
    for (id, sequence, second) in [("b5", 5, 0), ("b6", 6, 10)] {
        let mut batch = upload(id, "t", sequence);
        batch.received_at = at(second);
        fixture.journal(batch).await;
    }
    assert_eq!(fixture.store.release_overdue(at(599)).await.unwrap(), 0);
    assert_eq!(fixture.store.release_overdue(at(600)).await.unwrap(), 1);
    assert_eq!(fixture.store.release_overdue(at(9_999)).await.unwrap(), 0);
    assert_eq!(fixture.status("b5").await, Queued);
    assert_eq!(fixture.status("b6").await, Held);
    let job = fixture.claim(700).await.unwrap();
    assert!(job.after_gap);
    assert_eq!(fixture.store.release_overdue(at(9_999)).await.unwrap(), 0);
    let result = fixture.result(&job, Merged).await;
    fixture.store.apply_result(result).await.unwrap();
    let job = fixture.claim(700).await.unwrap();
    assert_eq!(job.entries[0].batch.sequence, 6);
    assert!(!job.after_gap);
    fixture.journal(upload("b4", "t", 4)).await;
    let late = fixture.batch("b4").await;
    assert_eq!(late.status, Quarantined);
    assert!(late.reason.unwrap().contains("came after its successors"));
    fixture.journal(upload("b4-again", "t", 4)).await;
    let late = fixture.batch("b4-again").await;
    assert!(late.reason.unwrap().contains("came after its successors"));
    assert_eq!(
        fixture.journal(upload("b4", "t", 4)).await,
        Journaled::Replayed
    );
}

#[tokio::test]
async fn a_backlog_is_not_a_gap() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    fixture.journal(upload("b1", "t", 1)).await;
    assert_eq!(fixture.store.release_overdue(at(99_999)).await.unwrap(), 0);
    let job = fixture.claim(1).await.unwrap();
    assert_eq!(fixture.store.release_overdue(at(99_999)).await.unwrap(), 0);
    assert_eq!(fixture.status("b0").await, Processing);
    assert_eq!(job.entries[0].batch.status, Processing);
    assert_eq!(fixture.status("b1").await, Held);
}

#[tokio::test]
async fn each_route_has_its_own_patience() {
    let fixture = Fixture::new().await;
    put_route(&fixture.store, "hasty").await;
    let hasty = RouteId::new("hasty").unwrap();
    let update = RouteUpdate {
        settings: SettingsUpdate {
            hold_s: Some(0),
            ..SettingsUpdate::default()
        },
        ..RouteUpdate::default()
    };
    let put = fixture.store.put_route(&hasty, update, by(), at(0)).await;
    assert_eq!(put.unwrap(), mapshift::store::Put::Updated);
    fixture.journal(upload("b", "t", 1)).await;
    let mut batch = upload("b", "t", 1);
    batch.route_id = hasty.clone();
    fixture.journal(batch).await;
    assert_eq!(fixture.store.release_overdue(at(0)).await.unwrap(), 1);
    assert_eq!(fixture.status("b").await, Held);
    let job = fixture.claim(1).await.unwrap();
    assert_eq!(job.route_id, hasty);
}

#[tokio::test]
async fn a_sequence_is_used_once() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("first", "t", 0)).await;
    fixture.journal(upload("ahead", "t", 2)).await;
    for (id, sequence, holder) in [("again", 0, "first"), ("ahead-again", 2, "ahead")] {
        let stored = fixture.journal(upload(id, "t", sequence)).await;
        assert_eq!(stored, Journaled::Stored);
        let again = fixture.batch(id).await;
        assert_eq!(again.status, Quarantined);
        let reason = again.reason.unwrap();
        assert!(
            reason.ends_with(&format!("already used by {holder}")),
            "{reason}"
        );
    }
    finish(&fixture, Quarantined).await;
    fixture.journal(upload("third", "t", 0)).await;
    let reason = fixture.batch("third").await.reason.unwrap();
    assert!(reason.ends_with("already used by first"), "{reason}");
    assert_eq!(fixture.status("ahead").await, Held);
}

#[tokio::test]
async fn a_trip_belongs_to_one_vehicle() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("mine", "t", 0)).await;
    let mut foreign = upload("foreign", "t", 1);
    foreign.vehicle_id = VehicleId::new("w").unwrap();
    fixture.journal(foreign).await;
    let foreign = fixture.batch("foreign").await;
    assert_eq!(foreign.status, Quarantined);
    assert_eq!(
        foreign.reason.as_deref(),
        Some("trip t belongs to vehicle v")
    );
    fixture.journal(upload("own", "t", 1)).await;
    assert_eq!(
        fixture.status("own").await,
        Held,
        "the foreign one took no place"
    );
    let record = fixture.store.route(&route()).await.unwrap().unwrap();
    assert_eq!(record.counts.vehicles, 2);
}
