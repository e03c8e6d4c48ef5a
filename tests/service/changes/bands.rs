//! A 3D lidar whose gateway sends two height bands: a table comes, and stands in one of them.

use mapshift::geometry::Pose2;
use mapshift::scan::{BandScanner, CloudLidar, HeightBand};
use mapshift::sim::{Changes, Furniture, Scene, SimCloudLidar, Vehicle};
use serde_json::{Value, json};

use super::reported::{ROUTE, alerts, brief, empty_route};
use crate::drives::{Drive, workshop};

const LAPS_BEFORE: usize = 2;
const LAPS: usize = 4;
const SCANS: usize = 60;
const PATH_NOISE_M: f64 = 0.1;

fn lidar() -> SimCloudLidar {
    let ring = |k: u32| (0.66 * f64::from(k) - 16.0).to_radians();
    SimCloudLidar {
        lidar: CloudLidar {
            mount: Pose2::new(0.2, 0.0, 0.0),
            height_m: 0.85,
            elevations_rad: (0..32).map(ring).collect(),
            beams: 360,
            range_min_m: 0.3,
            range_max_m: 30.0,
            range_sigma_m: 0.01,
        },
        dropout_rate: 0.002,
    }
}

/// From clouds to alerts: both bands make one map, and the top of the table, which the low band
/// looks under, is reported in the high one.
#[tokio::test(flavor = "multi_thread")]
async fn a_table_is_reported_in_the_band_that_shows_its_top() {
    let lidar = lidar();
    let scanner = |from_m, to_m, least_m| {
        BandScanner::new(
            &lidar.lidar,
            HeightBand::new(from_m, to_m).unwrap(),
            least_m,
        )
        .unwrap()
    };
    let scanners = [scanner(0.1, 0.4, 0.1), scanner(0.6, 1.0, 0.03)];
    let mut scene = Scene::of_hall(&workshop(), 1);
    let mut changes = Changes::new(&mut scene, LAPS_BEFORE, PATH_NOISE_M, 1);
    let parts = changes.furnish(Furniture::Table, 0.4).unwrap();
    let top = scene.objects[*parts.last().unwrap()].shape.clone();

    let vehicle = Vehicle {
        scan_spacing_m: 0.2,
        ..Vehicle::of_fleet(0, PATH_NOISE_M)
    };
    let service = empty_route().await;
    for lap in 0..LAPS {
        let drives = scene
            .drive_bands(&vehicle, &lidar, &scanners, lap..lap + 1, 1)
            .unwrap();
        for (k, (scanner, scans)) in scanners.iter().zip(drives).enumerate() {
            let mut of_band = vehicle.clone();
            of_band.lidar.geometry = (**scanner.lidar()).clone();
            let (name, trip) = (format!("band-{k}"), format!("band-{k}-lap-{lap}"));
            let hours = (2 * lap + k) as i64;
            let drive = Drive::of(&of_band, (&name, &trip), scans, hours);
            service.client.put_all(ROUTE, &drive.batches(SCANS)).await;
        }
    }
    service.client.merged(ROUTE).await;
    let reported = alerts(&service.client).await;
    let lines: Vec<String> = reported.iter().map(brief).collect();
    let high = json!([{"from": 0.6, "to": 1.0}]);
    let of_table = reported.iter().find(|alert| {
        let place = super::reported::place(alert);
        alert["kind"] == "appeared" && top.contains(&place) && alert["bands"] == high
    });
    let of_table = of_table.unwrap_or_else(|| panic!("{lines:?}"));
    assert_eq!(of_table["status"], "open");
    let is_near = |alert: &&Value| {
        let place = super::reported::place(alert);
        top.contains(&place) || top.distance_to(&place) < 0.3
    };
    assert!(reported.iter().all(|alert| is_near(&alert)), "{lines:?}");
    // A node says what its scan is made of.
    let node = of_table["node_ids"][0].as_i64().unwrap();
    let scan = service
        .client
        .json(&format!("/v1/routes/{ROUTE}/nodes/{node}/scan"))
        .await;
    assert_eq!(scan["lidar"]["band"]["from"], 0.6);
    service.stop().await;
}
