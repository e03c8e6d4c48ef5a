//! Limited resources: a total amount, of which one client address may take only a share.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::client_address::ClientAddress;
use super::problem::{Problem, ProblemKind};
use super::quota::Quota;

/// A limited resource.
pub(super) struct Shares {
    name: &'static str,
    /// How much one address may take; `None` if it may take all.
    quota: Option<Quota>,
    whole: Arc<Semaphore>,
    by_address: Arc<Mutex<HashMap<ClientAddress, usize>>>,
}

/// What a client has taken; released when dropped.
pub(super) struct Share {
    _permit: OwnedSemaphorePermit,
    _own: Own,
}

/// The amount counted against an address.
struct Own {
    by_address: Arc<Mutex<HashMap<ClientAddress, usize>>>,
    client: ClientAddress,
    amount: usize,
}

impl Shares {
    /// `whole` requests, of which one address may have `per_address`.
    pub(super) fn of_requests(name: &'static str, whole: usize, per_address: usize) -> Self {
        Self::new(name, whole, Quota::requests(name, per_address))
    }

    /// `whole` bytes, of which one address may have `per_address`.
    pub(super) fn of_bytes(name: &'static str, whole: usize, per_address: usize) -> Self {
        Self::new(name, whole, Quota::bytes(name, per_address))
    }

    fn new(name: &'static str, whole: usize, quota: Quota) -> Self {
        Self {
            name,
            quota: Some(quota).filter(|quota| quota.amount() < whole),
            whole: Arc::new(Semaphore::new(whole)),
            by_address: Arc::default(),
        }
    }

    /// Takes an amount without waiting.
    ///
    /// # Errors
    /// 429 if the address has its share, 503 if nothing is left.
    pub(super) fn try_take(&self, client: ClientAddress, amount: usize) -> Result<Share, Problem> {
        let own = self.own(client, amount)?;
        let amount = u32::try_from(amount).unwrap_or(u32::MAX);
        let permit = self.whole.clone().try_acquire_many_owned(amount);
        let permit = permit.map_err(|_| self.none_left())?;
        Ok(Share {
            _permit: permit,
            _own: own,
        })
    }

    /// Takes one, waiting for it if none is free.
    ///
    /// # Errors
    /// 429 if the address has its share, 503 if none becomes free.
    pub(super) async fn take(
        &self,
        client: ClientAddress,
        time_max: Duration,
    ) -> Result<Share, Problem> {
        let own = self.own(client, 1)?;
        let permit = tokio::time::timeout(time_max, self.whole.clone().acquire_owned()).await;
        let permit = permit.map_err(|_| self.none_left())?;
        let permit = permit.map_err(Problem::internal)?;
        Ok(Share {
            _permit: permit,
            _own: own,
        })
    }

    fn own(&self, client: ClientAddress, amount: usize) -> Result<Own, Problem> {
        let mut by_address = lock(&self.by_address);
        let held = by_address.get(&client).copied().unwrap_or(0);
        let exceeds = |quota: &&Quota| held + amount > quota.amount();
        if let Some(quota) = self.quota.as_ref().filter(exceeds) {
            refused(self.name, "address");
            return Err(quota.exceeded());
        }
        by_address.insert(client, held + amount);
        Ok(Own {
            by_address: self.by_address.clone(),
            client,
            amount,
        })
    }

    fn none_left(&self) -> Problem {
        refused(self.name, "service");
        let detail = format!(
            "too many {} are under way; send the same again later",
            self.name
        );
        Problem::new(ProblemKind::Overloaded, detail)
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        let mut by_address = lock(&self.by_address);
        if let Some(held) = by_address.get_mut(&self.client) {
            *held -= self.amount;
            if *held == 0 {
                by_address.remove(&self.client);
            }
        }
    }
}

fn lock(
    by_address: &Mutex<HashMap<ClientAddress, usize>>,
) -> std::sync::MutexGuard<'_, HashMap<ClientAddress, usize>> {
    by_address.lock().unwrap_or_else(PoisonError::into_inner)
}

fn refused(limit: &'static str, scope: &'static str) {
    metrics::counter!("mapshift_limit_refusals_total", "limit" => limit, "scope" => scope)
        .increment(1);
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use super::*;

    fn client(text: &str) -> ClientAddress {
        text.parse::<IpAddr>().unwrap().into()
    }

    fn refusal<T>(outcome: Result<T, Problem>) -> ProblemKind {
        outcome.map(drop).unwrap_err().kind()
    }

    #[test]
    fn one_address_gets_its_share_and_leaves_the_rest_to_others() {
        let shares = Shares::of_requests("tests", 3, 2);
        let (one, other) = (client("192.0.2.1"), client("192.0.2.2"));
        let held = [shares.try_take(one, 1), shares.try_take(one, 1)];
        assert!(held.iter().all(Result::is_ok));
        assert_eq!(
            refusal(shares.try_take(one, 1)),
            ProblemKind::TooManyRequests
        );
        let last = shares.try_take(other, 1).unwrap();
        assert_eq!(refusal(shares.try_take(other, 1)), ProblemKind::Overloaded);
        drop((held, last));
        assert!(lock(&shares.by_address).is_empty());
        assert!(shares.try_take(one, 2).is_ok());
    }

    #[test]
    fn a_refusal_of_the_whole_does_not_count_against_the_address() {
        let shares = Shares::of_bytes("tests", 4, 4);
        let held = shares.try_take(client("192.0.2.1"), 3).unwrap();
        let other = client("192.0.2.2");
        assert_eq!(refusal(shares.try_take(other, 2)), ProblemKind::Overloaded);
        drop(held);
        assert!(shares.try_take(other, 4).is_ok());
    }

    #[tokio::test]
    async fn taking_one_waits_for_a_bounded_time() {
        let shares = Shares::of_requests("tests", 1, 1);
        let held = shares.try_take(client("192.0.2.1"), 1).unwrap();
        let wait = |time_max| shares.take(client("192.0.2.2"), time_max);
        let refused = wait(Duration::from_millis(5)).await;
        assert_eq!(refusal(refused), ProblemKind::Overloaded);
        let patient = wait(Duration::from_secs(60));
        let (waited, ()) = tokio::join!(patient, async { drop(held) });
        assert!(waited.is_ok());
    }
}
