//! The HTTP interface: one file per resource, one error type, the OpenAPI document, the console.
//!
//! Uses the store, the pipeline's [`Decisions`](crate::pipeline::Decisions) and
//! [`Operations`](crate::pipeline::Operations), and the policy for addresses of webhooks
//! ([`ReceiverPolicy`](crate::webhooks::ReceiverPolicy)); knows nothing of matching, solving and workers. Begin with
//! [`router`]: it lists the operations and the layers around them.

mod access;
mod alerts;
mod audit;
mod batch_body;
mod batch_intake;
mod batch_upload;
mod batches;
mod bounding_box;
mod client_address;
mod compression;
mod documents;
mod edge_batches;
mod edges;
mod entity_tags;
mod enum_schemas;
mod export;
mod extract;
mod filters;
mod gate;
mod graph;
mod if_match;
mod keys;
mod known_route;
mod layers;
mod limits;
mod map_cache;
mod map_files;
mod map_layers;
mod map_validity;
mod maps;
mod nodes;
mod note;
mod offload;
mod openapi;
mod operation;
mod operations;
mod paging;
mod parameters;
pub mod problem;
mod problem_kinds;
mod problem_pages;
mod problem_responses;
mod quarantines;
mod quota;
mod raw_answer;
mod reading;
mod recordings;
mod releases;
mod removals;
mod report;
mod residuals;
mod retries;
mod route_body;
mod route_put;
mod routes;
mod session;
mod shares;
mod shown_map;
mod state;
mod subgraphs;
mod tiles;
mod trajectories;
mod transcoding;
mod trips;
mod types;
mod upload;
mod vda5050;
mod vehicles;
mod version_diff;
mod version_maps;
mod versions;
mod webhooks;
mod words;
mod zone_body;
mod zones;

use std::sync::Arc;

use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use tower_http::catch_panic::CatchPanicLayer;
use utoipa::OpenApi as _;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

pub use access::{
    AccessOptions, GroupRole, InvalidGroupRole, InvalidNetwork, InvalidUrl, Network, PublicUrl,
    TrustedProxies,
};
pub use alerts::alert_text;
pub use client_address::{ClientAddress, PeerAddress};
pub use limits::{Limits, Pace, Reads};
pub use quota::Quota;
pub use raw_answer::raw_answer;
pub use reading::Held;
pub use state::{ApiSettings, ApiState};
pub use webhooks::EventForms;

use access::Rules;
use reading::Weight;

/// Operations that write, or read a few rows.
fn short_operations() -> OpenApiRouter<ApiState> {
    route_operations()
        .merge(alert_operations())
        .merge(access_operations())
}

/// Routes, what is uploaded to them, and their maps.
fn route_operations() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(routes::list_routes))
        .routes(routes!(
            routes::put_route,
            routes::get_route,
            routes::delete_route
        ))
        .routes(routes!(batches::list_batches))
        .routes(routes!(batches::put_batch, batches::get_batch))
        .routes(routes!(recordings::put_recording))
        .routes(routes!(retries::retry_batch))
        .routes(routes!(edge_batches::put_edge_batch))
        .routes(routes!(removals::post_removal))
        .routes(routes!(quarantines::quarantine_vehicle))
        .routes(routes!(quarantines::release_vehicle))
        .routes(routes!(operation::get_operation))
        .routes(routes!(nodes::list_nodes))
        .routes(routes!(nodes::get_node))
        .routes(routes!(nodes::get_node_scan))
        .routes(routes!(edges::list_edges))
        .routes(routes!(edges::get_edge))
        .routes(routes!(versions::list_versions))
        .routes(routes!(versions::get_version))
        .routes(routes!(vda5050::get_vda5050))
        .routes(routes!(releases::release_version))
        .routes(routes!(releases::retire_version))
}

/// Alerts, decisions about them, and webhooks.
fn alert_operations() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(alerts::list_alerts))
        .routes(routes!(alerts::list_alerts_geojson))
        .routes(routes!(alerts::get_alert))
        .routes(routes!(alerts::list_alert_passes))
        .routes(routes!(alerts::acknowledge_alert))
        .routes(routes!(alerts::accept_alert))
        .routes(routes!(alerts::dismiss_alert))
        .routes(routes!(alerts::reopen_alert))
        .routes(routes!(alerts::undo_alert))
        .routes(routes!(alerts::decide_alerts))
        .routes(routes!(alerts::assign_alert))
        .routes(routes!(
            alerts::list_alert_comments,
            alerts::comment_on_alert
        ))
        .routes(routes!(zones::list_zones, zones::create_zone))
        .routes(routes!(
            zones::get_zone,
            zones::put_zone,
            zones::delete_zone
        ))
        .routes(routes!(webhooks::list_webhooks, webhooks::register_webhook))
        .routes(routes!(
            webhooks::get_webhook,
            webhooks::change_webhook,
            webhooks::delete_webhook
        ))
        .routes(routes!(webhooks::test_webhook))
        .routes(routes!(webhooks::rotate_webhook_secret))
        .routes(routes!(webhooks::list_deliveries))
}

