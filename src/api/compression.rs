//! Gzip for answers that are text.
//!
//! The compression layer of tower-http is not used: it would bring a second compression stack (`async-compression`)
//! beside `flate2`, for what is done here.

use std::io::Write;

use axum::body::{Body, BodyDataStream, Bytes, HttpBody};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use flate2::Compression;
use flate2::write::GzEncoder;
use futures::{StreamExt, stream};

use super::entity_tags::media_type;

/// Shorter answers are not compressed.
const COMPRESSED_BYTES_MIN: u64 = 1_024;
/// Media types that are compressed: text, except event streams, which must not be delayed.
const COMPRESSED: [&str; 7] = [
    "application/json",
    "application/geo+json",
    "application/yaml",
    "image/svg+xml",
    "text/html",
    "text/css",
    "text/javascript",
];

/// Compresses text for clients that accept gzip. An answer with a strong ETag keeps its bytes: edits are bound to it.
pub(super) async fn compress(request: Request, next: Next) -> Response {
    let is_get = request.method() == Method::GET;
    let accepts_gzip = accepts_gzip(request.headers());
    let mut response = next.run(request).await;
    if !is_get || !is_to_be_compressed(&response) {
        return response;
    }
    let varies = HeaderValue::from_static("accept-encoding");
    response.headers_mut().append(header::VARY, varies);
    if !accepts_gzip {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    parts.headers.remove(header::CONTENT_LENGTH);
    let gzip = HeaderValue::from_static("gzip");
    parts.headers.insert(header::CONTENT_ENCODING, gzip);
    Response::from_parts(parts, gzipped(body))
}

fn is_to_be_compressed(response: &Response) -> bool {
    let headers = response.headers();
    let strong = headers.get(header::ETAG);
    let strong = strong.is_some_and(|tag| !tag.as_bytes().starts_with(b"W/"));
    let least = response.body().size_hint().exact();
    response.status() == StatusCode::OK
        && COMPRESSED.contains(&media_type(headers))
        && !strong
        && !headers.contains_key(header::CONTENT_ENCODING)
        && least.is_none_or(|bytes| bytes >= COMPRESSED_BYTES_MIN)
}

/// Whether `Accept-Encoding` names gzip without a weight of 0 (RFC 9110, section 12.5.3).
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let mut values = headers.get_all(header::ACCEPT_ENCODING).iter();
    values.any(|value| {
        let mut codings = value.to_str().unwrap_or_default().split(',');
        codings.any(|coding| {
            let mut parts = coding.split(';').map(str::trim);
            let is_gzip = parts
                .next()
                .is_some_and(|name| name.eq_ignore_ascii_case("gzip"));
            let weight = parts.find_map(|part| part.strip_prefix("q="));
            is_gzip && weight.is_none_or(|q| q.parse().is_ok_and(|q: f64| q > 0.0))
        })
    })
}

/// The part of a body that is not compressed yet, and the encoder that has the rest.
type Rest = (BodyDataStream, GzEncoder<Vec<u8>>);

fn gzipped(body: Body) -> Body {
    let encoder = GzEncoder::new(Vec::new(), Compression::fast());
    let whole = Some((body.into_data_stream(), encoder));
    Body::from_stream(stream::try_unfold(whole, next_piece))
}

/// The next piece of a compressed body as soon as there is one, and the rest.
async fn next_piece(rest: Option<Rest>) -> Result<Option<(Bytes, Option<Rest>)>, axum::Error> {
    let Some((mut pieces, mut encoder)) = rest else {
        return Ok(None);
    };
    while let Some(piece) = pieces.next().await {
        encoder.write_all(&piece?).map_err(axum::Error::new)?;
        let compressed = std::mem::take(encoder.get_mut());
        if !compressed.is_empty() {
            return Ok(Some((compressed.into(), Some((pieces, encoder)))));
        }
    }
    let last = encoder.finish().map_err(axum::Error::new)?;
    Ok(Some((last.into(), None)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_accepted_if_it_is_named_with_a_weight_above_zero() {
        let accepts = |value: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT_ENCODING, value.parse().unwrap());
            accepts_gzip(&headers)
        };
        assert!(!accepts_gzip(&HeaderMap::new()));
        for good in ["gzip", "br, GZIP;q=0.5", "deflate,gzip ; q=1"] {
            assert!(accepts(good), "{good}");
        }
        for bad in ["", "br", "gzip;q=0", "gzip;q=0.0, br"] {
            assert!(!accepts(bad), "{bad}");
        }
    }
}
