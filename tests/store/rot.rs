//! What is not what was written: found where it is read, and by a check of the whole database.
//!
//! With SQL past the store, for SQLite: bits that flip in the file.

use mapshift::model::BatchStatus;
use mapshift::store::{Fault, FsckReport, Store, StoreError, fsck};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, SqliteConnection};

use crate::settled::settled;
use crate::support::{Fixture, intermediate, put_route, route, upload};

/// What never changes of a row, but for its keys.
const COVERED: [(&str, &[&str]); 3] = [
    (
        "nodes",
        &[
            "batch_key",
            "stamp_ns",
            "odom_x",
            "odom_y",
            "odom_theta",
            "trip_order",
        ],
    ),
    (
        "edges",
        &[
            "batch_key",
            "from_node",
            "to_node",
            "x",
            "y",
            "theta",
            "info_xx",
            "info_xy",
            "info_xt",
            "info_yy",
            "info_yt",
            "info_tt",
            "delta_f",
            "checksum",
        ],
    ),
    (
        "closures",
        &[
            "x",
            "y",
            "theta",
            "info_xx",
            "info_xy",
            "info_xt",
            "info_yy",
            "info_yt",
            "info_tt",
            "overlap",
            "inlier_share",
            "rmse_m",
            "all_points_residual",
        ],
    ),
];

async fn check(fixture: &Fixture) -> FsckReport {
    let report = fsck(fixture.directory.path(), true, &|_, _| {});
    let report = report.await.unwrap();
    assert_eq!(report.sound, report.faults.is_empty());
    report
}

/// What is wrong, without the laws that say so.
async fn faults(fixture: &Fixture) -> Vec<String> {
    let faults = check(fixture).await.faults.into_iter();
    faults.map(|Fault { what, .. }| what).collect()
}

/// A connection for which no row has to be what another one says.
async fn lawless(fixture: &Fixture) -> SqliteConnection {
    let options =
        SqliteConnectOptions::new().filename(fixture.directory.path().join("mapshift.db"));
    options.foreign_keys(false).connect().await.unwrap()
}

async fn execute(connection: &mut SqliteConnection, statement: String) {
    let done = sqlx::query(AssertSqlSafe(statement)).execute(connection);
    assert_eq!(done.await.unwrap().rows_affected(), 1);
}

/// Flips a bit of a number, or flips it back: the last one of a real number, and of an integer the
/// last two, so that it is still the key of something.
async fn flip(connection: &mut SqliteConnection, (table, column, key): (&str, &str, &str)) {
    let read = |kind: &str| {
        AssertSqlSafe(format!(
            "SELECT {column} FROM {table} WHERE {key} AND typeof({column}) = '{kind}'"
        ))
    };
    let real: Option<f64> = sqlx::query_scalar(read("real"))
        .fetch_optional(&mut *connection)
        .await
        .unwrap();
    let write = AssertSqlSafe(format!("UPDATE {table} SET {column} = ? WHERE {key}"));
    let write = match real {
        Some(real) => sqlx::query(write).bind(f64::from_bits(real.to_bits() ^ 1)),
        None => {
            let integer = sqlx::query_scalar(read("integer"));
            let integer: i64 = integer.fetch_one(&mut *connection).await.unwrap();
            sqlx::query(write).bind(integer ^ 3)
        }
    };
    assert_eq!(write.execute(connection).await.unwrap().rows_affected(), 1);
}

async fn read_all(store: &Store) -> Result<(), StoreError> {
    store.nodes(&route()).await?;
    store.edges(&route()).await?;
    Ok(())
}

