//! Maps that share a budget of memory.

use super::super::workspace::Workspaces;
use super::bench::{Bench, route};
use crate::ids::RouteId;

#[tokio::test(flavor = "multi_thread")]
async fn those_longest_unused_make_room_and_the_last_one_stays() {
    let (bench, _) = Bench::with_alert().await;
    let store = &bench.engine.store;
    let map = async || {
        let nowhere = Workspaces::new(0);
        nowhere.take(store, &route()).await.unwrap()
    };
    let bytes = map().await.size_bytes();
    // Some 150 scans of 180 beams, and what is made of them.
    assert!((1_500_000..6_000_000).contains(&bytes), "{bytes}");
    assert_eq!(map().await.size_bytes(), bytes);

    let maps = Workspaces::new(2 * bytes);
    let put = async |name: &str| {
        let workspace = map().await;
        maps.put_back(RouteId::new(name).unwrap(), workspace);
        maps.held().join(" ")
    };
    assert_eq!(put("a").await, "a");
    assert_eq!(put("b").await, "a b");
    assert_eq!(put("a").await, "b a");
    assert_eq!(put("c").await, "a c");
    let tight = Workspaces::new(bytes - 1);
    tight.put_back(RouteId::new("d").unwrap(), map().await);
    assert_eq!(tight.held(), ["d"]);
}
