//! Which URLs webhooks are sent to.

use std::net::IpAddr;

use reqwest::Url;

use super::address::ReceiverPolicy;

/// Longest URL, bytes.
pub const URL_LENGTH_MAX: usize = 2_048;

/// What operators of a closed plant can do.
const HINT: &str = "webhooks go to public addresses; where receivers live in the plant's own \
     network, the service is started with --webhooks-to-private-networks";

/// Last parts of names that belong to one machine or one network.
const PRIVATE_DOMAINS: [&str; 14] = [
    "corp",
    "home",
    "home.arpa",
    "internal",
    "intranet",
    "invalid",
    "lan",
    "local",
    "localdomain",
    "localhost",
    "onion",
    "private",
    "svc",
    "test",
];

/// Why a URL is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UrlRefusal {
    /// It is no URL.
    #[error("this is no absolute URL; send one such as https://hooks.example.com/mapshift")]
    Malformed,
    /// It is too long.
    #[error("a URL has at most {URL_LENGTH_MAX} bytes")]
    TooLong,
    /// It is neither https nor an allowed http.
    #[error(
        "webhooks are sent by https, so that nobody on the way reads or changes them; http is for \
         private networks, and needs a service started with --webhooks-to-private-networks"
    )]
    Scheme,
    /// It has a user name or a password.
    #[error(
        "a user name or password in a URL ends up in logs; leave it out and check the signature, \
         or put a token into the path"
    )]
    Credentials,
    /// It has a fragment.
    #[error("what follows a # is never sent; leave it out")]
    Fragment,
    /// Its port is 0.
    #[error("nothing listens on port 0")]
    Port,
    /// Its host's name means something in one network alone.
    #[error("{0} is a name of one machine or one network; {HINT}")]
    PrivateName(String),
    /// Its host is an address that webhooks are not sent to.
    #[error("{address} is {what}; {HINT}")]
    Address {
        /// The address.
        address: IpAddr,
        /// What it is.
        what: &'static str,
    },
}

impl ReceiverPolicy {
    /// Checks a URL, and hands it back in its normal form. What a name resolves to is not looked
    /// at: that is checked at each attempt.
    ///
    /// # Errors
    /// [`UrlRefusal`].
    pub fn check_url(self, text: &str) -> Result<String, UrlRefusal> {
        self.parse(text).map(String::from)
    }

    pub(super) fn parse(self, text: &str) -> Result<Url, UrlRefusal> {
        if text.len() > URL_LENGTH_MAX {
            return Err(UrlRefusal::TooLong);
        }
        let url = Url::parse(text).map_err(|_| UrlRefusal::Malformed)?;
        match (url.scheme(), self) {
            ("https", _) | ("http", Self::PrivateToo) => {}
            _ => return Err(UrlRefusal::Scheme),
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(UrlRefusal::Credentials);
        }
        if url.fragment().is_some() {
            return Err(UrlRefusal::Fragment);
        }
        if url.port() == Some(0) {
            return Err(UrlRefusal::Port);
        }
        // The normal form of a name can be longer than what was sent.
        if url.as_str().len() > URL_LENGTH_MAX {
            return Err(UrlRefusal::TooLong);
        }
        self.check_host(url.host_str().ok_or(UrlRefusal::Malformed)?)?;
        Ok(url)
    }

    /// Checks a host in its normal form: numbers of all notations are dotted quads by now.
    fn check_host(self, host: &str) -> Result<(), UrlRefusal> {
        let bare = host.trim_start_matches('[').trim_end_matches(']');
        if let Ok(address) = bare.parse() {
            let refuse = |what| UrlRefusal::Address { address, what };
            return self.check_address(address).map_err(refuse);
        }
        if self == Self::Public && is_private_name(host) {
            return Err(UrlRefusal::PrivateName(host.to_owned()));
        }
        Ok(())
    }
}

fn is_private_name(host: &str) -> bool {
    let name = host.trim_end_matches('.');
    let below = |domain: &str| {
        name.strip_suffix(domain)
            .is_some_and(|rest| rest.is_empty() || rest.ends_with('.'))
    };
    !name.contains('.') || PRIVATE_DOMAINS.iter().any(|domain| below(domain))
}

#[cfg(test)]
mod tests;