#[tokio::test]
async fn a_flipped_bit_of_a_row_is_found_wherever_it_is() {
    let fixture = settled().await;
    let mut raw = lawless(&fixture).await;
    assert_eq!(faults(&fixture).await, [] as [&str; 0]);
    for (table, columns) in COVERED {
        // Both have left the map.
        let (key, name) = match table {
            "nodes" => ("node_id = 9", "node 9"),
            _ => ("edge_id = 103", "edge 103"),
        };
        for column in columns {
            flip(&mut raw, (table, column, key)).await;
            let read = read_all(&fixture.store).await;
            let Err(StoreError::Corrupt(what)) = read else {
                panic!("{table}.{column}: {read:?}");
            };
            assert_eq!(what.to_string(), name, "{table}.{column}");
            let found = faults(&fixture).await;
            let expected = format!("{name} of route r");
            assert!(found.contains(&expected), "{table}.{column}: {found:?}");
            flip(&mut raw, (table, column, key)).await;
            read_all(&fixture.store).await.unwrap();
        }
    }
    assert_eq!(faults(&fixture).await, [] as [&str; 0]);
    for (statement, name) in [
        (
            "UPDATE edges SET kind = 'odometry' WHERE edge_id = 103",
            "edge 103",
        ),
        (
            "UPDATE nodes SET client_id = 'another' WHERE node_id = 9",
            "node 9",
        ),
    ] {
        execute(&mut raw, statement.to_owned()).await;
        assert!(
            faults(&fixture)
                .await
                .contains(&format!("{name} of route r"))
        );
    }
}

#[tokio::test]
async fn one_route_that_is_corrupt_is_loaded_no_more_and_others_are() {
    let fixture = settled().await;
    put_route(&fixture.store, "other").await;
    let mut raw = lawless(&fixture).await;
    flip(&mut raw, ("edges", "x", "edge_id = 101")).await;
    let loaded = fixture.store.load_graph(&route()).await.map(drop);
    assert_eq!(
        loaded.unwrap_err().to_string(),
        "edge 101 is corrupt on the disk"
    );
    let other = mapshift::ids::RouteId::new("other").unwrap();
    assert!(fixture.store.load_graph(&other).await.unwrap().is_some());
}

#[tokio::test]
async fn rows_from_before_there_were_checksums_are_read_as_they_are() {
    let fixture = settled().await;
    let mut raw = lawless(&fixture).await;
    for table in ["nodes", "edges"] {
        let forget = format!("UPDATE {table} SET checksum = NULL");
        sqlx::query(AssertSqlSafe(forget))
            .execute(&mut raw)
            .await
            .unwrap();
    }
    flip(&mut raw, ("edges", "x", "edge_id = 103")).await;
    read_all(&fixture.store).await.unwrap();
    assert!(check(&fixture).await.sound);
}

#[tokio::test]
async fn everything_that_is_corrupt_is_named_at_once() {
    let fixture = settled().await;
    fixture.journal(upload("b2", "new", 1)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.result(&job, BatchStatus::Merged).await;
    result.intermediate = vec![intermediate(15, 0)];
    fixture.store.apply_result(result).await.unwrap();
    let sound = check(&fixture).await;
    assert!(sound.sound, "{:?}", sound.faults);
    assert_eq!(
        (sound.routes, sound.batches, sound.nodes, sound.edges),
        (1, 3, 15, 18)
    );

    let mut raw = lawless(&fixture).await;
    for statement in [
        "UPDATE batch_bodies SET body = x'00' WHERE batch_key = 2",
        "UPDATE node_scans SET scan = x'00' WHERE node_id = 5",
        "UPDATE intermediate_scans SET scan = x'00' WHERE node_id = 15",
        "UPDATE nodes SET odom_x = 7 WHERE node_id = 6",
        "UPDATE nodes SET stamp_ns = 7 WHERE node_id = 7",
        "UPDATE edges SET x = 7 WHERE edge_id = 4",
        "UPDATE closures SET overlap = 0.25 WHERE edge_id = 105",
    ] {
        execute(&mut raw, statement.to_owned()).await;
    }
    let named = [
        "the body of batch b1 of route r",
        "the scan of node 5 of route r",
        "node 6 of route r",
        "node 7 of route r",
        "the scan of node 15 of route r",
        "edge 4 of route r",
        "edge 105 of route r",
    ];
    assert_eq!(faults(&fixture).await, named);
}

/// SQLite does not keep it.
#[tokio::test]
async fn the_sign_of_a_zero_is_no_fault() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.chain(&job, 2).await;
    result.nodes[0].node.odom_from_base.x = -0.0;
    result.edges[0].measurement.y = -0.0;
    fixture.store.apply_result(result).await.unwrap();
    read_all(&fixture.store).await.unwrap();
}

