//! The plan of a simulation: a world, its vehicles, and the changes.

use anyhow::{bail, ensure};

use crate::sim::{Changes, Hall, Rooms, RouteError, Scene, SimScan, Vehicle};

/// Sizes of new objects, relative to the mean area of the original ones.
const AREA_SHARES: [f64; 3] = [0.3, 1.0, 0.1];
/// How far a faulty vehicle's lidar is knocked aside on its mount, degrees.
pub(super) const FAULT_DEG: f64 = 2.0;
/// Sound laps of a faulty vehicle, each a trip of its own: enough to calibrate its mount.
const SOUND_LAPS: usize = 3;
/// Fewest laps afterwards: enough to confirm the change.
const FAULTY_LAPS_MIN: usize = 2;

/// The kind of world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum WorldKind {
    /// A production hall with racks, boxes and columns.
    Hall,
    /// A store of pallet racks on thin legs.
    Racks,
    /// A corridor between rooms with doors.
    Rooms,
    /// Streets with houses, poles and parked cars.
    Street,
}

/// The parameters of a simulation.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct PlanArgs {
    /// The world in which the vehicles drive.
    #[arg(long, value_enum, default_value_t = WorldKind::Hall)]
    pub world: WorldKind,
    /// Laps of each vehicle.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u8).range(1..=50))]
    pub laps: u8,
    /// Vehicles; their lidars, mounts and wheels differ.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=20))]
    pub vehicles: u8,
    /// Changes of the world: objects that come, go and move.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(0..=100))]
    pub changes: u8,
    /// Laps that are driven before the world changes; else half of them.
    #[arg(long, value_name = "LAPS")]
    pub change_lap: Option<u8>,
    /// People who walk near the route in every lap.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=50))]
    pub walkers: u8,
    /// How far laps stray from the route, metres, 0 to 1.
    #[arg(long, value_name = "METRES", default_value_t = 0.3)]
    pub path_noise: f64,
    /// The same seed gives the same simulation.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// After three laps the last vehicle's lidar is knocked aside by 2°, and the vehicle does not know.
    #[arg(long)]
    pub faulty: bool,
}

/// A simulation that is ready to be driven.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub scene: Scene,
    pub vehicles: Vec<Vehicle>,
    pub laps: usize,
    pub seed: u64,
    /// The first lap in which the last vehicle's lidar is turned.
    pub knocked_lap: Option<usize>,
}

impl Plan {
    /// Everything that the vehicle of this number (from 0) records.
    pub(super) fn drive(&self, number: usize) -> Vec<SimScan> {
        let vehicle = &self.vehicles[number];
        let seed = self.seed + number as u64;
        let is_last = number + 1 == self.vehicles.len();
        let sound_laps = self.knocked_lap.filter(|_| is_last).unwrap_or(self.laps);
        let mut scans = self.scene.drive(vehicle, 0..sound_laps, seed);
        let knocked = vehicle.clone().with_turned_lidar(FAULT_DEG.to_radians());
        scans.extend(self.scene.drive(&knocked, sound_laps..self.laps, seed));
        scans
    }
}

impl PlanArgs {
    /// Builds the simulation.
    pub(super) fn plan(&self) -> anyhow::Result<Plan> {
        ensure!(
            (0.0..=1.0).contains(&self.path_noise),
            "--path-noise is 0 to 1 metre, not {}",
            self.path_noise
        );
        let mut scene = self.changing_scene(self.first_changed_lap()?)?;
        scene.walkers = self.walkers.into();
        let laps = usize::from(self.laps);
        ensure!(
            !self.faulty || laps >= SOUND_LAPS + FAULTY_LAPS_MIN,
            "--faulty needs at least {} laps: {SOUND_LAPS} make a vehicle known, {FAULTY_LAPS_MIN} confirm its fault",
            SOUND_LAPS + FAULTY_LAPS_MIN
        );
        Ok(Plan {
            scene,
            vehicles: (0..usize::from(self.vehicles))
                .map(|number| Vehicle::of_fleet(number, self.path_noise))
                .collect(),
            laps,
            seed: self.seed,
            knocked_lap: self.faulty.then_some(SOUND_LAPS),
        })
    }

