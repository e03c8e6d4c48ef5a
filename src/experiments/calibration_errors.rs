//! How well a vehicle's trips show what is off of it: simulated vehicles, each with one error whose
//! size is known, and sound ones, of which nothing may be corrected.

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::off_vehicle::OffVehicle;
use super::table::Table;
use crate::calibration::{
    CalibratedTrip, Corrections, Estimate, MapFit, MapScan, Quantity, TripCalibration, TripScan,
    VehicleCalibration,
};
use crate::geometry::Pose2;
use crate::ids::{StampNs, TripId};
use crate::matching::ReferenceCloud;
use crate::scan::{SurfacePoint, surface_points};
use crate::sim::{Hall, Scene, SimScan};

/// Laps of a vehicle, each of which is a trip: as many as it takes to be sure of something.
const TRIPS: usize = 4;
/// From the start of a trip to that of the next, seconds.
const PAUSE_S: f64 = 10_000.0;
/// So many of a trip's scans are compared with a map of another vehicle.
const COMPARED: usize = 60;
/// Every so many of another vehicle's scans make the map.
const MAP_EVERY: usize = 3;
/// An estimate is right within so many of its standard errors.
const RIGHT_SIGMAS: f64 = 2.0;

/// What a vehicle's trips showed of one quantity.
#[derive(Debug, Clone, Serialize)]
pub struct CalibrationCase {
    /// What is off; `None` for a sound vehicle.
    pub quantity: Option<Quantity>,
    /// How the vehicle and its hall were drawn.
    pub seed: u64,
    /// By how much it is off, in the quantity's unit.
    pub truth: f64,
    /// What the trips show together; `None` if they show nothing.
    pub estimate: Option<Estimate>,
    /// Whether they are sure of it: the next trip is corrected, or the vehicle is suspected.
    pub is_sure: bool,
    /// What else they are sure of, although it is as stated.
    pub wrongly_sure: Vec<Quantity>,
    /// Whether the vehicle would be suspected of something else.
    pub is_suspected: bool,
}

/// Drives `seeds` vehicles for each quantity, and as many sound ones; calls `after_vehicle` after
/// each.
///
/// # Errors
/// If a hall has no route.
pub fn measure_calibration(
    seeds: std::ops::Range<u64>,
    after_vehicle: impl Fn() + Sync,
) -> anyhow::Result<Vec<CalibrationCase>> {
    let rows = Quantity::ALL.into_iter().map(Some).chain([None]);
    let cases: Vec<_> = rows
        .flat_map(|quantity| seeds.clone().map(move |seed| (quantity, seed)))
        .collect();
    let run_one = |(quantity, seed)| {
        let case = run(quantity, seed);
        after_vehicle();
        case
    };
    cases.into_par_iter().map(run_one).collect()
}

fn run(quantity: Option<Quantity>, seed: u64) -> anyhow::Result<CalibrationCase> {
    let hall = Hall::generate(seed)?;
    let scene = Scene::lasting(hall.route, hall.world.shapes().cloned(), seed);
    let off = OffVehicle::drawn(quantity.as_slice(), seed);
    let map = Map::of(&scene, seed)?;
    let mut trips = Vec::new();
    for lap in 1..=TRIPS {
        let driven = scene.drive(&off.vehicle, lap..lap + 1, seed);
        let scans = off.sent(&driven, PAUSE_S * lap as f64)?;
        trips.push(CalibratedTrip {
            trip: TripId::new(format!("{lap}"))?,
            stamp: scans.last().map_or(StampNs(0), |scan| scan.stamp),
            scans: scans.len() as u32,
            calibration: map.compared(&scans, &driven)?,
        });
    }
    Ok(judged(quantity, seed, &off.truth, trips))
}

/// What a sound vehicle has mapped of a hall.
struct Map {
    scans: Vec<(Pose2, Vec<SurfacePoint>)>,
}

impl Map {
    fn of(scene: &Scene, seed: u64) -> anyhow::Result<Self> {
        let maker = OffVehicle::new(Corrections::default());
        let driven = scene.drive(&maker.vehicle, 0..1, seed + 1);
        let sent = maker.sent(&driven, 0.0)?;
        let placed = driven.iter().zip(&sent).step_by(MAP_EVERY);
        let scans = placed.map(|(driven, sent)| (driven.map_from_base, surface_points(&sent.scan)));
        Ok(Self {
            scans: scans.collect(),
        })
    }

    /// What a trip shows, by itself and beside the map.
    fn compared(&self, scans: &[TripScan], driven: &[SimScan]) -> anyhow::Result<TripCalibration> {
        let cloud = self.scans.iter().map(|(pose, p)| (*pose, p.as_slice()));
        let every = scans.len().div_ceil(COMPARED).max(1);
        let cloud = ReferenceCloud::new(cloud);
        let cloud = cloud.ok_or_else(|| anyhow::anyhow!("the map of the hall is empty"))?;
        let compared = scans.iter().zip(driven).step_by(every);
        let compared = compared.map(|(scan, driven)| MapScan {
            scan: &scan.scan,
            map: &cloud,
            map_from_base: driven.map_from_base,
        });
        let map_fit = MapFit { near: 0, closed: 0 };
        let calibration = TripCalibration::of_scans(scans);
        Ok(calibration.beside_others(map_fit, &compared.collect::<Vec<_>>()))
    }
}

