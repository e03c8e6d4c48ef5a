//! The audit: one row for each change, written with it.
//!
//! With SQL past the store, for SQLite: a table that takes no rows.

use mapshift::change::{AlertAction, AlertStatus, Tier};
use mapshift::ids::{AlertId, OperationId, TripId, VehicleId, WebhookId};
use mapshift::model::{
    Actor, AuditAction, BatchStatus, Detector, DismissReason, VersionState, WebhookTopic,
};
use mapshift::store::{
    AlertRecord, Attempt, AttemptEnd, AttemptVerdict, AuditFilter, AuditRecord, Decided, Decision,
    Deleted, Edited, HistoryEntry, MapPicture, MapVersionRecord, Meant, NewWebhook, NextDelivery,
    OperationRecord, OperationRequest, OperationResult, Put, Quarantine, Registered, Release,
    Removal, RemovalRequest, RemovalResult, Retried, RouteEdition, RouteRecord, RouteUpdate,
    SettingsUpdate, StoreError, VersionRelease, WebhookRecord, WebhookSecret, WebhookUpdate,
};
use serde_json::{Value, json};
use uuid::Uuid;

use crate::support::{Fixture, at, batch_id, by, route, upload};
use crate::tiers::{alert, write};

const ALERT: u128 = 1;
const RESULT: RemovalResult = RemovalResult {
    batches: 1,
    nodes: 0,
    edges: 0,
    alerts: 0,
    moved_m: 0.0,
    rebuilt: false,
    not_rebuilt_because: None,
};

fn alert_id() -> AlertId {
    AlertId(Uuid::from_u128(ALERT))
}

fn webhook_id(number: u128) -> WebhookId {
    WebhookId(Uuid::from_u128(number))
}

fn operation_id(number: u128) -> OperationId {
    OperationId(Uuid::from_u128(number))
}

fn webhook(number: u128) -> NewWebhook {
    NewWebhook {
        id: webhook_id(number),
        url: "https://example.com/hook?token=hush".to_owned(),
        secret: WebhookSecret([b'S'; 32]),
        events: vec![WebhookTopic::AlertRaised],
        route_id: Some(route()),
        description: None,
        include_tentative: false,
        created_at: at(10),
    }
}

fn removal(dry_run: bool) -> RemovalRequest {
    RemovalRequest {
        meant: Meant::Trips(vec![TripId::new("gone").unwrap()]),
        dry_run,
        erase: false,
        note: Some("its lidar was loose".to_owned()),
    }
}

/// A removal that takes out the batches of the trip `gone`.
async fn computed(fixture: &Fixture, operation: u128) -> Removal {
    let meant = removal(false).meant;
    Removal {
        operation: operation_id(operation),
        route_id: route(),
        base_revision: fixture.revision(&route()).await,
        removable: fixture.store.removable(&route(), &meant).await.unwrap(),
        changed_nodes: Vec::new(),
        changed_edges: Vec::new(),
        alerts: Vec::new(),
        reason: "its lidar was loose".to_owned(),
        erase: false,
        result: RESULT,
        ends: true,
        at: at(30),
    }
}

/// Somebody dismisses the alert as it is.
async fn dismissal(fixture: &Fixture) -> Decision {
    let alert = fixture.store.alert(alert_id()).await.unwrap().unwrap();
    let mut next = AlertRecord {
        revision: alert.revision + 1,
        status: AlertStatus::Dismissed,
        updated_at: at(20),
        ..alert
    };
    next.history.push(HistoryEntry {
        status: AlertStatus::Dismissed,
        at: at(20),
        by: "kim".to_owned(),
        note: Some("a parked lorry".to_owned()),
        reason: Some(DismissReason::Temporary),
    });
    Decision {
        base_revision: fixture.revision(&route()).await,
        action: AlertAction::Dismiss,
        actor: by().clone(),
        alerts: vec![next],
        map: None,
    }
}

