//! What the store keeps of webhooks, as values.

use std::fmt;

use jiff::Timestamp;

use crate::ids::{AlertId, BatchId, OperationId, RouteId, VehicleId, WebhookId};
use crate::model::{DeliveryFailure, DeliveryStatus, WebhookEvent, WebhookTopic};

/// Most webhooks of a service: each costs a row for every event, and a connection.
pub const WEBHOOKS_MAX: u32 = 100;

/// What a webhook's events are signed with.
#[derive(Clone, PartialEq, Eq)]
pub struct WebhookSecret(pub [u8; 32]);

impl fmt::Debug for WebhookSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("WebhookSecret(..)")
    }
}

/// A secret in the place of another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewSecret {
    /// What is signed with from now on.
    pub secret: WebhookSecret,
    /// Until when the one before is signed with as well; `None` for no longer.
    pub previous_until: Option<Timestamp>,
}

/// A webhook to register.
#[derive(Debug, Clone, PartialEq)]
pub struct NewWebhook {
    /// Sorts by when it is registered.
    pub id: WebhookId,
    /// Where events are sent.
    pub url: String,
    /// What they are signed with.
    pub secret: WebhookSecret,
    /// Which ones; not empty.
    pub events: Vec<WebhookTopic>,
    /// Of this route alone; `None` for all.
    pub route_id: Option<RouteId>,
    /// For people.
    pub description: Option<String>,
    /// Whether alerts are sent also while they are tentative.
    pub include_tentative: bool,
    /// When.
    pub created_at: Timestamp,
}

/// A webhook, without its secret, which is shown only once.
#[derive(Debug, Clone, PartialEq)]
pub struct WebhookRecord {
    /// Sorts by when it was registered.
    pub id: WebhookId,
    /// 1, and one more with every edit: what an ETag is made of.
    pub revision: i64,
    /// Where events are sent.
    pub url: String,
    /// Which ones.
    pub events: Vec<WebhookTopic>,
    /// Of this route alone; `None` for all.
    pub route_id: Option<RouteId>,
    /// For people.
    pub description: Option<String>,
    /// Whether alerts are sent also while they are tentative.
    pub include_tentative: bool,
    /// Whether events are sent.
    pub active: bool,
    /// When its receiver answered 410 Gone, which disabled it; `None` once it is enabled again.
    pub gone_at: Option<Timestamp>,
    /// Until when calls are signed with the secret before as well; `None` if there is none.
    pub previous_secret_until: Option<Timestamp>,
    /// When it was registered.
    pub created_at: Timestamp,
    /// When it last changed.
    pub updated_at: Timestamp,
}

/// What to change of a webhook; `None` leaves it as it is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WebhookUpdate {
    /// Where events are sent.
    pub url: Option<String>,
    /// Which ones; not empty.
    pub events: Option<Vec<WebhookTopic>>,
    /// For people.
    pub description: Option<String>,
    /// Whether alerts are sent also while they are tentative.
    pub include_tentative: Option<bool>,
    /// Whether events are sent.
    pub active: Option<bool>,
}

/// What became of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Registered {
    /// It is there.
    Created,
    /// There are [`WEBHOOKS_MAX`] already; nothing was written.
    TooMany,
    /// The route is not there; nothing was written.
    UnknownRoute,
}

/// What became of an edit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edited {
    /// Committed.
    Done,
    /// It has changed since it was read; nothing was written.
    Stale,
    /// There is no such webhook.
    Unknown,
}

/// What became of a request for a test.
#[derive(Debug, Clone, PartialEq)]
pub enum TestQueued {
    /// It is sent next; or one that waited already is.
    Queued(DeliveryRecord),
    /// The webhook is not active; nothing was written.
    Disabled,
    /// There is no such webhook.
    Unknown,
}

/// What an event is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Subject {
    /// An alert.
    Alert(AlertId),
    /// An upload.
    Batch(RouteId, BatchId),
    /// A vehicle of a route.
    Vehicle(RouteId, VehicleId),
    /// An operation.
    Operation(OperationId),
}

/// An event on its way to a receiver.
#[derive(Debug, Clone, PartialEq)]
pub struct DeliveryRecord {
    /// In the order of commits.
    pub key: i64,
    /// The same for every attempt.
    pub id: String,
    /// What happened.
    pub event: WebhookEvent,
    /// The event in the stream of alerts; `None` for what is about no alert.
    pub event_sequence: Option<i64>,
    /// What it is about; `None` for a test.
    pub subject: Option<Subject>,
    /// When the event happened.
    pub at: Timestamp,
    /// How far it has come.
    pub status: DeliveryStatus,
    /// Attempts so far.
    pub attempts: i64,
    /// When the last one ended.
    pub attempted_at: Option<Timestamp>,
    /// When the next one follows.
    pub next_attempt_at: Option<Timestamp>,
    /// How the last one ended; `None` before the first.
    pub last_end: Option<AttemptEnd>,
}

/// How an attempt ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttemptEnd {
    /// With an answer of this status.
    Answer(u16),
    /// Without an answer.
    Failure(DeliveryFailure),
}

/// What is sent next to a webhook.
#[derive(Debug, Clone, PartialEq)]
pub struct NextDelivery {
    /// The delivery's key.
    pub key: i64,
    /// The same for every attempt.
    pub id: String,
    /// The webhook.
    pub webhook_id: WebhookId,
    /// The webhook's revision.
    pub webhook_revision: i64,
    /// Where to.
    pub url: String,
    /// What it is signed with.
    pub secret: WebhookSecret,
    /// What it is signed with as well, until when.
    pub previous_secret: Option<(WebhookSecret, Timestamp)>,
    /// What happened.
    pub event: WebhookEvent,
    /// What it is about; `None` for a test.
    pub subject: Option<Subject>,
    /// When the event happened.
    pub at: Timestamp,
    /// Attempts so far.
    pub attempts: i64,
    /// Not before.
    pub due_at: Timestamp,
}

/// An attempt that has ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Attempt {
    /// The delivery's key.
    pub delivery_key: i64,
    /// Attempts so far, with this one.
    pub attempts: i64,
    /// The webhook's revision when it was made.
    pub webhook_revision: i64,
    /// The revision of the alert that was sent; `None` for what is about no alert.
    pub alert_revision: Option<i64>,
    /// When it ended.
    pub ended_at: Timestamp,
    /// How it ended.
    pub end: AttemptEnd,
    /// What follows from that.
    pub verdict: AttemptVerdict,
}

/// What follows from an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttemptVerdict {
    /// The receiver took it.
    Delivered,
    /// Another attempt, not before this time.
    RetryAt(Timestamp),
    /// No further attempt.
    Failed,
    /// No further attempt, and the webhook is disabled: its receiver answered 410 Gone.
    Gone,
}