fn judged(
    quantity: Option<Quantity>,
    seed: u64,
    truth: &Corrections,
    trips: Vec<CalibratedTrip>,
) -> CalibrationCase {
    let known = VehicleCalibration::of(trips);
    let mut sure = known.sure();
    sure.extend(known.uncorrected());
    let is_sure = quantity.is_some_and(|quantity| sure.remove(&quantity).is_some());
    let (_, faults) = known.lasting_faults();
    let is_steady = known.changes().is_empty() && known.unsteady().is_empty();
    CalibrationCase {
        quantity,
        seed,
        truth: quantity.map_or(0.0, |quantity| truth.get(quantity)),
        estimate: quantity.and_then(|quantity| Some(known.combined(quantity)?.estimate)),
        is_sure,
        wrongly_sure: sure.into_keys().collect(),
        is_suspected: !(is_steady && faults.is_empty()),
    }
}

/// A row for each quantity.
pub fn calibration_text(cases: &[CalibrationCase]) -> String {
    let mut table = Table::new(
        "Errors of vehicles, as their trips show them",
        &[
            "off",
            "vehicles",
            "known",
            "error, median",
            "90 %",
            "standard error, median",
            "within 2 of them",
            "sure, of those worth it",
            "sure of something else",
            "suspected",
        ],
    );
    for quantity in Quantity::ALL.into_iter().map(Some).chain([None]) {
        let row: Vec<_> = cases.iter().filter(|c| c.quantity == quantity).collect();
        if !row.is_empty() {
            table.row(cells(quantity, &row));
        }
    }
    table.remark(format!(
        "Each vehicle drives {TRIPS} laps, a trip each. Errors are in radians, metres, seconds, radians \
         a metre, and otherwise shares. Ways by scans grow with the ranges, so that a wrong range_scale \
         shows as a way_scale too."
    ));
    table.text()
}

fn cells(quantity: Option<Quantity>, row: &[&CalibrationCase]) -> Vec<String> {
    let known = || row.iter().filter_map(|c| Some((c.truth, c.estimate?)));
    let mut errors: Vec<f64> = known().map(|(truth, e)| (e.value - truth).abs()).collect();
    let mut sigmas: Vec<f64> = known().map(|(_, e)| e.sigma).collect();
    errors.sort_by(f64::total_cmp);
    sigmas.sort_by(f64::total_cmp);
    let at = |sorted: &[f64], share: f64| {
        let value = sorted.get((share * sorted.len() as f64) as usize);
        value.map_or_else(|| "–".to_owned(), |value| format!("{value:.5}"))
    };
    let within = known().filter(|(truth, e)| (e.value - truth).abs() <= RIGHT_SIGMAS * e.sigma);
    let least = quantity.map_or(f64::MAX, Quantity::applied_min);
    let worth = row.iter().filter(|c| c.truth.abs() >= least);
    let is_corrected = quantity.is_some_and(Quantity::is_of_vehicle);
    let sure = match is_corrected {
        true => {
            let sure = worth.clone().filter(|c| c.is_sure).count();
            format!("{sure} of {}", worth.count())
        }
        false => "–".to_owned(),
    };
    let count = |is: fn(&CalibrationCase) -> bool| row.iter().filter(|c| is(c)).count().to_string();
    vec![
        quantity.map_or("nothing", Quantity::name).to_owned(),
        row.len().to_string(),
        errors.len().to_string(),
        at(&errors, 0.5),
        at(&errors, 0.9),
        at(&sigmas, 0.5),
        within.count().to_string(),
        sure,
        count(|c| !c.wrongly_sure.is_empty()),
        count(|c| c.is_suspected),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_counts_what_is_right() {
        let case = |seed, value: f64| CalibrationCase {
            quantity: Some(Quantity::RangeScale),
            seed,
            truth: 0.03,
            estimate: Some(Estimate {
                value,
                sigma: 0.001,
            }),
            is_sure: seed > 1,
            wrongly_sure: Vec::new(),
            is_suspected: seed == 1,
        };
        let cases = [case(1, 0.0), case(2, 0.031), case(3, 0.0305)];
        let row = cells(cases[0].quantity, &cases.iter().collect::<Vec<_>>());
        let expected = [
            "range_scale",
            "3",
            "3",
            "0.00100",
            "0.03000",
            "0.00100",
            "2",
            "2 of 3",
            "0",
            "1",
        ];
        assert_eq!(row, expected);
        assert!(calibration_text(&cases).contains("range_scale"));
    }
}
