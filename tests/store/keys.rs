//! Keys and sessions: when they end, what is kept of them, and the rows of the audit.
//!
//! With SQL past the store, for SQLite: a table that takes no rows.

use mapshift::ids::{KeyId, RouteId, VehicleId};
use mapshift::model::{Actor, AuditAction, Role};
use mapshift::store::{AuditFilter, KeyText, NewKey, Secret};
use serde_json::Value;
use uuid::Uuid;

use crate::support::{Fixture, at, by, open};

const HOUR_S: i64 = 3_600;

fn key(number: u128) -> NewKey {
    NewKey {
        id: KeyId(Uuid::from_u128(number)),
        secret: Secret::random().unwrap(),
        name: "Kim".to_owned(),
        role: Role::Vehicle,
        vehicle_id: Some(VehicleId::new("v").unwrap()),
        routes: Some(vec![RouteId::new("r").unwrap()]),
        created_at: at(10),
        expires_at: Some(at(30 * 24 * HOUR_S)),
    }
}

fn text(key: &NewKey) -> KeyText {
    let (id, secret) = (key.id, key.secret.clone());
    KeyText { id, secret }
}

#[tokio::test]
async fn a_key_is_recognised_until_it_ends() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    assert!(!store.has_keys());
    let (own, other) = (key(1), key(2));
    for key in [&own, &other] {
        store.create_key(key.clone(), by()).await.unwrap();
    }
    assert!(store.has_keys());
    let found = store.key_shown(&text(&own), at(20)).await.unwrap().unwrap();
    assert_eq!((found.id, found.role), (own.id, Role::Vehicle));
    assert_eq!(
        (found.vehicle_id, found.routes),
        (own.vehicle_id.clone(), own.routes.clone())
    );
    assert_eq!(
        (found.created_by.as_str(), found.last_used_at),
        ("local", None)
    );
    let mixed = KeyText {
        id: own.id,
        secret: other.secret.clone(),
    };
    assert_eq!(store.key_shown(&mixed, at(20)).await.unwrap(), None);
    let last_day = at(30 * 24 * HOUR_S - 1);
    assert!(
        store
            .key_shown(&text(&own), last_day)
            .await
            .unwrap()
            .is_some()
    );
    let over = at(30 * 24 * HOUR_S);
    assert_eq!(store.key_shown(&text(&own), over).await.unwrap(), None);
    assert!(store.revoke_key(own.id, by(), at(50)).await.unwrap());
    assert_eq!(store.key_shown(&text(&own), at(50)).await.unwrap(), None);
    assert!(
        store
            .key_shown(&text(&other), at(50))
            .await
            .unwrap()
            .is_some()
    );
    assert!(
        !store
            .revoke_key(KeyId(Uuid::nil()), by(), at(50))
            .await
            .unwrap()
    );
}

#[tokio::test]
async fn the_last_use_is_noted_every_five_minutes() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let own = key(1);
    store.create_key(own.clone(), by()).await.unwrap();
    for (second, noted) in [(20, 20), (300, 20), (319, 20), (320, 320), (330, 320)] {
        store.key_shown(&text(&own), at(second)).await.unwrap();
        let key = store.key(own.id).await.unwrap().unwrap();
        assert_eq!(key.last_used_at, Some(at(noted)), "{second}");
    }
}

#[tokio::test]
async fn a_service_that_has_had_a_key_is_never_open_again() {
    let fixture = Fixture::new().await;
    let own = key(1);
    fixture.store.create_key(own.clone(), by()).await.unwrap();
    fixture
        .store
        .revoke_key(own.id, by(), at(20))
        .await
        .unwrap();
    fixture.store.close().await.unwrap();
    assert!(open(&fixture.directory).await.has_keys());
}

#[tokio::test]
async fn a_session_ends_when_idle_when_old_and_with_its_key() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let own = key(1);
    store.create_key(own.clone(), by()).await.unwrap();
    let begin = async || {
        let id = Secret::random().unwrap();
        store.begin_session(&id, own.id, at(0)).await.unwrap();
        id
    };
    let lives = async |id: &Secret, hour: i64| {
        let session = store.session(id, at(hour * HOUR_S)).await.unwrap();
        session.is_some()
    };
    let idle = begin().await;
    assert!(lives(&idle, 11).await);
    assert!(!lives(&idle, 23).await);

    let used = begin().await;
    for hour in (0..168).step_by(8) {
        assert!(lives(&used, hour).await, "{hour}");
    }
    assert!(!lives(&used, 168).await);

    let (left, ended) = (begin().await, begin().await);
    store.end_session(&ended).await.unwrap();
    assert!(lives(&left, 1).await && !lives(&ended, 1).await);
    store.revoke_key(own.id, by(), at(HOUR_S)).await.unwrap();
    assert!(!lives(&left, 1).await);
}

#[tokio::test]
async fn keys_are_made_and_revoked_with_a_row_each_or_not_at_all() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let (own, other) = (key(1), key(2));
    let kim = Actor::Key {
        id: own.id,
        name: "Kim".to_owned(),
        address: "192.0.2.7".to_owned(),
    };
    store.create_key(own.clone(), by()).await.unwrap();
    for _ in 0..2 {
        store.revoke_key(own.id, &kim, at(20)).await.unwrap();
    }
    let rows = store
        .audit_page(&AuditFilter::default(), None, 10)
        .await
        .unwrap();
    let actions: Vec<_> = rows.iter().map(|row| row.action).collect();
    use AuditAction::{KeyCreated, KeyRevoked, RouteCreated};
    assert_eq!(actions, [KeyRevoked, KeyCreated, RouteCreated]);
    assert_eq!((&rows[0].actor, &rows[1].actor), (&kim, by()));
    assert_eq!(rows[0].subject, own.id.to_string());
    let (before, after) = (
        rows[0].before.as_ref().unwrap(),
        rows[0].after.as_ref().unwrap(),
    );
    assert_eq!(
        (&before["revoked_at"], before["routes"][0].as_str()),
        (&Value::Null, Some("r"))
    );
    assert!(after["revoked_at"].is_string());

    let jam = "CREATE TRIGGER jam BEFORE INSERT ON audit BEGIN SELECT RAISE(ABORT, 'jammed'); END";
    let mut raw = fixture.raw().await;
    sqlx::query(jam).execute(&mut raw).await.unwrap();
    assert!(store.create_key(other.clone(), by()).await.is_err());
    assert_eq!(store.key(other.id).await.unwrap(), None);
}
