//! The pose graph of a route: what results write, and what is read of it.
//!
//! With SQL past the store, for SQLite: rows that have gone, and a scan that is not what was written.

use mapshift::geometry::{Information, Pose2, PoseSigma};
use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::{EdgeId, NodeId, RouteId, TripId};
use mapshift::model::Stage;
use mapshift::store::{
    Applied, BatchFilter, ClosureRecord, Corruption, Deleted, EdgeChange, EdgeFilter, GeoAnchor,
    JobResult, NodeChange, Put, RouteEdition, RouteSettings, RouteUpdate, SettingsUpdate,
    StoreError,
};

use crate::support::{
    Fixture, at, batch_id, by, edge, intermediate, route, upload, with_residuals,
};

fn closure() -> ClosureRecord {
    ClosureRecord {
        all_points_measurement: Pose2::new(0.3, 0.2, 0.1),
        all_points_information: Information::from_sigmas(0.01, 0.02),
        overlap: 0.7,
        inlier_share: 1.0,
        rmse_m: 0.012,
        all_points_residual: 3.5,
    }
}

#[tokio::test]
async fn a_graph_is_read_back_to_the_bit() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.chain(&job, 700).await;
    let mut loop_closure = edge(&job.entries[0].batch, 5_000, 1, 600);
    loop_closure.kind = EdgeKind::LoopClosure;
    loop_closure.delta_f = Some(-1e-12);
    loop_closure.closure = Some(closure());
    loop_closure.subgraph_id = Some(4);
    result.edges.push(loop_closure.clone());
    result.nodes[5].node.active = false;
    // As a batch of edges brings them.
    (result.nodes[7].scan, result.nodes[7].lidar) = (None, None);
    result.nodes[7].node.client_id = Some("07".to_owned());
    result.stage = Stage::Monitoring;
    let applied = fixture.store.apply_result(result.clone()).await.unwrap();
    assert_eq!(applied, Applied::Committed);

    let store = &fixture.store;
    let graph = store.load_graph(&route()).await.unwrap().unwrap();
    let mut active = result.nodes.clone();
    let settled = active.remove(5).node.id;
    assert_eq!(graph.nodes, active);
    let nodes: Vec<_> = result.nodes.iter().map(|n| n.node.clone()).collect();
    let mut between = with_residuals(result.edges.clone(), &nodes);
    between.retain(|edge| edge.from != settled && edge.to != settled);
    assert_eq!(between.len(), result.edges.len() - 2);
    assert_eq!(graph.edges, between);
    assert_eq!((graph.revision, graph.stage), (1, Stage::Monitoring));
    assert_eq!(graph.settings, RouteSettings::default());
    assert_eq!(graph.next_node_id, NodeId(701));
    assert_eq!(graph.next_edge_id, EdgeId(5_001));

    let nodes: Vec<_> = result.nodes.iter().map(|n| n.node.clone()).collect();
    assert_eq!(store.nodes(&route()).await.unwrap(), nodes);
    let trip = TripId::new("t").unwrap();
    assert_eq!(store.trip_nodes(&route(), &trip).await.unwrap(), nodes);
    let page = store.node_page(&route(), Some(NodeId(3)), 2).await.unwrap();
    assert_eq!(page, nodes[3..5]);
    let one = store.node(&route(), NodeId(9)).await.unwrap();
    assert_eq!(one.as_ref(), Some(&nodes[8]));
    let active = store.nodes_with_scans(&route()).await.unwrap();
    assert_eq!(active.len(), 698);
    let vehicle = &job.entries[0].batch.vehicle_id;
    let names = ["7", "07", "none"].map(str::to_owned);
    let known = store.client_nodes(&route(), vehicle, &names).await.unwrap();
    assert_eq!(known, [("07".to_owned(), NodeId(8))]);
    let other = mapshift::ids::VehicleId::new("other").unwrap();
    let known = store.client_nodes(&route(), &other, &names).await.unwrap();
    assert_eq!(known, []);
    assert_eq!(active[5], result.nodes[6]);
    let scan = store.node_scan(&route(), NodeId(9)).await.unwrap();
    assert_eq!(scan, result.nodes[8].scan);

    let edges = with_residuals(result.edges.clone(), &nodes);
    assert_eq!(store.edges(&route()).await.unwrap(), edges);
    let page = store
        .edge_page(&route(), EdgeFilter::default(), None, 2)
        .await
        .unwrap();
    assert_eq!(page, edges[..2]);
    let one = store.edge(&route(), EdgeId(5_000)).await.unwrap();
    assert_eq!(one.as_ref(), edges.last());
    assert_eq!(store.edge(&route(), EdgeId(4_999)).await.unwrap(), None);
}

