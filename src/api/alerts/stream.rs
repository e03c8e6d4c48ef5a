//! Changes of alerts as they happen: server-sent events.

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
use super::pacing::Pacing;
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

/// How often the store is asked for new events.
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

/// Follow changes of alerts.
///
/// Server-sent events `alert.raised` and `alert.updated`, for tentative alerts too. `data` is the alert as it is
/// when the event is sent, in the form of `GET /v1/alerts/{alert}`. An event is sent at once when what a decision
/// is about has changed (status, kind, tier, region: `decision_revision`). An alert that only gains evidence, or
/// whose assignee, comments or muting change, is sent at most once every 5 s. An event is left out if its
/// revision was already sent within the last 5 s.
///
/// Without `Last-Event-ID` the stream begins with the next change. With it, the stream resumes where the client
/// left off, so that nothing is missed. `id` is the position to resume from and never decreases; while an update
/// is held back, several events have the same `id`, and some are sent again after a reconnection: compare
/// `revision`.
///
/// A stream ends after half an hour, or when a key is revoked, and its last `id` is the one to reconnect with.
#[utoipa::path(
    get, path = "/v1/alerts/stream", tag = "alerts",
    params(
        StreamQuery,
        ("Last-Event-ID" = Option<String>, Header, nullable = false, description = "`id` of the last event received; 0 for all stored events"),
    ),
    responses((status = 200, description = "Events until the client disconnects, or for half an hour", body = String, content_type = "text/event-stream"), AlertListProblems)
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
        read: after,
        pending: VecDeque::new(),
        pacing: Pacing::default(),
        _place: place,
    };
    let keep_alive = KeepAlive::new().interval(KEEP_ALIVE);
    let events = Sse::new(events(reader)).keep_alive(keep_alive);
    // A proxy that buffers answers would hold every event back.
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

/// The state of a stream.
struct Reader {
    state: ApiState,
    /// Who reads the stream.
    identity: Identity,
    /// How many keys had been revoked when it began.
    revocations: u64,
    route: Option<RouteId>,
    /// The last event that was read and is not in `pending`.
    read: i64,
    pending: VecDeque<AlertEvent>,
    pacing: Pacing,
    ends_at: Instant,
    ended: bool,
    _place: Share,
}

fn events(reader: Reader) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold(reader, |mut reader| async move {
        match reader.next().await {
            Ok(event) => event.map(|event| (Ok(event), reader)),
            Err(error) => {
                // The client reconnects with the id of the last event that it received.
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
            while let Some(event) = self.next_now() {
                if let Some(event) = self.sent(event).await? {
                    return Ok(Some(event));
                }
            }
            let route = self.route.as_ref();
            let news = self
                .state
                .store
                .alert_events(route, self.read, EVENTS_AT_ONCE);
            self.pending = news.await?.into();
            if self.pending.is_empty() {
                tokio::select! {
                    () = self.state.draining.cancelled() => return Ok(None),
                    () = tokio::time::sleep(POLL) => {}
                }
                // A client whose key was revoked gets no more events.
                let revoked = self.state.store.revocations() != self.revocations;
                if revoked || Instant::now() >= self.ends_at {
                    return self.last(revoked).await;
                }
            }
        }
        Ok(None)
    }

    /// The next event that is due, of those that were read.
    fn next_now(&mut self) -> Option<AlertEvent> {
        if let Some(event) = self.pacing.due(Instant::now()) {
            return Some(event);
        }
        while let Some(event) = self.pending.pop_front() {
            self.read = event.sequence;
            if let Some(event) = self.pacing.take(event, Instant::now()) {
                return Some(event);
            }
        }
        None
    }

    /// An event as it is sent; `None` if the client may not read it, or its route has just been deleted.
    async fn sent(&mut self, event: AlertEvent) -> Result<Option<Event>, StoreError> {
        let alert = self.state.store.alert(event.alert_id).await?;
        let Some(alert) = alert.filter(|alert| self.identity.sees(&alert.route_id)) else {
            return Ok(None);
        };
        let revision = alert.shown_revision();
        self.pacing.note(event.alert_id, revision, Instant::now());
        let kind = match event.revision {
            1 => AlertEventKind::Raised,
            _ => AlertEventKind::Updated,
        };
        let sent = Event::default().id(self.place()).event(kind.name());
        Ok(sent.json_data(AlertBody::from(alert)).ok())
    }

    /// The last event before the stream ends: an update that is still held back, or an empty event with the `id`
    /// to resume from.
    async fn last(&mut self, revoked: bool) -> Result<Option<Event>, StoreError> {
        while let Some(event) = (!revoked).then(|| self.pacing.rest()).flatten() {
            if let Some(event) = self.sent(event).await? {
                return Ok(Some(event));
            }
        }
        self.ended = true;
        Ok(Some(Event::default().id(self.place())))
    }

    fn place(&self) -> String {
        self.pacing.resume_after(self.read).to_string()
    }
}
