//! The headers of an upload.

use axum::http::{HeaderMap, header};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};

use crate::api::problem::{Problem, ProblemKind};

const CONTENT_DIGEST: &str = "content-digest";
const JSON: &str = "application/json";
const BINARY: &str = "application/octet-stream";

/// How the body is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::api) enum Encoding {
    Identity,
    Gzip,
    Zstd,
}

/// The checked headers of an upload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::api) struct UploadHead {
    pub encoding: Encoding,
    pub content_length: Option<usize>,
    /// The SHA-256 of the bytes on the wire in base64, if the sender stated it (RFC 9530).
    pub digest: Option<String>,
}

impl UploadHead {
    pub(super) fn check(headers: &HeaderMap, wire_bytes_max: usize) -> Result<Self, Problem> {
        check_media_type(headers).map_err(Problem::closing)?;
        let encoding = encoding(headers).map_err(Problem::closing)?;
        Self::of(headers, encoding, wire_bytes_max)
    }

    /// The headers of a recording, which must not be compressed.
    pub(super) fn check_recording(headers: &HeaderMap, bytes_max: usize) -> Result<Self, Problem> {
        check_type(headers, BINARY).map_err(Problem::closing)?;
        check_plain(headers).map_err(Problem::closing)?;
        Self::of(headers, Encoding::Identity, bytes_max)
    }

    fn of(headers: &HeaderMap, encoding: Encoding, bytes_max: usize) -> Result<Self, Problem> {
        let digest = digest(headers).map_err(Problem::closing)?;
        let content_length = headers
            .get(header::CONTENT_LENGTH)
            .and_then(|v| v.to_str().ok()?.parse::<usize>().ok());
        if content_length.is_some_and(|length| length > bytes_max) {
            return Err(too_large(bytes_max).closing());
        }
        Ok(Self {
            encoding,
            content_length,
            digest,
        })
    }

    /// Compares the bytes on the wire with the stated digest.
    pub(in crate::api) fn check_digest(&self, wire: &[u8]) -> Result<(), Problem> {
        match self.digest {
            Some(_) => self.check_sha256(&Sha256::digest(wire)),
            None => Ok(()),
        }
    }

    /// Compares the SHA-256 of the bytes on the wire with the stated digest.
    pub(super) fn check_sha256(&self, sha256: &[u8]) -> Result<(), Problem> {
        let is_same = |stated: &String| *stated == STANDARD.encode(sha256);
        if self.digest.as_ref().is_none_or(is_same) {
            return Ok(());
        }
        Err(Problem::new(
            ProblemKind::DigestMismatch,
            "the SHA-256 of the bytes that arrived differs from the one in Content-Digest: send them again",
        ))
    }
}

pub(super) fn too_large(wire_bytes_max: usize) -> Problem {
    let detail = format!("a body has at most {wire_bytes_max} bytes: split it");
    Problem::new(ProblemKind::TooLarge, detail)
}

pub(super) fn check_media_type(headers: &HeaderMap) -> Result<(), Problem> {
    check_type(headers, JSON)
}

/// Whether the body has a media type; text must be UTF-8.
fn check_type(headers: &HeaderMap, expected: &'static str) -> Result<(), Problem> {
    let value = headers.get(header::CONTENT_TYPE);
    let text = value.and_then(|v| v.to_str().ok()).unwrap_or_default();
    let mut parts = text.split(';').map(str::trim);
    let is_expected = parts
        .next()
        .is_some_and(|media_type| media_type.eq_ignore_ascii_case(expected));
    let is_utf8 = parts.all(|parameter| match parameter.split_once('=') {
        Some((name, value)) if name.trim().eq_ignore_ascii_case("charset") => {
            value.trim().trim_matches('"').eq_ignore_ascii_case("utf-8")
        }
        _ => true,
    });
    if is_expected && is_utf8 {
        return Ok(());
    }
    let in_utf8 = if expected == JSON { ", in UTF-8" } else { "" };
    let detail = format!("the body must be {expected}{in_utf8}");
    let problem = Problem::new(ProblemKind::UnsupportedMediaType, detail);
    Err(problem.header(header::ACCEPT, expected))
}

