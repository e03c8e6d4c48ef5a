//! Creates, lists and revokes keys over HTTP.

use jiff::Timestamp;
use reqwest::Method;
use serde::{Deserialize, Serialize};

use super::{Answer, Gateway, GatewayError, Request};
use crate::ids::{KeyId, RouteId, VehicleId};
use crate::model::Role;

/// A key to create.
#[derive(Debug, Clone, Serialize)]
pub struct KeyRequest {
    pub name: String,
    pub role: Role,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vehicle_id: Option<VehicleId>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub routes: Option<Vec<RouteId>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<Timestamp>,
}

/// A key as listed.
#[derive(Debug, Clone, Deserialize)]
pub struct KeyReport {
    pub id: KeyId,
    pub name: String,
    pub role: Role,
    pub vehicle_id: Option<VehicleId>,
    pub routes: Option<Vec<RouteId>>,
    pub last_used_at: Option<Timestamp>,
    pub expires_at: Option<Timestamp>,
    pub revoked_at: Option<Timestamp>,
    /// The secret, right after creation.
    pub key: Option<String>,
}

/// One page of keys, and the cursor of the next.
#[derive(Deserialize)]
struct KeyPage {
    items: Vec<KeyReport>,
    next_cursor: Option<String>,
}

impl Gateway {
    /// Creates a key.
    pub async fn create_key(&self, key: &KeyRequest) -> Result<KeyReport, GatewayError> {
        let what = || format!("the key of {}", key.name);
        let unreadable = |source| GatewayError::Answer {
            what: what(),
            url: self.url.clone(),
            source,
        };
        let body = serde_json::to_vec(key).map_err(unreadable)?;
        let request = Request {
            method: Method::POST,
            path: "/v1/keys".to_owned(),
            what: what(),
            body: Some(&body),
            gzip: false,
        };
        let Answer { body, .. } = self.send(request).await?;
        serde_json::from_slice(&body).map_err(unreadable)
    }

    /// All keys, the oldest first.
    pub async fn keys(&self) -> Result<Vec<KeyReport>, GatewayError> {
        let (mut keys, mut cursor) = (Vec::new(), String::new());
        loop {
            let path = format!("/v1/keys?limit=1000{cursor}");
            let page: KeyPage = self.get(path, "the list of keys".to_owned()).await?;
            keys.extend(page.items);
            match page.next_cursor {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return Ok(keys),
            }
        }
    }

    /// Revokes a key.
    pub async fn revoke_key(&self, id: KeyId) -> Result<(), GatewayError> {
        let request = Request {
            method: Method::DELETE,
            path: format!("/v1/keys/{id}"),
            what: format!("key {id}"),
            body: None,
            gzip: false,
        };
        self.send(request).await.map(|_| ())
    }
}
