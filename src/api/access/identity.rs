//! The sender of a request, and what they may read.

use std::convert::Infallible;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use jiff::Timestamp;

use crate::api::client_address::ClientAddress;
use crate::api::problem::{Problem, ProblemKind};
use crate::ids::{KeyId, RouteId, VehicleId};
use crate::model::{Actor, Role};
use crate::store::{KeyRecord, SessionRecord};

/// The sender of a request. The layer `admit` adds it; without that layer the sender is nobody.
#[derive(Debug, Clone)]
pub(in crate::api) struct Identity {
    who: Who,
    /// Their role; `None` for nobody, and for somebody without a role.
    pub role: Option<Role>,
    /// The routes that they are limited to; `None` for all.
    pub routes: Option<Vec<RouteId>>,
    /// When the identity expires.
    pub expires_at: Option<Timestamp>,
    /// The vehicle that they upload for; `None` for any.
    vehicle_id: Option<VehicleId>,
}

#[derive(Debug, Clone)]
enum Who {
    Nobody,
    Local,
    Key { id: KeyId, name: String },
    Proxy { name: String },
}

impl Identity {
    /// A sender who is not identified.
    pub(super) fn nobody() -> Self {
        Self::new(Who::Nobody, None)
    }

    /// Any sender to a service that is open.
    pub(super) fn local() -> Self {
        Self::new(Who::Local, Some(Role::Admin))
    }

    /// A person whom a trusted proxy has signed in.
    pub(super) fn of_proxy(name: String, role: Option<Role>) -> Self {
        Self::new(Who::Proxy { name }, role)
    }

    /// The holder of a key.
    pub(in crate::api) fn of_key(key: KeyRecord) -> Self {
        let (id, name) = (key.id, key.name);
        Self {
            vehicle_id: key.vehicle_id,
            routes: key.routes,
            expires_at: key.expires_at,
            ..Self::new(Who::Key { id, name }, Some(key.role))
        }
    }

    /// A person who has signed in with a key.
    pub(in crate::api) fn of_session(session: SessionRecord) -> Self {
        Self {
            expires_at: Some(session.expires_at()),
            ..Self::of_key(session.key)
        }
    }

    fn new(who: Who, role: Option<Role>) -> Self {
        Self {
            who,
            role,
            routes: None,
            expires_at: None,
            vehicle_id: None,
        }
    }

    /// Their name, if they have signed in.
    pub(in crate::api) fn name(&self) -> Option<&str> {
        match &self.who {
            Who::Nobody | Who::Local => None,
            Who::Key { name, .. } | Who::Proxy { name } => Some(name),
        }
    }

    /// Whether they may read what belongs to a route.
    pub(in crate::api) fn sees(&self, route: &RouteId) -> bool {
        let routes = self.routes.as_ref();
        routes.is_none_or(|routes| routes.contains(route))
    }

    /// Refuses a route that they may not read, as if it did not exist.
    ///
    /// # Errors
    /// The [`Problem`] of an unknown route.
    pub(in crate::api) fn check_route(&self, route: &RouteId) -> Result<(), Problem> {
        match self.sees(route) {
            true => Ok(()),
            false => Err(Problem::unknown_route()),
        }
    }

    /// The one vehicle whose uploads they may read; `None` for all.
    pub(in crate::api) fn own_vehicle(&self) -> Option<&VehicleId> {
        self.vehicle_id.as_ref()
    }

    /// Whether they upload for one vehicle, and this is another.
    pub(in crate::api) fn is_foreign(&self, vehicle: &VehicleId) -> bool {
        self.own_vehicle().is_some_and(|own| own != vehicle)
    }

    /// Refuses uploads for vehicles other than their own.
    ///
    /// # Errors
    /// A [`Problem`] that names the vehicle.
    pub(in crate::api) fn check_upload(&self, vehicle: &VehicleId) -> Result<(), Problem> {
        match &self.vehicle_id {
            Some(own) if own != vehicle => {
                let detail = format!("this key uploads only for vehicle {own}, not for {vehicle}");
                Err(Problem::new(ProblemKind::Forbidden, detail).at("/vehicle_id"))
            }
            _ => Ok(()),
        }
    }

    /// The actor for the audit.
    fn actor(&self, address: ClientAddress) -> Actor {
        let address = address.to_string();
        match self.who.clone() {
            Who::Nobody | Who::Local => Actor::Local { address },
            Who::Key { id, name } => Actor::Key { id, name, address },
            Who::Proxy { name } => Actor::Proxy { name, address },
        }
    }
}

impl<S: Sync> FromRequestParts<S> for Identity {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let stated = parts.extensions.get::<Self>().cloned();
        Ok(stated.unwrap_or_else(Self::nobody))
    }
}

impl<S: Sync> FromRequestParts<S> for Actor {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Infallible> {
        let address = ClientAddress::from_request_parts(parts, state).await?;
        let identity = Identity::from_request_parts(parts, state).await?;
        Ok(identity.actor(address))
    }
}