/// A store with the route `r`, an alert, a quarantined batch `q`, a batch of the trip `gone`, the
/// webhook 1 and the operation 1.
async fn full() -> Fixture {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    write(&fixture, "gone", &alert(ALERT, Tier::Confirmed))
        .await
        .unwrap();
    fixture.journal(upload("q", "q", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.result(&job, BatchStatus::Quarantined).await;
    result.outcomes[0].reason = Some("too far".to_owned());
    store.apply_result(result).await.unwrap();
    let registered = store.register_webhook(webhook(1), by()).await;
    assert_eq!(registered.unwrap(), Registered::Created);
    ask(&fixture, 1, removal(false)).await.unwrap();
    fixture
}

async fn ask(fixture: &Fixture, number: u128, request: RemovalRequest) -> Result<(), StoreError> {
    let (id, route) = (operation_id(number), route());
    let request = OperationRequest::Removal(request);
    let asked = fixture
        .store
        .ask_for(id, Some(&route), request, by(), at(15));
    asked.await
}

/// Every row, in the order of commits.
async fn rows(fixture: &Fixture) -> Vec<AuditRecord> {
    let filter = AuditFilter::default();
    let page = fixture.store.audit_page(&filter, None, 1_000).await;
    let mut rows = page.unwrap();
    rows.sort_by_key(|row| row.key);
    rows
}

/// What a row says, by whom and when aside.
type Told = (AuditAction, String, Option<Value>, Option<Value>);

/// What was written since there were so many rows, each by the one who makes the changes.
async fn told_since(fixture: &Fixture, count: usize, actor: &Actor) -> Vec<Told> {
    let rows = rows(fixture).await.split_off(count);
    let told = rows.into_iter().map(|row| {
        assert_eq!(&row.actor, actor);
        assert_eq!(row.route_id, Some(route()));
        (row.action, row.subject, row.before, row.after)
    });
    told.collect()
}

/// An attempt whose receiver is no more.
fn gone(next: &NextDelivery) -> Attempt {
    Attempt {
        delivery_key: next.key,
        attempts: 1,
        webhook_revision: next.webhook_revision,
        alert_revision: None,
        ended_at: at(12),
        end: AttemptEnd::Answer(410),
        verdict: AttemptVerdict::Gone,
    }
}

fn told(action: AuditAction, subject: impl ToString, before: Value, after: Value) -> Told {
    let present = |value: Value| (!value.is_null()).then_some(value);
    (action, subject.to_string(), present(before), present(after))
}

fn settings(hold_s: u32) -> Value {
    json!({"detector": "fused", "false_alarm_rate": 0.01, "hold_s": hold_s, "max_shift_m": 0.02})
}

fn named(name: &str, hold_s: u32) -> RouteUpdate {
    RouteUpdate {
        display_name: Some(name.to_owned()),
        settings: SettingsUpdate {
            hold_s: Some(hold_s),
            ..SettingsUpdate::default()
        },
        ..RouteUpdate::default()
    }
}

#[tokio::test]
async fn a_route_that_is_made_changed_and_deleted_leaves_a_row_each() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let elsewhere = Some(RouteEdition {
        revision: 99,
        updated_at: at(0),
    });
    let stale = RouteUpdate {
        expected: elsewhere,
        ..named("Hall", 7)
    };
    for (update, became) in [
        (RouteUpdate::default(), Put::Updated), // changes nothing
        (stale, Put::Stale),
        (named("Hall", 5), Put::Updated),
        (named("Hall", 5), Put::Updated), // the same once more
    ] {
        let put = store.put_route(&route(), update, by(), at(1)).await;
        assert_eq!(put.unwrap(), became);
    }
    for (expected, became) in [
        (elsewhere, Deleted::Stale),
        (None, Deleted::Done),
        (None, Deleted::NotThere),
    ] {
        let deletion = store.delete_route(&route(), expected, by(), at(2)).await;
        assert_eq!(deletion.unwrap(), became);
    }
    let made = json!({"display_name": null, "geo_anchor": null, "settings": settings(600)});
    let changed = json!({"display_name": "Hall", "geo_anchor": null, "settings": settings(5)});
    assert_eq!(
        told_since(&fixture, 0, by()).await,
        [
            told(AuditAction::RouteCreated, "r", Value::Null, made.clone()),
            told(AuditAction::RouteChanged, "r", made, changed.clone()),
            told(AuditAction::RouteDeleted, "r", changed, Value::Null),
        ]
    );
    let times: Vec<_> = rows(&fixture).await.iter().map(|row| row.at).collect();
    assert_eq!(times, [at(0), at(1), at(2)]);
}

#[tokio::test]
async fn a_detector_that_is_fixed_leaves_no_row() {
    let fixture = full().await;
    let before = rows(&fixture).await;
    let mut seed = named("Hall", 5);
    seed.settings.detector = Some(Detector::Seed);
    let put = fixture.store.put_route(&route(), seed, by(), at(1)).await;
    assert_eq!(put.unwrap(), Put::DetectorFixed);
    assert_eq!(rows(&fixture).await, before);
}

fn webhook_told(active: bool, description: Value, gone_at: Value) -> Value {
    json!({
        "url": "https://example.com/hook?…", "events": ["alert.raised"], "route_id": "r",
        "description": description, "include_tentative": false, "active": active,
        "gone_at": gone_at,
    })
}

#[tokio::test]
async fn a_webhook_leaves_a_row_for_each_change_and_none_of_its_secrets() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    store.register_webhook(webhook(1), by()).await.unwrap();
    let tickets = WebhookUpdate {
        description: Some("tickets".to_owned()),
        ..WebhookUpdate::default()
    };
    let other_token = WebhookUpdate {
        url: Some("https://example.com/hook?token=other".to_owned()),
        ..WebhookUpdate::default()
    };
    for (update, revision, became) in [
        (tickets.clone(), Some(9), Edited::Stale),
        (tickets.clone(), None, Edited::Done),
        (tickets, None, Edited::Done), // the same once more
        (other_token, None, Edited::Done),
    ] {
        let edited = store.update_webhook(webhook_id(1), revision, update, by(), at(2));
        assert_eq!(edited.await.unwrap(), became);
    }
    for (revision, became) in [
        (Some(1), Edited::Stale),
        (None, Edited::Done),
        (None, Edited::Unknown),
    ] {
        let deleted = store.delete_webhook(webhook_id(1), revision, by(), at(3));
        assert_eq!(deleted.await.unwrap(), became);
    }
    let id = webhook_id(1);
    let made = webhook_told(true, Value::Null, Value::Null);
    let changed = webhook_told(true, json!("tickets"), Value::Null);
    assert_eq!(
        told_since(&fixture, 1, by()).await,
        [
            told(AuditAction::WebhookCreated, id, Value::Null, made.clone()),
            told(AuditAction::WebhookChanged, id, made, changed.clone()),
            // What differs is in the query, which is not told.
            told(
                AuditAction::WebhookChanged,
                id,
                changed.clone(),
                changed.clone()
            ),
            told(AuditAction::WebhookDeleted, id, changed, Value::Null),
        ]
    );
    let everything = format!("{:?}", rows(&fixture).await);
    for secret in ["token", "hush", "other", "SSSS", "83, 83"] {
        assert!(!everything.contains(secret), "{secret} in {everything}");
    }
}

