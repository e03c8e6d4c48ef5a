//! Parameters that several operations have, for the OpenAPI document. Handlers read the path and the headers
//! themselves; parameters of queries are declared where they are read.

// Only the derived descriptions are used, never a value.
#![allow(dead_code)]

use utoipa::IntoParams;

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct RouteParam {
    /// Name of the route
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    route: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct BatchParam {
    /// Name of the batch, chosen by the client
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    batch: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct TripParam {
    /// Name of the trip
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    trip: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct VehicleParam {
    /// Name of the vehicle
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct OperationParam {
    /// Id of the operation
    #[param(format = "uuid")]
    operation: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct NodeParam {
    /// Id of the node
    node: i64,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct EdgeParam {
    /// Id of the edge
    edge: i64,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct VersionParam {
    /// A version of the map: its number in the list of versions
    #[param(minimum = 1)]
    version: i64,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct AlertParam {
    /// Id of the alert
    #[param(format = "uuid")]
    alert: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct KeyParam {
    /// Id of the key
    #[param(format = "uuid")]
    key: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct WebhookParam {
    /// Id of the webhook
    #[param(format = "uuid")]
    webhook: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct ZoneParam {
    /// Id of the zone
    #[param(format = "uuid")]
    zone: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
pub(super) struct IfMatch {
    /// Refuse the request unless this is still the ETag
    #[param(rename = "If-Match", nullable = false)]
    if_match: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
pub(super) struct IfAlertMatches {
    /// The alert's ETag, as it was read
    #[param(rename = "If-Match")]
    if_match: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
pub(super) struct IfNoneMatch {
    /// Answer 304 without a body if this is still the ETag
    #[param(rename = "If-None-Match", nullable = false)]
    if_none_match: Option<String>,
}

/// How a recording is sent.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
pub(super) struct RecordingHeaders {
    /// The digest of the file as `sha-256=:BASE64:` (RFC 9530)
    #[param(rename = "Content-Digest", nullable = false)]
    content_digest: Option<String>,
}

/// How the body of an upload is sent.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
pub(super) struct UploadHeaders {
    /// `gzip`, `zstd` or `identity`
    #[param(
        rename = "Content-Encoding",
        nullable = false,
        pattern = "^(gzip|zstd|identity)$"
    )]
    content_encoding: Option<String>,
    /// The digest of the bytes as they are sent, as `sha-256=:BASE64:` (RFC 9530)
    #[param(rename = "Content-Digest", nullable = false)]
    content_digest: Option<String>,
}
