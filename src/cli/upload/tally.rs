//! The outcome of an upload.

use std::time::Instant;

use crate::cli::progress::say;
use crate::client::{Gateway, GatewayError};
use crate::ids::{BatchId, RouteId};

/// Counts, and what was refused.
#[derive(Debug)]
pub(super) struct Tally {
    pub started: Instant,
    /// Whether the route is known to exist.
    pub has_route: bool,
    pub scans_stored: usize,
    pub nodes_stored: usize,
    pub batches: Vec<BatchId>,
    pub stored: usize,
    pub replayed: usize,
    pub failures: Vec<String>,
}

impl Tally {
    /// The tally before an upload.
    pub(super) fn begin() -> Self {
        Self {
            started: Instant::now(),
            has_route: false,
            scans_stored: 0,
            nodes_stored: 0,
            batches: Vec::new(),
            stored: 0,
            replayed: 0,
            failures: Vec::new(),
        }
    }

    /// Creates the route if it does not exist, once there is something to send.
    ///
    /// # Errors
    /// If the service cannot be reached, or refuses to make the route.
    pub(super) async fn ensure_route(
        &mut self,
        gateway: &Gateway,
        route: &RouteId,
    ) -> Result<(), GatewayError> {
        if !self.has_route {
            if gateway.ensure_route(route, None).await? {
                say(&format!("route {route} was made"));
            }
            self.has_route = true;
        }
        Ok(())
    }

    /// What was stored, for people.
    pub(super) fn content(&self) -> String {
        let nodes = format!("{} nodes", self.nodes_stored);
        let scans = format!("{} scans", self.scans_stored);
        match (self.scans_stored, self.nodes_stored) {
            (_, 0) => scans,
            (0, _) => nodes,
            _ => format!("{scans}, {nodes}"),
        }
    }
}

/// What may help against a refusal.
pub(super) fn advice(error: &GatewayError) -> &'static str {
    match error {
        GatewayError::Refused { problem, .. } if problem.status == 409 => {
            " (another drive has this name, or it was sent with other options: --trip chooses \
             another name)"
        }
        _ => "",
    }
}