#[tokio::test]
async fn a_webhook_that_goes_with_its_route_has_a_row_of_its_own() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let of_all = NewWebhook {
        route_id: None,
        ..webhook(2)
    };
    for webhook in [webhook(1), of_all] {
        store.register_webhook(webhook, by()).await.unwrap();
    }
    let deleted = store.delete_route(&route(), None, by(), at(20)).await;
    assert_eq!(deleted.unwrap(), Deleted::Done);
    let told = told_since(&fixture, 3, by()).await;
    let told: Vec<_> = told.iter().map(|row| (row.0, row.1.as_str())).collect();
    let id = webhook_id(1).to_string();
    assert_eq!(
        told,
        [
            (AuditAction::RouteDeleted, "r"),
            (AuditAction::WebhookDeleted, id.as_str())
        ]
    );
}

#[tokio::test]
async fn a_webhook_that_the_service_disables_is_noted_as_its_own_doing() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    store.register_webhook(webhook(1), by()).await.unwrap();
    for _ in 0..2 {
        store
            .queue_webhook_test(webhook_id(1), at(11))
            .await
            .unwrap();
        let Some(next) = store.next_deliveries().await.unwrap().pop() else {
            break; // The second time nothing is sent any more.
        };
        let gone = gone(&next);
        // Noted once, however often it is told.
        store.record_attempt(gone.clone()).await.unwrap();
        store.record_attempt(gone).await.unwrap();
    }
    let before = webhook_told(true, Value::Null, Value::Null);
    let after = webhook_told(false, Value::Null, json!(at(12)));
    assert_eq!(
        told_since(&fixture, 2, &Actor::System).await,
        [told(
            AuditAction::WebhookChanged,
            webhook_id(1),
            before,
            after
        )]
    );
}

