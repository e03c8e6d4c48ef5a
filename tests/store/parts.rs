//! Lists that are read in pages: the pages follow each other without gap or repetition.

use mapshift::ids::{KeyId, OperationId, RouteId, TripId, WebhookId};
use mapshift::model::{OperationKind, Role, WebhookTopic};
use mapshift::store::{
    Meant, NewKey, NewWebhook, OperationRequest, RemovalRequest, Secret, WebhookSecret,
};
use uuid::Uuid;

use crate::support::{Fixture, at, by, put_route, route};

/// A whole list, read in pages of a length.
async fn in_parts<T: Clone>(limit: u32, part: impl AsyncFn(Option<T>, u32) -> Vec<T>) -> Vec<T> {
    let mut all: Vec<T> = Vec::new();
    loop {
        let part = part(all.last().cloned(), limit).await;
        if part.is_empty() {
            return all;
        }
        assert!(part.len() <= limit as usize);
        all.extend(part);
    }
}

fn route_ids(names: &[&str]) -> Vec<RouteId> {
    names
        .iter()
        .map(|name| RouteId::new(*name).unwrap())
        .collect()
}

#[tokio::test]
async fn routes_are_listed_by_name_and_some_of_them_alone() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for name in ["z", "a", "k", "b"] {
        put_route(store, name).await;
    }
    let among = route_ids(&["k", "unknown", "z", "a"]);
    for limit in 1..5 {
        let all = in_parts(limit, async |after: Option<RouteId>, limit| {
            let part = store.routes(after.as_ref(), limit).await.unwrap();
            part.into_iter().map(|route| route.id).collect()
        });
        assert_eq!(all.await, route_ids(&["a", "b", "k", "r", "z"]));
        let some = in_parts(limit, async |after: Option<RouteId>, limit| {
            let part = store
                .routes_among(&among, after.as_ref(), limit)
                .await
                .unwrap();
            part.into_iter().map(|route| route.id).collect()
        });
        assert_eq!(some.await, route_ids(&["a", "k", "z"]));
    }
    assert!(store.routes_among(&[], None, 9).await.unwrap().is_empty());
}

/// Webhooks of all routes are not among those of some routes.
#[tokio::test]
async fn webhooks_are_listed_by_age_and_those_of_some_routes_alone() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    put_route(store, "q").await;
    let webhook_id = |number| WebhookId(Uuid::from_u128(number));
    for (number, of) in [(1, Some("r")), (2, None), (3, Some("q")), (4, Some("r"))] {
        let webhook = NewWebhook {
            id: webhook_id(number),
            url: "https://example.com/".to_owned(),
            secret: WebhookSecret([7; 32]),
            events: WebhookTopic::DEFAULT.to_vec(),
            route_id: of.map(|name| RouteId::new(name).unwrap()),
            description: None,
            include_tentative: false,
            created_at: at(0),
        };
        store.register_webhook(webhook, by()).await.unwrap();
    }
    for (among, expected) in [
        (None, vec![1, 2, 3, 4]),
        (Some(vec![route()]), vec![1, 4]),
        (Some(route_ids(&["q", "r"])), vec![1, 3, 4]),
        (Some(vec![]), vec![]),
    ] {
        let listed = in_parts(1, async |after, limit| {
            let part = match &among {
                None => store.webhooks(after, limit).await,
                Some(among) => store.webhooks_among(among, after, limit).await,
            };
            part.unwrap()
                .into_iter()
                .map(|webhook| webhook.id)
                .collect()
        });
        let expected: Vec<_> = expected.into_iter().map(webhook_id).collect();
        assert_eq!(listed.await, expected, "{among:?}");
    }
}

#[tokio::test]
async fn keys_are_listed_by_age_live_or_not() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let key_id = |number| KeyId(Uuid::from_u128(number));
    for number in 1..=4 {
        let key = NewKey {
            id: key_id(number),
            secret: Secret::random().unwrap(),
            name: "Kim".to_owned(),
            role: Role::Maintainer,
            vehicle_id: None,
            routes: None,
            created_at: at(10),
            expires_at: None,
        };
        store.create_key(key, by()).await.unwrap();
    }
    assert!(store.revoke_key(key_id(2), by(), at(20)).await.unwrap());
    let listed = in_parts(3, async |after, limit| {
        let part = store.keys(after, limit).await.unwrap();
        part.into_iter().map(|key| key.id).collect()
    });
    assert_eq!(listed.await, [1, 2, 3, 4].map(key_id));
}

/// One operation at a time, in the order of their requests.
#[tokio::test]
async fn operations_have_their_turn_one_after_the_other() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let (of, operation_id) = (route(), |number| OperationId(Uuid::from_u128(number)));
    for number in [3, 1, 2] {
        let request = OperationRequest::Removal(RemovalRequest {
            meant: Meant::Trips(vec![TripId::new("t").unwrap()]),
            dry_run: true,
            erase: false,
            note: None,
        });
        let asked = store.ask_for(operation_id(number), Some(&of), request, by(), at(10));
        asked.await.unwrap();
    }
    for number in [3, 1, 2] {
        for _ in 0..2 {
            let next = store
                .next_operation(OperationKind::Removal)
                .await
                .unwrap()
                .unwrap();
            assert_eq!(next.id, operation_id(number));
        }
        let failed = Err("out of luck".to_owned());
        store
            .end_operation(operation_id(number), failed, at(20))
            .await
            .unwrap();
    }
    assert_eq!(
        store.next_operation(OperationKind::Removal).await.unwrap(),
        None
    );
}
