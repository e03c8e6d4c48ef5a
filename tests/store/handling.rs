//! Assignments, comments and zones: none of them raises the own revision of an alert.

use mapshift::change::Tier;
use mapshift::geometry::Vector2;
use mapshift::ids::{AlertId, RouteId, ZoneId};
use mapshift::store::{Edited, Muted, Store, ZONES_MAX, ZoneEdit, ZoneMade};
use tokio::task::JoinSet;
use uuid::Uuid;

use crate::support::{Fixture, at, by, route};
use crate::tiers::{alert, mute, write};

fn id(number: u128) -> AlertId {
    AlertId(Uuid::from_u128(number))
}

fn zone_id(number: u128) -> ZoneId {
    ZoneId(Uuid::from_u128(number))
}

#[tokio::test]
async fn assignments_and_comments_do_not_raise_the_own_revision_of_an_alert() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    write(&fixture, "b0", &alert(1, Tier::Confirmed))
        .await
        .unwrap();
    let assign = |number, to: Option<&str>, second| {
        store.assign_alert(id(number), to.map(str::to_owned), by(), at(second))
    };
    assert!(!assign(9, Some("kim"), 10).await.unwrap(), "there is none");
    // Who is assigned already is no change.
    for (to, changes) in [
        (Some("kim"), 1),
        (Some("kim"), 1),
        (Some("sam"), 2),
        (None, 3),
    ] {
        assert!(assign(1, to, 11).await.unwrap());
        let record = store.alert(id(1)).await.unwrap().unwrap();
        assert_eq!(record.handling.assignee.as_deref(), to);
        assert_eq!((record.revision, record.handling.changes), (1, changes));
    }
    let say = |number, text: &str, second| {
        store.comment_on_alert(
            id(number),
            "kim".to_owned(),
            text.to_owned(),
            by(),
            at(second),
        )
    };
    assert_eq!(say(9, "there is no such alert", 12).await.unwrap(), None);
    let mut said = Vec::new();
    for (text, second) in [("a lorry?", 13), ("a lorry", 12), ("gone", 14)] {
        said.push(say(1, text, second).await.unwrap().unwrap());
    }
    // In the order of commits, whatever clocks say; in parts that follow each other.
    assert_eq!(store.alert_comments(id(1), 0, 10).await.unwrap(), said);
    let parts = [
        (0, &said[..2]),
        (said[0].key, &said[1..]),
        (said[2].key, &said[3..]),
    ];
    for (after, part) in parts {
        assert_eq!(store.alert_comments(id(1), after, 2).await.unwrap(), part);
    }
    let record = store.alert(id(1)).await.unwrap().unwrap();
    assert_eq!((record.revision, record.handling.comments), (1, 3));
    assert_eq!(record.shown_revision(), 1 + record.handling.changes);
}

async fn muted(store: &Store) -> Option<Muted> {
    let alert = store.alert(id(1)).await.unwrap();
    alert.unwrap().handling.muted
}

async fn make(store: &Store, number: u128) -> ZoneMade {
    let (route, zone) = (route(), zone_id(number));
    let made = store.create_zone(&route, zone, mute(), by(), at(10));
    made.await.unwrap()
}

/// An alert is muted while a zone covers it: when one is made, moved, or taken away.
#[tokio::test]
async fn an_edit_of_a_zone_takes_effect_at_once_unless_it_is_stale() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    write(&fixture, "b0", &alert(1, Tier::Confirmed))
        .await
        .unwrap();
    assert_eq!(make(store, 1).await, ZoneMade::Created);
    let until = Some(at(100));
    assert_eq!(muted(store).await, Some(Muted { until }));
    let elsewhere = ZoneEdit {
        polygon: [[8.0, 8.0], [9.0, 8.0], [9.0, 9.0]]
            .map(Vector2::from)
            .to_vec(),
        note: Some("the other bay".to_owned()),
        ..mute()
    };
    let of = route();
    let edit = |number, revision, edit: Option<&ZoneEdit>| {
        store.edit_zone(&of, zone_id(number), revision, edit.cloned(), by(), at(20))
    };
    let here = mute();
    for (revision, to, became, is_muted) in [
        (Some(7), Some(&elsewhere), Edited::Stale, true),
        (Some(1), Some(&elsewhere), Edited::Done, false),
        (Some(1), Some(&here), Edited::Stale, false),
        (None, Some(&here), Edited::Done, true),
        (Some(3), None, Edited::Done, false),
        (None, None, Edited::Unknown, false),
    ] {
        let before = store.zone(&route(), zone_id(1)).await.unwrap();
        assert_eq!(edit(1, revision, to).await.unwrap(), became);
        assert_eq!(
            muted(store).await.is_some(),
            is_muted,
            "{revision:?} {to:?}"
        );
        let after = store.zone(&route(), zone_id(1)).await.unwrap();
        match (became, to) {
            (Edited::Done, Some(edit)) => {
                let (before, after) = (before.unwrap(), after.unwrap());
                assert_eq!((&after.edit, after.revision), (edit, before.revision + 1));
            }
            (Edited::Done, None) => assert_eq!(after, None),
            _ => assert_eq!(after, before),
        }
    }
    assert_eq!(edit(2, None, Some(&here)).await.unwrap(), Edited::Unknown);
}

#[tokio::test]
async fn the_zones_of_a_route_are_listed_in_parts_and_bounded() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let elsewhere = RouteId::new("elsewhere").unwrap();
    let unknown = store.create_zone(&elsewhere, zone_id(1), mute(), by(), at(10));
    assert_eq!(unknown.await.unwrap(), ZoneMade::UnknownRoute);
    let mut making = JoinSet::new();
    for number in 1..=u128::from(ZONES_MAX) {
        let store = store.clone();
        making.spawn(async move { make(&store, number).await });
    }
    let made = making.join_all().await;
    assert!(made.iter().all(|made| *made == ZoneMade::Created));
    assert_eq!(make(store, 1_000).await, ZoneMade::TooMany);
    let mut listed: Vec<ZoneId> = Vec::new();
    loop {
        let part = store
            .zones(&route(), listed.last().copied(), 90)
            .await
            .unwrap();
        if part.is_empty() {
            break;
        }
        listed.extend(part.iter().map(|zone| zone.id));
    }
    let all = (1..=u128::from(ZONES_MAX)).map(zone_id);
    assert_eq!(listed, all.collect::<Vec<_>>());
    assert_eq!(store.zones(&elsewhere, None, 10).await.unwrap(), []);
    assert_eq!(store.zone(&elsewhere, zone_id(1)).await.unwrap(), None);
}
