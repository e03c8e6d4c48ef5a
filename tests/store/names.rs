//! Names and addresses of people: replaced everywhere once their time is over.
//!
//! With SQL past the store, for SQLite: the columns of every table are searched for a name.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use mapshift::change::{AlertAction, AlertStatus, Tier};
use mapshift::ids::{AlertId, KeyId, OperationId, RouteId, ZoneId};
use mapshift::model::{Actor, AuditAction, DecisionResult, Role};
use mapshift::pipeline::DecisionError;
use mapshift::store::{
    AcceptanceChange, AlertRecord, AuditFilter, AuditRecord, Decided, Decision, DecisionOutcome,
    DecisionRequest, DecisionsRequest, HistoryEntry, MapDecision, MapPicture, NewKey,
    OperationRequest, OperationResult, Release, Secret, VersionRelease, copy,
};
use uuid::Uuid;

use crate::support::{Fixture, at, by, route};
use crate::tables::columns_with;
use crate::tiers::{alert, mute, write};
use crate::versions::taken_in;

const NAME: &str = "Kim Canary";
const ADDRESS: &str = "203.0.113.9";
const REDACTED: &str = "redacted";
/// When the last of [`lived_in`] was written.
const LAST: i64 = 70;

fn kim() -> &'static Actor {
    static KIM: LazyLock<Actor> = LazyLock::new(|| Actor::Key {
        id: key_id(9),
        name: NAME.to_owned(),
        address: ADDRESS.to_owned(),
    });
    &KIM
}

fn id(number: u128) -> AlertId {
    AlertId(Uuid::from_u128(number))
}

fn key_id(number: u128) -> KeyId {
    KeyId(Uuid::from_u128(number))
}

fn operation_id(number: u128) -> OperationId {
    OperationId(Uuid::from_u128(number))
}

async fn record(fixture: &Fixture, number: u128) -> AlertRecord {
    fixture.store.alert(id(number)).await.unwrap().unwrap()
}

/// Kim decides about alerts.
async fn decide(
    fixture: &Fixture,
    numbers: &[u128],
    (action, status): (AlertAction, AlertStatus),
    map: Option<MapDecision>,
    second: i64,
) {
    let mut alerts = Vec::new();
    for number in numbers {
        let mut next = record(fixture, *number).await;
        (next.revision, next.status, next.updated_at) = (next.revision + 1, status, at(second));
        next.history.push(HistoryEntry {
            status,
            at: at(second),
            by: NAME.to_owned(),
            note: Some("as planned".to_owned()),
            reason: None,
        });
        alerts.push(next);
    }
    let decision = Decision {
        base_revision: fixture.revision(&route()).await,
        action,
        actor: kim().clone(),
        alerts,
        map,
    };
    let decided = fixture.store.apply_decision(decision).await;
    assert_eq!(decided.unwrap(), Decided::Committed);
}

/// Kim accepts alerts, which makes a version of the map.
async fn accept(fixture: &Fixture, numbers: &[u128], version: i64, second: i64) {
    let mut taken = Vec::new();
    for number in numbers {
        taken.push(taken_in(&record(fixture, *number).await, version));
    }
    let map = MapDecision {
        accepted: AcceptanceChange::Added(taken),
        changed_nodes: Vec::new(),
        changed_edges: Vec::new(),
        superseded: MapPicture::default(),
        max_displacement_m: 0.0,
    };
    let accepted = (AlertAction::Accept, AlertStatus::Accepted);
    decide(fixture, numbers, accepted, Some(map), second).await;
}

async fn dismiss(fixture: &Fixture, number: u128, second: i64) {
    let dismissed = (AlertAction::Dismiss, AlertStatus::Dismissed);
    decide(fixture, &[number], dismissed, None, second).await;
}

async fn release(fixture: &Fixture, version: i64, second: i64) {
    let release = Release {
        route_id: route(),
        version,
        base_revision: fixture.revision(&route()).await,
        actor: kim().clone(),
        release: VersionRelease {
            at: at(second),
            by: NAME.to_owned(),
            note: None,
        },
        picture: MapPicture::default(),
    };
    let released = fixture.store.apply_release(release).await.unwrap();
    assert_eq!(released, Decided::Committed);
}

