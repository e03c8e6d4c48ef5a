//! The audit as a table, for spreadsheets and archives.

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use futures::stream;

use super::{AuditBody, AuditQuery};
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::extract::ApiQuery;
use crate::api::problem::Problem;
use crate::api::problem_responses::AnyProblems;
use crate::store::{AuditFilter, StoreError};

const HEAD: &str = "id,at,actor,key_id,address,action,route_id,subject,before,after\r\n";
/// Changes read and sent at a time.
const CHANGES_AT_ONCE: u32 = 500;

/// Export the audit.
///
/// The changes that `GET /v1/audit` lists under the same conditions, all in one table (CSV, RFC 4180, UTF-8), the
/// newest first. `before` and `after` are JSON. A text that a spreadsheet would take for a formula is preceded by
/// an apostrophe.
#[utoipa::path(
    get, path = "/v1/audit.csv", tag = "audit", params(AuditQuery),
    responses((status = 200, description = "The table", body = String, content_type = "text/csv"), AnyProblems)
)]
pub(in crate::api) async fn export_audit(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<AuditQuery>,
) -> Result<Response, Problem> {
    if query.limit.is_some() || query.cursor.is_some() {
        let detail = "the export is not divided into pages: leave limit and cursor out";
        return Err(Problem::parameter("limit", detail));
    }
    let sending = Sending {
        state,
        filter: query.filter(&identity)?,
        before: None,
        text: HEAD.to_owned(),
    };
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8"),
        (
            header::CONTENT_DISPOSITION,
            "attachment; filename=\"audit.csv\"",
        ),
        (header::CACHE_CONTROL, "no-store"),
    ];
    let body = stream::try_unfold(Some(sending), next_part);
    Ok((headers, Body::from_stream(body)).into_response())
}

/// A table that is being sent.
struct Sending {
    state: ApiState,
    filter: AuditFilter,
    /// The key of the last change sent.
    before: Option<i64>,
    /// The text that the next part begins with.
    text: String,
}

/// The next rows. An error cuts the connection, so that the table does not look complete.
async fn next_part(
    sending: Option<Sending>,
) -> Result<Option<(Bytes, Option<Sending>)>, StoreError> {
    let Some(mut sending) = sending else {
        return Ok(None);
    };
    let store = &sending.state.store;
    let page = store.audit_page(&sending.filter, sending.before, CHANGES_AT_ONCE);
    let changes = page.await?;
    let is_last = changes.len() < CHANGES_AT_ONCE as usize;
    sending.before = changes.last().map(|change| change.key).or(sending.before);
    let mut text = std::mem::take(&mut sending.text);
    for change in changes {
        append(&mut text, &change.into());
    }
    let rest = (!is_last).then_some(sending);
    Ok(Some((text.into(), rest)))
}

fn append(text: &mut String, change: &AuditBody) {
    let json = |value: &Option<serde_json::Value>| value.as_ref().map(ToString::to_string);
    let or_empty = |text: &Option<String>| text.clone().unwrap_or_default();
    let fields = [
        change.id.to_string(),
        change.at.to_string(),
        change.actor.clone(),
        or_empty(&change.key_id),
        or_empty(&change.address),
        change.action.name().to_owned(),
        or_empty(&change.route_id),
        change.subject.clone(),
        or_empty(&json(&change.before)),
        or_empty(&json(&change.after)),
    ];
    let fields: Vec<String> = fields.iter().map(|field| quoted(field)).collect();
    text.push_str(&fields.join(","));
    text.push_str("\r\n");
}

/// A field of the table, in quotes if it needs them.
fn quoted(field: &str) -> String {
    let is_formula = field.starts_with(['=', '+', '-', '@', '\t', '\r']);
    let guard = if is_formula { "'" } else { "" };
    match is_formula || field.contains([',', '"', '\r', '\n']) {
        true => format!("\"{guard}{}\"", field.replace('"', "\"\"")),
        false => field.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_quoted_and_no_formulas() {
        for (field, written) in [
            ("", ""),
            ("kim", "kim"),
            ("a,b", "\"a,b\""),
            ("{\"a\":1}", "\"{\"\"a\"\":1}\""),
            ("=1+1", "\"'=1+1\""),
        ] {
            assert_eq!(quoted(field), written);
        }
    }
}