/// The audit, sessions and keys.
fn access_operations() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(audit::list_audit))
        .routes(routes!(
            session::get_session,
            session::sign_in,
            session::sign_out
        ))
        .routes(routes!(keys::list_keys, keys::create_key))
        .routes(routes!(keys::get_key, keys::revoke_key))
}

/// Operations that draw, or compute from many rows.
fn heavy_operations() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(subgraphs::list_subgraphs))
        .routes(routes!(vehicles::list_vehicles))
        .routes(routes!(trips::list_trips))
        .routes(routes!(vehicles::get_vehicle))
        .routes(routes!(residuals::get_residuals))
        .routes(routes!(maps::get_map_png))
        .routes(routes!(maps::get_map_pgm))
        .routes(routes!(maps::get_map_yaml))
        .routes(routes!(tiles::get_tiles))
        .routes(routes!(tiles::get_tile))
        .routes(routes!(map_layers::get_trajectory_layer))
        .routes(routes!(map_layers::get_residual_layer))
        .routes(routes!(map_layers::get_keyframe_layer))
        .routes(routes!(version_diff::get_version_diff))
        .routes(routes!(version_diff::get_version_diff_png))
        .routes(routes!(version_maps::get_version_png))
        .routes(routes!(version_maps::get_version_pgm))
        .routes(routes!(version_maps::get_version_yaml))
        .routes(routes!(alerts::preview_alert))
        .routes(routes!(report::get_report))
        .routes(routes!(alerts::get_evidence))
        .routes(routes!(alerts::get_evidence_svg))
        .routes(routes!(alerts::get_observations))
        .routes(routes!(alerts::get_observations_svg))
}

/// Operations whose answer grows with the age of a route.
fn export_operations() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(graph::get_graph))
        .routes(routes!(graph::get_graph_g2o))
        .routes(routes!(trajectories::get_trajectory))
        .routes(routes!(trajectories::get_trajectory_tum))
        .routes(routes!(audit::export_audit))
}

/// Operations that never wait for others: health, and streams, which have limits of their own.
fn unlimited_operations() -> OpenApiRouter<ApiState> {
    OpenApiRouter::with_openapi(openapi::Document::openapi())
        .routes(routes!(alerts::stream_alerts))
        .routes(routes!(operations::livez))
        .routes(routes!(operations::readyz))
        .routes(routes!(operations::metrics))
}

/// All operations with their documentation; `surround` adds the layers around those of a weight.
fn operations(
    surround: impl Fn(OpenApiRouter<ApiState>, Weight) -> OpenApiRouter<ApiState>,
) -> OpenApiRouter<ApiState> {
    unlimited_operations()
        .merge(surround(short_operations(), Weight::Short))
        .merge(surround(heavy_operations(), Weight::Heavy))
        .merge(surround(export_operations(), Weight::Export))
}

/// The OpenAPI document.
///
/// # Errors
/// If it does not serialise.
pub fn openapi_document() -> Result<serde_json::Value, serde_json::Error> {
    openapi::complete(operations(|router, _| router).get_openapi())
}

/// The service's router, with all layers around its handlers.
///
/// # Errors
/// If the OpenAPI document, or the console's words, do not serialise.
pub fn router(state: ApiState) -> Result<Router, serde_json::Error> {
    let document = openapi_document()?;
    let rules = Arc::new(Rules::of(&document));
    let document = serde_json::to_vec(&document)?;
    let limited = |router: OpenApiRouter<ApiState>, weight| {
        router
            .route_layer(from_fn_with_state(state.clone(), known_route::require))
            .route_layer(from_fn_with_state((state.clone(), weight), reading::limit))
    };
    let (router, _) = operations(limited).split_for_parts();
    Ok(router
        .route_layer(from_fn_with_state((state.clone(), rules), access::admit))
        .merge(documents::router(document.into(), words::script()?.into()))
        .merge(problem_pages::router())
        .fallback(layers::unknown_path)
        .method_not_allowed_fallback(layers::unknown_method)
        .layer(from_fn(paging::link_next))
        .layer(from_fn(entity_tags::tag_answers))
        .layer(from_fn_with_state(state.clone(), access::check_origin))
        .layer(from_fn_with_state(state.clone(), layers::limit_time))
        .layer(CatchPanicLayer::custom(layers::problem_of_panic))
        .layer(from_fn(layers::limit_uri))
        .layer(from_fn_with_state(
            state.clone(),
            layers::refuse_while_draining,
        ))
        .layer(from_fn(layers::observe))
        .layer(from_fn(compression::compress))
        .with_state(state))
}