#[tokio::test]
async fn laws_are_checked() {
    for (statement, law) in [
        (
            "DELETE FROM nodes WHERE node_id = 12",
            "what a row refers to is there",
        ),
        ("DELETE FROM jobs", "a batch has a job"),
        (
            "UPDATE batches SET status = 'merged' WHERE id = 'b2'",
            "a batch has a job",
        ),
        (
            "UPDATE batches SET nodes_added = 9 WHERE id = 'b0'",
            "a merged batch has as many nodes",
        ),
        (
            "UPDATE routes SET edges = edges + 1",
            "a route has as many rows as it says",
        ),
        (
            "UPDATE nodes SET active = 1 WHERE node_id = 9",
            "the sums over what has left",
        ),
        (
            "UPDATE routes SET map_version = 2",
            "a map has a picture of each version",
        ),
        (
            "UPDATE commits SET count = count - 1",
            "every commit is there",
        ),
    ] {
        let fixture = settled().await;
        fixture.journal(upload("b2", "new", 1)).await;
        assert!(check(&fixture).await.sound);
        execute(&mut lawless(&fixture).await, statement.to_owned()).await;
        let faults = check(&fixture).await.faults;
        let broken = |fault: &Fault| fault.law.starts_with(law);
        assert!(faults.iter().any(broken), "{statement}: {faults:?}");
    }
}

/// Pages that SQLite itself finds corrupt.
#[tokio::test]
async fn what_cannot_be_read_is_a_fault_and_the_rest_is_checked() {
    let fixture = settled().await;
    let Fixture { store, directory } = fixture;
    store.close().await.unwrap();
    let path = directory.path().join("mapshift.db");
    let options = SqliteConnectOptions::new().filename(&path);
    let mut raw = options.connect().await.unwrap();
    let root: i64 =
        sqlx::query_scalar("SELECT rootpage FROM sqlite_schema WHERE name = 'closures'")
            .fetch_one(&mut raw)
            .await
            .unwrap();
    sqlx::Connection::close(raw).await.unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let from = 4096 * (root as usize - 1);
    bytes[from..from + 64].fill(0xff);
    std::fs::write(&path, bytes).unwrap();
    let report = fsck(directory.path(), false, &|_, _| {}).await.unwrap();
    assert!(!report.sound);
    let unread = report
        .faults
        .iter()
        .find(|fault| fault.what == "route r: the database");
    assert!(unread.is_some(), "{:?}", report.faults);
    assert_eq!((report.batches, report.nodes, report.edges), (2, 15, 0));
}

#[tokio::test]
async fn no_database_and_one_of_an_older_version_are_not_checked() {
    let directory = tempfile::tempdir().unwrap();
    assert!(fsck(directory.path(), false, &|_, _| {}).await.is_err());
    assert!(
        std::fs::read_dir(directory.path())
            .unwrap()
            .next()
            .is_none()
    );
    let fixture = Fixture::new().await;
    execute(
        &mut fixture.raw().await,
        "DELETE FROM _sqlx_migrations WHERE version = (SELECT max(version) FROM _sqlx_migrations)"
            .to_owned(),
    )
    .await;
    let refused = fsck(fixture.directory.path(), false, &|_, _| {}).await;
    assert!(matches!(refused, Err(StoreError::OldSchema)), "{refused:?}");
}
