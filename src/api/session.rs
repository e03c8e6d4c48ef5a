//! Sessions: a browser exchanges a key for a cookie.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::time::Instant;
use utoipa::ToSchema;

use super::ApiState;
use super::access::{Identity, ended_cookie, not_a_key, session_cookie, session_id};
use super::client_address::ClientAddress;
use super::extract::NoQuery;
use super::problem::Problem;
use super::problem_responses::{AnyProblems, SignInProblems, SignOutProblems};
use super::upload::small_json;
use crate::ids::RouteId;
use crate::model::Role;
use crate::store::{KeyText, Secret};

/// The identity of the sender.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Session, example = json!({
    "open": false, "name": "Kim", "role": "maintainer", "routes": null,
    "expires_at": "2026-11-27T06:00:00Z"
}))]
pub(super) struct SessionBody {
    /// Whether no key exists, so that everybody may do everything.
    open: bool,
    /// Their name; null if they have not signed in.
    #[schema(required)]
    name: Option<String>,
    /// Their role; null for none.
    #[schema(value_type = Option<Role>, required)]
    role: Option<Role>,
    /// The routes that they are limited to; null for all.
    #[schema(value_type = Option<Vec<String>>, required)]
    routes: Option<Vec<RouteId>>,
    /// The latest time at which they have to sign in again; null for never.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    expires_at: Option<Timestamp>,
}

impl SessionBody {
    fn new(identity: Identity, open: bool) -> Self {
        Self {
            open,
            name: identity.name().map(str::to_owned),
            role: identity.role,
            routes: identity.routes,
            expires_at: identity.expires_at,
        }
    }
}

/// A key to sign in with.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SessionPost {
    /// The key as it was shown when it was created.
    #[schema(max_length = 200)]
    key: String,
}

/// Read the own identity.
///
/// Works without signing in. While no key exists, `open` is true and `role` is `admin`.
#[utoipa::path(
    get, path = "/v1/session", tag = "access",
    responses((status = 200, description = "The identity", body = SessionBody), AnyProblems)
)]
pub(super) async fn get_session(
    State(state): State<ApiState>,
    identity: Identity,
    _: NoQuery,
) -> Response {
    let body = Json(SessionBody::new(identity, state.is_open()));
    ([(header::CACHE_CONTROL, "no-store")], body).into_response()
}

/// Sign in.
///
/// Exchanges a key for a session, kept in a cookie that scripts cannot read. The session ends after 12 hours
/// without a request, after 7 days, or when its key becomes invalid. An address that sends ten invalid keys
/// within a minute has to wait.
#[utoipa::path(
    post, path = "/v1/session", tag = "access",
    request_body(content = SessionPost, description = "The key"),
    responses((status = 200, description = "Signed in", body = SessionBody, headers(("Set-Cookie" = String, description = "The session"))), SignInProblems)
)]
pub(super) async fn sign_in(
    State(state): State<ApiState>,
    client: ClientAddress,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    state.sign_ins.check(client, Instant::now())?;
    let post: SessionPost = small_json(&state, &headers, body).await?;
    let now = Timestamp::now();
    let shown: Option<KeyText> = post.key.trim().parse().ok();
    let key = match shown {
        Some(shown) => state.store.key_shown(&shown, now).await?,
        None => None,
    };
    let Some(key) = key else {
        state.sign_ins.failed(client, Instant::now());
        return Err(not_a_key());
    };
    let id = Secret::random().map_err(Problem::internal)?;
    state.store.begin_session(&id, key.id, now).await?;
    // There is none if the key has been revoked in the meantime.
    let session = state.store.session(&id, now).await?;
    let session = session.ok_or_else(not_a_key)?;
    tracing::info!(name = key.name, key = %key.id, "signed in");
    let cookie = session_cookie(&id, &headers).map_err(Problem::internal)?;
    let body = Json(SessionBody::new(Identity::of_session(session), false));
    let no_store = (header::CACHE_CONTROL, "no-store");
    Ok(([(header::SET_COOKIE, cookie)], [no_store], body).into_response())
}

/// Sign out.
///
/// Ends the session of the cookie, if there is one.
#[utoipa::path(
    delete, path = "/v1/session", tag = "access",
    responses((status = 204, description = "Signed out"), SignOutProblems)
)]
pub(super) async fn sign_out(
    State(state): State<ApiState>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if let Some(id) = session_id(&headers) {
        state.store.end_session(&id).await?;
    }
    let cookie = ended_cookie(&headers).map_err(Problem::internal)?;
    Ok((StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response())
}
