//! Databases of earlier versions, brought up to date with what is in them.

use std::collections::BTreeMap;

use sqlx::AssertSqlSafe;

use super::*;

/// The last migration before enumerations in columns were opened.
const CLOSED_ENUMERATIONS: i64 = 16;

/// A row and more in every table, as the versions before wrote them. Keys of rows that are gone are
/// above those that are left.
const ROWS: &str = r#"
    INSERT INTO routes VALUES
        (1, 'line-4', 'Line 4', 47.5, 19.0, 90.0, 'fused', 600, 'monitoring', 2, 2, 7, 4, 3, 4, 400, 1,
         3, 2, 1, 1, 10, 20, 1, 15, 'a2', 'accept', 0.02),
        (2, 'line-5', NULL, NULL, NULL, NULL, 'seed', 60, 'mapping', 1, 1, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0,
         11, 21, 0, NULL, NULL, NULL, 0.01),
        (9, 'gone', NULL, NULL, NULL, NULL, 'seed', 60, 'mapping', 1, 1, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0,
         11, 21, 0, NULL, NULL, NULL, 0.01);
    DELETE FROM routes WHERE route_key = 9;
    INSERT INTO trips VALUES (1, 'trip', 'bus', 4, '[]'), (1, 'edges', 'bus', 1, NULL);
    INSERT INTO batches VALUES
        (1, 1, 'b1', 'bus', 'trip', 0, 'merged', NULL, '["late"]', 100, 3, 1, NULL, zeroblob(32), 9, 1,
         2, 0, 'scans'),
        (2, 1, 'b2', 'bus', 'trip', 1, 'processing', NULL, '[]', 100, 0, 0, NULL, zeroblob(32), 9, 1,
         NULL, 1, 'scans'),
        (3, 1, 'b3', 'bus', 'trip', 3, 'held', NULL, '[]', 100, 0, 0, NULL, zeroblob(32), 9, 1, NULL, 1,
         'scans'),
        (4, 1, 'b4', 'bus', 'edges', 0, 'unanchored', 'why', '[]', 0, 0, 0, 3, zeroblob(32), 9, 1, 2, 1,
         'edges'),
        (8, 1, 'b8', 'bus', 'trip', 9, 'quarantined', 'why', '[]', 0, 0, 0, 3, zeroblob(32), 9, 1, 2, 1,
         'scans');
    DELETE FROM batches WHERE batch_key = 8;
    INSERT INTO batch_bodies VALUES (2, x'01'), (3, x'02'), (4, x'03');
    INSERT INTO jobs VALUES (1, 2, 1, 'trip', 1, 'running', 1, 1, 0, 0, 99);
    INSERT INTO nodes VALUES
        (1, 1, 1, 5, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 0.0, 1, 1, 1, 0, NULL, 0.1, 0.1, 0.01),
        (1, 2, 1, 6, 1.1, 0.2, 0.3, 1.0, 2.0, 3.0, 0.5, 0, 1, 1, 1, NULL, NULL, NULL, NULL),
        (1, 3, 4, 7, 2.1, 0.2, 0.3, 1.0, 2.0, 3.0, 0.5, 0, 0, NULL, 0, 'n0', NULL, NULL, NULL);
    INSERT INTO node_scans VALUES
        (1, 1, x'aa', zeroblob(32), NULL), (1, 2, x'bb', zeroblob(32), 'top');
    INSERT INTO intermediate_scans VALUES
        (1, 1, 0, 5, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, NULL, NULL, NULL, 0);
    INSERT INTO edges VALUES
        (1, 1, 1, 2, 'odometry', 'active', 1, 1.0, 0.0, 0.1, 9.0, 0.1, 0.2, 8.0, 0.3, 7.0, 1, NULL),
        (1, 2, 2, 1, 'loop_closure', 'active', 1, 1.0, 0.0, 0.1, 9.0, 0.1, 0.2, 8.0, 0.3, 7.0, 1, 0.25),
        (1, 3, 1, 3, 'loop_closure', 'retired', 4, 1.0, 0.0, 0.1, 9.0, 0.1, 0.2, 8.0, 0.3, 7.0, NULL,
         0.5);
    INSERT INTO closures VALUES
        (1, 2, 1.0, 0.0, 0.1, 9.0, 0.1, 0.2, 8.0, 0.3, 7.0, 0.9, 0.8, 0.01, 0.3);
    INSERT INTO alerts VALUES
        (1, 1, '00000000-0000-7000-8000-000000000001', 3, 'appeared', 'open', 0.9, 1.0, 2.0, 0.1,
         zeroblob(48), '[2]', '[1,2]', '["trip"]', '["bus"]', 4, 2, 5, 6, 7, NULL, 2, 0.25, 0.1, 2.5,
         0.001, 1, 1, '[]', 8, 9, 'confirmed', 2, 'disappeared', zeroblob(48), 0.1, 0.2, '[[0.1,0.3]]',
         NULL),
        (2, 1, '00000000-0000-7000-8000-000000000002', 1, 'vehicle_suspect', 'accepted', 0.9, 1.0, 2.0,
         0.1, zeroblob(0), '[]', '[]', '[]', '[]', 0, 0, 5, 6, 7, 8, NULL, NULL, NULL, NULL, NULL, NULL,
         1, '[]', 8, 9, 'tentative', NULL, NULL, NULL, NULL, NULL, '[]', '{}'),
        (7, 1, '00000000-0000-7000-8000-000000000007', 1, 'residual', 'dismissed', 0.9, 1.0, 2.0, 0.1,
         zeroblob(0), '[]', '[]', '[]', '[]', 0, 0, 5, 6, 7, 8, NULL, NULL, NULL, NULL, NULL, NULL, 1,
         '[]', 8, 9, 'tentative', NULL, NULL, NULL, NULL, NULL, '[]', NULL);
    DELETE FROM alerts WHERE alert_key = 7;
    INSERT INTO alert_history VALUES
        (1, 0, 'open', 8, 'system', NULL), (2, 0, 'open', 8, 'system', NULL),
        (2, 1, 'accepted', 9, 'anna', 'a door');
    INSERT INTO alert_batches VALUES (1, 1), (2, 1);
    INSERT INTO alert_events VALUES (1, 1, 1, 8), (2, 2, 1, 9);
    INSERT INTO accepted_changes VALUES (2, 1, zeroblob(48), 6, 2, '[1]', 3, x'00', 1, zeroblob(32));
    INSERT INTO map_versions VALUES
        (1, 1, 1, 10, 20, NULL, NULL, x'01', x'02', 3, zeroblob(32), 'yaml'),
        (1, 2, 2, 20, 30, 'a2', 'accept', x'01', x'02', 3, zeroblob(32), 'yaml');
    INSERT INTO webhooks VALUES
        (1, '00000000-0000-7000-8000-00000000000a', 1, 'https://example.com', zeroblob(32),
         '["alert.raised"]', NULL, NULL, 1, NULL, 1, 2, 1);
    INSERT INTO webhook_deliveries VALUES
        (1, 1, 'm1', 'alert.raised', 1, 1, 1, 8, 'delivered', 1, 9, NULL, 204, NULL),
        (2, 1, 'm2', 'webhook.test', NULL, NULL, NULL, 8, 'pending', 1, 9, 10, NULL, 'timeout'),
        (6, 1, 'm6', 'alert.updated', 2, 2, 1, 8, 'failed', 1, 9, NULL, 500, NULL);
    DELETE FROM webhook_deliveries WHERE delivery_key = 6;
    INSERT INTO lidar_calibrations VALUES (1, 'trip', '', 'bus', 5, 150, '{}', NULL);
