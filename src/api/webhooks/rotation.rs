//! Replacing the secret of a webhook.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::WebhookBody;
use super::{check_edited, known_webhook, wanted_revision, with_secret};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::parameters::{IfMatch, WebhookParam};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::WebhookRotationProblems;
use crate::api::upload::SmallJson;
use crate::ids::WebhookId;
use crate::model::Actor;
use crate::store::NewSecret;
use crate::webhooks::{generate_secret, secret_text};

const OVERLAP_HOURS_DEFAULT: u32 = 24;
/// A week: enough time to change a receiver by hand.
const OVERLAP_HOURS_MAX: u32 = 168;

/// How to replace a secret; an empty body counts as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"overlap_hours": 24}))]
pub(in crate::api) struct SecretRotationPost {
    /// For how long calls are also signed with the old secret; 24 by default. With 0 the old secret becomes invalid
    /// at once.
    #[schema(minimum = 0, maximum = 168, default = 24)]
    overlap_hours: Option<u32>,
}

impl SecretRotationPost {
    fn previous_until(&self, now: Timestamp) -> Result<Option<Timestamp>, Problem> {
        let hours = self.overlap_hours.unwrap_or(OVERLAP_HOURS_DEFAULT);
        if hours > OVERLAP_HOURS_MAX {
            let detail = format!("at most {OVERLAP_HOURS_MAX} hours, a week");
            return Err(Problem::new(ProblemKind::OutOfRange, detail).at("/overlap_hours"));
        }
        Ok((hours > 0).then(|| now + SignedDuration::from_hours(hours.into())))
    }
}

/// Replace a webhook's secret.
///
/// The answer contains the new secret, which is shown only here. From now on calls are signed with it and, during
/// the overlap, also with the old one: `webhook-signature` then has two signatures, separated by a space, and a
/// receiver accepts a call if either is right. Only one old secret is kept: another replacement within the
/// overlap invalidates it. Send `If-Match`, so that a request repeated after a lost answer does not do that.
#[utoipa::path(
    post, path = "/v1/webhooks/{webhook}/rotate-secret", tag = "webhooks",
    params(WebhookParam, IfMatch),
    request_body(content = SecretRotationPost, description = "For how long the old secret stays valid"),
    responses((status = 200, description = "The webhook with its new secret", body = WebhookBody, headers(("ETag" = String, description = "Changes with every edit"))), WebhookRotationProblems)
)]
pub(in crate::api) async fn rotate_webhook_secret(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    SmallJson(post): SmallJson<SecretRotationPost>,
) -> Result<Response, Problem> {
    let revision = wanted_revision(&headers, &known_webhook(&state, id).await?)?;
    let now = Timestamp::now();
    let secret = NewSecret {
        secret: generate_secret().map_err(Problem::internal)?,
        previous_until: post.previous_until(now)?,
    };
    let text = secret_text(&secret.secret);
    let rotated = state
        .store
        .rotate_webhook_secret(id, revision, secret, &by, now);
    check_edited(rotated.await?)?;
    Ok(with_secret(known_webhook(&state, id).await?, text))
}