#[tokio::test]
async fn changes_touch_what_they_name() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let first = fixture.chain(&job, 400).await;
    fixture.store.apply_result(first.clone()).await.unwrap();
    fixture.journal(upload("b1", "t", 1)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut second = fixture.chain(&job, 0).await;
    let mut nodes: Vec<_> = first.nodes.iter().map(|n| n.node.clone()).collect();
    for node in nodes.iter_mut().filter(|node| node.id.0 != 100) {
        node.pose = Pose2::new(node.pose.y, 1.0 / 7.0, 0.2);
        node.sigma = (node.id.0 % 6 != 0).then(|| PoseSigma {
            x_m: 0.1 + 0.2,
            y_m: 1.0 / node.id.0 as f64,
            theta_rad: 0.0,
        });
        node.active = node.id.0 % 5 != 0;
        node.reference = node.id.0 % 3 == 0;
        node.subgraph_id = Some(node.id.0 % 4);
        node.drift_m = 0.25 * node.id.0 as f64;
        second.changed_nodes.push(NodeChange {
            id: node.id,
            pose: node.pose,
            sigma: node.sigma,
            subgraph_id: node.subgraph_id,
            drift_m: node.drift_m,
            reference: node.reference,
            active: node.active,
        });
    }
    let mut edges = first.edges.clone();
    for edge in edges.iter_mut().skip(1) {
        edge.status = EdgeStatus::Retired;
        if edge.id.0 % 2 == 0 {
            edge.status = EdgeStatus::Active;
        }
        edge.subgraph_id = (edge.id.0 % 7 != 0).then_some(edge.id.0 % 6);
        second.changed_edges.push(EdgeChange {
            id: edge.id,
            status: edge.status,
            subgraph_id: edge.subgraph_id,
        });
    }
    second.changed_edges.reverse();
    let applied = fixture.store.apply_result(second).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    assert_eq!(fixture.store.nodes(&route()).await.unwrap(), nodes);
    let edges = with_residuals(edges, &nodes);
    assert_eq!(fixture.store.edges(&route()).await.unwrap(), edges);
    let counts = fixture.store.route(&route()).await.unwrap().unwrap().counts;
    // Active edges have even ids: blocks 0, 2, 4.
    assert_eq!(counts.subgraphs, 3);
}

