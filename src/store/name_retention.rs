//! Replacing the names of people, and their addresses, that were written long ago.
//!
//! A step has one moment for all tables: what was written until then is redacted, wherever it stands, and nothing
//! after it. So the journal of inputs and what follows from it never differ in a name.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::micros;
use super::error::StoreError;
use super::request::Request;

/// Rows of one table in a step: other writes wait as long as it takes.
const STEP_MAX: i64 = 256;
/// The row of a version holds the picture of its map, which is written again with it.
const VERSIONS_MAX: i64 = 1;

impl Store {
    /// Replaces the names and addresses of people that were written before a time, of the oldest few rows, by
    /// `redacted`; returns how many rows that were, 0 if none is left. Names that are still needed stay: those of
    /// keys that are valid, of who sees to a pending alert, and of operations that have not ended.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn redact_names(&self, before: Timestamp) -> Result<u64, StoreError> {
        self.work(RedactNames { before }).await
    }
}

/// Where names are.
struct Place {
    /// Most rows of one step.
    step_max: i64,
    /// When the row was written that has $2 older ones before it, of those with names written before $1.
    written: &'static str,
    /// Redacts what was written until $1.
    redact: &'static str,
}

/// That a column holds the name of a person.
macro_rules! is_name {
    ($column:literal) => {
        concat!($column, " NOT IN ('system', 'local', 'redacted')")
    };
}

/// Path and new value of a name in JSON, for `json_replace`; where there is none, nothing changes.
macro_rules! redacted {
    ($json:literal, $path:literal) => {
        concat!(
            "'",
            $path,
            "', iif(coalesce(json_extract(",
            $json,
            ", '",
            $path,
            "'), 'system') IN ('system', 'local'), json_extract(",
            $json,
            ", '",
            $path,
            "'), 'redacted')"
        )
    };
}

/// What the audit has of something before or after a change, without names.
macro_rules! redacted_state {
    ($column:literal) => {
        concat!(
            $column,
            " = json_replace(",
            $column,
            ", ",
            redacted!($column, "$.by"),
            ", ",
            redacted!($column, "$.assignee"),
            ", ",
            redacted!($column, "$.name"),
            ")"
        )
    };
}

macro_rules! written {
    ($table:literal, $time:literal, $condition:expr) => {
        concat!(
            "SELECT ",
            $time,
            " FROM ",
            $table,
            " WHERE ",
            $condition,
            " AND ",
            $time,
            " < $1 ORDER BY ",
            $time,
            " LIMIT 1 OFFSET $2"
        )
    };
}

macro_rules! redact {
    ($table:literal, $time:literal, $condition:expr, $set:expr) => {
        concat!(
            "UPDATE ", $table, " SET ", $set, " WHERE ", $condition, " AND ", $time, " <= $1"
        )
    };
}

/// An assignee of an alert that nobody has to decide about any more.
macro_rules! is_past_assignee {
    () => {
        concat!(
            is_name!("assignee"),
            " AND (SELECT status FROM alerts WHERE alerts.alert_key = alert_handling.alert_key) \
             NOT IN ('open', 'acknowledged')"
        )
    };
}

/// An entry that says who decided or released.
macro_rules! is_named_input {
    () => {
        "coalesce(json_extract(input, '$.decision.by'), json_extract(input, '$.version_released.by'), \
         json_extract(input, '$.accepted_together.alerts[0].by')) NOT IN ('system', 'local', 'redacted')"
    };
}

/// Decisions that were carried out; removals name nobody.
macro_rules! is_named_operation {
    () => {
        "ended_at_us IS NOT NULL AND json_extract(request, '$.actor.address') <> 'redacted'"
    };
}

/// When a key ended or ends: the earlier of its revocation and its expiry.
macro_rules! key_end {
    () => {
        "min(coalesce(revoked_at_us, expires_at_us), coalesce(expires_at_us, revoked_at_us))"
    };
}

