//! The gate that reads of one weight pass: a few are worked on at once, one address may have only a share of
//! them under way, and one route never has all turns: who wants another's picture does not wait for it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, SemaphorePermit};
use tokio::time::{Instant, timeout_at};

use super::client_address::ClientAddress;
use super::limits::{Limits, Reads};
use super::problem::{Problem, ProblemKind};
use super::shares::{Share, Shares};
use crate::ids::RouteId;

/// Bounds the reads of one weight.
pub(super) struct Gate {
    under_way: Shares,
    turns: Semaphore,
    turns_of_routes: TurnsOfRoutes,
}

/// What a read holds while it is worked on.
pub(super) struct Admitted<'a> {
    /// Counts against the client's address until the answer has been sent.
    pub share: Share,
    /// Lets the next read begin once it is dropped.
    pub turn: Turn<'a>,
}

/// A turn, and the route's if the read is of one.
pub(super) struct Turn<'a> {
    _of_all: SemaphorePermit<'a>,
    _of_route: Option<OwnedSemaphorePermit>,
}

impl Gate {
    pub(super) fn new(name: &'static str, reads: Reads, limits: &Limits) -> Self {
        let share = limits.share(reads.under_way);
        Self {
            under_way: Shares::of_requests(name, reads.under_way, share),
            turns: Semaphore::new(reads.at_once),
            turns_of_routes: TurnsOfRoutes {
                each: reads.at_once.saturating_sub(1).max(1),
                by_route: Mutex::default(),
            },
        }
    }

    /// Waits for a turn, at most `time_max`: first for one of the route's, if the read is of one.
    ///
    /// # Errors
    /// 429 if the address has its share, 503 if no turn comes in time.
    pub(super) async fn enter(
        &self,
        client: ClientAddress,
        route: Option<&RouteId>,
        time_max: Duration,
    ) -> Result<Admitted<'_>, Problem> {
        let deadline = Instant::now() + time_max;
        let share = self.under_way.take(client, time_max).await?;
        let turn = timeout_at(deadline, self.turn(route)).await;
        let turn = turn.map_err(|_| {
            let detail = "too many reads are under way; send the same again later";
            Problem::new(ProblemKind::Overloaded, detail)
        })??;
        Ok(Admitted { share, turn })
    }

    async fn turn(&self, route: Option<&RouteId>) -> Result<Turn<'_>, Problem> {
        let of_route = match route {
            Some(route) => {
                let turns = self.turns_of_routes.of(route);
                Some(turns.acquire_owned().await.map_err(Problem::internal)?)
            }
            None => None,
        };
        let of_all = self.turns.acquire().await.map_err(Problem::internal)?;
        Ok(Turn {
            _of_all: of_all,
            _of_route: of_route,
        })
    }
}

/// The turns of each route that is read.
struct TurnsOfRoutes {
    each: usize,
    by_route: Mutex<BTreeMap<RouteId, Arc<Semaphore>>>,
}

impl TurnsOfRoutes {
    fn of(&self, route: &RouteId) -> Arc<Semaphore> {
        let mut by_route = self.by_route.lock().unwrap_or_else(PoisonError::into_inner);
        by_route.retain(|_, turns| Arc::strong_count(turns) > 1);
        let turns = by_route.entry(route.clone());
        Arc::clone(turns.or_insert_with(|| Arc::new(Semaphore::new(self.each))))
    }
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};

    use super::*;

    #[tokio::test]
    async fn a_route_never_has_all_turns() {
        let gate = Gate::new("reads", Limits::default().heavy_reads, &Limits::default());
        let client = ClientAddress::from(IpAddr::V4(Ipv4Addr::LOCALHOST));
        let [large, other] = ["large", "other"].map(|id| RouteId::new(id).unwrap());
        // Whoever does not get a turn at once gets none.
        let enter = |route| gate.enter(client, route, Duration::ZERO);
        let drawing = enter(Some(&large)).await.unwrap();
        assert!(enter(Some(&large)).await.is_err());
        let of_other = enter(Some(&other)).await.unwrap();
        drop(of_other);
        let of_none = enter(None).await.unwrap();
        assert!(enter(Some(&other)).await.is_err(), "all turns are taken");
        drop((drawing, of_none));
        assert!(enter(Some(&large)).await.is_ok());
        enter(Some(&other)).await.unwrap();
        assert_eq!(gate.turns_of_routes.by_route.lock().unwrap().len(), 1);
    }
}
