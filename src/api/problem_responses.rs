//! The problems that operations can answer with, for the OpenAPI document: one set for each kind of operation,
//! which its `responses` name.

use std::collections::BTreeMap;

use utoipa::IntoResponses;
use utoipa::openapi::header::HeaderBuilder;
use utoipa::openapi::schema::Type;
use utoipa::openapi::{ContentBuilder, ObjectBuilder, Ref, RefOr, Response, ResponseBuilder};

use super::problem::{ProblemKind, ProblemKind as K};

/// The problems of every operation.
const ANY: &[ProblemKind] = &[
    K::InvalidParameter,
    K::BadRequest,
    K::Unauthenticated,
    K::Forbidden,
    K::ForeignOrigin,
    K::ForeignHost,
    K::UriTooLong,
    K::TooManyRequests,
    K::HeadersTooLarge,
    K::Internal,
    K::Corrupt,
    K::Overloaded,
    K::ShuttingDown,
];
/// Further problems of an operation that reads a body and stores what is in it.
const BODY: &[ProblemKind] = &[
    K::MalformedJson,
    K::InvalidField,
    K::BodyTimeout,
    K::TooLarge,
    K::UnsupportedMediaType,
    K::UnsupportedEncoding,
    K::OutOfRange,
    K::DiskFull,
];
/// Further problems of an upload of a batch.
const UPLOAD: &[ProblemKind] = &[
    K::UnknownRoute,
    K::BadEncoding,
    K::DigestMismatch,
    K::BatchIdReused,
];

/// A header of responses to requests that can be repeated, and its description.
const RETRY_AFTER: (&str, &str) = (
    "Retry-After",
    "Seconds to wait before the same request is sent again",
);
const WWW_AUTHENTICATE: (&str, &str) = ("WWW-Authenticate", "`Bearer`");
const RATE_LIMIT_POLICY: (&str, &str) = (
    "RateLimit-Policy",
    "How much one client address may have under way (draft-ietf-httpapi-ratelimit-headers-10): `\"uploads\";q=32;qu=\"concurrent-requests\"`",
);
const RATE_LIMIT: (&str, &str) = (
    "RateLimit",
    "How much of it is left, and after how many seconds to try again: `\"uploads\";r=0;t=2`",
);