const PLACES: [Place; 12] = [
    Place {
        step_max: STEP_MAX,
        written: written!(
            "alert_history INDEXED BY alert_history_with_names",
            "at_us",
            is_name!("by_whom")
        ),
        redact: redact!(
            "alert_history INDEXED BY alert_history_with_names",
            "at_us",
            is_name!("by_whom"),
            "by_whom = 'redacted'"
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!(
            "alert_comments INDEXED BY alert_comments_with_names",
            "at_us",
            is_name!("by_whom")
        ),
        redact: redact!(
            "alert_comments INDEXED BY alert_comments_with_names",
            "at_us",
            is_name!("by_whom"),
            "by_whom = 'redacted'"
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!(
            "alert_handling INDEXED BY alert_handling_with_names",
            "assigned_at_us",
            is_past_assignee!()
        ),
        redact: redact!(
            "alert_handling INDEXED BY alert_handling_with_names",
            "assigned_at_us",
            is_past_assignee!(),
            "assignee = 'redacted'"
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!("routes", "version_created_at_us", is_name!("version_by")),
        redact: redact!(
            "routes",
            "version_created_at_us",
            is_name!("version_by"),
            "version_by = 'redacted'"
        ),
    },
    Place {
        step_max: VERSIONS_MAX,
        written: written!(
            "map_versions INDEXED BY map_versions_with_causes",
            "created_at_us",
            is_name!("cause_by")
        ),
        redact: redact!(
            "map_versions INDEXED BY map_versions_with_causes",
            "created_at_us",
            is_name!("cause_by"),
            "cause_by = 'redacted'"
        ),
    },
    Place {
        step_max: VERSIONS_MAX,
        written: written!(
            "map_versions INDEXED BY map_versions_with_releases",
            "released_at_us",
            is_name!("released_by")
        ),
        redact: redact!(
            "map_versions INDEXED BY map_versions_with_releases",
            "released_at_us",
            is_name!("released_by"),
            "released_by = 'redacted'"
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!(
            "audit INDEXED BY audit_with_names",
            "at_us",
            "address <> 'redacted'"
        ),
        // The id of a key would lead to its name while it is there.
        redact: redact!(
            "audit INDEXED BY audit_with_names",
            "at_us",
            "address <> 'redacted'",
            concat!(
                "actor = iif(actor = 'local', actor, 'redacted'), address = 'redacted', key_id = NULL, ",
                redacted_state!("before"),
                ", ",
                redacted_state!("after")
            )
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!(
            "inputs INDEXED BY inputs_with_names",
            "at_us",
            is_named_input!()
        ),
        redact: redact!(
            "inputs INDEXED BY inputs_with_names",
            "at_us",
            is_named_input!(),
            concat!(
                "input = json_replace(input, ",
                redacted!("input", "$.decision.by"),
                ", ",
                redacted!("input", "$.version_released.by"),
                ", '$.accepted_together.alerts', json((SELECT json_group_array( \
                     json(json_replace(value, ",
                redacted!("value", "$.by"),
                ")) ORDER BY key) FROM json_each(input, '$.accepted_together.alerts'))))"
            )
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!(
            "operations INDEXED BY operations_with_names",
            "asked_at_us",
            is_named_operation!()
        ),
        // A refusal says who has decided before: what follows that name goes with it.
        redact: redact!(
            "operations INDEXED BY operations_with_names",
            "asked_at_us",
            is_named_operation!(),
            concat!(
                "request = json_replace(request, ",
                redacted!("request", "$.by"),
                ", ",
                redacted!("request", "$.actor.name"),
                ", '$.actor.address', 'redacted', '$.actor.key', NULL), \
                 result = iif(result IS NULL, NULL, (SELECT json_group_array( \
                     json(iif(json_extract(value, '$.result') = 'changed', \
                         json_replace(value, '$.detail', substr(json_extract(value, '$.detail'), 1, \
                             instr(json_extract(value, '$.detail'), ' by ')) || 'by redacted'), \
                         value)) ORDER BY key) FROM json_each(result)))"
            )
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!("zones", "created_at_us", is_name!("created_by")),
        redact: redact!(
            "zones",
            "created_at_us",
            is_name!("created_by"),
            "created_by = 'redacted'"
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: written!("keys", "created_at_us", is_name!("created_by")),
        redact: redact!(
            "keys",
            "created_at_us",
            is_name!("created_by"),
            "created_by = 'redacted'"
        ),
    },
    Place {
        step_max: STEP_MAX,
        written: concat!(
            "SELECT ",
            key_end!(),
            " AS ended_at_us FROM keys WHERE ",
            is_name!("name"),
            " AND ended_at_us < $1 ORDER BY ended_at_us LIMIT 1 OFFSET $2"
        ),
        redact: concat!(
            "UPDATE keys SET name = 'redacted' WHERE ",
            is_name!("name"),
            " AND ",
            key_end!(),
            " <= $1"
        ),
    },
];

struct RedactNames {
    before: Timestamp,
}

impl Request for RedactNames {
    type Outcome = u64;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<u64, StoreError> {
        let until_us = until_us(transaction, micros(self.before)).await?;
        redact_until(transaction, until_us).await
    }
}

/// How far a step goes: to before a time, unless some table would have too many rows by then.
async fn until_us(transaction: &mut SqliteConnection, before_us: i64) -> Result<i64, StoreError> {
    let mut until_us = before_us.saturating_sub(1);
    for place in &PLACES {
        let full: Option<i64> = sqlx::query_scalar(place.written)
            .bind(before_us)
            .bind(place.step_max - 1)
            .fetch_optional(&mut *transaction)
            .await?;
        until_us = full.map_or(until_us, |full| full.min(until_us));
    }
    Ok(until_us)
}

async fn redact_until(
    transaction: &mut SqliteConnection,
    until_us: i64,
) -> Result<u64, StoreError> {
    let mut rows = 0;
    for place in &PLACES {
        let redacted = sqlx::query(place.redact)
            .bind(until_us)
            .execute(&mut *transaction)
            .await?;
        rows += redacted.rows_affected();
    }
    Ok(rows)
}
