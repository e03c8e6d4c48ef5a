//! What receivers are sent.

use jiff::Timestamp;
use serde::Serialize;

use crate::model::WebhookEvent;
use crate::store::{AlertRecord, NextDelivery, Store, StoreError};

/// Writes an alert as readers of the interface see it: a JSON object.
pub type AlertForm = fn(AlertRecord) -> Result<String, serde_json::Error>;

/// The body of a test.
#[derive(Serialize)]
struct TestData<'a> {
    webhook_id: String,
    message: &'a str,
}

/// Why there is no message.
#[derive(Debug, thiserror::Error)]
pub(super) enum MessageError {
    /// The alert could not be read.
    #[error("the alert could not be read")]
    Store(#[from] StoreError),
    /// It has no JSON.
    #[error("the message has no JSON")]
    Json(#[from] serde_json::Error),
}

/// What is sent.
#[derive(Debug)]
pub(super) struct Message {
    pub body: String,
    /// The revision of the alert in it; `None` in a test.
    pub alert_revision: Option<i64>,
}

/// The message of a delivery: what happened, when, and the alert as it is now, so that an attempt
/// that comes late never tells an old state. `None` if the alert was deleted with its route.
///
/// # Errors
/// [`MessageError`].
pub(super) async fn message(
    store: &Store,
    form: AlertForm,
    next: &NextDelivery,
) -> Result<Option<Message>, MessageError> {
    let (alert_revision, data) = match next.alert_id {
        None => (None, test_data(next)?),
        Some(id) => match store.alert(id).await? {
            None => return Ok(None),
            Some(alert) => (Some(alert.shown_revision()), form(alert)?),
        },
    };
    Ok(Some(Message {
        body: envelope(next.event, next.at, &data),
        alert_revision,
    }))
}

fn test_data(next: &NextDelivery) -> Result<String, serde_json::Error> {
    serde_json::to_string(&TestData {
        webhook_id: next.webhook_id.to_string(),
        message: "If you can check the signature of this, alerts will arrive as well.",
    })
}

/// The members and their order as Standard Webhooks recommends them. Names of events and times
/// have no character that JSON escapes.
fn envelope(event: WebhookEvent, at: Timestamp, data: &str) -> String {
    let kind = event.name();
    format!(r#"{{"type":"{kind}","timestamp":"{at}","data":{data}}}"#)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::AlertEventKind;

    #[test]
    fn the_envelope_is_json_and_leaves_the_data_alone() {
        let at = Timestamp::from_microsecond(1_795_154_409_000_250).unwrap();
        let event = WebhookEvent::Alert(AlertEventKind::Updated);
        let body = envelope(event, at, r#"{"b":1e-9,"a":"\"ü"}"#);
        assert!(body.contains(r#"{"b":1e-9,"a":"\"ü"}"#));
        let value: serde_json::Value = serde_json::from_str(&body).unwrap();
        assert_eq!(value["type"], "alert.updated");
        assert_eq!(value["timestamp"], "2026-11-20T06:00:09.00025Z");
        assert_eq!(value["data"]["a"], "\"ü");
    }
}
