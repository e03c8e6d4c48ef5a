//! The table of problems: the `type`, status and title of each, and the text of its page. The OpenAPI document,
//! `/problems` and `docs/reference/problems.md` are made from it.

use axum::http::StatusCode;

/// Whether repeating the same request helps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeating {
    /// The request is refused again.
    Never,
    /// The request is served once something else has changed.
    AfterChange,
    /// The request is served later.
    Later,
}

impl Repeating {
    /// The answer for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Never => "No: the same request is refused again.",
            Self::AfterChange => "Only after something that the request depends on has changed.",
            Self::Later => {
                "Yes: send the same request again after the seconds given in Retry-After, or after a few seconds without that header, and wait longer each time. Uploads keep their id, so that nothing is stored twice."
            }
        }
    }
}

macro_rules! problem_kinds {
    ($($kind:ident = $status:ident, $name:literal, $title:literal, $repeating:ident, $cause:literal, $remedy:literal;)*) => {
        /// The stable kinds of problem: each has its `type`, status and title.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[allow(missing_docs)]
        pub enum ProblemKind { $($kind,)* }

        impl ProblemKind {
            /// All kinds.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// The last part of the `type` URI.
            pub fn name(self) -> &'static str {
                match self { $(Self::$kind => $name,)* }
            }

            /// The HTTP status.
            pub fn status(self) -> StatusCode {
                match self { $(Self::$kind => StatusCode::$status,)* }
            }

            /// The title, the same for every occurrence.
            pub fn title(self) -> &'static str {
                match self { $(Self::$kind => $title,)* }
            }

            /// Whether repeating the same request helps.
            pub fn repeating(self) -> Repeating {
                match self { $(Self::$kind => Repeating::$repeating,)* }
            }

            /// What happened, for the page of the problem.
            pub fn cause(self) -> &'static str {
                match self { $(Self::$kind => $cause,)* }
            }

            /// What to do about it.
            pub fn remedy(self) -> &'static str {
                match self { $(Self::$kind => $remedy,)* }
            }
        }
    };
}

