//! Where something is written in a database, whatever its tables are.

use std::collections::BTreeSet;

use sqlx::{AssertSqlSafe, SqliteConnection};

/// The columns, as `table.column`, of which some row holds a text, alone or within another.
pub async fn columns_with(database: &mut SqliteConnection, text: &str) -> BTreeSet<String> {
    let columns: Vec<(String, String)> = sqlx::query_as(
        "SELECT tables.name, columns.name FROM sqlite_schema AS tables, \
         pragma_table_info(tables.name) AS columns WHERE tables.type = 'table'",
    )
    .fetch_all(&mut *database)
    .await
    .unwrap();
    let mut found = BTreeSet::new();
    for (table, column) in columns {
        let statement = format!(
            "SELECT EXISTS (SELECT 1 FROM \"{table}\" \
             WHERE instr(CAST(\"{column}\" AS BLOB), CAST($1 AS BLOB)) > 0)"
        );
        // Made of names of the schema.
        let is_there: bool = sqlx::query_scalar(AssertSqlSafe(statement))
            .bind(text)
            .fetch_one(&mut *database)
            .await
            .unwrap();
        if is_there {
            found.insert(format!("{table}.{column}"));
        }
    }
    found
}
