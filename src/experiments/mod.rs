//! What the detectors find in recordings with known objects drawn into them, and the paper's own
//! experiments.
//!
//! No public recording of a 2D lidar has all of its changes labelled. So known objects are drawn
//! into real scans: the noise, the motion and the clutter are real, and the truth is known.
//! Published detectors are scored beside ours, on the same scans and poses.
//!
//! It knows nothing of HTTP, of the store or of the command line, and the service does not use
//! it. Begin with [`score_recordings`], or with [`score_worlds`] for simulated worlds, which are
//! another measure: there the truth is whole, and the noise is ours; [`score_bands`] has furniture in
//! them, and a 3D lidar. [`measure_stability`], [`measure_buildings`], [`measure_faults`] and
//! [`measure_pose_consistency`] ask of the map alone, [`measure_calibration`] of vehicles. [`Protocol::run`] is the paper's.

mod alert;
mod bands;
mod baselines;
mod buildings;
mod calibration_errors;
mod correlation;
mod cpu;
mod detector;
mod distance;
mod drawn;
mod labels;
mod mending;
mod odometry_faults;
mod off_vehicle;
mod pictures;
mod placed;
mod places;
mod pose_consistency;
mod recording;
mod report;
mod reproduce;
mod route;
mod scoring;
mod stability;
mod study;
mod table;
mod wilson;
mod world_conditions;
mod world_report;
mod world_scoring;
mod worlds;

pub use alert::ScoredAlert;
pub use bands::{BandsRow, BandsStudy, bands_text, score_bands};
pub use buildings::{BUILDINGS, Building, BuildingCase, buildings_text, measure_buildings};
pub use calibration_errors::{CalibrationCase, calibration_text, measure_calibration};
pub use correlation::Correlation;
pub use detector::Detector;
pub use distance::region_distance_m;
pub use drawn::{DrawnObject, altered};
pub use labels::{Label, read_labels};
pub use mending::{
    Displacement, MendedRecordings, MendingCase, Outcome, measure_mended_recordings,
    measure_mending, mending_text,
};
pub use odometry_faults::{Fault, FaultCase, FaultyTrip, faults_text, measure_faults};
pub use off_vehicle::OffVehicle;
pub use pictures::Picture;
pub use pose_consistency::{PoseConsistency, measure_pose_consistency, pose_consistency_text};
pub use recording::{Recording, in_sequence};
pub use report::text_of;
pub use reproduce::{Figure, Protocol, Reproduced, Seeds};
pub use scoring::Score;
pub use stability::{Disturbance, Moved, measure_stability, stability_text};
pub use study::{Options, Place, Row, Study, score_recordings};
pub use table::{Table, number};
pub use wilson::Share;
pub use world_report::worlds_text;
pub use world_scoring::WorldScore;
pub use worlds::{
    NamedCorrelation, WorldRow, WorldsStudy, measure_correlation, score_worlds, world_runs,
};
