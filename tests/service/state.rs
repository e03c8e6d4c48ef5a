//! What a route's map holds, to be compared with another's.

use std::collections::BTreeMap;

use mapshift::geometry::{Pose2, wrap_angle};
use serde_json::Value;

use crate::client::Client;

/// Trip and stamp of a keyframe.
pub type Key = (String, String);

/// A route's graph as it is reported.
#[derive(Debug, PartialEq)]
pub struct State {
    pub nodes: Vec<Value>,
    pub edges: Vec<Value>,
}

pub fn pose_of(value: &Value) -> Pose2 {
    let number = |field: &str| value[field].as_f64().unwrap();
    Pose2::new(number("x"), number("y"), number("theta"))
}

impl State {
    pub async fn of(client: &Client, route: &str) -> Self {
        let mut graph = client.json(&format!("/v1/routes/{route}/graph")).await;
        let mut take = |field: &str| match graph[field].take() {
            Value::Array(items) => items,
            other => panic!("{field} is {other}"),
        };
        Self {
            nodes: take("nodes"),
            edges: take("edges"),
        }
    }

    pub fn poses(&self) -> BTreeMap<Key, Pose2> {
        let text = |node: &Value, field: &str| node[field].as_str().unwrap().to_owned();
        let keyed = self.nodes.iter().map(|node| {
            let key = (text(node, "trip_id"), text(node, "stamp"));
            (key, pose_of(&node["pose"]))
        });
        keyed.collect()
    }

    /// The largest differences of the poses: metres, radians.
    ///
    /// # Panics
    /// If the two have different keyframes.
    pub fn distance_to(&self, other: &Self) -> (f64, f64) {
        let (own, others) = (self.poses(), other.poses());
        assert!(own.keys().eq(others.keys()), "other keyframes");
        let pairs = own.values().zip(others.values());
        pairs.fold((0.0, 0.0), |(metres, radians): (f64, f64), (a, b)| {
            let apart = (a.translation() - b.translation()).norm();
            (
                metres.max(apart),
                radians.max(wrap_angle(a.theta - b.theta).abs()),
            )
        })
    }
}
