//! The layer that bounds reads by weight. Uploads, health and metrics never wait for them.

use std::any::Any;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::ApiState;
use super::client_address::ClientAddress;
use super::known_route::named_route;
use super::problem::Problem;

/// How much a read costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weight {
    /// A few rows.
    Short,
    /// Pictures, series, evidence.
    Heavy,
    /// Documents that grow with the age of a route.
    Export,
}

/// What an answer holds until all of it has been sent: the listener takes it out of the extensions.
#[derive(Clone)]
pub struct Held {
    _share: Arc<dyn Any + Send + Sync>,
}

/// Makes a read wait for its turn, and counts its answer against the client until it has been sent.
pub(super) async fn limit(
    State((state, weight)): State<(ApiState, Weight)>,
    client: ClientAddress,
    request: Request,
    next: Next,
) -> Response {
    if ![Method::GET, Method::HEAD].contains(request.method()) {
        return next.run(request).await;
    }
    match read(&state, weight, client, request, next).await {
        Ok(response) => response,
        Err(problem) => problem.into_response(),
    }
}

async fn read(
    state: &ApiState,
    weight: Weight,
    client: ClientAddress,
    request: Request,
    next: Next,
) -> Result<Response, Problem> {
    let gate = match weight {
        Weight::Short => &state.short_reads,
        Weight::Heavy => &state.heavy_reads,
        Weight::Export => &state.exports,
    };
    let (mut parts, body) = request.into_parts();
    let route = named_route(&mut parts, state).await?;
    let request = Request::from_parts(parts, body);
    let admitted = gate
        .enter(client, route.as_ref(), state.limits.turn_timeout)
        .await?;
    let mut response = next.run(request).await;
    drop(admitted.turn);
    let _share = Arc::new(admitted.share);
    response.extensions_mut().insert(Held { _share });
    Ok(response)
}
