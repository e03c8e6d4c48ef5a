//! Conditions of simulated worlds that are difficult for the detector.

use crate::sim::{PassErrors, Vehicle};

/// Laps before the change.
pub(super) const LAPS_BEFORE: usize = 2;
const LAPS_AFTER: usize = 2;
/// Laps of every vehicle.
pub(super) const LAPS: std::ops::Range<usize> = 0..LAPS_BEFORE + LAPS_AFTER;

/// Which world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WorldKind {
    /// The paper's.
    Hall,
    /// A store of pallet racks.
    Racks,
    /// A corridor with rooms; a third of the changes are doors.
    Rooms,
    /// Streets under an open sky.
    Street,
}

impl WorldKind {
    const ALL: [Self; 4] = [Self::Hall, Self::Racks, Self::Rooms, Self::Street];
    const FOR_NOISE: [Self; 2] = [Self::Hall, Self::Racks];
    pub(super) const INDOORS: [Self; 3] = [Self::Hall, Self::Racks, Self::Rooms];

    /// In tables.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Hall => "hall",
            Self::Racks => "racks",
            Self::Rooms => "rooms",
            Self::Street => "street",
        }
    }
}

/// Works in a building.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Works {
    /// Doors that open or close, where there are doors.
    pub doors: usize,
    /// Walls that are taken down, and as many that are put up elsewhere.
    pub walls: usize,
    /// Whether all that stands free in one third moves. Which third depends on the seed; laps
    /// begin in the second.
    pub rebuilds_third: bool,
}

impl Works {
    pub(super) const NONE: Self = Self {
        doors: 0,
        walls: 0,
        rebuilds_third: false,
    };
}

/// A simulated world with its vehicles and changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Condition {
    pub name: &'static str,
    pub worlds: &'static [WorldKind],
    /// Changes of the world between the laps before and the laps after.
    pub changes: usize,
    /// Works between the same laps.
    pub works: Works,
    /// People who walk, in every lap.
    pub walkers: usize,
    /// People who stand still, different ones in every lap.
    pub bystanders: usize,
    pub vehicles: usize,
    /// How far laps stray from the route, metres.
    pub path_noise_m: f64,
    /// Whether the last vehicle's lidar sits turned on its mount.
    pub faulty: bool,
    /// Whether every lap is a trip of its own.
    pub trip_a_lap: bool,
    /// Noise of all ranges instead of the vehicles' own, metres.
    pub range_sigma_m: Option<f64>,
    /// The lidars' maximum range instead of the vehicles' own, metres.
    pub range_max_m: Option<f64>,
    /// The errors that the scans of a lap have in common.
    pub pass_errors: PassErrors,
}

impl Condition {
    /// Whether doors are ajar in single laps; where errors are those of recordings.
    pub(super) fn has_doors_ajar(&self) -> bool {
        self.pass_errors != PassErrors::NONE
    }

    /// The vehicles.
    pub(super) fn fleet(&self) -> Vec<Vehicle> {
        (0..self.vehicles).map(|k| self.vehicle(k)).collect()
    }

    fn vehicle(&self, number: usize) -> Vehicle {
        let mut vehicle = Vehicle::of_fleet(number, self.path_noise_m);
        if self.faulty && number + 1 == self.vehicles {
            vehicle = vehicle.with_turned_lidar(2.0_f64.to_radians());
        }
        let lidar = &mut vehicle.lidar.geometry;
        lidar.range_sigma_m = self.range_sigma_m.unwrap_or(lidar.range_sigma_m);
        lidar.range_max_m = self.range_max_m.unwrap_or(lidar.range_max_m);
        vehicle.lidar.pass_errors = self.pass_errors;
        vehicle
    }
}

/// One vehicle, without difficulties.
pub(super) const PLAIN: Condition = Condition {
    name: "one vehicle",
    worlds: &WorldKind::ALL,
    changes: 6,
    works: Works::NONE,
    walkers: 0,
    bystanders: 0,
    vehicles: 1,
    path_noise_m: 0.5,
    faulty: false,
    trip_a_lap: false,
    range_sigma_m: None,
    range_max_m: None,
    pass_errors: PassErrors::NONE,
};

