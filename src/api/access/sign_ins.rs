//! How often one address may try an invalid key.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

use crate::api::client_address::ClientAddress;
use crate::api::problem::{Problem, ProblemKind};

const FAILURES_MAX: u32 = 10;
const WINDOW: Duration = Duration::from_secs(60);
/// Addresses that are remembered; beyond this number those whose window is over are forgotten first, then all.
const ADDRESSES_MAX: usize = 10_000;

/// Failed sign-ins by address.
#[derive(Default)]
pub(in crate::api) struct SignIns(Mutex<HashMap<ClientAddress, Failures>>);

struct Failures {
    since: Instant,
    count: u32,
}

impl SignIns {
    /// Refuses an address that has failed too often recently.
    ///
    /// # Errors
    /// A [`Problem`] that says when to try again.
    pub(in crate::api) fn check(&self, client: ClientAddress, now: Instant) -> Result<(), Problem> {
        let failures = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(failed) = failures.get(&client) else {
            return Ok(());
        };
        let left = WINDOW.saturating_sub(now.duration_since(failed.since));
        if failed.count < FAILURES_MAX || left.is_zero() {
            return Ok(());
        }
        let detail = "this address has sent too many invalid keys; try again later";
        let problem = Problem::new(ProblemKind::TooManySignIns, detail);
        Err(problem.retry_after(left.as_secs() as u32 + 1))
    }

    /// Counts a failure.
    pub(in crate::api) fn failed(&self, client: ClientAddress, now: Instant) {
        let mut failures = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        failures.retain(|_, failed| now.duration_since(failed.since) < WINDOW);
        if failures.len() >= ADDRESSES_MAX {
            failures.clear();
        }
        let new = || Failures {
            since: now,
            count: 0,
        };
        failures.entry(client).or_insert_with(new).count += 1;
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use super::*;

    #[test]
    fn an_address_waits_after_ten_failures() {
        let address = |text: &str| ClientAddress::from(text.parse::<IpAddr>().unwrap());
        let (one, other) = (address("192.0.2.1"), address("192.0.2.2"));
        let (sign_ins, now) = (SignIns::default(), Instant::now());
        for _ in 0..FAILURES_MAX {
            assert!(sign_ins.check(one, now).is_ok());
            sign_ins.failed(one, now);
        }
        assert!(sign_ins.check(one, now).is_err());
        assert!(sign_ins.check(other, now).is_ok());
        assert!(sign_ins.check(one, now + WINDOW).is_ok());
    }
}
