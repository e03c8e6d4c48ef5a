//! What all handlers share.

use std::net::IpAddr;
use std::sync::Arc;

use metrics_exporter_prometheus::PrometheusHandle;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::Limits;
use super::access::{AccessOptions, Hosts, SignIns, TrustedProxies};
use super::gate::Gate;
use super::map_cache::MapCache;
use super::offload::Offload;
use super::problem::Problem;
use super::shares::Shares;
use crate::ids::RouteId;
use crate::pipeline::{Decisions, Operations};
use crate::store::{RouteRecord, Store};
use crate::webhooks::ReceiverPolicy;

/// What all handlers share; cheap to clone.
#[derive(Clone)]
pub struct ApiState(Arc<Shared>);

/// The parts of [`ApiState`].
pub struct Shared {
    /// The database.
    pub store: Store,
    /// How much the service takes on.
    pub limits: Limits,
    /// Cancelled once the service accepts no new requests.
    pub draining: CancellationToken,
    /// The source of `/metrics`.
    pub metrics: PrometheusHandle,
    /// Carries out decisions about alerts.
    pub decisions: Decisions,
    /// Carries out long work.
    pub operations: Operations,
    /// Which addresses webhooks may have.
    pub receivers: ReceiverPolicy,
    /// The names of the service.
    pub(super) hosts: Hosts,
    /// The proxies that are trusted to identify people.
    pub(super) proxies: TrustedProxies,
    /// Failed sign-ins.
    pub(super) sign_ins: SignIns,
    /// Uploads that may be under way.
    pub(super) upload_slots: Shares,
    /// Bytes of uploads as they are sent.
    pub(super) wire_budget: Shares,
    /// Kibibytes of decompressed uploads.
    pub(super) body_budget: Arc<Semaphore>,
    /// Recordings that may be under way.
    pub(super) recordings: Shares,
    /// Converts recordings to batches, one at a time.
    pub(super) transcoding: Offload,
    /// Decodes uploads.
    pub(super) decoding: Offload,
    /// Makes pictures and large documents.
    pub(super) rendering: Offload,
    /// Reads of a few rows.
    pub(super) short_reads: Gate,
    /// Reads of pictures, series and evidence.
    pub(super) heavy_reads: Gate,
    /// Reads of whole graphs and trajectories.
    pub(super) exports: Gate,
    /// Streams of alerts that may be open.
    pub(super) streams: Shares,
    /// Pictures of maps.
    pub(super) maps: MapCache,
}

/// How the interface is set up.
pub struct ApiSettings {
    /// How much the service takes on.
    pub limits: Limits,
    /// Which addresses webhooks may have.
    pub receivers: ReceiverPolicy,
    /// The address that the service listens on.
    pub listen: IpAddr,
    /// The names under which it is reached, and which proxies are trusted.
    pub access: AccessOptions,
}

impl ApiState {
    /// The state of a service.
    pub fn new(
        store: Store,
        settings: ApiSettings,
        draining: CancellationToken,
        metrics: PrometheusHandle,
        decisions: Decisions,
        operations: Operations,
    ) -> Self {
        let ApiSettings {
            limits,
            receivers,
            listen,
            access,
        } = settings;
        let requests = |name, whole| Shares::of_requests(name, whole, limits.share(whole));
        let wire_bytes = limits.wire_bytes_total;
        // The largest upload fits into every share.
        let wire_share = limits.share(wire_bytes).max(limits.wire_bytes);
        Self(Arc::new(Shared {
            upload_slots: requests("uploads", limits.uploads),
            wire_budget: Shares::of_bytes("upload-bytes", wire_bytes, wire_share),
            body_budget: Arc::new(Semaphore::new(limits.body_bytes_total >> 10)),
            recordings: requests("recordings", limits.recordings),
            transcoding: Offload::new(1),
            decoding: Offload::new(limits.decoders),
            rendering: Offload::new(2),
            short_reads: Gate::new("short-reads", limits.short_reads, &limits),
            heavy_reads: Gate::new("heavy-reads", limits.heavy_reads, &limits),
            exports: Gate::new("exports", limits.exports, &limits),
            streams: requests("streams", limits.streams),
            maps: MapCache::default(),
            store,
            limits,
            draining,
            metrics,
            decisions,
            operations,
            receivers,
            hosts: Hosts::new(listen, access.public_url),
            proxies: access.proxies,
            sign_ins: SignIns::default(),
        }))
    }

    /// Whether everybody may do everything: no key was ever created, and no proxy is trusted.
    pub(super) fn is_open(&self) -> bool {
        !self.store.has_keys() && self.proxies.networks.is_empty()
    }

    /// A route as it is now.
    ///
    /// # Errors
    /// The [`Problem`] that there is none.
    pub(super) async fn known_route(&self, id: &RouteId) -> Result<RouteRecord, Problem> {
        let route = self.store.route(id).await?;
        route.ok_or_else(Problem::unknown_route)
    }
}

impl std::ops::Deref for ApiState {
    type Target = Shared;
    fn deref(&self) -> &Shared {
        &self.0
    }
}
