//! What is raised, where and when; and what is not.

use std::collections::BTreeSet;

use jiff::{SignedDuration, Timestamp};
use mapshift::geometry::{Vector2, distance_to_polygon};
use mapshift::sim::Shape;
use serde_json::{Value, json};

use super::reported::{
    ROUTE, after_lap, alerts, brief, empty_route, ids, names, only, reach_beyond, statuses, time,
};
use super::shop::{Shop, crate_in_the_middle, trip_name, vehicle_name};
use crate::client::Client;
use crate::state::State;

const CHANGED_LAP: usize = 2;
const LAPS: usize = 4;
/// No corner of a region is farther from what changed, metres.
const BEYOND_MAX_M: f64 = 0.35;

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_is_reported_once() {
    let shop = Shop::new(1).with_crate(CHANGED_LAP, None);
    one_change_is_reported_once(&shop, "appeared", &crate_in_the_middle()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_goes_is_reported_once() {
    let shop = Shop::new(2).without_cupboard(CHANGED_LAP);
    one_change_is_reported_once(&shop, "disappeared", shop.cupboard()).await;
}

async fn one_change_is_reported_once(shop: &Shop, kind: &str, shape: &Shape) {
    let service = empty_route().await;
    let client = &service.client;
    for lap in 0..CHANGED_LAP {
        let reported = after_lap(client, shop, lap).await;
        assert!(reported.is_empty(), "lap {lap}: {reported:?}");
    }
    let mut raised: Option<Value> = None;
    for lap in CHANGED_LAP..LAPS {
        let alert = only(after_lap(client, shop, lap).await);
        assert_eq!(alert["kind"], kind, "{alert}");
        assert_eq!(alert["status"], "open", "{alert}");
        assert_eq!(statuses(&alert), ["open"]);
        let beyond_m = reach_beyond(&alert, shape);
        assert!(beyond_m <= BEYOND_MAX_M, "{beyond_m} m: {}", brief(&alert));
        let raised = raised.get_or_insert_with(|| alert.clone());
        assert_eq!(alert["id"], raised["id"]);
        assert_eq!(alert["first_seen"], raised["first_seen"]);
        let laps = lap + 1 - CHANGED_LAP;
        let passes = alert["laps"].as_u64().unwrap() as usize;
        assert!((laps..=2 * laps).contains(&passes), "{passes} passes");
        parts_are_sound(client, &alert, lap).await;
        evidence_is_there(client, &alert).await;
        passes_are_those_driven(client, &alert, lap).await;
        observations_are_there(client, &alert).await;
        eprintln!("{kind}, lap {lap}: {}, {beyond_m:.2} m", brief(&alert));
    }
    service.stop().await;
}

/// What the alert names is in the graph, and is what tells of the change.
async fn parts_are_sound(client: &Client, alert: &Value, lap: usize) {
    let seen = CHANGED_LAP..=lap;
    let trips: Vec<String> = seen.clone().map(trip_name).collect();
    let vehicles: BTreeSet<String> = seen.map(|lap| vehicle_name(lap % 2)).collect();
    assert_eq!(names(alert, "trip_ids"), trips);
    assert_eq!(names(alert, "vehicle_ids"), Vec::from_iter(vehicles));

    let state = State::of(client, ROUTE).await;
    let trip_of = |id: i64| {
        let node = state.nodes.iter().find(|node| node["id"] == id);
        node.unwrap()["trip_id"].as_str().unwrap()
    };
    let nodes = ids(alert, "node_ids");
    let showing = nodes
        .iter()
        .filter(|id| trips.iter().any(|t| t == trip_of(**id)));
    let views = alert["views"].as_i64().unwrap() as usize;
    // Every scan is a view; several may follow one node.
    let showing = showing.count();
    assert!(views >= 4 && showing >= 2, "{showing} nodes: {alert}");
    let edges = ids(alert, "edge_ids");
    assert!(!edges.is_empty());
    for id in edges {
        let edge = state.edges.iter().find(|edge| edge["id"] == id).unwrap();
        assert_eq!(edge["kind"], "loop_closure");
        let ends = ["from", "to"].map(|end| edge[end].as_i64().unwrap());
        assert!(
            ends.iter().any(|end| nodes.contains(end)),
            "{edge} in {alert}"
        );
        let new = ends.map(|end| trips.iter().any(|trip| trip == trip_of(end)));
        assert_eq!(
            new,
            [false, true],
            "{edge}: the change lies between its ends"
        );
    }
    let (since, last_seen) = (time(alert, "since"), time(alert, "last_seen"));
    let of_trip = |name: String| {
        let nodes = state.nodes.iter().filter(move |n| n["trip_id"] == name);
        nodes.map(|node| time(node, "stamp"))
    };
    let was_driven = |trip: String, at| {
        let (first, last) = (of_trip(trip.clone()).min(), of_trip(trip).max());
        first.is_some_and(|first| first <= at) && last.is_some_and(|last| at <= last)
    };
    assert!(was_driven(trip_name(CHANGED_LAP), since), "{alert}");
    assert!(was_driven(trip_name(lap), last_seen), "{alert}");
    assert_eq!(alert["first_seen"], alert["since"]);
    assert_eq!(alert["until"], Value::Null);
    let confidence = alert["confidence"].as_f64().unwrap();
    assert!((0.99..=1.0).contains(&confidence), "{confidence}");
}

/// Both scans, one from before and one from after, that show the change beam by beam.
async fn evidence_is_there(client: &Client, alert: &Value) {
    let path = format!("/v1/alerts/{}/evidence", alert["id"].as_str().unwrap());
    let svg = client.text(&format!("{path}.svg")).await;
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    let evidence = client.json(&path).await;
    assert_eq!(evidence["region"], alert["region"]);
    let edges = ids(alert, "edge_ids");
    assert!(edges.contains(&evidence["edge_id"].as_i64().unwrap()));
    let scans = evidence["scans"].as_array().unwrap();
    let roles: Vec<&Value> = scans.iter().map(|scan| &scan["role"]).collect();
    assert_eq!(roles, ["old", "new"]);
    let since = time(alert, "since");
    assert!(time(&scans[0], "stamp") < since && since <= time(&scans[1], "stamp"));
    let showing = scans
        .iter()
        .flat_map(|scan| scan["beams"].as_array().unwrap());
    let showing = showing
        .filter(|beam| beam["verdict"] == "contradicts")
        .count();
    assert!(showing >= 3, "{showing} beams contradict");
    assert!(
        !evidence["residuals"]["entries"]
            .as_array()
            .unwrap()
            .is_empty()
    );
}

/// Every lap before saw the old state, every one since the new state, as often as the detector counts.
async fn passes_are_those_driven(client: &Client, alert: &Value, lap: usize) {
    let id = alert["id"].as_str().unwrap();
    let passes = client.json(&format!("/v1/alerts/{id}/passes")).await;
    let passes = passes["items"].as_array().unwrap();
    let trips = |side: &str, outcome: &str| {
        let such = passes.iter();
        let such = such.filter(|pass| pass["side"] == side && pass["outcome"] == outcome);
        let trips: Vec<String> = such
            .map(|pass| pass["trip_id"].as_str().unwrap().to_owned())
            .collect();
        trips
    };
    let laps = |laps: std::ops::Range<usize>| laps.map(trip_name).collect::<BTreeSet<_>>();
    let (old, new) = (trips("before", "old_state"), trips("since", "new_state"));
    assert_eq!(
        BTreeSet::from_iter(old.clone()),
        laps(0..CHANGED_LAP),
        "{passes:#?}"
    );
    assert_eq!(
        BTreeSet::from_iter(new.clone()),
        laps(CHANGED_LAP..lap + 1),
        "{passes:#?}"
    );
    assert!(trips("before", "new_state").is_empty(), "{passes:#?}");
    assert!(trips("since", "old_state").is_empty(), "{passes:#?}");
    assert_eq!(alert["laps"], new.len(), "{passes:#?}");

    let (was, is) = match alert["kind"].as_str() {
        Some("appeared") => ("saw_free", "saw_occupied"),
        _ => ("saw_occupied", "saw_free"),
    };
    let (before, since) = (&alert["passes"]["before"], &alert["passes"]["since"]);
    assert_eq!((&before[was], &before[is]), (&json!(old.len()), &json!(0)));
    assert_eq!((&since[was], &since[is]), (&json!(0), &json!(new.len())));
    let summary = alert["summary"].as_str().unwrap();
    assert!(
        summary.contains(&format!("{} earlier pass", old.len())),
        "{summary}"
    );
    assert!(
        summary.contains(&format!("in {0} of {0} pass", new.len())),
        "{summary}"
    );
    assert!(alert["blocking"].is_string(), "{alert}");
}

/// In the region cells were hit on one side and missed on the other.
async fn observations_are_there(client: &Client, alert: &Value) {
    let path = format!("/v1/alerts/{}/observations", alert["id"].as_str().unwrap());
    let observations = client.json(&path).await;
    let region = alert["region"].as_array().unwrap();
    let corner =
        |corner: &Value| Vector2::new(corner[0].as_f64().unwrap(), corner[1].as_f64().unwrap());
    let region: Vec<Vector2<f64>> = region.iter().map(corner).collect();
    let number = |value: &Value| value.as_f64().unwrap();
    let (resolution, width) = (
        number(&observations["resolution"]),
        number(&observations["width"]),
    );
    let origin = &observations["origin"];
    let in_region = |side: &str, what: &str| {
        let (cells, counts) = (&observations[side]["cells"], &observations[side][what]);
        let cells = cells
            .as_array()
            .unwrap()
            .iter()
            .zip(counts.as_array().unwrap());
        let inside = cells.filter(|(cell, _)| {
            let (row, column) = ((number(cell) / width).floor(), number(cell) % width);
            let middle = Vector2::new(
                number(&origin["x"]) + resolution * (column + 0.5),
                number(&origin["y"]) + resolution * (row + 0.5),
            );
            distance_to_polygon(&middle, &region) == 0.0
        });
        inside.map(|(_, count)| number(count)).sum::<f64>()
    };
    let share =
        |side| in_region(side, "hits") / (in_region(side, "hits") + in_region(side, "misses"));
    let (before, since) = (share("before"), share("since"));
    match alert["kind"].as_str() {
        Some("appeared") => assert!(before < 0.02 && since > 0.3, "{before} {since}"),
        _ => assert!(since < 0.02 && before > 0.3, "{before} {since}"),
    }
    for show in ["before", "since", "both"] {
        let svg = client.text(&format!("{path}.svg?show={show}")).await;
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn people_are_no_change() {
    people_raise_nothing(3, 4).await;
}

/// `cargo test --test service -- --ignored many_people`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes"]
async fn many_people_are_no_change() {
    for seed in 100..120 {
        people_raise_nothing(seed, 8).await;
    }
}

async fn people_raise_nothing(seed: u64, laps: usize) {
    let mut shop = Shop::new(seed);
    shop.scene.walkers = 2;
    let service = empty_route().await;
    let client = &service.client;
    let mut ever = BTreeSet::new();
    for lap in 0..laps {
        let reported = after_lap(client, &shop, lap).await;
        ever.extend(reported.iter().map(brief));
    }
    assert!(ever.is_empty(), "seed {seed}: {ever:?}");
    service.stop().await;
}

/// Stands there for a lap, is away for two, and comes back.
#[tokio::test(flavor = "multi_thread")]
async fn what_leaves_again_is_resolved_until_it_returns() {
    let shop = Shop::new(4).with_crate(2, Some(3)).with_crate(5, None);
    let service = empty_route().await;
    let client = &service.client;
    let mut lives = Vec::new();
    for lap in 0..6 {
        let reported = after_lap(client, &shop, lap).await;
        lives.push(reported.iter().map(statuses).collect::<Vec<_>>());
    }
    let reported = alerts(client).await;
    eprintln!(
        "{lives:?}: {:?}",
        reported.iter().map(brief).collect::<Vec<_>>()
    );
    let nothing: [[&str; 0]; 0] = [];
    assert_eq!(lives[0], nothing);
    assert_eq!(lives[1], nothing);
    assert_eq!(lives[2], [["open"]]);
    assert_eq!(lives[3], [["open", "resolved"]]);
    assert_eq!(lives[4], [["open", "resolved"]]);
    assert_eq!(lives[5], [["open", "resolved", "open"]]);
    let alert = only(reported);
    assert_eq!(alert["kind"], "appeared");
    assert_eq!(names(&alert, "trip_ids"), [trip_name(5)]);
    assert!(time(&alert, "first_seen") < time(&alert, "since"));
    assert!(reach_beyond(&alert, &crate_in_the_middle()) <= BEYOND_MAX_M);
    service.stop().await;
}

/// The vehicle that sees it has a clock that is two years ahead.
#[tokio::test(flavor = "multi_thread")]
async fn a_clock_that_is_ahead_makes_nothing_last_for_years() {
    let shop = Shop::new(4).with_crate(2, Some(3));
    let service = empty_route().await;
    let client = &service.client;
    for lap in 0..2 {
        assert!(after_lap(client, &shop, lap).await.is_empty());
    }
    let mut ahead = shop.drive(2);
    ahead.began += SignedDuration::from_hours(2 * 365 * 24);
    client.put_all(ROUTE, &ahead.batches(60)).await;
    for batch in client.merged(ROUTE).await {
        let is_ahead = batch["trip_id"] == ahead.trip;
        let expected = if is_ahead {
            json!(["clock_skew"])
        } else {
            json!([])
        };
        assert_eq!(batch["flags"], expected, "{batch}");
    }
    let alert = only(alerts(client).await);
    assert_eq!(
        (&alert["kind"], &alert["status"]),
        (&json!("appeared"), &json!("open"))
    );
    assert!(time(&alert, "last_seen") < Timestamp::now());
    let mut after = shop.drive(3);
    after.began = after.began.max(Timestamp::now());
    client.put_all(ROUTE, &after.batches(60)).await;
    client.merged(ROUTE).await;
    assert_eq!(only(alerts(client).await)["status"], "resolved");
    service.stop().await;
}