#[tokio::test]
async fn a_decision_leaves_a_row_with_what_was_and_what_is() {
    let fixture = full().await;
    let count = rows(&fixture).await.len();
    let decision = dismissal(&fixture).await;
    let stale = Decision {
        base_revision: decision.base_revision - 1,
        ..decision.clone()
    };
    for (decision, became) in [
        (stale, Decided::Stale),
        (decision.clone(), Decided::Committed),
        (decision, Decided::Stale), // the same once more
    ] {
        let decided = fixture.store.apply_decision(decision).await;
        assert_eq!(decided.unwrap(), became);
    }
    let before = json!({"status": "open", "by": "system", "note": null});
    let after = json!({"status": "dismissed", "by": "kim", "note": "a parked lorry", "reason": "temporary"});
    assert_eq!(
        told_since(&fixture, count, by()).await,
        [told(AuditAction::AlertDismissed, alert_id(), before, after)]
    );
}

#[tokio::test]
async fn a_removal_is_noted_when_it_is_asked_for_and_when_it_has_ended() {
    let fixture = full().await;
    let count = rows(&fixture).await.len();
    let store = &fixture.store;
    let asked = json!({"trips": ["gone"], "erase": false, "note": "its lidar was loose"});
    assert_eq!(
        told_since(&fixture, count - 1, by()).await,
        [told(
            AuditAction::RemovalAsked,
            operation_id(1),
            Value::Null,
            asked
        )]
    );
    ask(&fixture, 2, removal(true)).await.unwrap();
    let dry = store.end_operation(
        operation_id(2),
        Ok(OperationResult::Removal(RESULT)),
        at(16),
    );
    dry.await.unwrap();
    assert_eq!(
        rows(&fixture).await.len(),
        count,
        "a dry run changes nothing"
    );

    let removal_of_1 = computed(&fixture, 1).await;
    let stale = Removal {
        base_revision: removal_of_1.base_revision - 1,
        ..removal_of_1.clone()
    };
    assert!(!store.apply_removal(stale).await.unwrap());
    assert!(store.apply_removal(removal_of_1).await.unwrap());
    ask(&fixture, 3, removal(false)).await.unwrap();
    for _ in 0..2 {
        let failed = Err("out of luck".to_owned());
        let ended = store.end_operation(operation_id(3), failed, at(17));
        ended.await.unwrap();
    }
    let mut rows = rows(&fixture).await.split_off(count);
    let by_system: Vec<Told> = [rows.remove(0), rows.remove(1)]
        .into_iter()
        .map(|row| {
            assert_eq!(row.actor, Actor::System);
            (row.action, row.subject, row.before, row.after)
        })
        .collect();
    assert_eq!(rows.len(), 1, "the request in between");
    let result = json!({"batches": 1, "nodes": 0, "edges": 0, "alerts": 0, "moved_m": 0.0,
        "rebuilt": false, "not_rebuilt_because": null});
    let reason = json!({"reason": "out of luck"});
    assert_eq!(
        by_system,
        [
            told(
                AuditAction::RemovalDone,
                operation_id(1),
                Value::Null,
                result
            ),
            told(
                AuditAction::RemovalFailed,
                operation_id(3),
                Value::Null,
                reason
            ),
        ]
    );
}

#[tokio::test]
async fn a_removal_of_an_operation_that_has_ended_changes_nothing() {
    let fixture = full().await;
    let store = &fixture.store;
    let failed = Err("out of luck".to_owned());
    let ended = store.end_operation(operation_id(1), failed, at(16));
    ended.await.unwrap();
    let before = State::of(&fixture).await;
    let late = store.apply_removal(computed(&fixture, 1).await).await;
    assert!(
        matches!(late, Err(StoreError::InvalidResult(_))),
        "{late:?}"
    );
    assert_eq!(State::of(&fixture).await, before);
}

#[tokio::test]
async fn a_batch_that_is_tried_again_leaves_one_row() {
    let fixture = full().await;
    let count = rows(&fixture).await.len();
    for (batch, is_queued) in [("q", true), ("q", false), ("gone", false), ("none", false)] {
        let (route, batch) = (route(), batch_id(batch));
        let retried = fixture.store.retry_batch(&route, &batch, by(), at(20));
        assert_eq!(retried.await.unwrap() == Retried::Queued, is_queued);
    }
    let before = json!({"status": "quarantined", "reason": "too far"});
    let after = json!({"status": "queued", "reason": "too far"});
    assert_eq!(
        told_since(&fixture, count, by()).await,
        [told(AuditAction::BatchRetried, "q", before, after)]
    );
}