problem_kinds! {
    MalformedJson = BAD_REQUEST, "malformed-json", "The body is not the JSON that is expected", Never,
        "The body is not a single JSON document in UTF-8, or it has an unknown field, or the same field twice.",
        "Correct the place that `errors` names. A beam without a return is `null`: NaN and Infinity are not JSON.";
    InvalidField = BAD_REQUEST, "invalid-field", "A field is missing or has the wrong form", Never,
        "A field of the body or a part of the path is missing, does not have the documented type, or cannot be combined with another field.",
        "Correct the place that `errors` names; the OpenAPI document describes the form of every field.";
    InvalidParameter = BAD_REQUEST, "invalid-parameter", "A query parameter is not usable", Never,
        "A query parameter is unknown to this operation, occurs twice, or has a value outside its range.",
        "Correct or remove the parameter that `errors` or `detail` names. Send a cursor exactly as `next_cursor` gave it.";
    BadEncoding = BAD_REQUEST, "bad-encoding", "The body does not decompress", Never,
        "The body does not have the encoding in `Content-Encoding`, is truncated, or expands to more than 20 times its size.",
        "Compress the body once, as a whole, with gzip or zstd; send a body that compresses better than 20:1 uncompressed.";
    DigestMismatch = BAD_REQUEST, "digest-mismatch", "The body does not match its digest", Later,
        "`Content-Digest` is malformed, or the bytes that arrived have a different SHA-256.",
        "If the header is well formed, the body was changed on the way: send it again. The digest is that of the bytes as sent, after compression.";
    BadRequest = BAD_REQUEST, "bad-request", "The request is not usable", Never,
        "The request is not well-formed HTTP, or breaks a rule that no other problem names.",
        "Read `detail`; the cause is more often the sender's HTTP library or a proxy than the data.";
    Unauthenticated = UNAUTHORIZED, "unauthenticated", "The request does not say who sends it", AfterChange,
        "The operation needs a key, and the request has none, or one that is unknown, expired or revoked.",
        "Send `Authorization: Bearer` with a valid key, or sign in to the console. An administrator creates keys with `POST /v1/keys` or `mapshift keys create`.";
    Forbidden = FORBIDDEN, "forbidden", "The sender may not do this", AfterChange,
        "The key is valid, but its role, its vehicle or its routes do not cover this operation.",
        "Use a key with the role that `detail` names, or ask an administrator for one.";
    ForeignOrigin = FORBIDDEN, "foreign-origin", "The request comes from another site", Never,
        "A browser sent a change for a page that does not belong to this service.",
        "Programs send a key and no `Origin`. If people reach the service under another name, start it with `--public-url`.";
    UnknownRoute = NOT_FOUND, "unknown-route", "There is no such route", AfterChange,
        "The route was never created, was deleted, or is not among those that the key is limited to.",
        "Check the name; `PUT /v1/routes/{route}` creates a route. A gateway keeps its uploads until the route exists.";
    NotFound = NOT_FOUND, "not-found", "Not found", AfterChange,
        "The path does not exist, or what it names never existed or was removed.",
        "Check the path against the OpenAPI document, and the id against the list that it came from.";
    MethodNotAllowed = METHOD_NOT_ALLOWED, "method-not-allowed", "The path does not have this method", Never,
        "The path exists, but not with this method.",
        "Use one of the methods in the header `Allow`.";
    BodyTimeout = REQUEST_TIMEOUT, "request-timeout", "The request took too long to arrive", Later,
        "The body arrived too slowly, or stopped arriving.",
        "Send it again over a better link, compress it, or send smaller batches.";
    TripTaken = CONFLICT, "trip-taken", "The trip already has batches", Never,
        "A recording is a whole trip, and this trip of the vehicle has batches that do not belong to this recording. What is stored does not change.",
        "Give the recording a `trip_id` of its own.";
    BatchIdReused = CONFLICT, "batch-id-reused", "The batch id is already in use", Never,
        "A batch with this id is stored on this route, and its content differs from what was sent now. What is stored does not change.",
        "Give the new data an id of its own. If this happens for a repeated upload, the gateway has changed the bytes between attempts.";
    FirstKey = CONFLICT, "first-key", "The first key must be an administrator's", Never,
        "There is no key yet, and a key that is not an administrator's would lock everybody out.",
        "Create a key with the role `admin` first.";
    DetectorFixed = CONFLICT, "detector-fixed", "The detector of a route with batches cannot be changed", Never,
        "The detector shapes the map from the first batch on.",
        "Create another route with the other detector, and upload the data there.";
    TransitionNotAllowed = CONFLICT, "transition-not-allowed", "The alert's status does not allow this", AfterChange,
        "The action is not possible for an alert of this status or kind; somebody else may have decided in the meantime.",
        "Read the alert again: `actions` lists what is possible.";
    RetryRefused = CONFLICT, "retry-refused", "The batch cannot be tried again", AfterChange,
        "Only a batch that is `quarantined` or `unanchored`, and whose body is still kept, can be tried again.",
        "Read the batch's `status` and `reason`; upload the data under a new id if the body is gone.";
    VersionState = CONFLICT, "version-state", "The version's state does not allow this", AfterChange,
        "The operation is not possible for a version in this state: draft, released or retired.",
        "Read the version's `state`; only the draft can be released, and only a released version is for vehicles.";
    NoGeoAnchor = CONFLICT, "no-geo-anchor", "The map's place on the Earth is not known", AfterChange,
        "GeoJSON is in degrees, and the route has no `geo_anchor`.",
        "Set `geo_anchor` with `PUT /v1/routes/{route}`, or use `GET /v1/alerts`, which answers in metres.";
    TooManyWebhooks = CONFLICT, "too-many-webhooks", "The limit of webhooks is reached", AfterChange,
        "The number of webhooks is limited.",
        "Delete a webhook that is not used.";
    TooManyZones = CONFLICT, "too-many-zones", "The limit of zones is reached", AfterChange,
        "The number of zones on a route is limited.",
        "Delete zones that are not needed, or combine several into one.";
    WebhookDisabled = CONFLICT, "webhook-disabled", "The webhook is not active", AfterChange,
        "A disabled webhook is not called, not even for a test.",
        "Enable it with `PATCH /v1/webhooks/{webhook}`, then test it.";
    PreconditionFailed = PRECONDITION_FAILED, "precondition-failed", "It has changed since it was read", AfterChange,
        "`If-Match` does not name the current revision: somebody or something has changed it in the meantime.",
        "Read it again, check what has changed, and send the request with the new ETag.";
    PreconditionRequired = PRECONDITION_REQUIRED, "precondition-required", "The decision must name a revision", Never,
        "A decision about an alert needs `If-Match`, so that nobody decides about a state that they have not seen.",
        "Read the alert, and send its ETag (the `decision_revision` in quotes) in `If-Match`.";
    TooLarge = PAYLOAD_TOO_LARGE, "too-large", "The request is too large", Never,
        "The body has more bytes, scans, beams, nodes or edges than a request may have.",
        "Split it into several batches; the operation's description states the limits.";
    UriTooLong = URI_TOO_LONG, "uri-too-long", "The address of the request is too long", Never,
        "Path and query together are longer than 8 KiB.",
        "Shorten the query: request fewer things at once.";
    UnsupportedMediaType = UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", "The media type of the body is not supported", Never,
        "`Content-Type` is missing, or is not one that the operation accepts.",
        "Send `Content-Type: application/json` in UTF-8, or the media type in the header `Accept` of the answer.";
    UnsupportedEncoding = UNSUPPORTED_MEDIA_TYPE, "unsupported-encoding", "The encoding of the body is not supported", Never,
        "`Content-Encoding` names an encoding that this operation does not accept.",
        "Send the body uncompressed, or compressed once with an encoding in the header `Accept-Encoding` of the answer.";
    ScanGeometry = UNPROCESSABLE_ENTITY, "scan-geometry", "The scans do not fit the lidar", Never,
        "The fields are well formed, but do not describe a possible scan: beams and angles do not match, or a range or mount is impossible.",
        "Check units first: angles are radians, ranges metres. `errors` names the first field that does not fit.";
    EdgeGraph = UNPROCESSABLE_ENTITY, "edge-graph", "The nodes and edges do not form a graph", Never,
        "The batch is empty, repeats a node, has an edge from a node to itself, or an information matrix that is not positive definite.",
        "Correct the node or edge that `errors` names.";
    OutOfRange = UNPROCESSABLE_ENTITY, "out-of-range", "A value is out of range", Never,
        "A value is well formed, but too large, too small, too long, in the past, or in conflict with another one.",
        "Correct the field that `errors` names; check its unit.";
    TimestampOrder = UNPROCESSABLE_ENTITY, "timestamp-order", "The stamps do not increase", Never,
        "Scans of one lidar must have increasing stamps within a batch.",
        "Sort the scans by stamp, remove duplicates, and check that the clock does not jump back during a drive.";
    Recording = UNPROCESSABLE_ENTITY, "recording", "The recording cannot be used", Never,
        "The file is not a recording of the stated format, is damaged, or contains no scans whose pose the odometry determines.",
        "`detail` says what was found, and where. Check that the file is complete, and that it has laser scans and odometry.";
    RecordingTopics = UNPROCESSABLE_ENTITY, "recording-topics", "The recording does not have these topics", Never,
        "There is no topic with the requested name or type, or several topics have odometry.",
        "`detail` lists the topics of the recording: choose among them with `topic` and `odometry_topic`.";
    WebhookUrlRefused = UNPROCESSABLE_ENTITY, "webhook-url-refused", "Webhooks are not sent to this URL", Never,
        "The URL is not an https address that the service may call: private networks are excluded unless the operator allows them.",
        "Use a public https URL, or have the operator start the service with `--webhooks-to-private-networks`.";
    ForeignHost = MISDIRECTED_REQUEST, "foreign-host", "The request is meant for another host", Never,
        "The service does not have the name in the header `Host`.",
        "Use the address that the service listens on, or start it with `--public-url` and the name that people use.";
    TooManySignIns = TOO_MANY_REQUESTS, "too-many-sign-ins", "Too many failed sign-ins from this address", Later,
        "This address has sent too many invalid keys in a short time.",
        "Check the key, and wait.";
    TooManyRequests = TOO_MANY_REQUESTS, "too-many-requests", "Too many requests from this address", Later,
        "One client address may have only a share of the uploads, reads, streams and connections under way, so that others are served too.",
        "Send fewer requests at the same time. If all clients share a proxy or NAT, the operator raises `--address-share`.";
    HeadersTooLarge = REQUEST_HEADER_FIELDS_TOO_LARGE, "headers-too-large", "The request's headers are too large", Never,
        "The head of the request has more bytes or more fields than are accepted.",
        "Remove headers and cookies that do not belong to this service.";
    Internal = INTERNAL_SERVER_ERROR, "internal", "Internal error", Later,
        "Something failed inside the service. The cause is in its log, under the request id in `instance`.",
        "Repeat the request once; if it fails again, give the request id to the operator.";
    Corrupt = INTERNAL_SERVER_ERROR, "corrupt", "Stored data is damaged", Never,
        "A checksum in the database does not match: the disk or a copy of the file is damaged.",
        "The operator runs `mapshift fsck`, and restores the damaged part from a backup.";
    Overloaded = SERVICE_UNAVAILABLE, "overloaded", "The service is overloaded", Later,
        "Too many requests of this kind are under way, or the answer took too long. Nothing was stored.",
        "Wait and repeat; a gateway keeps the upload in the meantime.";
    ShuttingDown = SERVICE_UNAVAILABLE, "shutting-down", "The service is shutting down", Later,
        "The service completes requests under way and accepts no new ones.",
        "Repeat after the restart.";
    NotReady = SERVICE_UNAVAILABLE, "not-ready", "The service is not ready", Later,
        "The service is starting, or its database is not responding.",
        "Wait; if it persists, the operator should read the log.";
    DiskFull = INSUFFICIENT_STORAGE, "disk-full", "The disk is full", Later,
        "The data directory has no space left, and nothing was written. Reads still work.",
        "The operator frees space; clients keep their data and repeat the request.";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_problem_is_explained_in_whole_sentences() {
        for kind in ProblemKind::ALL {
            for text in [kind.cause(), kind.remedy()] {
                assert!(text.ends_with('.') && text.len() > 10, "{}", kind.name());
            }
        }
    }

    /// The OpenAPI document and gateways rely on it: the problems worth repeating are those with `Retry-After`.
    #[test]
    fn a_refusal_with_retry_after_is_worth_repeating() {
        for kind in ProblemKind::ALL {
            let status = kind.status().as_u16();
            if [408, 429, 503, 507].contains(&status) {
                assert_eq!(kind.repeating(), Repeating::Later, "{}", kind.name());
            } else if status < 500 && *kind != ProblemKind::DigestMismatch {
                assert_ne!(kind.repeating(), Repeating::Later, "{}", kind.name());
            }
        }
    }

    /// The reference page is made here. After a change of the table, rename the `.new` file.
    #[test]
    fn the_reference_page_is_the_table() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/reference/problems.md");
        let expected = reference_page();
        let written = std::fs::read_to_string(path).unwrap_or_default();
        if written != expected {
            std::fs::write(format!("{path}.new"), expected).unwrap();
            panic!("docs/reference/problems.md differs from the table: rename problems.md.new");
        }
    }

    fn reference_page() -> String {
        let mut page = String::from(
            "# Problems\n\n\
             Every error is a problem document (RFC 9457, `application/problem+json`). Its `type` is\n\
             `/problems/` followed by one of the names below: a URI reference, relative to the service, to a page with\n\
             the same text. Names and statuses are stable; `detail` says what happened in this case and may be\n\
             reworded. [HTTP conventions](http.md) describes the form of a problem and the order in which requests\n\
             are checked. This page is made from the table in `src/api/problem_kinds.rs`.\n\n\
             | type | status | title | repeat? |\n|---|---|---|---|\n",
        );
        for kind in ProblemKind::ALL {
            let repeat = match kind.repeating() {
                Repeating::Never => "no",
                Repeating::AfterChange => "after a change",
                Repeating::Later => "yes",
            };
            let (name, status) = (kind.name(), kind.status().as_u16());
            let title = kind.title();
            page.push_str(&format!(
                "| [{name}](#{name}) | {status} | {title} | {repeat} |\n"
            ));
        }
        for kind in ProblemKind::ALL {
            page.push_str(&format!(
                "\n## {}\n\n{}: {}.\n\n{}\n\n**What to do.** {}\n\n**Does repeating help?** {}\n",
                kind.name(),
                kind.status(),
                kind.title(),
                kind.cause(),
                kind.remedy(),
                kind.repeating().text(),
            ));
        }
        page
    }
}