/// Kim asks for a decision about an alert that somebody has decided about meanwhile.
async fn ask(fixture: &Fixture, number: u128, second: i64) {
    let decision = DecisionRequest {
        alert_id: id(1),
        action: AlertAction::Accept,
        decision_revisions: Some(vec![1]),
        note: None,
        reason: None,
    };
    let request = OperationRequest::Decisions(DecisionsRequest {
        decisions: vec![decision],
        by: NAME.to_owned(),
        actor: kim().clone(),
        routes: None,
    });
    let store = &fixture.store;
    let asked = store.ask_for(operation_id(number), None, request, kim(), at(second));
    asked.await.unwrap();
}

/// The operation ends with the refusal that the service gives for it.
async fn refuse(fixture: &Fixture, number: u128, second: i64) {
    let changed = DecisionError::Changed(Box::new(record(fixture, 1).await));
    let outcome = |result, detail| DecisionOutcome {
        alert_id: id(1),
        action: AlertAction::Accept,
        result,
        detail,
        map_version: None,
    };
    let outcomes = vec![
        outcome(
            DecisionResult::Changed,
            Some(changed.detail(AlertAction::Accept)),
        ),
        outcome(DecisionResult::AlreadyDone, None),
    ];
    let result = OperationResult::Decisions(outcomes);
    let ended = fixture
        .store
        .end_operation(operation_id(number), Ok(result), at(second));
    ended.await.unwrap();
}

async fn make_key(fixture: &Fixture, number: u128, expires_second: Option<i64>) {
    let key = NewKey {
        id: key_id(number),
        secret: Secret::random().unwrap(),
        name: NAME.to_owned(),
        role: Role::Maintainer,
        vehicle_id: None,
        routes: Some(vec![RouteId::new("r").unwrap()]),
        created_at: at(54),
        expires_at: expires_second.map(at),
    };
    fixture.store.create_key(key, kim()).await.unwrap();
}

/// A store in which Kim's name is wherever it can be. Still needed are the assignee of the pending alert 4,
/// the operation 2 and the name of the key 2.
async fn lived_in() -> Fixture {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for (number, batch) in (1..=4).zip(["b1", "b2", "b3", "b4"]) {
        write(&fixture, batch, &alert(number, Tier::Confirmed))
            .await
            .unwrap();
    }
    for (number, second) in [(1, 10), (4, 55)] {
        let assigned = store.assign_alert(id(number), Some(NAME.to_owned()), kim(), at(second));
        assert!(assigned.await.unwrap());
    }
    let text = "a lorry".to_owned();
    let said = store.comment_on_alert(id(1), NAME.to_owned(), text, kim(), at(11));
    assert!(said.await.unwrap().is_some());
    accept(&fixture, &[1], 2, 20).await;
    accept(&fixture, &[2, 3], 3, 30).await;
    release(&fixture, 3, 40).await;
    let retired = store.retire_version(&route(), 3, kim(), at(41)).await;
    assert!(retired.unwrap());
    for (number, second) in [(1, 50), (2, 52)] {
        ask(&fixture, number, second).await;
    }
    refuse(&fixture, 1, 51).await;
    let of = route();
    let zone = store.create_zone(&of, ZoneId(Uuid::from_u128(1)), mute(), kim(), at(53));
    zone.await.unwrap();
    for (number, expires_second) in [(1, None), (2, None), (3, Some(LAST))] {
        make_key(&fixture, number, expires_second).await;
    }
    assert!(store.revoke_key(key_id(1), kim(), at(60)).await.unwrap());
    fixture
}

/// Redacts until nothing is left to do; returns the rows of each step.
async fn redact(fixture: &Fixture, before: i64) -> Vec<u64> {
    let mut steps = Vec::new();
    loop {
        match fixture.store.redact_names(at(before)).await.unwrap() {
            0 => return steps,
            rows => steps.push(rows),
        }
    }
}

async fn found(fixture: &Fixture, text: &str) -> BTreeSet<String> {
    columns_with(&mut fixture.raw().await, text).await
}

fn columns<const N: usize>(names: [&str; N]) -> BTreeSet<String> {
    names.map(str::to_owned).into()
}

