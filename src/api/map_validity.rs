//! For how long an answer made of a map's picture is valid.

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::if_match::is_known;
use super::map_cache::Shown;
use crate::store::RouteRecord;

/// A year, the longest time for which caches keep anything. Not in caches that several people share.
const FOR_EVER: &str = "private, max-age=31536000, immutable";
const REVALIDATE: &str = "no-cache";

/// The ETag of an answer made of a picture, and for how long the answer is valid.
pub(super) struct Validity {
    tag: String,
    for_ever: bool,
}

impl Validity {
    /// Of an answer to a request that names this version, or none.
    pub(super) fn of(route: &RouteRecord, version: Option<i64>, shown: Shown) -> Self {
        let created = route.created_at.as_millisecond();
        Self {
            tag: match shown {
                Shown::Draft(layer) => {
                    format!("\"{created:x}-{}-{}\"", route.revision, layer.name())
                }
                Shown::Version(version) => format!("\"{created:x}-v{version}\""),
            },
            for_ever: version.is_some() && matches!(shown, Shown::Version(_)),
        }
    }

    /// Of an answer made of two pictures.
    pub(super) fn of_both(first: &Self, second: &Self) -> Self {
        let [a, b] = [&first.tag, &second.tag].map(|tag| tag.trim_matches('"'));
        Self {
            tag: format!("\"{a}-{b}\""),
            for_ever: first.for_ever && second.for_ever,
        }
    }

    /// The answer 304, if the client's copy is still valid.
    pub(super) fn unchanged(&self, request: &HeaderMap) -> Option<Response> {
        let known = is_known(request, &self.tag);
        known.then(|| (StatusCode::NOT_MODIFIED, self.headers()).into_response())
    }

    /// The answer with a body.
    pub(super) fn answer(&self, media_type: &'static str, body: Bytes) -> Response {
        let media_type = HeaderValue::from_static(media_type);
        (self.headers(), [(header::CONTENT_TYPE, media_type)], body).into_response()
    }

    /// The ETag.
    pub(super) fn tag(&self) -> &str {
        &self.tag
    }

    /// The ETag, and for how long the answer is valid.
    pub(super) fn headers(&self) -> [(header::HeaderName, String); 2] {
        let caching = if self.for_ever { FOR_EVER } else { REVALIDATE };
        [
            (header::ETAG, self.tag.clone()),
            (header::CACHE_CONTROL, caching.to_owned()),
        ]
    }
}