#[tokio::test]
async fn a_vehicle_that_is_kept_out_and_released_leaves_a_row_each() {
    let fixture = full().await;
    let (count, route) = (rows(&fixture).await.len(), route());
    let quarantine = |second, note: &str| Quarantine {
        since: at(second),
        note: Some(note.to_owned()),
    };
    let (known, unknown) = (vehicle("v"), vehicle("nobody"));
    for (vehicle, quarantine, is_known) in [
        (&known, None, true), // it was not kept out
        (&known, Some(quarantine(20, "loose mount")), true),
        (&known, Some(quarantine(21, "another")), true), // the first note stays
        (&known, None, true),
        (&known, None, true), // the same once more
        (&unknown, Some(quarantine(22, "who?")), false),
    ] {
        let store = &fixture.store;
        let put = store.put_quarantine(&route, vehicle, quarantine, by(), at(23));
        assert_eq!(put.await.unwrap(), is_known);
    }
    let kept_out = json!({"since": at(20), "note": "loose mount"});
    assert_eq!(
        told_since(&fixture, count, by()).await,
        [
            told(
                AuditAction::VehicleQuarantined,
                "v",
                Value::Null,
                kept_out.clone()
            ),
            told(AuditAction::VehicleReleased, "v", kept_out, Value::Null),
        ]
    );
}

/// A release of the route's first version as it is now.
async fn first_release(fixture: &Fixture) -> Release {
    Release {
        route_id: route(),
        version: 1,
        base_revision: fixture.revision(&route()).await,
        actor: by().clone(),
        release: VersionRelease {
            at: at(20),
            by: "kim".to_owned(),
            note: Some("new racks".to_owned()),
        },
        picture: MapPicture {
            pgm: b"P5".to_vec(),
            ..MapPicture::default()
        },
    }
}

#[tokio::test]
async fn a_version_that_is_released_and_retired_leaves_a_row_each() {
    let fixture = full().await;
    let (count, route, store) = (rows(&fixture).await.len(), route(), &fixture.store);
    let release = first_release(&fixture).await;
    let retire = || store.retire_version(&route, 1, by(), at(21));
    assert!(!retire().await.unwrap(), "a draft is not retired");
    let stale = Release {
        base_revision: release.base_revision - 1,
        ..release.clone()
    };
    for (release, became) in [
        (stale, Decided::Stale),
        (release.clone(), Decided::Committed),
        (release, Decided::Stale), // the same once more
    ] {
        assert_eq!(store.apply_release(release).await.unwrap(), became);
    }
    assert_eq!(store.newest_release(&route).await.unwrap(), Some(1));
    assert!(retire().await.unwrap());
    assert!(!retire().await.unwrap(), "the same once more");
    assert_eq!(store.newest_release(&route).await.unwrap(), None);
    let picture = store.map_version_picture(&route, 1).await.unwrap();
    assert_eq!(picture.unwrap().pgm, b"P5");
    let versions = store.map_versions(&route, 0, 10).await.unwrap();
    let states: Vec<_> = versions.iter().map(MapVersionRecord::state).collect();
    assert_eq!(states, [VersionState::Retired, VersionState::Draft]);
    let sha256: String = versions[0]
        .sha256
        .unwrap()
        .map(|b| format!("{b:02x}"))
        .concat();
    assert_eq!(
        told_since(&fixture, count, by()).await,
        [
            told(
                AuditAction::VersionReleased,
                1,
                json!({"state": "draft"}),
                json!({"state": "released", "sha256": sha256, "note": "new racks"})
            ),
            told(
                AuditAction::VersionRetired,
                1,
                json!({"state": "released"}),
                json!({"state": "retired"})
            ),
        ]
    );
}

fn vehicle(name: &str) -> VehicleId {
    VehicleId::new(name).unwrap()
}

/// What changes can change.
#[derive(Debug, PartialEq)]
struct State {
    rows: Vec<AuditRecord>,
    routes: Vec<RouteRecord>,
    webhooks: Vec<WebhookRecord>,
    alert: Option<AlertRecord>,
    operations: Vec<OperationRecord>,
    batches: Vec<BatchStatus>,
    quarantine: Option<Quarantine>,
    versions: Vec<MapVersionRecord>,
}