async fn audit(fixture: &Fixture) -> Vec<AuditRecord> {
    let filter = AuditFilter::default();
    fixture
        .store
        .audit_page(&filter, None, 1_000)
        .await
        .unwrap()
}

#[tokio::test]
async fn what_is_still_needed_keeps_its_name_until_it_is_not() {
    let fixture = lived_in().await;
    let everywhere = columns([
        "alert_comments.by_whom",
        "alert_handling.assignee",
        "alert_history.by_whom",
        "audit.actor",
        "audit.after",
        "audit.before",
        "inputs.input",
        "keys.created_by",
        "keys.name",
        "map_versions.cause_by",
        "map_versions.released_by",
        "operations.request",
        "operations.result",
        "routes.version_by",
        "zones.created_by",
    ]);
    assert_eq!(found(&fixture, NAME).await, everywhere);
    assert_eq!(
        found(&fixture, ADDRESS).await,
        columns(["audit.address", "operations.request"])
    );
    assert!(!redact(&fixture, LAST + 1).await.is_empty());
    let needed = columns(["alert_handling.assignee", "keys.name", "operations.request"]);
    assert_eq!(found(&fixture, NAME).await, needed);
    let store = &fixture.store;
    assert_eq!(
        record(&fixture, 4).await.handling.assignee.as_deref(),
        Some(NAME)
    );
    let names = store.keys(None, 10).await.unwrap();
    let names: Vec<&str> = names.iter().map(|key| key.name.as_str()).collect();
    assert_eq!(names, [REDACTED, NAME, REDACTED]);
    assert_eq!(
        found(&fixture, ADDRESS).await,
        columns(["operations.request"])
    );

    refuse(&fixture, 2, 100).await;
    assert!(store.revoke_key(key_id(2), kim(), at(100)).await.unwrap());
    dismiss(&fixture, 4, 100).await;
    redact(&fixture, 101).await;
    for text in [NAME, ADDRESS, "192.0.2.7", &key_id(9).to_string()] {
        assert_eq!(found(&fixture, text).await, BTreeSet::new(), "{text}");
    }
    // A copy has nothing but what its tables and indices have.
    let copied = tempfile::tempdir().unwrap();
    copy(fixture.directory.path(), copied.path()).await.unwrap();
    let bytes = std::fs::read(copied.path().join("mapshift.db")).unwrap();
    let has = |text: &str| {
        bytes
            .windows(text.len())
            .any(|part| part == text.as_bytes())
    };
    assert!(has(REDACTED) && !has(NAME) && !has(ADDRESS));
}

#[tokio::test]
async fn everything_but_names_and_addresses_is_as_it_was() {
    let fixture = lived_in().await;
    let store = &fixture.store;
    let before = (record(&fixture, 1).await, audit(&fixture).await);
    let operation = store.operation(operation_id(1)).await.unwrap().unwrap();
    let versions = store.map_versions(&route(), 0, 10).await.unwrap();
    redact(&fixture, 1_000).await;

    let mut alert = before.0;
    alert.history[1].by = REDACTED.to_owned();
    alert.handling.assignee = Some(REDACTED.to_owned());
    assert_eq!(record(&fixture, 1).await, alert);
    assert_eq!(alert.history[0].by, "system");
    let comments = store.alert_comments(id(1), 0, 10).await.unwrap();
    let said: Vec<_> = comments.iter().map(|c| (&*c.by, &*c.text)).collect();
    assert_eq!(said, [(REDACTED, "a lorry")]);

    for (was, row) in before.1.iter().zip(audit(&fixture).await) {
        let mut expected = was.clone();
        let address = REDACTED.to_owned();
        expected.actor = match &was.actor {
            Actor::System => Actor::System,
            Actor::Local { .. } => Actor::Local { address },
            _ => Actor::Proxy {
                name: REDACTED.to_owned(),
                address,
            },
        };
        for state in [&mut expected.before, &mut expected.after] {
            for field in ["by", "assignee", "name"] {
                let name = state.as_mut().and_then(|state| state.get_mut(field));
                if let Some(name) = name.filter(|name| *name == NAME) {
                    *name = REDACTED.into();
                }
            }
        }
        assert_eq!(row, expected);
    }
    let actions: BTreeSet<&str> = before.1.iter().map(|row| row.action.name()).collect();
    for action in [AuditAction::RouteCreated, AuditAction::ZoneCreated] {
        assert!(actions.contains(action.name()));
    }

    let now = store.operation(operation_id(1)).await.unwrap().unwrap();
    let Some(OperationResult::Decisions(outcomes)) = &now.result else {
        panic!("{:?}", now.result)
    };
    let refusal = outcomes[0].detail.as_deref().unwrap();
    assert!(refusal.starts_with("the alert is not as If-Match says"));
    assert!(refusal.ends_with(" by redacted"), "{refusal}");
    let Some(OperationResult::Decisions(were)) = &operation.result else {
        panic!("{:?}", operation.result)
    };
    assert_eq!(outcomes[1..], were[1..]);
    assert_eq!(
        (now.status, now.ended_at),
        (operation.status, operation.ended_at)
    );

    let now = store.map_versions(&route(), 0, 10).await.unwrap();
    let expected = versions.into_iter().map(|mut version| {
        if let Some(cause) = &mut version.cause {
            cause.by = Some(REDACTED.to_owned());
        }
        if let Some(released) = &mut version.released {
            released.by = REDACTED.to_owned();
        }
        version
    });
    assert_eq!(now, expected.collect::<Vec<_>>());
}

