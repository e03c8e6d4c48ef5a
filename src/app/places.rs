//! Places for connections: a total number, of which one address may have only a share.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::activity::Activity;
use crate::api::{ClientAddress, Limits};

/// The places that connections take.
pub(super) struct Places {
    whole: usize,
    per_address: usize,
    open: Mutex<Open>,
}

#[derive(Default)]
struct Open {
    next: u64,
    connections: HashMap<u64, (ClientAddress, Arc<Activity>)>,
    by_address: HashMap<ClientAddress, usize>,
}

/// A connection's place; released when dropped.
pub(super) struct Place {
    places: Arc<Places>,
    number: u64,
    pub activity: Arc<Activity>,
}

/// Why a connection gets no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoPlace {
    /// Its address has its share, and none of those connections is idle.
    OfAddress,
    /// All places are taken, and no connection is idle.
    AtAll,
}

impl Places {
    pub(super) fn new(limits: &Limits) -> Self {
        Self {
            whole: limits.connections,
            per_address: limits.share(limits.connections),
            open: Mutex::default(),
        }
    }

    /// How many places one address may have.
    pub(super) fn per_address(&self) -> usize {
        self.per_address
    }

    /// Whether one address may have only some of the places.
    fn is_shared(&self) -> bool {
        self.per_address < self.whole
    }

    /// Takes a place, if necessary that of the connection that has been idle longest: one of the same address if that has
    /// its share, otherwise of any.
    pub(super) fn take(self: &Arc<Self>, client: ClientAddress) -> Result<Place, NoPlace> {
        let mut open = self.open();
        let held = open.by_address.get(&client).copied().unwrap_or(0);
        if self.is_shared() && held >= self.per_address && !open.close_idle(Some(client)) {
            return Err(NoPlace::OfAddress);
        }
        if open.connections.len() >= self.whole && !open.close_idle(None) {
            return Err(NoPlace::AtAll);
        }
        let activity = Arc::new(Activity::new());
        let number = open.next;
        open.next += 1;
        open.connections.insert(number, (client, activity.clone()));
        *open.by_address.entry(client).or_default() += 1;
        Ok(Place {
            places: self.clone(),
            number,
            activity,
        })
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Open {
    /// Closes the connection that has been idle longest, of one address or of any. Returns whether there was one.
    fn close_idle(&mut self, of: Option<ClientAddress>) -> bool {
        let idle = self.connections.iter().filter_map(|(number, entry)| {
            let (client, activity) = entry;
            let is_meant = of.is_none_or(|of| of == *client);
            Some((activity.idle_since().filter(|_| is_meant)?, *number))
        });
        let Some((_, number)) = idle.min() else {
            return false;
        };
        if let Some(activity) = self.remove(number) {
            activity.unwanted.cancel();
            metrics::counter!("mapshift_connections_displaced_total").increment(1);
        }
        true
    }

    fn remove(&mut self, number: u64) -> Option<Arc<Activity>> {
        let (client, activity) = self.connections.remove(&number)?;
        if let Some(held) = self.by_address.get_mut(&client) {
            *held -= 1;
            if *held == 0 {
                self.by_address.remove(&client);
            }
        }
        Some(activity)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.places.open().remove(self.number);
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use super::*;

    fn client(last: u8) -> ClientAddress {
        IpAddr::from([192, 0, 2, last]).into()
    }

    fn places(connections: usize) -> Arc<Places> {
        let limits = Limits {
            connections,
            ..Limits::default()
        };
        Arc::new(Places::new(&limits))
    }

    #[test]
    fn an_address_has_its_share_and_its_own_idle_connections_make_room() {
        let places = places(4);
        let first = places.take(client(1)).unwrap();
        let second = places.take(client(1)).unwrap();
        first.activity.begin();
        let third = places.take(client(1)).unwrap();
        assert!(second.activity.unwanted.is_cancelled());
        assert!(!first.activity.unwanted.is_cancelled());
        third.activity.begin();
        assert_eq!(places.take(client(1)).err(), Some(NoPlace::OfAddress));
        assert!(places.take(client(2)).is_ok());
        drop(first);
        assert!(places.take(client(1)).is_ok());
    }

    #[test]
    fn the_connection_that_has_been_idle_longest_makes_room() {
        let places = places(4);
        let held: Vec<Place> = (1..=4).map(|k| places.take(client(k)).unwrap()).collect();
        held[0].activity.begin();
        let next = places.take(client(5)).unwrap();
        let displaced: Vec<bool> = held
            .iter()
            .map(|place| place.activity.unwanted.is_cancelled())
            .collect();
        assert_eq!(displaced, [false, true, false, false]);
        for place in held[2..].iter().chain([&next]) {
            place.activity.begin();
        }
        assert_eq!(places.take(client(6)).err(), Some(NoPlace::AtAll));
        drop(held);
        drop(next);
        let open = places.open();
        assert!(open.connections.is_empty() && open.by_address.is_empty());
    }
}