    /// A third of the changes are moves, of doors where there are doors; the others come or go.
    fn changing_scene(&self, changed_lap: Option<usize>) -> Result<Scene, RouteError> {
        let Self { world, seed, .. } = *self;
        let count = usize::from(self.changes);
        let (moves, mut others) = (count / 3, count - count / 3);
        let mut scene = match world {
            WorldKind::Hall => Scene::of_hall(&Hall::generate(seed)?, seed),
            WorldKind::Racks => Scene::racks(seed)?,
            WorldKind::Street => Scene::street(seed)?,
            WorldKind::Rooms => {
                let mut rooms = Rooms::generate(seed)?;
                if let Some(lap) = changed_lap {
                    rooms.swing_doors(moves, lap, seed);
                }
                rooms.scene
            }
        };
        let Some(lap) = changed_lap else {
            return Ok(scene);
        };
        let mut changes = Changes::new(&mut scene, lap, self.path_noise, seed);
        if world != WorldKind::Rooms {
            changes.displace(moves);
        }
        for area_share in AREA_SHARES.iter().cycle() {
            if others == 0 {
                break;
            }
            changes.add(1, *area_share);
            changes.remove(others.min(2) - 1);
            others -= others.min(2);
        }
        Ok(scene)
    }

    /// `None` if nothing changes.
    fn first_changed_lap(&self) -> anyhow::Result<Option<usize>> {
        let lap = match self.change_lap {
            Some(lap) if lap == 0 || lap >= self.laps => bail!(
                "--change-lap {lap}: of {} laps some must be driven before the change and some after",
                self.laps
            ),
            Some(lap) => lap,
            None => self.laps / 2,
        };
        Ok((self.changes > 0 && lap > 0).then_some(lap.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        plan: PlanArgs,
    }

    fn plan(arguments: &[&str]) -> anyhow::Result<Plan> {
        Command::try_parse_from(["simulate"].iter().chain(arguments))?
            .plan
            .plan()
    }

    /// How many objects come and go, and before which lap.
    fn changes(plan: &Plan) -> (usize, usize, Vec<usize>) {
        let came = plan.scene.objects.iter().map(|o| o.from_lap);
        let came: Vec<usize> = came.filter(|&lap| lap > 0).collect();
        let went: Vec<usize> = plan
            .scene
            .objects
            .iter()
            .filter_map(|o| o.until_lap)
            .collect();
        let (comers, goers) = (came.len(), went.len());
        let mut laps = [came, went].concat();
        laps.sort_unstable();
        laps.dedup();
        (comers, goers, laps)
    }

    #[test]
    fn plans_have_what_was_asked_for() {
        for world in ["hall", "racks", "rooms", "street"] {
            let arguments = ["--world", world, "--changes", "8", "--change-lap", "2"];
            let plan = plan(&arguments).unwrap();
            // Two moves, and six that come or go.
            assert_eq!(changes(&plan), (5, 5, vec![2]), "{world}");
            assert_eq!((plan.vehicles.len(), plan.laps), (2, 6));
        }
        let default = plan(&[]).unwrap();
        assert_eq!(changes(&default).2, [3]);
        let unchanged = plan(&["--changes", "0", "--walkers", "3"]).unwrap();
        assert_eq!(changes(&unchanged), (0, 0, vec![]));
        assert_eq!(unchanged.scene.walkers, 3);
        assert_eq!(changes(&plan(&["--laps", "1"]).unwrap()), (0, 0, vec![]));
    }

    #[test]
    fn only_the_last_vehicle_is_knocked_and_only_after_three_laps() {
        let arguments = ["--laps", "5", "--changes", "0"];
        let sound = plan(&arguments).unwrap();
        let faulty = plan(&[&arguments[..], &["--faulty"]].concat()).unwrap();
        assert_eq!(sound.drive(0), faulty.drive(0));
        let (sound, faulty) = (sound.drive(1), faulty.drive(1));
        assert_eq!(sound.len(), faulty.len());
        for (sound, faulty) in sound.iter().zip(&faulty) {
            assert_eq!(sound.map_from_base, faulty.map_from_base);
            assert_eq!(sound.ranges_m == faulty.ranges_m, faulty.lap < 3);
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for arguments in [
            ["--change-lap", "0"],
            ["--change-lap", "6"],
            ["--path-noise", "1.5"],
            ["--vehicles", "0"],
            ["--world", "moon"],
        ] {
            assert!(plan(&arguments).is_err(), "{arguments:?}");
        }
        assert!(plan(&["--laps", "4", "--faulty"]).is_err());
    }
}