#[tokio::test]
async fn nothing_is_redacted_before_its_time() {
    let fixture = lived_in().await;
    redact(&fixture, 20).await;
    let entries = |alert: &AlertRecord| {
        let by = alert.history.iter().map(|entry| entry.by.clone());
        by.collect::<Vec<_>>()
    };
    assert_eq!(entries(&record(&fixture, 1).await), ["system", NAME]);
    let at_20 = audit(&fixture).await;
    for row in &at_20 {
        let is_redacted = row.actor.address() == Some(REDACTED);
        assert_eq!(is_redacted, row.at < at(20), "{row:?}");
    }
    // Alert 1 is not pending any more.
    let assignees = [1, 4].map(|number| record(&fixture, number));
    let [first, fourth] = assignees;
    assert_eq!(first.await.handling.assignee.as_deref(), Some(REDACTED));
    assert_eq!(fourth.await.handling.assignee.as_deref(), Some(NAME));
    redact(&fixture, 21).await;
    assert_eq!(entries(&record(&fixture, 1).await), ["system", REDACTED]);
}

/// When something was written in which the name still is, by a statement.
async fn times(fixture: &Fixture, statement: &'static str) -> Vec<i64> {
    let times = sqlx::query_scalar(statement).bind(NAME);
    times.fetch_all(&mut fixture.raw().await).await.unwrap()
}

#[tokio::test]
async fn the_journal_and_what_follows_from_it_never_differ() {
    let fixture = lived_in().await;
    let mut steps = 0;
    loop {
        let journal = times(
            &fixture,
            "SELECT at_us FROM inputs WHERE instr(input, $1) > 0 ORDER BY at_us",
        );
        let made = times(
            &fixture,
            "SELECT at_us FROM alert_history WHERE by_whom = $1 \
             UNION SELECT released_at_us FROM map_versions WHERE released_by = $1 ORDER BY 1",
        );
        let began = times(
            &fixture,
            "SELECT created_at_us FROM map_versions WHERE cause_by = $1 \
             UNION SELECT version_created_at_us FROM routes WHERE version_by = $1 ORDER BY 1",
        );
        let journal = journal.await;
        assert_eq!(made.await, journal);
        assert_eq!(began.await, journal);
        if fixture.store.redact_names(at(1_000)).await.unwrap() == 0 {
            break;
        }
        steps += 1;
    }
    assert!(steps > 2, "a version is a step of its own");
}

#[tokio::test]
async fn many_names_are_redacted_in_steps() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    write(&fixture, "b0", &alert(1, Tier::Confirmed))
        .await
        .unwrap();
    for second in 1..=300 {
        let said = store.comment_on_alert(
            id(1),
            NAME.to_owned(),
            "a lorry".to_owned(),
            by(),
            at(second),
        );
        said.await.unwrap();
    }
    // One row of the audit is that of the route, at second 0.
    assert_eq!(redact(&fixture, 1_000).await, [256 + 255, 45 + 45]);
    assert_eq!(redact(&fixture, 1_000).await, [0_u64; 0]);
}