impl State {
    async fn of(fixture: &Fixture) -> Self {
        let store = &fixture.store;
        let mut operations = Vec::new();
        for number in 1..=3 {
            operations.extend(store.operation(operation_id(number)).await.unwrap());
        }
        Self {
            rows: rows(fixture).await,
            routes: store.routes(None, 10).await.unwrap(),
            webhooks: store.webhooks(None, 10).await.unwrap(),
            alert: store.alert(alert_id()).await.unwrap(),
            operations,
            batches: vec![fixture.status("gone").await, fixture.status("q").await],
            quarantine: store.quarantine(&route(), &vehicle("v")).await.unwrap(),
            versions: store.map_versions(&route(), 0, 10).await.unwrap(),
        }
    }
}

/// Every kind of change against a table that takes no rows.
#[tokio::test]
async fn no_change_is_made_without_its_row() {
    let fixture = full().await;
    let store = &fixture.store;
    store
        .queue_webhook_test(webhook_id(1), at(11))
        .await
        .unwrap();
    let next = store.next_deliveries().await.unwrap().remove(0);
    let gone = gone(&next);
    let released = store.apply_release(first_release(&fixture).await).await;
    assert_eq!(released.unwrap(), Decided::Committed);
    let second_release = Release {
        version: 2,
        ..first_release(&fixture).await
    };
    let before = State::of(&fixture).await;
    let jam = "CREATE TRIGGER jam BEFORE INSERT ON audit BEGIN SELECT RAISE(ABORT, 'jammed'); END";
    sqlx::query(jam)
        .execute(&mut fixture.raw().await)
        .await
        .unwrap();

    let another = mapshift::ids::RouteId::new("another").unwrap();
    let edit = WebhookUpdate {
        active: Some(false),
        ..WebhookUpdate::default()
    };
    let failed = Err("out of luck".to_owned());
    let kept_out = Quarantine {
        since: at(20),
        note: None,
    };
    let refused = [
        store
            .put_route(&another, RouteUpdate::default(), by(), at(20))
            .await
            .is_err(),
        store
            .put_route(&route(), named("Hall", 5), by(), at(20))
            .await
            .is_err(),
        store
            .delete_route(&route(), None, by(), at(20))
            .await
            .is_err(),
        store.register_webhook(webhook(2), by()).await.is_err(),
        store
            .update_webhook(webhook_id(1), None, edit, by(), at(20))
            .await
            .is_err(),
        store
            .delete_webhook(webhook_id(1), None, by(), at(20))
            .await
            .is_err(),
        store.record_attempt(gone).await.is_err(),
        store
            .apply_decision(dismissal(&fixture).await)
            .await
            .is_err(),
        ask(&fixture, 2, removal(false)).await.is_err(),
        store
            .apply_removal(computed(&fixture, 1).await)
            .await
            .is_err(),
        store
            .end_operation(operation_id(1), failed, at(20))
            .await
            .is_err(),
        store
            .retry_batch(&route(), &batch_id("q"), by(), at(20))
            .await
            .is_err(),
        store
            .put_quarantine(&route(), &vehicle("v"), Some(kept_out), by(), at(20))
            .await
            .is_err(),
        store.apply_release(second_release).await.is_err(),
        store
            .retire_version(&route(), 1, by(), at(21))
            .await
            .is_err(),
    ];
    assert_eq!(refused, [true; 15]);
    assert_eq!(State::of(&fixture).await, before);
}

/// Clocks are set back, and changes are written in another order than they were begun in.
#[tokio::test]
async fn parts_follow_each_other_by_time_without_gap_or_repetition() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for (hold_s, second) in [(1, 50), (2, 30), (3, 50), (4, 40), (5, 50)] {
        let update = named("Hall", hold_s);
        let put = store.put_route(&route(), update, by(), at(second)).await;
        assert_eq!(put.unwrap(), Put::Updated);
    }
    let hold_s = |row: &AuditRecord| row.after.as_ref().unwrap()["settings"]["hold_s"].clone();
    for limit in [1, 2, 3, 10] {
        let (mut held, mut before): (Vec<Value>, Option<i64>) = (Vec::new(), None);
        loop {
            let filter = AuditFilter::default();
            let page = store.audit_page(&filter, before, limit).await.unwrap();
            held.extend(page.iter().map(hold_s));
            match page.last() {
                Some(last) => before = Some(last.key),
                None => break,
            }
        }
        assert_eq!(held, [5, 3, 1, 4, 2, 600], "in parts of {limit}");
    }
    let between = AuditFilter {
        since: Some(at(30)),
        until: Some(at(50)),
        ..AuditFilter::default()
    };
    let page = store.audit_page(&between, None, 10).await.unwrap();
    assert_eq!(page.iter().map(hold_s).collect::<Vec<_>>(), [4, 2]);
}
