//! What happens to alerts, as it happens: server-sent events.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::stream::{self, Stream};
use serde::Deserialize;
use tokio::time::Instant;
use utoipa::IntoParams;

use super::body::AlertBody;
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::client_address::ClientAddress;
use crate::api::extract::ApiQuery;
use crate::api::filters::checked_route;
use crate::api::problem::Problem;
use crate::api::problem_responses::AlertListProblems;
use crate::api::shares::Share;
use crate::ids::RouteId;
use crate::model::AlertEventKind;
use crate::store::{AlertEvent, StoreError};

/// How often the store is asked for what is new.
const POLL: Duration = Duration::from_millis(500);
/// Events read at once.
const EVENTS_AT_ONCE: u32 = 100;
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Which events to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::api) struct StreamQuery {
    /// Only of alerts of this route.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    route_id: Option<String>,
}

/// Follow what happens to alerts.
///
/// Server-sent events `alert.raised` and `alert.updated`, also of alerts that are tentative. `data` is the alert as it is when the
/// event is sent, in the form of `GET /v1/alerts/{alert}`; `id` grows with every event. Without
/// `Last-Event-ID` the stream begins with what happens next; with it, after that event, so that a
/// client that was away misses nothing. Events of an alert that follow each other quickly may
/// carry the same state: compare `revision`.
///
/// A stream ends after half an hour, and when a key is revoked, with the `id` to come back with, so that
/// nobody holds one who is no longer there.
#[utoipa::path(
    get, path = "/v1/alerts/stream", tag = "alerts",
    params(
        StreamQuery,
        ("Last-Event-ID" = Option<String>, Header, nullable = false, description = "`id` of the last event that was seen; 0 for all that is known"),
    ),
    responses((status = 200, description = "Events until the client goes away, or for half an hour", body = String, content_type = "text/event-stream"), AlertListProblems)
)]
pub(in crate::api) async fn stream_alerts(
    State(state): State<ApiState>,
    client: ClientAddress,
    identity: Identity,
    ApiQuery(query): ApiQuery<StreamQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let route = checked_route(query.route_id.as_deref())?;
    if let Some(route) = &route {
        identity.check_route(route)?;
        state.known_route(route).await?;
    }
    let after = match last_event_id(&headers)? {
        Some(after) => after,
        None => state.store.last_alert_event().await?,
    };
    let place = state.streams.try_take(client, 1)?;
    let reader = Reader {
        ends_at: Instant::now() + state.limits.stream_time,
        ended: false,
        revocations: state.store.revocations(),
        identity,
        state,
        route,
        after,
        pending: VecDeque::new(),
        _place: place,
    };
    let keep_alive = KeepAlive::new().interval(KEEP_ALIVE);
    let events = Sse::new(events(reader)).keep_alive(keep_alive);
    // A proxy that collects an answer before it passes it on would hold every event back.
    let unbuffered = [
        (header::CACHE_CONTROL.as_str(), "no-store"),
        ("x-accel-buffering", "no"),
    ];
    Ok((unbuffered, events).into_response())
}

fn last_event_id(headers: &HeaderMap) -> Result<Option<i64>, Problem> {
    let Some(value) = headers.get("last-event-id") else {
        return Ok(None);
    };
    let number = value.to_str().ok().and_then(|text| text.parse().ok());
    match number {
        Some(number) if number >= 0 => Ok(Some(number)),
        _ => {
            let detail = "Last-Event-ID is the id of an event of this stream, or 0";
            Err(Problem::parameter("Last-Event-ID", detail))
        }
    }
}

/// Where a stream stands.
struct Reader {
    state: ApiState,
    /// Whose stream it is.
    identity: Identity,
    /// How many keys were revoked when it began.
    revocations: u64,
    route: Option<RouteId>,
    after: i64,
    pending: VecDeque<AlertEvent>,
    ends_at: Instant,
    ended: bool,
    _place: Share,
}

fn events(reader: Reader) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold(reader, |mut reader| async move {
        match reader.next().await {
            Ok(event) => event.map(|event| (Ok(event), reader)),
            Err(error) => {
                // The client comes back with the id of the last event it saw.
                tracing::warn!(%error, "a stream of alerts ended early");
                None
            }
        }
    })
}

impl Reader {
    /// Waits for the next event; `None` once the service shuts down, or the stream's time is over.
    async fn next(&mut self) -> Result<Option<Event>, StoreError> {
        while !self.ended {
            while let Some(event) = self.pending.pop_front() {
                self.after = event.sequence;
                // Gone only if its route was deleted a moment ago.
                if let Some(alert) = self.state.store.alert(event.alert_id).await?
                    && self.identity.sees(&alert.route_id)
                {
                    return Ok(sent(&event, &AlertBody::from(alert)));
                }
            }
            let route = self.route.as_ref();
            let news = self
                .state
                .store
                .alert_events(route, self.after, EVENTS_AT_ONCE);
            self.pending = news.await?.into();
            if self.pending.is_empty() {
                tokio::select! {
                    () = self.state.draining.cancelled() => return Ok(None),
                    () = tokio::time::sleep(POLL) => {}
                }
                // Whose key was revoked does not come back.
                let revoked = self.state.store.revocations() != self.revocations;
                if revoked || Instant::now() >= self.ends_at {
                    self.ended = true;
                    return Ok(Some(self.last()));
                }
            }
        }
        Ok(None)
    }

    /// No event, but the place to go on from for a client that has seen none.
    fn last(&self) -> Event {
        Event::default().id(self.after.to_string())
    }
}

fn sent(event: &AlertEvent, alert: &AlertBody) -> Option<Event> {
    let kind = match event.revision {
        1 => AlertEventKind::Raised,
        _ => AlertEventKind::Updated,
    };
    let sent = Event::default()
        .id(event.sequence.to_string())
        .event(kind.name());
    sent.json_data(alert).ok()
}