/// One vehicle, about half of what it sees changed between two laps of its trip.
pub(super) const REBUILT: Condition = Condition {
    name: "50 changes at once",
    changes: 50,
    ..PLAIN
};

/// One vehicle, and much that was rebuilt between two trips.
pub(super) const BUILDING_WORKS: Condition = works(
    "doors, walls and a third rebuilt at once",
    &WorldKind::INDOORS,
    Works {
        doors: 12,
        walls: 4,
        rebuilds_third: true,
    },
);

/// One vehicle with correlated errors as in recordings, among people who stand still.
pub(super) const CORRELATED: Condition = Condition {
    name: "as correlated as recordings",
    walkers: 3,
    bystanders: 3,
    pass_errors: PassErrors::AS_RECORDED,
    ..PLAIN
};

/// Every condition, in the order of the table.
pub(super) const CONDITIONS: [Condition; 19] = [
    PLAIN,
    Condition {
        name: "3 people walk",
        walkers: 3,
        ..PLAIN
    },
    Condition {
        name: "4 vehicles, 3 kinds of lidar, 3 people, strays of 1 m",
        walkers: 3,
        vehicles: 4,
        path_noise_m: 1.0,
        ..PLAIN
    },
    Condition {
        name: "every lap localised by search, 3 people",
        trip_a_lap: true,
        walkers: 3,
        ..PLAIN
    },
    REBUILT,
    Condition {
        name: "50 changes at once, every lap localised by search",
        trip_a_lap: true,
        ..REBUILT
    },
    works(
        "12 doors swing",
        &[WorldKind::Rooms],
        Works {
            doors: 12,
            ..Works::NONE
        },
    ),
    works(
        "4 walls move",
        &WorldKind::INDOORS,
        Works {
            walls: 4,
            ..Works::NONE
        },
    ),
    works(
        "a third rebuilt",
        &WorldKind::ALL,
        Works {
            rebuilds_third: true,
            ..Works::NONE
        },
    ),
    BUILDING_WORKS,
    Condition {
        name: "nothing changes, 5 people, one of 3 lidars turned by 2°",
        changes: 0,
        walkers: 5,
        vehicles: 3,
        faulty: true,
        ..PLAIN
    },
    noisy("range noise of 1 cm", 0.01),
    noisy("range noise of 2 cm", 0.02),
    noisy("range noise of 3 cm", 0.03),
    noisy("range noise of 4 cm", 0.04),
    noisy("range noise of 5 cm", 0.05),
    short("lidar of 6 m", 6.0),
    short("lidar of 2 m", 2.0),
    CORRELATED,
];

/// Every lap is localised by search.
const fn works(name: &'static str, worlds: &'static [WorldKind], works: Works) -> Condition {
    Condition {
        name,
        worlds,
        changes: 0,
        works,
        trip_a_lap: true,
        ..PLAIN
    }
}

const fn noisy(name: &'static str, range_sigma_m: f64) -> Condition {
    Condition {
        name,
        worlds: &WorldKind::FOR_NOISE,
        range_sigma_m: Some(range_sigma_m),
        ..PLAIN
    }
}

const fn short(name: &'static str, range_max_m: f64) -> Condition {
    Condition {
        name,
        worlds: &WorldKind::INDOORS,
        range_max_m: Some(range_max_m),
        ..PLAIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lidars_are_what_their_conditions_say() {
        for condition in CONDITIONS {
            for vehicle in condition.fleet() {
                let lidar = vehicle.lidar.geometry.validated().unwrap();
                let states = |stated: Option<f64>, value| stated.is_none_or(|s| s == value);
                assert!(states(condition.range_sigma_m, lidar.range_sigma_m));
                assert!(states(condition.range_max_m, lidar.range_max_m));
            }
        }
    }

    #[test]
    fn names_are_unique() {
        let names: std::collections::BTreeSet<_> = CONDITIONS.iter().map(|c| c.name).collect();
        assert_eq!(names.len(), CONDITIONS.len());
    }
}
