//! A vehicle that disagrees with the others everywhere.

use super::reported::{after_lap, brief, empty_route};
use super::shop::Shop;

const TURN_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// The third lap and the sixth are of a vehicle whose lidar always sits turned on its mount by 2°.
/// That is how the vehicle is: nothing about it changes, and the map is of what it sees.
#[tokio::test(flavor = "multi_thread")]
async fn a_lidar_that_always_sits_turned_raises_nothing() {
    let mut shop = Shop::new(8);
    let sound = shop.vehicles.clone();
    let turned = sound[0].clone().with_turned_lidar(TURN_RAD);
    let service = empty_route().await;
    let client = &service.client;
    shop.vehicles = vec![sound[0].clone(), sound[1].clone(), turned];
    for lap in 0..6 {
        let reported = after_lap(client, &shop, lap).await;
        let reported: Vec<_> = reported.iter().map(brief).collect();
        assert!(reported.is_empty(), "lap {lap}: {reported:?}");
    }
    service.stop().await;
}