"#;

/// Texts that this version does not know, one in each column that was closed.
const NOVEL: &str = "
    UPDATE routes SET detector = 'novel', stage = 'novel', version_action = 'novel';
    UPDATE batches SET kind = 'novel', status = 'novel';
    UPDATE edges SET kind = 'novel', status = 'novel';
    UPDATE alerts SET kind = 'novel', status = 'novel';
    UPDATE alert_history SET status = 'novel';
    UPDATE map_versions SET cause_action = 'novel' WHERE version = 2;
    UPDATE webhook_deliveries SET event = 'novel', failure = 'novel' WHERE delivery_key = 2;
    UPDATE webhook_deliveries SET status = 'novel' WHERE delivery_key = 1;
";

async fn texts(writer: &mut SqliteConnection, query: impl Into<String>) -> Vec<String> {
    sqlx::query_scalar(AssertSqlSafe(query.into()))
        .fetch_all(writer)
        .await
        .unwrap()
}

/// The columns of every table, by name.
async fn columns(writer: &mut SqliteConnection) -> BTreeMap<String, Vec<String>> {
    let tables =
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND name <> '_sqlx_migrations'";
    let mut columns = BTreeMap::new();
    for table in texts(writer, tables).await {
        let names = format!("SELECT name FROM pragma_table_info('{table}') ORDER BY name");
        let names = texts(writer, names).await;
        columns.insert(table, names);
    }
    columns
}

/// What every row of these tables has in these columns, and the definition of every index.
async fn contents(
    writer: &mut SqliteConnection,
    columns: &BTreeMap<String, Vec<String>>,
) -> BTreeMap<String, Vec<String>> {
    let mut contents = BTreeMap::new();
    for (table, columns) in columns {
        let quoted: Vec<_> = columns
            .iter()
            .map(|column| format!("' {column}=' || quote({column})"))
            .collect();
        let rows = format!("SELECT {} FROM {table} ORDER BY 1", quoted.join(" || "));
        let rows = texts(writer, rows).await;
        contents.insert(table.clone(), rows);
    }
    let indices = "SELECT name || ' of ' || tbl_name || ': ' || coalesce(sql, '') \
                   FROM sqlite_schema WHERE type = 'index' ORDER BY 1";
    let indices = texts(writer, indices).await;
    contents.insert("indices".to_owned(), indices);
    contents
}

/// Makes a database of the version before with [`ROWS`].
async fn older(writer: &mut SqliteConnection) {
    let migrated = MIGRATIONS.run_to(CLOSED_ENUMERATIONS, &mut *writer);
    migrated.await.unwrap();
    sqlx::raw_sql(ROWS).execute(&mut *writer).await.unwrap();
}

