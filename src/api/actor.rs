//! Who sends a request, as the audit has it.

use std::convert::Infallible;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;

use super::client_address::ClientAddress;
use crate::model::Actor;

impl<S: Sync> FromRequestParts<S> for Actor {
    type Rejection = Infallible;

    /// Nobody has a key yet: all that is known is the address.
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Infallible> {
        let address = ClientAddress::from_request_parts(parts, state).await?;
        Ok(Self::Local {
            address: address.to_string(),
        })
    }
}
