//! Keys, which identify the people and machines that use the service.

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::paging::{Listed, PageQuery, page};
use super::parameters::KeyParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{
    AnyProblems, KeyCreationProblems, KeyProblems, KeyRevocationProblems,
};
use super::types::NameText;
use super::upload::SmallJson;
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
    /// The public part of the key.
    #[schema(format = "uuid")]
    id: String,
    /// Its holder, a person or a machine.
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
    /// When it was created.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// Who created it.
    created_by: String,
    /// When it was last used, to within five minutes; null before the first use.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    last_used_at: Option<Timestamp>,
    /// When it expires; null for never.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    expires_at: Option<Timestamp>,
    /// When it was revoked; null if it was not.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    revoked_at: Option<Timestamp>,
    /// The key itself, shown once in the answer to its creation; null in every other answer.
    #[schema(required)]
    key: Option<String>,
}

page! {
    /// A page of the list of keys.
    pub(super) struct KeyPage {
        /// The oldest first.
        items: Vec<KeyBody>,
    }
}

/// A key to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"name": "agv-07", "role": "vehicle", "vehicle_id": "agv-07"}))]
pub(super) struct KeyPost {
    /// Its holder, a person or a machine. Several keys may have the same name, so that they can be rotated.
    #[schema(
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    name: String,
    /// What its holder may do.
    role: Role,
    /// The one vehicle that it uploads for; only with role `vehicle`.
    #[schema(value_type = Option<String>, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<VehicleId>,
    /// The routes that it is limited to; all if left out. Not with role `admin`.
    #[schema(value_type = Option<Vec<NameText>>, min_items = 1, max_items = 1000)]
    routes: Option<Vec<RouteId>>,
    /// When it expires; never if left out.
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
            let detail = "vehicle_id goes with the role vehicle only";
            return refuse("/vehicle_id", detail.to_owned());
        }
        let count = self.routes.as_ref().map(Vec::len);
        if count.is_some_and(|count| !(1..=ROUTES_MAX).contains(&count)) {
            let detail = "name 1 to 1,000 routes, or leave them out for all";
            return refuse("/routes", detail.to_owned());
        }
        if count.is_some() && self.role == Role::Admin {
            let detail =
                "an admin can create keys for every route, so it cannot be limited to some";
            return refuse("/routes", detail.to_owned());
        }
        if self.expires_at.is_some_and(|end| end <= now) {
            return refuse(
                "/expires_at",
                format!("this is in the past: it is {now:.0} now"),
            );
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
/// The oldest first, including revoked and expired ones.
#[utoipa::path(
    get, path = "/v1/keys", tag = "access", params(PageQuery),
    responses((status = 200, description = "A page of the list", body = KeyPage), AnyProblems)
)]
pub(super) async fn list_keys(
    State(state): State<ApiState>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<KeyPage>, Problem> {
    let wanted = query.wanted::<KeyId>()?;
    let keys = state.store.keys(wanted.after, wanted.to_read()).await?;
    Ok(wanted.page(keys, |key| key.id, KeyBody::from))
}

/// Read a key.
///
/// Its holder, its role, and when it was last used; never its secret.
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

/// Create a key.
///
/// The answer contains the key, which is shown only here. The first key must have the role `admin`: from then on
/// every request needs a key.
#[utoipa::path(
    post, path = "/v1/keys", tag = "access",
    request_body(content = KeyPost, description = "Its holder and role"),
    responses((status = 201, description = "Created; with its secret", body = KeyBody, headers(("Location" = String, description = "Path of the key"))), KeyCreationProblems)
)]
pub(super) async fn create_key(
    State(state): State<ApiState>,
    _: NoQuery,
    by: Actor,
    SmallJson(post): SmallJson<KeyPost>,
) -> Result<Response, Problem> {
    let new = post.check(Timestamp::now())?;
    if state.is_open() && new.role != Role::Admin {
        let detail = "once there is a key, every request needs one: create one with the role admin \
                      first, which can create others";
        return Err(Problem::new(ProblemKind::FirstKey, detail).at("/role"));
    }
    let (id, secret) = (new.id, new.secret.clone());
    state.store.create_key(new, &by).await?;
    let location = (header::LOCATION, format!("/v1/keys/{id}"));
    // The answer contains a secret.
    let no_store = (header::CACHE_CONTROL, "no-store".to_owned());
    let mut body = KeyBody::from(known_key(&state, id).await?);
    body.key = Some(KeyText { id, secret }.text());
    Ok((StatusCode::CREATED, [location, no_store], Json(body)).into_response())
}

/// Revoke a key.
///
/// It is no longer valid, and the sessions begun with it end. It remains in the list.
#[utoipa::path(
    delete, path = "/v1/keys/{key}", tag = "access", params(KeyParam),
    responses((status = 204, description = "Revoked, now or before"), KeyRevocationProblems)
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
