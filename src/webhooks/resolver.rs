//! Names are resolved once for each connection, and only to addresses that webhooks are sent to.
//!
//! The connection is made to what was checked: no second look-up could lead elsewhere.

use std::net::SocketAddr;

use reqwest::dns::{Addrs, Name, Resolve, Resolving};

use super::address::ReceiverPolicy;

/// Why a name leads nowhere.
#[derive(Debug, thiserror::Error)]
pub(super) enum NameRefusal {
    /// Nobody knows the name.
    #[error("the name could not be resolved")]
    Unknown(#[source] std::io::Error),
    /// It has addresses, all of them such as webhooks are not sent to.
    #[error("the name has no address that webhooks are sent to")]
    Addresses,
}

/// Resolves names by the system, and drops the addresses that are refused.
pub(super) struct GuardedResolver(pub(super) ReceiverPolicy);

impl Resolve for GuardedResolver {
    fn resolve(&self, name: Name) -> Resolving {
        let policy = self.0;
        Box::pin(async move {
            // The port comes from the URL.
            let found = tokio::net::lookup_host((name.as_str(), 0)).await;
            let found = found.map_err(NameRefusal::Unknown)?;
            let allowed = allowed(policy, found)?;
            Ok(Box::new(allowed.into_iter()) as Addrs)
        })
    }
}

fn allowed(
    policy: ReceiverPolicy,
    found: impl Iterator<Item = SocketAddr>,
) -> Result<Vec<SocketAddr>, NameRefusal> {
    let is_allowed = |address: &SocketAddr| policy.check_address(address.ip()).is_ok();
    let allowed: Vec<SocketAddr> = found.filter(is_allowed).collect();
    match allowed.is_empty() {
        true => Err(NameRefusal::Addresses),
        false => Ok(allowed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn left(policy: ReceiverPolicy, found: &[&str]) -> Option<Vec<String>> {
        let found = found
            .iter()
            .map(|text| SocketAddr::new(text.parse().unwrap(), 0));
        let left = allowed(policy, found).ok()?;
        Some(
            left.iter()
                .map(|address| address.ip().to_string())
                .collect(),
        )
    }

    #[test]
    fn what_is_refused_is_dropped_wherever_it_stands() {
        let public = ReceiverPolicy::Public;
        let mixed = [
            "10.0.0.1",
            "8.8.8.8",
            "::1",
            "2606:4700::1111",
            "169.254.169.254",
        ];
        assert_eq!(
            left(public, &mixed).unwrap(),
            ["8.8.8.8", "2606:4700::1111"]
        );
        assert_eq!(left(public, &["127.0.0.1", "::ffff:8.8.8.8"]), None);
        assert_eq!(left(public, &[]), None);
        let private = ReceiverPolicy::PrivateToo;
        assert_eq!(left(private, &mixed).unwrap().len(), 4);
        assert_eq!(left(private, &["169.254.169.254"]), None);
    }

    #[tokio::test]
    async fn names_are_looked_up_and_checked() {
        let resolve = |policy, name: &str| GuardedResolver(policy).resolve(name.parse().unwrap());
        let refused = resolve(ReceiverPolicy::Public, "localhost").await;
        let refused = refused.err().unwrap();
        let refused = refused.downcast_ref::<NameRefusal>().unwrap();
        assert!(matches!(refused, NameRefusal::Addresses), "{refused:?}");
        let found = resolve(ReceiverPolicy::PrivateToo, "localhost").await;
        assert!(found.unwrap().all(|address| address.ip().is_loopback()));
    }
}
