//! What a service tells of its alerts.

use jiff::Timestamp;
use mapshift::geometry::Vector2;
use mapshift::sim::Shape;
use serde_json::Value;

use super::shop::Shop;
use crate::client::Client;
use crate::running::Running;

pub const ROUTE: &str = "line";

/// A service with an empty route.
pub async fn empty_route() -> Running {
    let service = Running::start().await;
    service.client.put_route(ROUTE, Value::Null).await;
    service
}

/// Sends one lap and hands back every alert when it is in the map, the newest first.
pub async fn after_lap(client: &Client, shop: &Shop, lap: usize) -> Vec<Value> {
    client.put_all(ROUTE, &shop.lap(lap)).await;
    client.merged(ROUTE).await;
    alerts(client).await
}

/// Every alert, the newest first.
pub async fn alerts(client: &Client) -> Vec<Value> {
    let path = format!("/v1/alerts?route_id={ROUTE}&limit=1000");
    let mut page = client.json(&path).await;
    assert_eq!(page["next_cursor"], Value::Null);
    serde_json::from_value(page["items"].take()).unwrap()
}

/// The alert, if it is the only one; else fails.
pub fn only(alerts: Vec<Value>) -> Value {
    let [alert] = alerts.try_into().unwrap_or_else(|all: Vec<Value>| {
        panic!(
            "{} alerts: {}",
            all.len(),
            all.iter().map(brief).collect::<Vec<_>>().join("; ")
        )
    });
    alert
}

/// An alert in a line, for people.
pub fn brief(alert: &Value) -> String {
    let [x, y] = place(alert).into();
    let text = |field: &str| alert[field].as_str().unwrap().to_owned();
    let (kind, status) = (text("kind"), text("status"));
    let trips = &alert["trip_ids"];
    format!(
        "{status} {kind} at {x:.2}, {y:.2}, {} views of {trips}",
        alert["views"]
    )
}

pub fn place(alert: &Value) -> Vector2<f64> {
    let number = |field: &str| alert["location"][field].as_f64().unwrap();
    Vector2::new(number("x"), number("y"))
}

pub fn time(alert: &Value, field: &str) -> Timestamp {
    alert[field].as_str().unwrap().parse().unwrap()
}

pub fn ids(alert: &Value, field: &str) -> Vec<i64> {
    serde_json::from_value(alert[field].clone()).unwrap()
}

pub fn names(alert: &Value, field: &str) -> Vec<String> {
    serde_json::from_value(alert[field].clone()).unwrap()
}

pub fn statuses(alert: &Value) -> Vec<String> {
    let history = alert["history"].as_array().unwrap();
    let statuses = history
        .iter()
        .map(|entry| entry["status"].as_str().unwrap());
    statuses.map(ToOwned::to_owned).collect()
}

/// How far the farthest corner of an alert's region is from a thing, metres.
pub fn reach_beyond(alert: &Value, shape: &Shape) -> f64 {
    let corners: Vec<[f64; 2]> = serde_json::from_value(alert["region"].clone()).unwrap();
    assert!(corners.len() >= 3, "{alert}");
    let beyond = corners.iter().map(|&corner| {
        let corner = Vector2::from(corner);
        match shape.contains(&corner) {
            true => 0.0,
            false => shape.distance_to(&corner),
        }
    });
    beyond.fold(0.0, f64::max)
}
