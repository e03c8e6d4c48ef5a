//! Webhooks: what they tell of, and what becomes of telling it.

use serde::{Serialize, Serializer};

use super::{TextEnum, text_enum};

text_enum! {
    /// What happened to an alert.
    AlertEventKind {
        /// It was raised.
        Raised = "alert.raised",
        /// It changed.
        Updated = "alert.updated",
    }
}

text_enum! {
    /// What a webhook can subscribe to.
    WebhookTopic {
        /// An alert was raised.
        AlertRaised = "alert.raised",
        /// What a decision about an alert is about has changed.
        AlertUpdated = "alert.updated",
        /// An upload was kept out of the map.
        BatchQuarantined = "batch.quarantined",
        /// A vehicle has become suspect, or its uploads are kept out from now on.
        VehicleSuspect = "vehicle.suspect",
        /// An operation has ended.
        OperationFinished = "operation.finished",
    }
}

impl WebhookTopic {
    /// What a webhook subscribes to that does not say.
    pub const DEFAULT: [Self; 2] = [Self::AlertRaised, Self::AlertUpdated];
}

impl From<AlertEventKind> for WebhookTopic {
    fn from(kind: AlertEventKind) -> Self {
        match kind {
            AlertEventKind::Raised => Self::AlertRaised,
            AlertEventKind::Updated => Self::AlertUpdated,
        }
    }
}

/// What a webhook is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WebhookEvent {
    /// Something that it has subscribed to.
    Topic(WebhookTopic),
    /// Somebody tries the webhook out.
    Test,
}

impl WebhookEvent {
    /// Its text in columns and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Topic(topic) => topic.name(),
            Self::Test => "webhook.test",
        }
    }
}

impl TextEnum for WebhookEvent {
    const TABLE: &'static [(Self, &'static str)] = &[
        Self::Topic(WebhookTopic::AlertRaised).with_name(),
        Self::Topic(WebhookTopic::AlertUpdated).with_name(),
        Self::Topic(WebhookTopic::BatchQuarantined).with_name(),
        Self::Topic(WebhookTopic::VehicleSuspect).with_name(),
        Self::Topic(WebhookTopic::OperationFinished).with_name(),
        Self::Test.with_name(),
    ];
}

impl WebhookEvent {
    const fn with_name(self) -> (Self, &'static str) {
        (self, self.name())
    }
}

impl Serialize for WebhookEvent {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

text_enum! {
    /// How far a delivery has come.
    DeliveryStatus {
        /// An attempt follows.
        Pending = "pending",
        /// The receiver took it.
        Delivered = "delivered",
        /// No attempt follows.
        Failed = "failed",
    }
}

text_enum! {
    /// Why an attempt had no answer.
    DeliveryFailure {
        /// No answer in time.
        Timeout = "timeout",
        /// No connection: refused, cut, or not trusted (TLS).
        Connection = "connection",
        /// The host's name has no address.
        NameUnknown = "name_unknown",
        /// The host's addresses are none that webhooks are sent to.
        AddressRefused = "address_refused",
        /// The URL is none that webhooks are sent to, since settings changed.
        UrlRefused = "url_refused",
        /// What came back was not HTTP.
        BrokenAnswer = "broken_answer",
    }
}
