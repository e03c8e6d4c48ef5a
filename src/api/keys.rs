//! Keys: whom the service knows.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::KeyParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{
    AnyProblems, KeyCreationProblems, KeyProblems, KeyRevocationProblems,
};
use super::types::NameText;
use super::upload::small_json;
use crate::ids::{KeyId, RouteId, VehicleId};
use crate::model::{Actor, Role, checked_holder};
use crate::store::{KeyRecord, KeyText, NewKey, Secret};

const ROUTES_MAX: usize = 1_000;

/// A key.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AccessKey, example = json!({
    "id": "019aa000-0000-7000-8000-00000000a001", "name": "agv-07", "role": "vehicle",
    "vehicle_id": "agv-07", "routes": ["line-4"], "created_at": "2026-11-20T06:00:00Z",
    "created_by": "kim", "last_used_at": null, "expires_at": null, "revoked_at": null, "key": null
}))]
pub(super) struct KeyBody {
    /// The part of it that is no secret.
    #[schema(format = "uuid")]
    id: String,
    /// Whose it is: a person or a machine.
    #[schema(example = "agv-07")]
    name: String,
    /// What its holder may do.
    role: Role,
    /// The vehicle that it uploads for; null for any, and for other roles than `vehicle`.
    #[schema(required)]
    vehicle_id: Option<String>,
    /// The routes that it is limited to; null for all.
    #[schema(value_type = Option<Vec<String>>, required)]
    routes: Option<Vec<RouteId>>,
    /// When it was made.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// Who made it.
    created_by: String,
    /// When it was last used, to five minutes; null before the first use.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    last_used_at: Option<Timestamp>,
    /// From then on it is no key; null for never.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    expires_at: Option<Timestamp>,
    /// Since then it is no key; null while nobody has revoked it.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    revoked_at: Option<Timestamp>,
    /// The key itself. Shown once, in the answer to its creation; null ever after.
    #[schema(required)]
    key: Option<String>,
}

/// A part of the list of keys.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct KeyPage {
    /// The oldest first.
    items: Vec<KeyBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for KeyPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// A key to make.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"name": "agv-07", "role": "vehicle", "vehicle_id": "agv-07"}))]
pub(super) struct KeyPost {
    /// Whose it is: a person or a machine. Several keys may have one name, so that they can be rotated.
    #[schema(
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    name: String,
    /// What its holder may do.
    role: Role,
    /// The one vehicle that it uploads for; with role `vehicle` alone.
    #[schema(value_type = Option<String>, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<VehicleId>,
    /// The routes that it is limited to; all if left out. Not with role `admin`.
    #[schema(value_type = Option<Vec<NameText>>, min_items = 1, max_items = 1000)]
    routes: Option<Vec<RouteId>>,
    /// From then on it is no key; never if left out.
    #[schema(value_type = Option<String>, format = DateTime)]
    expires_at: Option<Timestamp>,
}

impl From<KeyRecord> for KeyBody {
    fn from(key: KeyRecord) -> Self {
        Self {
            id: key.id.to_string(),
            name: key.name,
            role: key.role,
            vehicle_id: key.vehicle_id.map(|vehicle| vehicle.to_string()),
            routes: key.routes,
            created_at: key.created_at,
            created_by: key.created_by,
            last_used_at: key.last_used_at,
            expires_at: key.expires_at,
            revoked_at: key.revoked_at,
            key: None,
        }
    }
}

impl KeyPost {
    fn check(self, now: Timestamp) -> Result<NewKey, Problem> {
        let refuse = |pointer: &str, detail: String| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        if let Err(refusal) = checked_holder(&self.name) {
            return refuse("/name", refusal.to_string());
        }
        if self.vehicle_id.is_some() && self.role != Role::Vehicle {
            let detail = "vehicle_id goes with the role vehicle alone";
            return refuse("/vehicle_id", detail.to_owned());
        }
        let count = self.routes.as_ref().map(Vec::len);
        if count.is_some_and(|count| !(1..=ROUTES_MAX).contains(&count)) {
            let detail = "name 1 to 1,000 routes, or leave them out for all";
            return refuse("/routes", detail.to_owned());
        }
        if count.is_some() && self.role == Role::Admin {
            let detail = "an admin may make keys for every route, and is not limited to some";
            return refuse("/routes", detail.to_owned());
        }
        if self.expires_at.is_some_and(|end| end <= now) {
            return refuse("/expires_at", format!("it is {now:.0} already"));
        }
        Ok(NewKey {
            id: KeyId(Uuid::now_v7()),
            secret: Secret::random().map_err(Problem::internal)?,
            name: self.name,
            role: self.role,
            vehicle_id: self.vehicle_id,
            routes: self.routes,
            created_at: now,
            expires_at: self.expires_at,
        })
    }
}

