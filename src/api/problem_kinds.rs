//! The one table of problems: for each its `type`, status and title, and what its page says about it. The
//! OpenAPI document, `/problems` and `docs/reference/problems.md` are made from it.

use axum::http::StatusCode;

/// Whether sending the same request again helps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeating {
    /// It is refused again.
    Never,
    /// It is served once something else has changed.
    AfterChange,
    /// It is served later.
    Later,
}

impl Repeating {
    /// The answer for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Never => "No: the same request is refused again.",
            Self::AfterChange => {
                "Not by itself: only after what the request depends on has changed."
            }
            Self::Later => {
                "Yes: send the same request again after the seconds in Retry-After, or after a few seconds if there is no such header, and wait longer each time. Uploads keep their id, so that nothing is stored twice."
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

            /// The same for every occurrence.
            pub fn title(self) -> &'static str {
                match self { $(Self::$kind => $title,)* }
            }

            /// Whether sending the same again helps.
            pub fn repeating(self) -> Repeating {
                match self { $(Self::$kind => Repeating::$repeating,)* }
            }

            /// What happened, for whoever looks the problem up.
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
        "The body is not one JSON document in UTF-8, or it has a field that is not known here, or the same field twice.",
        "Correct the place that `errors` names. A beam without a return is `null`: NaN and Infinity are not JSON.";
    InvalidField = BAD_REQUEST, "invalid-field", "A field is missing or has the wrong form", Never,
        "A field of the body, or a part of the path, is missing, has another type than documented, or does not go with another field.",
        "Correct the place that `errors` names; the OpenAPI document has the form of every field.";
    InvalidParameter = BAD_REQUEST, "invalid-parameter", "A query parameter is not usable", Never,
        "A query parameter is unknown to this operation, occurs twice, or has a value outside its range.",
        "Correct or remove the parameter that `errors` or `detail` names. A cursor is used exactly as `next_cursor` gave it.";
    BadEncoding = BAD_REQUEST, "bad-encoding", "The body does not decompress", Never,
        "The body is not what `Content-Encoding` says, is cut off, or expands to more than 20 times its size.",
        "Compress the body once, as a whole, with gzip or zstd; send a body that compresses better than 20:1 plain.";
    DigestMismatch = BAD_REQUEST, "digest-mismatch", "The body is not what its digest says", Later,
        "`Content-Digest` is malformed, or the bytes that arrived have another SHA-256.",
        "If the header is well formed, the body was changed on its way: send it again. The digest is of the bytes as sent, after compression.";
    BadRequest = BAD_REQUEST, "bad-request", "The request is not usable", Never,
        "The request is not well-formed HTTP, or breaks a rule that no other problem names.",
        "Read `detail`; the sender's HTTP library or a proxy in between is at fault more often than the data.";
    Unauthenticated = UNAUTHORIZED, "unauthenticated", "The request does not say who sends it", AfterChange,
        "The operation needs a key, and the request has none, or one that is unknown, expired or revoked.",
        "Send `Authorization: Bearer` with a valid key, or sign in on the page. An administrator makes keys with `POST /v1/keys` or `mapshift keys create`.";
    Forbidden = FORBIDDEN, "forbidden", "Whoever sends this may not do it", AfterChange,
        "The key is valid, but its role, its vehicle or its routes do not cover this operation.",
        "Use a key with the role that `detail` names, or ask an administrator for one.";
    ForeignOrigin = FORBIDDEN, "foreign-origin", "Another page asks for this", Never,
        "A browser sent a change on behalf of a page that does not belong to this service.",
        "Programs send a key and no `Origin`. If people reach the service by another name, start it with `--public-url`.";
    UnknownRoute = NOT_FOUND, "unknown-route", "There is no such route", AfterChange,
        "The route was never created, was deleted, or is not among those that the key is limited to.",
        "Check the name; `PUT /v1/routes/{route}` creates a route. A gateway keeps its uploads until the route exists.";
    NotFound = NOT_FOUND, "not-found", "There is nothing here", AfterChange,
        "The path does not exist, or the thing that it names does not: it never did, or was removed.",
        "Check the path against the OpenAPI document, and the id against the list that it came from.";
    MethodNotAllowed = METHOD_NOT_ALLOWED, "method-not-allowed", "This method is not possible here", Never,
        "The path exists, but not with this method.",
        "Use one of the methods in the header `Allow`.";
    BodyTimeout = REQUEST_TIMEOUT, "request-timeout", "The request took too long to arrive", Later,
        "The body arrived too slowly, or stopped arriving.",
        "Send it again over a better link, compress it, or send smaller batches.";
    TripTaken = CONFLICT, "trip-taken", "The trip has batches already", Never,
        "A recording is a whole trip, and this trip of the vehicle has batches that are not of this recording. What is stored stays as it is.",
        "Give the recording a `trip_id` of its own.";
    BatchIdReused = CONFLICT, "batch-id-reused", "The batch id is taken by other bytes", Never,
        "A batch with this id is stored on this route, and its content is not what was sent now. What is stored stays as it is.",
        "Give the new data an id of its own. A gateway that meets this for a repeated upload has changed the bytes between attempts.";
    FirstKey = CONFLICT, "first-key", "The first key is an administrator's", Never,
        "There is no key yet, and a key that is not an administrator's would lock everybody out.",
        "Make a key with the role `admin` first.";
    DetectorFixed = CONFLICT, "detector-fixed", "A route that has batches keeps its detector", Never,
        "The detector shapes the map from the first batch on, so it cannot be changed later.",
        "Create another route with the other detector, and upload the data there.";
    TransitionNotAllowed = CONFLICT, "transition-not-allowed", "The alert's status does not allow this", AfterChange,
        "The alert has a status or a kind from which this action is not possible; somebody else may have decided meanwhile.",
        "Read the alert again: `actions` lists what is possible.";
    RetryRefused = CONFLICT, "retry-refused", "The batch cannot be tried again", AfterChange,
        "Only a batch that is `quarantined` or `unanchored`, and whose body is still kept, can be tried again.",
        "Read the batch's `status` and `reason`; upload the data under a new id if the body is gone.";
    VersionState = CONFLICT, "version-state", "The version's state does not allow this", AfterChange,
        "The version of the map is a draft, released or retired, and the operation needs another of these states.",
        "Read the version's `state`; only the draft can be released, and only a released version is for vehicles.";
    NoGeoAnchor = CONFLICT, "no-geo-anchor", "The map's place on the Earth is not known", AfterChange,
        "GeoJSON is in degrees, and the route has no `geo_anchor`.",
        "Set `geo_anchor` with `PUT /v1/routes/{route}`, or use `GET /v1/alerts`, which answers in metres.";
    TooManyWebhooks = CONFLICT, "too-many-webhooks", "There are as many webhooks as there can be", AfterChange,
        "The number of webhooks is limited.",
        "Delete one that is not used.";
    TooManyZones = CONFLICT, "too-many-zones", "The route has as many zones as it can have", AfterChange,
        "The number of zones on a route is limited.",
        "Delete zones that are not needed, or join several into one.";
    WebhookDisabled = CONFLICT, "webhook-disabled", "The webhook is not active", AfterChange,
        "A webhook that is disabled is not called, not even to test it.",
        "Enable it with `PATCH /v1/webhooks/{webhook}`, then test it.";
    PreconditionFailed = PRECONDITION_FAILED, "precondition-failed", "It has changed since it was read", AfterChange,
        "`If-Match` names another revision than the current one: somebody or something has changed it meanwhile.",
        "Read it again, look at what has changed, and send the change with the new ETag.";
    PreconditionRequired = PRECONDITION_REQUIRED, "precondition-required", "Say which revision the decision is about", Never,
        "A decision about an alert needs `If-Match`, so that nobody decides about something that they have not seen.",
        "Read the alert, and send its ETag (the `decision_revision` in quotes) in `If-Match`.";
    TooLarge = PAYLOAD_TOO_LARGE, "too-large", "The request is too large", Never,
        "The body has more bytes, scans, beams, nodes or edges than one request may have.",
        "Split it into several batches; the operation's description has the limits.";
    UriTooLong = URI_TOO_LONG, "uri-too-long", "The address of the request is too long", Never,
        "Path and query together are longer than 8 KiB.",
        "Shorten the query: ask for fewer things at once.";
    UnsupportedMediaType = UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", "The body has a type that is not taken here", Never,
        "`Content-Type` is missing, or is not the one that the operation takes.",
        "Send `Content-Type: application/json`, in UTF-8, or what the header `Accept` of the answer names.";
    UnsupportedEncoding = UNSUPPORTED_MEDIA_TYPE, "unsupported-encoding", "The body is encoded in a way that is not taken", Never,
        "`Content-Encoding` names an encoding that this operation does not take.",
        "Send the body plain, or compressed once as the header `Accept-Encoding` of the answer says.";
    ScanGeometry = UNPROCESSABLE_ENTITY, "scan-geometry", "The scans fit no lidar", Never,
        "The fields are well formed, but together they describe no possible scan: beams and angles do not fit, or a range or mount is impossible.",
        "Check units first: angles are radians, ranges metres. `errors` names the first field that does not fit.";
    EdgeGraph = UNPROCESSABLE_ENTITY, "edge-graph", "The nodes and edges make no graph", Never,
        "The batch is empty, names a node twice, has an edge from a node to itself, or an information matrix that is not positive definite.",
        "Correct the node or edge that `errors` names.";
    OutOfRange = UNPROCESSABLE_ENTITY, "out-of-range", "A value is beyond belief", Never,
        "A value is well formed, but too large, too small, too long, in the past, or not possible beside another one.",
        "Correct the field that `errors` names; check its unit.";
    TimestampOrder = UNPROCESSABLE_ENTITY, "timestamp-order", "The stamps do not increase", Never,
        "Scans of one lidar must have increasing stamps within a batch.",
        "Sort the scans by stamp, remove duplicates, and check that the clock does not jump back during a drive.";
    Recording = UNPROCESSABLE_ENTITY, "recording", "The recording cannot be used", Never,
        "The file is no recording of the stated format, is damaged, or holds no scans that can be placed by odometry.",
        "`detail` says what was found, and where. Check that the file is complete, and that it has laser scans and odometry.";
    RecordingTopics = UNPROCESSABLE_ENTITY, "recording-topics", "The recording has other topics", Never,
        "There is no topic of the name or type that was asked for, or the odometry could be one of several.",
        "`detail` lists the topics of the recording: choose with `topic` and `odometry_topic`.";
    WebhookUrlRefused = UNPROCESSABLE_ENTITY, "webhook-url-refused", "Webhooks are not sent to this URL", Never,
        "The URL is not an https address that the service may call: private networks are excluded unless the operator allows them.",
        "Use a public https URL, or have the operator start the service with `--webhooks-to-private-networks`.";
    ForeignHost = MISDIRECTED_REQUEST, "foreign-host", "The request is meant for another host", Never,
        "The header `Host` has a name that the service is not known by.",
        "Use the address that the service listens on, or start it with `--public-url` and the name that people use.";
    TooManySignIns = TOO_MANY_REQUESTS, "too-many-sign-ins", "This address has failed to sign in too often", Later,
        "Too many wrong keys came from this address in a short time.",
        "Check the key, and wait.";
    TooManyRequests = TOO_MANY_REQUESTS, "too-many-requests", "This address has its share under way", Later,
        "One client address may hold only a share of the uploads, reads, streams and connections, so that others are served as well.",
        "Send fewer requests at the same time. Behind a proxy or NAT that all clients share, the operator raises `--address-share`.";
    HeadersTooLarge = REQUEST_HEADER_FIELDS_TOO_LARGE, "headers-too-large", "The request's headers are too large", Never,
        "The head of the request has more bytes or more fields than are taken.",
        "Remove headers and cookies that do not belong to this service.";
    Internal = INTERNAL_SERVER_ERROR, "internal", "The service made a mistake", Later,
        "Something failed inside the service. The cause is in its log, under the request id that `instance` has.",
        "Repeat the request once; if it fails again, give the request id to the operator.";
    Corrupt = INTERNAL_SERVER_ERROR, "corrupt", "Something stored is not what was written", Never,
        "A checksum of the database does not match: the disk or a copy of the file is damaged.",
        "The operator runs `mapshift fsck`, and restores the damaged part from a backup.";
    Overloaded = SERVICE_UNAVAILABLE, "overloaded", "The service has too much to do", Later,
        "All places for this kind of request are taken, or the answer took too long. Nothing was stored.",
        "Wait and repeat; a gateway keeps the upload meanwhile.";
    ShuttingDown = SERVICE_UNAVAILABLE, "shutting-down", "The service is shutting down", Later,
        "The service finishes what it has begun and takes nothing new.",
        "Repeat after the restart.";
    NotReady = SERVICE_UNAVAILABLE, "not-ready", "The service is not ready", Later,
        "The service is starting, or its database does not answer.",
        "Wait; if it lasts, the operator reads the log.";
    DiskFull = INSUFFICIENT_STORAGE, "disk-full", "The disk is full", Later,
        "The data directory has no space left, and nothing was written. Reads still work.",
        "The operator makes space; clients keep what they have and repeat.";
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