#[tokio::test]
async fn what_is_not_finite_or_out_of_range_does_not_get_in() {
    type Spoiler = fn(&mut JobResult);
    let spoilers: [Spoiler; 11] = [
        |r| r.nodes[1].node.pose.x = f64::NAN,
        |r| r.nodes[1].node.pose.y = f64::INFINITY,
        |r| r.nodes[1].node.pose.theta = 7.0,
        |r| r.nodes[1].node.odom_from_base.x = f64::NEG_INFINITY,
        |r| r.edges[0].delta_f = Some(f64::INFINITY),
        |r| r.edges[0].information = Information::from_upper([-1.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
        |r| r.edges[0].measurement.theta = f64::NAN,
        |r| r.edges[0].to = NodeId(4_711),
        |r| r.edges[0].to = r.edges[0].from,
        |r| r.edges[0].closure.as_mut().unwrap().overlap = f64::NAN,
        |r| r.edges[0].closure.as_mut().unwrap().inlier_share = 1.5,
    ];
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    for (k, spoil) in spoilers.iter().enumerate() {
        let mut result = fixture.chain(&job, 3).await;
        result.edges[0].closure = Some(closure());
        spoil(&mut result);
        let answer = fixture.store.apply_result(result).await;
        assert!(
            matches!(answer, Err(StoreError::Database(_))),
            "{k}: {answer:?}"
        );
    }
    assert_eq!(fixture.store.nodes(&route()).await.unwrap(), vec![]);
    let anchor = GeoAnchor {
        latitude: 91.0,
        longitude: 0.0,
        heading: 0.0,
    };
    let update = RouteUpdate {
        geo_anchor: Some(anchor),
        ..RouteUpdate::default()
    };
    let answer = fixture.store.put_route(&route(), update, by(), at(1)).await;
    assert!(matches!(answer, Err(StoreError::Database(_))));
    fixture.store.check_ready().await.unwrap();
}

#[tokio::test]
async fn rot_in_a_scan_is_found() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let result = fixture.chain(&job, 3).await;
    fixture.store.apply_result(result).await.unwrap();
    sqlx::query("UPDATE node_scans SET scan = x'00' WHERE node_id = 2")
        .execute(&mut fixture.raw().await)
        .await
        .unwrap();
    let store = &fixture.store;
    let wanted = Corruption::Scan {
        route_id: route(),
        node_id: NodeId(2),
    };
    let graph = store.load_graph(&route()).await.unwrap().unwrap();
    let has_scan: Vec<bool> = graph.nodes.iter().map(|node| node.scan.is_some()).collect();
    assert_eq!(has_scan, [true, false, true], "the map goes on without it");
    let scan = store.node_scan(&route(), NodeId(2)).await;
    assert!(matches!(scan, Err(StoreError::Corrupt(what)) if what == wanted));
    assert!(
        store
            .node_scan(&route(), NodeId(1))
            .await
            .unwrap()
            .is_some()
    );
    assert_eq!(store.nodes(&route()).await.unwrap().len(), 3);
}

#[tokio::test]
async fn routes_are_put_listed_and_deleted() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let update = RouteUpdate {
        display_name: Some("Line 4".to_owned()),
        geo_anchor: Some(GeoAnchor {
            latitude: 47.5,
            longitude: 19.04,
            heading: 12.0,
        }),
        ..RouteUpdate::default()
    };
    let line = RouteId::new("line-4").unwrap();
    let put = store
        .put_route(&line, update.clone(), by(), at(1))
        .await
        .unwrap();
    assert_eq!(put, Put::Created);
    let settings = RouteSettings {
        hold_s: 5,
        max_shift_m: 0.05,
        false_alarm_rate: 0.01,
        detector: mapshift::model::Detector::Seed,
    };
    let change = RouteUpdate {
        settings: SettingsUpdate {
            detector: Some(settings.detector),
            false_alarm_rate: Some(settings.false_alarm_rate),
            hold_s: Some(settings.hold_s),
            max_shift_m: Some(settings.max_shift_m),
        },
        ..RouteUpdate::default()
    };
    let put = store.put_route(&line, change, by(), at(2)).await.unwrap();
    assert_eq!(put, Put::Updated);
    let record = store.route(&line).await.unwrap().unwrap();
    assert_eq!(record.display_name, update.display_name);
    assert_eq!(record.geo_anchor, update.geo_anchor);
    assert_eq!(record.settings, settings);
    assert_eq!((record.created_at, record.updated_at), (at(1), at(2)));
    assert_eq!(
        (record.map_version, record.epoch, record.revision),
        (1, 1, 0)
    );
    assert_eq!(record.stage, Stage::Mapping);
    let ids = |page: Vec<mapshift::store::RouteRecord>| -> Vec<String> {
        page.into_iter().map(|r| r.id.to_string()).collect()
    };
    let page = store.routes(None, 1).await.unwrap();
    assert_eq!(ids(page), ["line-4"]);
    let page = store.routes(Some(&line), 10).await.unwrap();
    assert_eq!(ids(page), ["r"]);

    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.chain(&job, 30).await;
    result.intermediate = vec![intermediate(2, 0), intermediate(2, 1)];
    store.apply_result(result).await.unwrap();
    fixture.journal(upload("c", "t", 1)).await;
    let job = fixture.claim(0).await.unwrap();
    let late = fixture.chain(&job, 3).await;
    let before = RouteEdition {
        revision: 1,
        updated_at: at(0),
    };
    let deletion = store
        .delete_route(&route(), Some(before), by(), at(3))
        .await;
    assert_eq!(deletion.unwrap(), Deleted::Stale);
    for expected in [Deleted::Done, Deleted::NotThere] {
        let deletion = store.delete_route(&route(), None, by(), at(3)).await;
        assert_eq!(deletion.unwrap(), expected);
    }
    assert_eq!(store.apply_result(late).await.unwrap(), Applied::Stale);
    assert!(store.load_graph(&route()).await.unwrap().is_none());
    let mut raw = fixture.raw().await;
    for table in [
        "trips",
        "batches",
        "batch_bodies",
        "jobs",
        "nodes",
        "node_scans",
        "intermediate_scans",
        "edges",
    ] {
        let query = sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
        let rows: i64 = sqlx::query_scalar(query).fetch_one(&mut raw).await.unwrap();
        assert_eq!(rows, 0, "{table}");
    }
    crate::support::put_route(store, "r").await;
    let fresh = store.route(&route()).await.unwrap().unwrap();
    assert_eq!((fresh.counts.batches, fresh.revision), (0, 0));
    let none = store
        .batches(&route(), &BatchFilter::default(), None, 9)
        .await;
    assert_eq!(none.unwrap(), vec![]);
    assert_eq!(store.batch(&route(), &batch_id("b")).await.unwrap(), None);
}

