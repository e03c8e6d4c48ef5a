//! The migrations of the schema, as the binary carries them.

use std::sync::LazyLock;

use sqlx::SqlSafeStr;
use sqlx::migrate::{Migration, MigrationType, Migrator};

/// A file of `migrations/`: its number, the words of its name, its text.
macro_rules! file {
    ($version:literal, $description:literal, $name:literal) => {
        (
            $version,
            $description,
            include_str!(concat!("../../migrations/", $name)),
        )
    };
}

/// Every file of `migrations/`. Listed by hand, because `sqlx::migrate!` needs sqlx and SQLite
/// compiled a second time, for the compiler itself.
const FILES: [(i64, &str, &str); 36] = [
    file!(1, "journal", "0001_journal.sql"),
    file!(2, "graph", "0002_graph.sql"),
    file!(3, "alerts", "0003_alerts.sql"),
    file!(4, "settled", "0004_settled.sql"),
    file!(5, "webhooks", "0005_webhooks.sql"),
    file!(6, "edge batches", "0006_edge_batches.sql"),
    file!(
        7,
        "edges without residual",
        "0007_edges_without_residual.sql"
    ),
    file!(8, "alert tiers", "0008_alert_tiers.sql"),
    file!(9, "false alerts per lap", "0009_false_alerts_per_lap.sql"),
    file!(10, "intermediate scans", "0010_intermediate_scans.sql"),
    file!(11, "alert shift", "0011_alert_shift.sql"),
    file!(12, "trip calibrations", "0012_trip_calibrations.sql"),
    file!(13, "node sigma", "0013_node_sigma.sql"),
    file!(14, "lidars", "0014_lidars.sql"),
    file!(15, "alert bands", "0015_alert_bands.sql"),
    file!(16, "corrections", "0016_corrections.sql"),
    file!(17, "open enumerations", "0017_open_enumerations.sql"),
    file!(18, "archive", "0018_archive.sql"),
    file!(19, "max shift", "0019_max_shift.sql"),
    file!(20, "lost processes", "0020_lost_processes.sql"),
    file!(21, "operations", "0021_operations.sql"),
    file!(22, "vehicle quarantines", "0022_vehicle_quarantines.sql"),
    file!(23, "audit", "0023_audit.sql"),
    file!(24, "trip clocks", "0024_trip_clocks.sql"),
    file!(25, "inputs", "0025_inputs.sql"),
    file!(26, "decision revisions", "0026_decision_revisions.sql"),
    file!(27, "access", "0027_access.sql"),
    file!(28, "alert passes", "0028_alert_passes.sql"),
    file!(29, "deciding", "0029_deciding.sql"),
    file!(30, "releases", "0030_releases.sql"),
    file!(31, "uploads", "0031_uploads.sql"),
    file!(32, "recordings", "0032_recordings.sql"),
    file!(33, "notifications", "0033_notifications.sql"),
    file!(34, "clock faults", "0034_clock_faults.sql"),
    file!(35, "name retention", "0035_name_retention.sql"),
    file!(36, "rebuilds", "0036_rebuilds.sql"),
];

/// The number of the newest migration.
pub(super) fn newest_schema() -> i64 {
    let versions = FILES.iter().map(|(version, ..)| *version);
    versions.max().unwrap_or_default()
}

/// Runs what a database has not seen yet.
pub(super) static MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| {
    let migration = |&(version, description, sql): &(i64, &'static str, &'static str)| {
        let sql = sql.into_sql_str();
        Migration::new(
            version,
            description.into(),
            MigrationType::Simple,
            sql,
            false,
        )
    };
    Migrator::with_migrations(FILES.iter().map(migration).collect())
});

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[tokio::test]
    async fn every_file_is_listed_as_sqlx_reads_it() {
        let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations");
        let read = Migrator::new(directory).await.unwrap();
        let fields = |m: &Migration| {
            let Migration {
                version,
                description,
                migration_type,
                sql,
                checksum,
                no_tx,
            } = m.clone();
            let sql = sql.as_str().to_owned();
            (version, description, migration_type, sql, checksum, no_tx)
        };
        let listed: Vec<_> = MIGRATIONS.iter().map(fields).collect();
        assert_eq!(listed, read.iter().map(fields).collect::<Vec<_>>());
    }
}