fn encoding(headers: &HeaderMap) -> Result<Encoding, Problem> {
    let mut values = headers.get_all(header::CONTENT_ENCODING).iter();
    let name = match (values.next(), values.next()) {
        (None, _) => return Ok(Encoding::Identity),
        (Some(value), None) => value.to_str().unwrap_or_default().to_ascii_lowercase(),
        (Some(_), Some(_)) => String::new(),
    };
    match name.trim() {
        "identity" => Ok(Encoding::Identity),
        "gzip" | "x-gzip" => Ok(Encoding::Gzip),
        "zstd" => Ok(Encoding::Zstd),
        _ => {
            let detail = "the body must be uncompressed, or compressed once with gzip or zstd";
            let problem = Problem::new(ProblemKind::UnsupportedEncoding, detail);
            Err(problem.header(header::ACCEPT_ENCODING, "gzip, zstd, identity"))
        }
    }
}

/// Refuses compressed bodies: small ones are not worth compressing.
pub(super) fn check_plain(headers: &HeaderMap) -> Result<(), Problem> {
    if matches!(encoding(headers), Ok(Encoding::Identity)) {
        return Ok(());
    }
    let detail = "the body must not be compressed here";
    let problem = Problem::new(ProblemKind::UnsupportedEncoding, detail);
    Err(problem.header(header::ACCEPT_ENCODING, "identity"))
}

/// The value of `sha-256=:…:`; other algorithms are ignored, as RFC 9530 allows.
fn digest(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    for value in headers.get_all(CONTENT_DIGEST) {
        let malformed = || {
            Problem::new(
                ProblemKind::DigestMismatch,
                "Content-Digest must have the form sha-256=:BASE64:",
            )
        };
        let text = value.to_str().map_err(|_| malformed())?;
        for member in text.split(',') {
            let (algorithm, value) = member.trim().split_once('=').ok_or_else(malformed)?;
            if algorithm.eq_ignore_ascii_case("sha-256") {
                let value = value.strip_prefix(':').and_then(|v| v.strip_suffix(':'));
                return Ok(Some(value.ok_or_else(malformed)?.to_owned()));
            }
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn head(pairs: &[(&'static str, &str)]) -> Result<UploadHead, ProblemKind> {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, HeaderValue::from_str(value).unwrap());
        }
        UploadHead::check(&headers, 1_000).map_err(|problem| problem.kind())
    }

    #[test]
    fn headers_are_read_in_the_forms_that_clients_send() {
        let json = ("content-type", "Application/JSON; charset=\"UTF-8\"");
        assert_eq!(head(&[json]).unwrap().encoding, Encoding::Identity);
        let zipped = head(&[
            json,
            ("content-encoding", "GZIP"),
            ("content-length", "1000"),
        ]);
        assert_eq!(zipped.unwrap().encoding, Encoding::Gzip);
        let digest = head(&[json, ("content-digest", "sha-512=:AA==:, sha-256=:Zg==:")]);
        assert_eq!(digest.unwrap().digest.as_deref(), Some("Zg=="));
        assert_eq!(
            head(&[json, ("content-digest", "md5=:AA==:")])
                .unwrap()
                .digest,
            None
        );
    }

    #[test]
    fn unsupported_headers_are_refused() {
        let json = ("content-type", "application/json");
        use ProblemKind::{DigestMismatch, TooLarge, UnsupportedEncoding, UnsupportedMediaType};
        for (pairs, kind) in [
            (vec![], UnsupportedMediaType),
            (vec![("content-type", "text/json")], UnsupportedMediaType),
            (
                vec![("content-type", "application/json; charset=latin1")],
                UnsupportedMediaType,
            ),
            (vec![json, ("content-encoding", "br")], UnsupportedEncoding),
            (
                vec![json, ("content-encoding", "gzip, zstd")],
                UnsupportedEncoding,
            ),
            (
                vec![
                    json,
                    ("content-encoding", "gzip"),
                    ("content-encoding", "gzip"),
                ],
                UnsupportedEncoding,
            ),
            (vec![json, ("content-length", "1001")], TooLarge),
            (
                vec![json, ("content-digest", "sha-256=Zg==")],
                DigestMismatch,
            ),
            (vec![json, ("content-digest", "nonsense")], DigestMismatch),
        ] {
            assert_eq!(head(&pairs), Err(kind), "{pairs:?}");
        }
    }
}