#[tokio::test]
async fn ids_are_not_used_again_after_their_rows_are_gone() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let result = fixture.chain(&job, 10).await;
    fixture.store.apply_result(result).await.unwrap();
    let mut raw = fixture.raw().await;
    for delete in [
        "DELETE FROM edges WHERE edge_id > 3",
        "DELETE FROM nodes WHERE node_id > 7",
    ] {
        sqlx::query(delete).execute(&mut raw).await.unwrap();
    }
    let graph = fixture.store.load_graph(&route()).await.unwrap().unwrap();
    assert_eq!((graph.next_node_id.0, graph.next_edge_id.0), (11, 10));
}

#[tokio::test]
async fn two_who_edit_a_route_do_not_undo_each_other() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let rate = |rate, expected| RouteUpdate {
        settings: SettingsUpdate {
            false_alarm_rate: Some(rate),
            ..SettingsUpdate::default()
        },
        expected,
        ..RouteUpdate::default()
    };
    let hold = RouteUpdate {
        settings: SettingsUpdate {
            hold_s: Some(7),
            ..SettingsUpdate::default()
        },
        ..RouteUpdate::default()
    };
    let seen = store.route(&route()).await.unwrap().unwrap().edition();
    let id = route();
    let (one, other) = tokio::join!(
        store.put_route(&id, hold, by(), at(1)),
        store.put_route(&id, rate(0.5, None), by(), at(1)),
    );
    assert_eq!([one.unwrap(), other.unwrap()], [Put::Updated; 2]);
    let now = store.route(&route()).await.unwrap().unwrap();
    assert_eq!(
        (now.settings.hold_s, now.settings.false_alarm_rate),
        (7, 0.5)
    );

    let late = store
        .put_route(&route(), rate(0.1, Some(seen)), by(), at(2))
        .await;
    assert_eq!(late.unwrap(), Put::Stale);
    let in_time = rate(0.2, Some(now.edition()));
    let in_time = store.put_route(&route(), in_time, by(), at(2)).await;
    assert_eq!(in_time.unwrap(), Put::Updated);
    let none = RouteId::new("none").unwrap();
    let put = store
        .put_route(&none, rate(0.1, Some(seen)), by(), at(2))
        .await;
    assert_eq!(put.unwrap(), Put::Stale);

    fixture.journal(upload("b", "t", 0)).await;
    let seed = RouteUpdate {
        settings: SettingsUpdate {
            detector: Some(mapshift::model::Detector::Seed),
            ..SettingsUpdate::default()
        },
        ..RouteUpdate::default()
    };
    let put = store.put_route(&route(), seed, by(), at(3)).await;
    assert_eq!(put.unwrap(), Put::DetectorFixed);
}
