//! What all handlers share.

use std::sync::Arc;

use metrics_exporter_prometheus::PrometheusHandle;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::Limits;
use super::alerts::STREAMS_MAX;
use super::export::EXPORTS_MAX;
use super::maps::MapCache;
use super::offload::Offload;
use super::problem::{Problem, ProblemKind};
use crate::ids::RouteId;
use crate::pipeline::{Decisions, Removals};
use crate::store::{RouteRecord, Store};
use crate::webhooks::ReceiverPolicy;

/// What all handlers share; cheap to clone.
#[derive(Clone)]
pub struct ApiState(Arc<Shared>);

/// The parts of [`ApiState`].
pub struct Shared {
    /// Where everything is kept.
    pub store: Store,
    /// How much is taken on.
    pub limits: Limits,
    /// Cancelled once the service takes no new requests.
    pub draining: CancellationToken,
    /// What `/metrics` is read from.
    pub metrics: PrometheusHandle,
    /// Who carries decisions about alerts out.
    pub decisions: Decisions,
    /// Who takes uploads out of maps.
    pub removals: Removals,
    /// Where webhooks may lead.
    pub receivers: ReceiverPolicy,
    /// Uploads that may be under way.
    pub(super) upload_slots: Arc<Semaphore>,
    /// Kibibytes of uploads as they are sent.
    pub(super) wire_budget: Arc<Semaphore>,
    /// Kibibytes of decompressed uploads.
    pub(super) body_budget: Arc<Semaphore>,
    /// Where uploads are decoded.
    pub(super) decoding: Offload,
    /// Where pictures and large documents are made.
    pub(super) rendering: Offload,
    /// Long documents that may be under way.
    pub(super) exports: Arc<Semaphore>,
    /// Streams of alerts that may be open.
    pub(super) streams: Arc<Semaphore>,
    /// Pictures of maps.
    pub(super) maps: MapCache,
}

impl ApiState {
    /// The state of a service.
    pub fn new(
        store: Store,
        limits: Limits,
        draining: CancellationToken,
        metrics: PrometheusHandle,
        decisions: Decisions,
        removals: Removals,
        receivers: ReceiverPolicy,
    ) -> Self {
        Self(Arc::new(Shared {
            upload_slots: Arc::new(Semaphore::new(limits.uploads)),
            wire_budget: Arc::new(Semaphore::new(limits.wire_bytes_total >> 10)),
            body_budget: Arc::new(Semaphore::new(limits.body_bytes_total >> 10)),
            decoding: Offload::new(limits.decoders),
            rendering: Offload::new(2),
            exports: Arc::new(Semaphore::new(EXPORTS_MAX)),
            streams: Arc::new(Semaphore::new(STREAMS_MAX)),
            maps: MapCache::default(),
            store,
            limits,
            draining,
            metrics,
            decisions,
            removals,
            receivers,
        }))
    }

    /// The route, or the problem that there is none.
    pub(super) async fn known_route(&self, id: &RouteId) -> Result<RouteRecord, Problem> {
        let route = self.store.route(id).await?;
        route.ok_or_else(Problem::unknown_route)
    }

    /// The problem of a service that has no capacity left.
    pub(super) fn overloaded(&self) -> Problem {
        Problem::new(
            ProblemKind::Overloaded,
            "too many uploads are under way; send the same again later",
        )
    }
}

impl std::ops::Deref for ApiState {
    type Target = Shared;
    fn deref(&self) -> &Shared {
        &self.0
    }
}
