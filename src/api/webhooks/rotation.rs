//! Replacing the secret of a webhook.

use axum::body::Body;
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
use crate::api::parameters::WebhookParam;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::WebhookRotationProblems;
use crate::api::upload::small_json;
use crate::ids::WebhookId;
use crate::model::Actor;
use crate::store::NewSecret;
use crate::webhooks::{generate_secret, secret_text};

const OVERLAP_HOURS_DEFAULT: u32 = 24;
/// A week: long enough for a receiver that somebody has to change by hand.
const OVERLAP_HOURS_MAX: u32 = 168;

/// How a secret is replaced; an empty body is as good as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"overlap_hours": 24}))]
pub(in crate::api) struct SecretRotationPost {
    /// For how long calls are signed with the old secret as well; 24 if left out. With 0 the old one is
    /// invalid at once.
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
/// The answer holds the new secret, which is shown only here. Calls are signed with it from now on and, for
/// the overlap, with the old one as well: `webhook-signature` then has two signatures, separated by a space,
/// and a receiver accepts a call if one of them is right. Only one old secret is kept: replacing it again
/// within the overlap ends the validity of the one before. Send `If-Match`, so that a request that is
/// repeated after a lost answer does not do so.
#[utoipa::path(
    post, path = "/v1/webhooks/{webhook}/rotate-secret", tag = "webhooks",
    params(
        WebhookParam,
        ("If-Match" = Option<String>, Header, nullable = false, description = "Refuse the change unless the webhook has this ETag"),
    ),
    request_body(content = SecretRotationPost, description = "For how long the old secret stays valid"),
    responses((status = 200, description = "The webhook with its new secret", body = WebhookBody, headers(("ETag" = String, description = "Changes with every edit"))), WebhookRotationProblems)
)]
pub(in crate::api) async fn rotate_webhook_secret(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let post: SecretRotationPost = small_json(&state, &headers, body).await?;
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
