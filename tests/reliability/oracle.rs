//! What every crash is judged by: everything acknowledged is there, once, and the database is sound.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use crate::client::Client;
use crate::fsck;
use crate::gateway::{Acknowledged, Gateway};

/// What is wrong with a running service and its data, after what it has acknowledged.
pub async fn faults(url: &str, data: &Path, acknowledged: &Acknowledged) -> Vec<String> {
    let mut faults = lost(url, acknowledged).await;
    for route in acknowledged.routes() {
        faults.extend(duplicates(url, &route).await);
    }
    faults.extend(fsck::faults(data));
    faults
}

/// What was acknowledged and is not there, or not as it was sent.
pub async fn lost(url: &str, acknowledged: &Acknowledged) -> Vec<String> {
    let (client, gateway) = (Client::new(url), Gateway::new(url));
    let mut faults = Vec::new();
    for (route, batch) in acknowledged.iter() {
        let path = format!("/v1/routes/{route}/batches/{}", batch.id);
        let (status, reported) = client.get_any(&path).await;
        if status != 200 {
            faults.push(format!(
                "{} of {route} was acknowledged, and is lost: {status}",
                batch.id
            ));
        } else if reported["status"] == "quarantined" {
            faults.push(format!(
                "{} of {route} is kept out: {}",
                batch.id, reported["reason"]
            ));
        } else {
            let again = gateway.put(route, batch).await.unwrap();
            if !again.is_replay {
                faults.push(format!(
                    "{} of {route} is not known again: {again:?}",
                    batch.id
                ));
            }
        }
    }
    faults
}

/// Batches, keyframes, edges and alerts that are there more than once.
async fn duplicates(url: &str, route: &str) -> Vec<String> {
    let client = Client::new(url);
    if client.status_of(&format!("/v1/routes/{route}")).await != 200 {
        return vec![format!("route {route} is lost")];
    }
    let mut graph = client.json(&format!("/v1/routes/{route}/graph")).await;
    let mut alerts = client
        .json(&format!("/v1/alerts?route_id={route}&limit=1000"))
        .await;
    let batches = client
        .list(&format!("/v1/routes/{route}/batches"), 1000)
        .await;
    let mut take = |field: &str| match graph[field].take() {
        Value::Array(items) => items,
        other => panic!("{field} is {other}"),
    };
    let counted = [
        ("batch", batches, vec!["trip_id", "sequence"]),
        ("node", take("nodes"), vec!["trip_id", "stamp"]),
        ("edge", take("edges"), vec!["from", "to", "kind"]),
        (
            "alert",
            alerts["items"].as_array_mut().unwrap().drain(..).collect(),
            vec!["kind", "location"],
        ),
    ];
    let twice = counted.into_iter().flat_map(|(what, items, key)| {
        let mut seen = BTreeSet::new();
        let mut is_new = move |item: &Value| {
            let key: Vec<String> = key.iter().map(|field| item[field].to_string()).collect();
            seen.insert(key)
        };
        let twice: Vec<String> = items
            .iter()
            .filter(|item| !is_new(item))
            .map(|item| format!("a {what} of {route} is there twice: {}", item["id"]))
            .collect();
        twice
    });
    twice.collect()
}
