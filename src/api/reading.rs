//! Reads are taken on in bounds of their own: a few are worked on at once, and what has not been sent
//! yet counts against the address that asked. Uploads, health and metrics never wait for them.

use std::any::Any;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout_at};

use super::ApiState;
use super::client_address::ClientAddress;
use super::limits::{Limits, Reads};
use super::problem::{Problem, ProblemKind};
use super::shares::Shares;

/// How much a read costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weight {
    /// A few rows.
    Short,
    /// Pictures, series, evidence.
    Heavy,
    /// Documents as long as a route is old.
    Export,
}

/// What reads of one weight take.
pub(super) struct Gate {
    under_way: Shares,
    turns: Semaphore,
}

/// What an answer holds until it is sent to the end: whoever sends it keeps this until then.
#[derive(Clone)]
pub struct Held {
    _share: Arc<dyn Any + Send + Sync>,
}

impl Gate {
    pub(super) fn new(name: &'static str, reads: Reads, limits: &Limits) -> Self {
        let share = limits.share(reads.under_way);
        Self {
            under_way: Shares::of_requests(name, reads.under_way, share),
            turns: Semaphore::new(reads.at_once),
        }
    }
}

/// Has a read wait for its turn, and its answer count until it is sent.
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
    let time_max = state.limits.turn_timeout;
    let deadline = Instant::now() + time_max;
    let share = gate.under_way.take(client, time_max).await?;
    let turn = timeout_at(deadline, gate.turns.acquire()).await;
    let turn = turn.map_err(|_| {
        let detail = "too many reads are under way; ask again later";
        Problem::new(ProblemKind::Overloaded, detail)
    })?;
    let turn = turn.map_err(Problem::internal)?;
    let mut response = next.run(request).await;
    drop(turn);
    let _share = Arc::new(share);
    response.extensions_mut().insert(Held { _share });
    Ok(response)
}
