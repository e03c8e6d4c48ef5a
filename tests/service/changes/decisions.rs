//! What keepers decide, and what later laps make of it.

use mapshift::geometry::Vector2;
use mapshift::sim::Shape;
use serde_json::{Value, json};

use super::picture::Picture;
use super::reported::{ROUTE, after_lap, alerts, empty_route, only, statuses};
use super::shop::{Shop, crate_in_the_middle};
use crate::client::Client;
use crate::running::Running;

const CHANGED_LAP: usize = 2;
/// A cell so near to a thing's outline shows it, metres: half a cell and the map's errors.
const NEAR_M: f64 = 0.06;
/// What is farther inside, no beam reaches, metres.
const INSIDE_M: f64 = 0.12;

#[tokio::test(flavor = "multi_thread")]
async fn what_came_can_be_accepted_and_undone() {
    accepted_then_more_laps(&Came::new(5), 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_went_can_be_accepted_and_undone() {
    accepted_then_more_laps(&Went::new(6), 3).await;
}

/// `cargo test --release --test service -- --ignored ten_laps_after`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes a minute"]
async fn ten_laps_after_an_acceptance_nothing_is_reported() {
    for seed in 200..204 {
        accepted_then_more_laps(&Came::new(seed), 10).await;
        accepted_then_more_laps(&Went::new(seed), 10).await;
    }
}

/// A change with what the map must show of it.
trait Change {
    fn shop(&self) -> &Shop;
    /// Fails unless the picture shows the state after the change.
    fn assert_shown(&self, picture: &Picture);
}

struct Came(Shop);

impl Came {
    fn new(seed: u64) -> Self {
        Self(Shop::new(seed).with_crate(CHANGED_LAP, None))
    }
}

impl Change for Came {
    fn shop(&self) -> &Shop {
        &self.0
    }

    fn assert_shown(&self, picture: &Picture) {
        let shape = crate_in_the_middle();
        let outline = picture.cells(|p| shape.distance_to(p) <= NEAR_M);
        let inside = picture.cells(|p| is_deep_inside(&shape, p));
        assert!(outline.occupied >= 20, "{outline:?}");
        assert_eq!(inside.free, 0, "{inside:?}");
    }
}

struct Went(Shop);

impl Went {
    fn new(seed: u64) -> Self {
        Self(Shop::new(seed).without_cupboard(CHANGED_LAP))
    }
}

impl Change for Went {
    fn shop(&self) -> &Shop {
        &self.0
    }

    fn assert_shown(&self, picture: &Picture) {
        let shape = self.0.cupboard();
        let there = |p: &_| shape.contains(p) || shape.distance_to(p) <= NEAR_M;
        let cells = picture.cells(there);
        assert_eq!(cells.occupied, 0, "{cells:?}");
        assert!(cells.free >= 9 * cells.unknown, "{cells:?}");
    }
}

fn is_deep_inside(shape: &Shape, point: &Vector2<f64>) -> bool {
    shape.contains(point) && shape.distance_to(point) >= INSIDE_M
}

async fn accepted_then_more_laps(change: &dyn Change, laps: usize) {
    let (service, alert) = reported_of(change.shop()).await;
    let client = &service.client;
    let before = Published::of(client).await;
    let accepted = client.decide(&alert, "accept").await;
    assert_eq!(accepted["status"], "accepted");
    change.assert_shown(&Picture::of(client).await);
    assert_ne!(Published::of(client).await.pgm, before.pgm);

    let restored = client.decide(&accepted, "undo").await;
    assert_eq!(restored["status"], "open");
    let after = Published::of(client).await;
    assert!(after.g2o == before.g2o, "another graph");
    assert!(after.pgm == before.pgm, "another map");
    let first_pgm = format!("/v1/routes/{ROUTE}/versions/1/map.pgm");
    assert!(client.bytes(&first_pgm).await == before.pgm);
    versions_tell(client, &alert["id"]).await;

    let again = client.decide(&restored, "accept").await;
    for lap in CHANGED_LAP + 1..=CHANGED_LAP + laps {
        let reported = only(after_lap(client, change.shop(), lap).await);
        assert_eq!(reported["status"], "accepted", "lap {lap}: {reported}");
        change.assert_shown(&Picture::of(client).await);
    }
    let last = only(alerts(client).await);
    assert_eq!(statuses(&last), statuses(&again));
    assert_eq!(statuses(&last), ["open", "accepted", "open", "accepted"]);
    let route = client.route(ROUTE).await;
    assert_eq!(route["map_version"], 4);
    assert_eq!(route["counts"]["open_alerts"], 0);
    service.stop().await;
}

/// A service that has reported a change in the first lap that shows it.
async fn reported_of(shop: &Shop) -> (Running, Value) {
    let service = empty_route().await;
    for lap in 0..CHANGED_LAP {
        after_lap(&service.client, shop, lap).await;
    }
    let alert = only(after_lap(&service.client, shop, CHANGED_LAP).await);
    (service, alert)
}

/// What others copy.
struct Published {
    g2o: Vec<u8>,
    pgm: Vec<u8>,
}

impl Published {
    async fn of(client: &Client) -> Self {
        let path = |name: &str| format!("/v1/routes/{ROUTE}/{name}");
        Self {
            g2o: client.bytes(&path("graph.g2o")).await,
            pgm: client.bytes(&path("map.pgm")).await,
        }
    }
}

async fn versions_tell(client: &Client, alert_id: &Value) {
    let path = format!("/v1/routes/{ROUTE}/versions");
    let versions = client.list(&path, 2).await;
    let reported: Vec<Value> = versions
        .iter()
        .map(|v| json!([v["version"], v["current"], v["cause"]]))
        .collect();
    let by = &versions[1]["cause"]["by"];
    assert!(by.is_string(), "{versions:?}");
    let cause =
        |action: &str| json!({"alert_id": alert_id, "action": action, "by": by, "note": null});
    assert_eq!(
        reported,
        [
            json!([1, false, null]),
            json!([2, false, cause("accept")]),
            json!([3, true, cause("undo")]),
        ]
    );
    assert!(versions[0]["sha256"].is_string() && versions[2]["sha256"].is_null());
    // The undo takes back the way that the accepted change has moved nodes.
    let moved_m = |k: usize| versions[k]["max_displacement_m"].as_f64();
    assert_eq!((moved_m(0), moved_m(1)), (None, moved_m(2)));
    assert_ne!(versions[0]["sha256"], versions[1]["sha256"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_dismissed_is_not_reported_again() {
    dismissed_then_more_laps(7, 2).await;
}

/// `cargo test --release --test service -- --ignored ten_laps_after`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes a minute"]
async fn ten_laps_after_a_dismissal_nothing_is_reported() {
    for seed in 300..304 {
        dismissed_then_more_laps(seed, 10).await;
    }
}

async fn dismissed_then_more_laps(seed: u64, laps: usize) {
    let shop = Shop::new(seed).with_crate(CHANGED_LAP, None);
    let (service, alert) = reported_of(&shop).await;
    let client = &service.client;
    let before = Published::of(client).await;
    let dismissed = client.decide(&alert, "dismiss").await;
    assert_eq!(dismissed["status"], "dismissed");
    let after = Published::of(client).await;
    assert!(after.g2o == before.g2o && after.pgm == before.pgm);
    for lap in CHANGED_LAP + 1..=CHANGED_LAP + laps {
        let reported = only(after_lap(client, &shop, lap).await);
        assert_eq!(
            statuses(&reported),
            ["open", "dismissed"],
            "lap {lap}: {reported}"
        );
    }
    assert_eq!(client.route(ROUTE).await["map_version"], 1);
    service.stop().await;
}
