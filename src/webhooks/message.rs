//! The messages that receivers get.

use jiff::Timestamp;
use serde::Serialize;

use crate::ids::AlertId;
use crate::model::WebhookEvent;
use crate::store::{
    AlertRecord, BatchRecord, NextDelivery, OperationRecord, Store, StoreError, Subject,
    VehicleRecord,
};

/// How the API shows the subjects of events: as JSON objects, and by URL on the console.
pub trait Forms: Send + Sync {
    /// An alert.
    ///
    /// # Errors
    /// If it has no JSON; so of the others.
    fn alert(&self, alert: AlertRecord) -> Result<String, serde_json::Error>;

    /// A batch, and the alerts that rest on it.
    ///
    /// # Errors
    /// If it has no JSON.
    fn batch(&self, batch: BatchRecord, alerts: &[AlertId]) -> Result<String, serde_json::Error>;

    /// A vehicle of a route.
    ///
    /// # Errors
    /// If it has no JSON.
    fn vehicle(&self, vehicle: VehicleRecord) -> Result<String, serde_json::Error>;

    /// An operation.
    ///
    /// # Errors
    /// If it has no JSON.
    fn operation(&self, operation: OperationRecord) -> Result<String, serde_json::Error>;

    /// Where the page shows it; `None` where it does not, or nobody said where people reach it.
    fn url(&self, subject: &Subject) -> Option<String>;
}

/// The body of a test.
#[derive(Serialize)]
struct TestData<'a> {
    webhook_id: String,
    message: &'a str,
}

/// Why there is no message.
#[derive(Debug, thiserror::Error)]
pub(super) enum MessageError {
    /// What the event is about could not be read.
    #[error("what the event is about could not be read")]
    Store(#[from] StoreError),
    /// It has no JSON.
    #[error("the message has no JSON")]
    Json(#[from] serde_json::Error),
}

/// A message.
#[derive(Debug)]
pub(super) struct Message {
    pub body: String,
    /// The revision of the alert in it; `None` in all others.
    pub alert_revision: Option<i64>,
}

/// The message of a delivery: the event, its time, and its subject in its present state, so that a late attempt
/// never carries an old state. `None` if the subject was deleted with its route.
///
/// # Errors
/// [`MessageError`].
pub(super) async fn message(
    store: &Store,
    forms: &dyn Forms,
    next: &NextDelivery,
) -> Result<Option<Message>, MessageError> {
    let (data, alert_revision) = match &next.subject {
        None => (Some(test_data(next)?), None),
        Some(subject) => data_of(store, forms, subject).await?,
    };
    let url = next.subject.as_ref().and_then(|subject| forms.url(subject));
    let body = data.map(|data| envelope(next.event, next.at, url.as_deref(), &data));
    Ok(body.transpose()?.map(|body| Message {
        body,
        alert_revision,
    }))
}

/// The subject of an event in its present state, if it still exists; for an alert with its revision.
async fn data_of(
    store: &Store,
    forms: &dyn Forms,
    subject: &Subject,
) -> Result<(Option<String>, Option<i64>), MessageError> {
    let (data, revision) = match subject {
        Subject::Alert(id) => {
            let alert = store.alert(*id).await?;
            let revision = alert.as_ref().map(AlertRecord::shown_revision);
            (alert.map(|alert| forms.alert(alert)), revision)
        }
        Subject::Batch(route, id) => {
            let batch = store.batch(route, id).await?;
            let alerts = store.batch_alerts(route, id).await?;
            (batch.map(|batch| forms.batch(batch, &alerts)), None)
        }
        Subject::Vehicle(route, id) => {
            let vehicle = store.vehicle(route, id).await?;
            (vehicle.map(|vehicle| forms.vehicle(vehicle)), None)
        }
        Subject::Operation(id) => {
            let operation = store.operation(*id).await?;
            (operation.map(|operation| forms.operation(operation)), None)
        }
    };
    Ok((data.transpose()?, revision))
}

fn test_data(next: &NextDelivery) -> Result<String, serde_json::Error> {
    serde_json::to_string(&TestData {
        webhook_id: next.webhook_id.to_string(),
        message: "If you can check the signature of this, events will arrive as well.",
    })
}

/// The members and their order as Standard Webhooks recommends them, and where people see more. Names of
/// events and times have no character that JSON escapes.
fn envelope(
    event: WebhookEvent,
    at: Timestamp,
    url: Option<&str>,
    data: &str,
) -> Result<String, serde_json::Error> {
    let (kind, url) = (event.name(), serde_json::to_string(&url)?);
    Ok(format!(
        r#"{{"type":"{kind}","timestamp":"{at}","url":{url},"data":{data}}}"#
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::WebhookTopic;

    #[test]
    fn the_envelope_is_json_and_leaves_the_data_alone() {
        let at = Timestamp::from_microsecond(1_795_154_409_000_250).unwrap();
        let event = WebhookEvent::Topic(WebhookTopic::AlertUpdated);
        let url = Some("https://maps.example.com/#/alerts/1");
        let body = envelope(event, at, url, r#"{"b":1e-9,"a":"\"ü"}"#).unwrap();
        assert!(body.contains(r#"{"b":1e-9,"a":"\"ü"}"#));
        let value: serde_json::Value = serde_json::from_str(&body).unwrap();
        assert_eq!(value["type"], "alert.updated");
        assert_eq!(value["timestamp"], "2026-11-20T06:00:09.00025Z");
        assert_eq!(value["data"]["a"], "\"ü");
        assert_eq!(value["url"], "https://maps.example.com/#/alerts/1");
        let body = envelope(event, at, None, "{}").unwrap();
        assert!(body.contains(r#""url":null"#), "{body}");
    }
}
