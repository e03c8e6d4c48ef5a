//! A vehicle that disagrees with the others everywhere.

use super::shop::{Shop, vehicle_name};
use super::told::{after_lap, brief, empty_route, names};

const TURN_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// The third lap and the sixth are of a vehicle whose lidar is turned on its mount by 2°; after
/// the second of them it is known.
#[tokio::test(flavor = "multi_thread")]
async fn a_turned_lidar_is_told_and_its_word_does_not_count() {
    let mut shop = Shop::new(8);
    let sound = shop.vehicles.clone();
    let turned = sound[0].clone().with_turned_lidar(TURN_RAD);
    let service = empty_route().await;
    let client = &service.client;
    shop.vehicles = vec![sound[0].clone(), sound[1].clone(), turned];
    for lap in 0..6 {
        let told = after_lap(client, &shop, lap).await;
        let changes = told.iter().filter(|a| a["kind"] != "vehicle_suspect");
        assert_eq!(changes.count(), 0, "lap {lap}: {told:?}");
        let suspects: Vec<_> = told.iter().map(|a| names(a, "vehicle_ids")).collect();
        eprintln!(
            "lap {lap}: {:?}",
            told.iter().map(brief).collect::<Vec<_>>()
        );
        if lap < 2 {
            assert!(suspects.is_empty(), "lap {lap}: {suspects:?}");
        } else if lap < 5 {
            assert!(suspects.len() <= 1, "lap {lap}: {suspects:?}");
        } else {
            assert_eq!(suspects, [[vehicle_name(2)]], "lap {lap}");
            assert_eq!(told[0]["status"], "open");
        }
    }
    service.stop().await;
}
