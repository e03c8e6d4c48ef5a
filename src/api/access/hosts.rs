//! The names under which the service is reached. A page with another name must not send requests to it, even if that
//! name resolves to this service (DNS rebinding).

use std::net::IpAddr;
use std::str::FromStr;

use axum::http::uri::{Authority, Uri};

/// The URL under which people reach the service, such as `https://maps.example.com`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PublicUrl {
    /// Scheme and authority as browsers send them.
    origin: String,
    host: String,
}

/// The text is not such a URL.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("give a URL without a path, like https://maps.example.com")]
pub struct InvalidUrl;

impl FromStr for PublicUrl {
    type Err = InvalidUrl;

    fn from_str(text: &str) -> Result<Self, InvalidUrl> {
        let url: Uri = text.parse().map_err(|_| InvalidUrl)?;
        let scheme = url.scheme_str().unwrap_or_default().to_ascii_lowercase();
        let authority = url.authority().ok_or(InvalidUrl)?;
        let is_plain = ["", "/"].contains(&url.path()) && url.query().is_none();
        let is_web = ["http", "https"].contains(&scheme.as_str());
        if !(is_plain && is_web) || authority.as_str().contains('@') {
            return Err(InvalidUrl);
        }
        let host = authority.host().to_ascii_lowercase();
        let port = match (scheme.as_str(), authority.port_u16()) {
            // Browsers leave these out.
            ("http", Some(80)) | ("https", Some(443)) | (_, None) => String::new(),
            (_, Some(port)) => format!(":{port}"),
        };
        Ok(Self {
            origin: format!("{scheme}://{host}{port}"),
            host,
        })
    }
}

impl PublicUrl {
    /// Scheme and authority, like `https://maps.example.com`.
    pub fn origin(&self) -> &str {
        &self.origin
    }
}

/// The names of the service.
#[derive(Debug, Clone)]
pub(in crate::api) struct Hosts {
    listen: IpAddr,
    public_url: Option<PublicUrl>,
}

impl Hosts {
    pub(in crate::api) fn new(listen: IpAddr, public_url: Option<PublicUrl>) -> Self {
        Self { listen, public_url }
    }

    /// Whether a request for this host (a name or an address, possibly with a port) is for the service. Addresses cannot
    /// be rebound, so a service that listens on all of them accepts any.
    pub(super) fn is_own(&self, host: &str) -> bool {
        let Ok(authority) = host.parse::<Authority>() else {
            return false;
        };
        let name = authority.host().trim_matches(['[', ']']);
        if let Ok(address) = name.parse::<IpAddr>() {
            let listen = self.listen;
            let is_ours = listen.is_unspecified() || address == listen;
            return is_ours || address.to_canonical().is_loopback() || self.is_public(name);
        }
        name.eq_ignore_ascii_case("localhost") || self.is_public(name)
    }

    fn is_public(&self, name: &str) -> bool {
        let url = self.public_url.as_ref();
        url.is_some_and(|url| url.host.trim_matches(['[', ']']).eq_ignore_ascii_case(name))
    }

    /// Scheme and authority under which people and vehicles reach the service, if set.
    pub(in crate::api) fn public_origin(&self) -> Option<&str> {
        let url = self.public_url.as_ref();
        url.map(PublicUrl::origin)
    }

    /// Whether this origin is the service's own, for a request to this host.
    pub(super) fn is_own_origin(&self, origin: &str, host: &str) -> bool {
        let url = self.public_url.as_ref();
        if url.is_some_and(|url| url.origin.eq_ignore_ascii_case(origin)) {
            return true;
        }
        let authority = origin
            .strip_prefix("http://")
            .or_else(|| origin.strip_prefix("https://"));
        authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
    }
}

/// Whether a host is the machine of the client itself.
pub(super) fn is_loopback(host: &str) -> bool {
    let Ok(authority) = host.parse::<Authority>() else {
        return false;
    };
    let name = authority.host().trim_matches(['[', ']']);
    let address = name.parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hosts(listen: &str, public_url: Option<&str>) -> Hosts {
        let public_url = public_url.map(|url| url.parse().unwrap());
        Hosts::new(listen.parse().unwrap(), public_url)
    }

    #[test]
    fn only_names_of_the_service_are_its_own() {
        let local = hosts("127.0.0.1", None);
        for own in [
            "localhost",
            "LOCALHOST:8080",
            "127.0.0.1:9",
            "127.8.8.8",
            "[::1]:8080",
        ] {
            assert!(local.is_own(own), "{own}");
        }
        for foreign in [
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "192.0.2.7",
            "",
            "a b",
            "maps.example.com",
        ] {
            assert!(!local.is_own(foreign), "{foreign}");
        }
        let public = hosts("192.0.2.7", Some("https://Maps.example.com/"));
        for own in [
            "192.0.2.7:80",
            "maps.example.com",
            "localhost",
            "maps.EXAMPLE.com:443",
        ] {
            assert!(public.is_own(own), "{own}");
        }
        assert!(!public.is_own("192.0.2.8"));
        let all = hosts("0.0.0.0", None);
        assert!(all.is_own("192.0.2.8:80") && !all.is_own("evil.example"));
    }

    #[test]
    fn only_pages_of_the_service_are_its_own() {
        let hosts = hosts("127.0.0.1", Some("https://maps.example.com:443"));
        for (origin, host) in [
            ("http://localhost:8080", "localhost:8080"),
            ("https://maps.example.com", "maps.example.com"),
            // A proxy may use its own name for the service.
            ("https://maps.example.com", "127.0.0.1:8080"),
        ] {
            assert!(hosts.is_own_origin(origin, host), "{origin} {host}");
        }
        for (origin, host) in [
            ("http://localhost:3000", "localhost:8080"),
            ("https://evil.example", "maps.example.com"),
            ("http://maps.example.com", "127.0.0.1:8080"),
            ("null", "null"),
            ("", ""),
            ("file://localhost", "localhost"),
        ] {
            assert!(!hosts.is_own_origin(origin, host), "{origin} {host}");
        }
    }

    #[test]
    fn public_urls_have_no_path() {
        for bad in [
            "",
            "maps.example.com",
            "ftp://a",
            "https://a/b",
            "https://u@a",
            "https://a/?b",
        ] {
            assert!(bad.parse::<PublicUrl>().is_err(), "{bad}");
        }
    }
}