/// List keys.
///
/// All of them, the oldest first, in parts; also those that are revoked or have expired.
#[utoipa::path(
    get, path = "/v1/keys", tag = "access", params(PageQuery),
    responses((status = 200, description = "A part of the list", body = KeyPage), AnyProblems)
)]
pub(super) async fn list_keys(
    State(state): State<ApiState>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<KeyPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<KeyId> = key_of_cursor(query.cursor.as_deref())?;
    let mut keys = state.store.keys(after, limit + 1).await?;
    let next_cursor = cut_page(&mut keys, limit, |key| key.id.to_string());
    Ok(Listed(KeyPage {
        items: keys.into_iter().map(KeyBody::from).collect(),
        next_cursor,
    }))
}

/// Read a key.
///
/// Whose it is, what it is for, and when it was last used; never its secret.
#[utoipa::path(
    get, path = "/v1/keys/{key}", tag = "access", params(KeyParam),
    responses((status = 200, description = "The key", body = KeyBody), KeyProblems)
)]
pub(super) async fn get_key(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<KeyId>,
    _: NoQuery,
) -> Result<Json<KeyBody>, Problem> {
    Ok(Json(known_key(&state, id).await?.into()))
}

/// Make a key.
///
/// The answer holds the key, which is shown only here. The first key has to be an administrator's: from
/// then on every request needs one.
#[utoipa::path(
    post, path = "/v1/keys", tag = "access",
    request_body(content = KeyPost, description = "For whom, and what they may do"),
    responses((status = 201, description = "Made; with its secret", body = KeyBody, headers(("Location" = String, description = "Path of the key"))), KeyCreationProblems)
)]
pub(super) async fn create_key(
    State(state): State<ApiState>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let post: KeyPost = small_json(&state, &headers, body).await?;
    let new = post.check(Timestamp::now())?;
    if state.is_open() && new.role != Role::Admin {
        let detail = "from the first key on nobody gets in without one: make one with the role admin \
                      first, so that somebody can make others";
        return Err(Problem::new(ProblemKind::FirstKey, detail).at("/role"));
    }
    let (id, secret) = (new.id, new.secret.clone());
    state.store.create_key(new, &by).await?;
    let location = (header::LOCATION, format!("/v1/keys/{id}"));
    // It holds a secret.
    let no_store = (header::CACHE_CONTROL, "no-store".to_owned());
    let mut body = KeyBody::from(known_key(&state, id).await?);
    body.key = Some(KeyText { id, secret }.text());
    Ok((StatusCode::CREATED, [location, no_store], Json(body)).into_response())
}

/// Revoke a key.
///
/// From now on it is no key, and the sessions that were begun with it have ended. It stays in the list.
#[utoipa::path(
    delete, path = "/v1/keys/{key}", tag = "access", params(KeyParam),
    responses((status = 204, description = "Revoked, perhaps before"), KeyRevocationProblems)
)]
pub(super) async fn revoke_key(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<KeyId>,
    _: NoQuery,
    by: Actor,
) -> Result<StatusCode, Problem> {
    match state.store.revoke_key(id, &by, Timestamp::now()).await? {
        true => Ok(StatusCode::NO_CONTENT),
        false => Err(unknown_key()),
    }
}

async fn known_key(state: &ApiState, id: KeyId) -> Result<KeyRecord, Problem> {
    state.store.key(id).await?.ok_or_else(unknown_key)
}

fn unknown_key() -> Problem {
    let detail = "there is no such key: GET /v1/keys lists them";
    Problem::new(ProblemKind::NotFound, detail)
}