    /// What the OpenAPI document and a gateway rely on: what is worth repeating is what says when.
    #[test]
    fn whatever_is_answered_when_overloaded_is_repeated() {
        for kind in ProblemKind::ALL {
            let status = kind.status().as_u16();
            if [408, 429, 503, 507].contains(&status) {
                assert_eq!(kind.repeating(), Repeating::Later, "{}", kind.name());
            } else if status < 500 && *kind != ProblemKind::DigestMismatch {
                assert_ne!(kind.repeating(), Repeating::Later, "{}", kind.name());
            }
        }
    }

    /// The reference page is what is made here. After a change of the table, take over the `.new` file.
    #[test]
    fn the_reference_page_is_the_table() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/reference/problems.md");
        let expected = reference_page();
        let written = std::fs::read_to_string(path).unwrap_or_default();
        if written != expected {
            std::fs::write(format!("{path}.new"), expected).unwrap();
            panic!("docs/reference/problems.md is not the table: take over problems.md.new");
        }
    }

    fn reference_page() -> String {
        let mut page = String::from(
            "# Problems\n\n\
             Every error is a problem document (RFC 9457, `application/problem+json`). Its `type` is\n\
             `/problems/` and one of the names below: a reference relative to the service, where it leads to a page\n\
             with the same text. Names and statuses are stable; `detail` says what happened this time and may be\n\
             reworded. [HTTP conventions](http.md) has the form of a problem and the order in which requests are\n\
             checked. This page is made from the table in `src/api/problem_kinds.rs`.\n\n\
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