#[tokio::test]
async fn tables_are_rebuilt_with_all_that_is_in_them_and_refers_to_them() {
    let directory = tempfile::tempdir().unwrap();
    let database = Database::in_directory(directory.path());
    let mut writer = database.open_writer().await.unwrap();
    older(&mut writer).await;
    let older_columns = columns(&mut writer).await;
    let before = contents(&mut writer, &older_columns).await;
    let empty: Vec<_> = before.iter().filter(|(_, rows)| rows.is_empty()).collect();
    assert!(empty.is_empty(), "nothing is tested of {empty:?}");
    let refused = sqlx::raw_sql("UPDATE edges SET kind = 'novel'");
    assert!(refused.execute(&mut writer).await.is_err());

    database.migrate(&mut writer).await.unwrap();
    let after = contents(&mut writer, &older_columns).await;
    for (table, rows) in &before {
        let mut left = after[table].clone();
        // Later migrations add indices, and tables with keys of their own.
        let may_grow = ["indices", "sqlite_sequence"].contains(&table.as_str());
        left.retain(|row| !may_grow || rows.contains(row));
        assert_eq!(left, *rows, "{table}");
    }

    sqlx::raw_sql(NOVEL).execute(&mut writer).await.unwrap();
    let astray = sqlx::raw_sql("UPDATE edges SET from_node = 77");
    assert!(astray.execute(&mut writer).await.is_err());
    let gone = sqlx::raw_sql("DELETE FROM routes");
    gone.execute(&mut writer).await.unwrap();
    let columns = columns(&mut writer).await;
    for (table, rows) in contents(&mut writer, &columns).await {
        let stays = [
            "commits",
            "indices",
            "sqlite_sequence",
            "webhook_deliveries",
            "webhooks",
        ];
        assert_eq!(rows.is_empty(), !stays.contains(&table.as_str()), "{table}");
    }
}

#[tokio::test]
async fn nothing_is_rebuilt_while_foreign_keys_are_enforced() {
    let directory = tempfile::tempdir().unwrap();
    let database = Database::in_directory(directory.path());
    let mut writer = database.open_writer().await.unwrap();
    older(&mut writer).await;
    let columns = columns(&mut writer).await;
    let before = contents(&mut writer, &columns).await;
    let error = MIGRATIONS.run(&mut writer).await.unwrap_err();
    assert!(format!("{error:?}").contains("CHECK"), "{error:?}");
    assert_eq!(contents(&mut writer, &columns).await, before);
}

/// The last migration before names had a retention.
const NAMES_FOR_EVER: i64 = 34;

#[tokio::test]
async fn when_somebody_was_assigned_is_read_from_the_audit() {
    let directory = tempfile::tempdir().unwrap();
    let database = Database::in_directory(directory.path());
    let mut writer = database.open_writer().await.unwrap();
    older(&mut writer).await;
    set(&mut writer, "PRAGMA foreign_keys = OFF").await.unwrap();
    let before = MIGRATIONS.run_to(NAMES_FOR_EVER, &mut writer);
    before.await.unwrap();
    // Of the assignee of the first the audit knows, of that of the second it does not; the third has none.
    let handled = "
        INSERT INTO alerts (alert_key, route_key, id, revision, kind, status, confidence, x, y, sigma_m,
            region, edges, nodes, trips, vehicles, views, laps, first_seen_ns, since_ns, last_seen_ns,
            map_version, related, raised_at_us, updated_at_us)
        SELECT 20, route_key, '00000000-0000-7000-8000-000000000020', 1, kind, status, confidence, x, y,
            sigma_m, region, edges, nodes, trips, vehicles, views, laps, first_seen_ns, since_ns,
            last_seen_ns, map_version, related, raised_at_us, updated_at_us FROM alerts WHERE alert_key = 1;
        INSERT INTO alert_handling (alert_key, assignee) VALUES (1, 'anna'), (2, 'anna'), (20, NULL);
        INSERT INTO audit (at_us, actor, address, action, subject) VALUES
            (30, 'kim', '192.0.2.7', 'alert.assigned', '00000000-0000-7000-8000-000000000001'),
            (40, 'kim', '192.0.2.7', 'alert.assigned', '00000000-0000-7000-8000-000000000001'),
            (50, 'kim', '192.0.2.7', 'alert.commented', '00000000-0000-7000-8000-000000000001'),
            (60, 'kim', '192.0.2.7', 'alert.assigned', '00000000-0000-7000-8000-000000000020');";
    sqlx::raw_sql(handled).execute(&mut writer).await.unwrap();
    database.migrate(&mut writer).await.unwrap();
    let assigned: Vec<Option<i64>> =
        sqlx::query_scalar("SELECT assigned_at_us FROM alert_handling ORDER BY alert_key")
            .fetch_all(&mut writer)
            .await
            .unwrap();
    // An alert that the audit does not know last changed at 9.
    assert_eq!(assigned, [Some(40), Some(9), None]);
}