macro_rules! problem_responses {
    ($($(#[$doc:meta])* $name:ident = $set:expr $(, with $also:ident)*;)+) => { $(
        $(#[$doc])*
        pub(super) struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<Response>> {
                let set: &[ProblemKind] = &$set;
                responses_of(&[ANY, set $(, $also)*].concat())
            }
        }
    )+ };
}

problem_responses! {
    /// Of an operation without parameters in its path.
    AnyProblems = [];
    /// Of checking whether the service is ready.
    ReadinessProblems = [K::NotReady];

    /// Of reading a route, or a list of its parts.
    RouteProblems = [K::InvalidField, K::UnknownRoute];
    /// Of reading a part of a route.
    RoutePartProblems = [K::InvalidField, K::UnknownRoute, K::NotFound];
    /// Of putting a route.
    RoutePutProblems = [K::PreconditionFailed, K::DetectorFixed], with BODY;
    /// Of deleting a route.
    RouteDeletionProblems = [K::InvalidField, K::UnknownRoute, K::PreconditionFailed, K::DiskFull];
    /// Of uploading scans.
    ScanUploadProblems = [K::ScanGeometry, K::TimestampOrder], with UPLOAD, with BODY;
    /// Of uploading a recording.
    RecordingUploadProblems = [
        K::TripTaken,
        K::Recording,
        K::RecordingTopics,
        K::ScanGeometry,
        K::TimestampOrder,
    ], with UPLOAD, with BODY;
    /// Of uploading edges.
    EdgeUploadProblems = [K::EdgeGraph], with UPLOAD, with BODY;

    /// Of trying a batch again.
    RetryProblems = [
        K::InvalidField,
        K::UnknownRoute,
        K::NotFound,
        K::RetryRefused,
        K::DiskFull,
    ];
    /// Of keeping a vehicle's uploads out.
    QuarantineProblems = [K::UnknownRoute, K::NotFound], with BODY;
    /// Of releasing a vehicle.
    ReleaseProblems = [K::InvalidField, K::UnknownRoute, K::NotFound, K::DiskFull];
    /// Of releasing a version of a map.
    VersionReleaseProblems = [K::UnknownRoute, K::NotFound, K::VersionState], with BODY;
    /// Of reading something that only a released version of a map has.
    VersionUseProblems = [K::InvalidField, K::UnknownRoute, K::NotFound, K::VersionState];
    /// Of retiring a version of a map.
    VersionRetirementProblems = [
        K::InvalidField,
        K::UnknownRoute,
        K::NotFound,
        K::VersionState,
        K::DiskFull,
    ];
    /// Of removing uploads.
    RemovalProblems = [K::UnknownRoute], with BODY;
    /// Of reading an operation.
    OperationProblems = [K::InvalidField, K::NotFound];

    /// Of listing or following alerts; the query may name a route.
    AlertListProblems = [K::UnknownRoute];
    /// Of listing alerts in geographic coordinates.
    AlertMapProblems = [K::UnknownRoute, K::NoGeoAnchor];
    /// Of reading an alert, or something that belongs to it.
    AlertProblems = [K::InvalidField, K::NotFound];
    /// Of deciding about an alert.
    DecisionProblems = [
        K::NotFound,
        K::PreconditionRequired,
        K::PreconditionFailed,
        K::TransitionNotAllowed,
    ], with BODY;

    /// Of previewing an acceptance.
    PreviewProblems = [K::InvalidField, K::NotFound, K::TransitionNotAllowed];
    /// Of assigning an alert, or commenting on it.
    HandlingProblems = [K::NotFound], with BODY;
    /// Of creating a zone.
    ZoneCreationProblems = [K::UnknownRoute, K::TooManyZones], with BODY;
    /// Of replacing a zone.
    ZonePutProblems = [K::UnknownRoute, K::NotFound, K::PreconditionFailed], with BODY;
    /// Of deleting a zone.
    ZoneDeletionProblems = [
        K::InvalidField,
        K::UnknownRoute,
        K::NotFound,
        K::PreconditionFailed,
        K::DiskFull,
    ];
    /// Of deciding about several alerts.
    DecisionsProblems = [], with BODY;

    /// Of reading a key.
    KeyProblems = [K::InvalidField, K::NotFound];
    /// Of creating a key.
    KeyCreationProblems = [K::FirstKey], with BODY;
    /// Of revoking a key.
    KeyRevocationProblems = [K::InvalidField, K::NotFound, K::DiskFull];
    /// Of beginning a session.
    SignInProblems = [K::TooManySignIns], with BODY;
    /// Of ending a session.
    SignOutProblems = [K::DiskFull];

    /// Of reading a webhook, or its deliveries.
    WebhookProblems = [K::InvalidField, K::NotFound];
    /// Of registering a webhook.
    WebhookRegistrationProblems = [K::UnknownRoute, K::TooManyWebhooks, K::WebhookUrlRefused], with BODY;
    /// Of changing a webhook.
    WebhookChangeProblems = [K::NotFound, K::PreconditionFailed, K::WebhookUrlRefused], with BODY;
    /// Of replacing a webhook's secret.
    WebhookRotationProblems = [K::NotFound, K::PreconditionFailed], with BODY;
    /// Of deleting a webhook.
    WebhookDeletionProblems = [K::InvalidField, K::NotFound, K::PreconditionFailed, K::DiskFull];
    /// Of testing a webhook.
    WebhookTestProblems = [K::InvalidField, K::NotFound, K::WebhookDisabled, K::DiskFull];
}

/// A response for each status, with all problems of that status.
fn responses_of(kinds: &[ProblemKind]) -> BTreeMap<String, RefOr<Response>> {
    let mut by_status: BTreeMap<u16, Vec<ProblemKind>> = BTreeMap::new();
    for kind in K::ALL.iter().filter(|kind| kinds.contains(kind)) {
        let status = kind.status().as_u16();
        by_status.entry(status).or_default().push(*kind);
    }
    by_status
        .into_iter()
        .map(|(status, kinds)| (status.to_string(), response(status, &kinds).into()))
        .collect()
}

fn response(status: u16, kinds: &[ProblemKind]) -> Response {
    let sentence = |kind: &ProblemKind| format!("`{}`: {}", kind.name(), kind.title());
    let description: Vec<_> = kinds.iter().map(sentence).collect();
    let problem = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem")));
    let response = ResponseBuilder::new()
        .description(description.join(". "))
        .content("application/problem+json", problem.build());
    let headers: &[(&str, &str)] = match status {
        401 => &[WWW_AUTHENTICATE],
        503 | 507 => &[RETRY_AFTER],
        429 => &[RETRY_AFTER, RATE_LIMIT_POLICY, RATE_LIMIT],
        _ => &[],
    };
    let with_header = |response: ResponseBuilder, (name, description): &(&str, &str)| {
        let header = HeaderBuilder::new()
            .description(Some(*description))
            .schema(Some(ObjectBuilder::new().schema_type(Type::String)));
        response.header(*name, header.build())
    };
    headers.iter().fold(response, with_header).build()
}
