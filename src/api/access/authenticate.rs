//! Who sends a request: identified by a key, by a trusted proxy, or by a session.

use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, request::Parts};
use jiff::Timestamp;

use super::cookie::session_id;
use super::identity::Identity;
use crate::api::ApiState;
use crate::api::client_address::PeerAddress;
use crate::api::problem::{Problem, ProblemKind};
use crate::store::KeyText;

/// Who sends a request, and how they were identified.
pub(super) struct Authenticated {
    pub(super) identity: Identity,
    /// Whether by a cookie: browsers add cookies whichever page makes them send the request.
    pub(super) by_cookie: bool,
}

impl Authenticated {
    fn by_header(identity: Identity) -> Self {
        Self {
            identity,
            by_cookie: false,
        }
    }
}

/// Who sends a request; a session that has ended identifies nobody.
///
/// # Errors
/// A [`Problem`] for an invalid key, for contradictory headers of a proxy, or if the store cannot be read.
pub(super) async fn authenticate(
    state: &ApiState,
    parts: &Parts,
) -> Result<Authenticated, Problem> {
    if state.is_open() {
        return Ok(Authenticated::by_header(Identity::local()));
    }
    let now = Timestamp::now();
    if let Some(text) = bearer(&parts.headers) {
        let shown: Option<KeyText> = text.parse().ok();
        let key = match shown {
            Some(shown) => state.store.key_shown(&shown, now).await?,
            None => None,
        };
        let key = key.ok_or_else(not_a_key)?;
        return Ok(Authenticated::by_header(Identity::of_key(key)));
    }
    let peer = parts.extensions.get::<PeerAddress>().map(|peer| peer.0);
    if let Some(identity) = state.proxies.identity(peer, &parts.headers)? {
        return Ok(Authenticated::by_header(identity));
    }
    if let Some(id) = session_id(&parts.headers)
        && let Some(session) = state.store.session(&id, now).await?
    {
        return Ok(Authenticated {
            identity: Identity::of_session(session),
            by_cookie: true,
        });
    }
    Ok(Authenticated::by_header(Identity::nobody()))
}

/// The text after `Bearer`; other schemes are for proxies.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(AUTHORIZATION)?.to_str().ok()?;
    let (scheme, text) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| text.trim())
}

/// The problem of an invalid key.
pub(in crate::api) fn not_a_key() -> Problem {
    let detail =
        "this key does not exist, was revoked or has expired: ask an administrator for another";
    unauthenticated(detail)
}

/// The problem of a sender who must identify themselves.
pub(super) fn unauthenticated(detail: &str) -> Problem {
    let problem = Problem::new(ProblemKind::Unauthenticated, detail);
    problem.header(axum::http::header::WWW_AUTHENTICATE, "Bearer")
}
