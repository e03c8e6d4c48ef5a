//! The command's arguments.

use std::path::{Path, PathBuf};

use crate::cli::key_arg::KeyArg;
use crate::cli::recording;
use crate::geometry::Pose2;
use crate::ids::{RouteId, TripId, VehicleId};
use crate::ingest::mcap::{MountOverride, TopicChoice};

/// Arguments of `mapshift upload`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings (ROS 2 bags and others in MCAP, CARMEN logs) or pose graphs (planar g2o: edges alone);
    /// also gzipped.
    #[arg(required = true, value_name = "FILE")]
    pub(super) files: Vec<PathBuf>,
    /// The route that was driven; created if it does not exist.
    #[arg(long)]
    pub(super) route: RouteId,
    /// The vehicle that drove.
    #[arg(long)]
    pub(super) vehicle: VehicleId,
    /// The trip's name; by default the file's name.
    #[arg(long)]
    pub(super) trip: Option<TripId>,
    /// The service.
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    pub(super) url: String,
    #[command(flatten)]
    pub(super) key: KeyArg,
    /// Scans in a batch.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=1_000))]
    pub(super) batch_scans: u16,
    /// Nodes of a pose graph in a batch.
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u16).range(1..=5_000))]
    pub(super) batch_nodes: u16,
    /// Multiply the stated beam spacing by this factor (some logs state it wrongly).
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = parse_beam_spacing)]
    pub(super) beam_spacing: f64,
    /// Where the vehicle started in the route's map, roughly: metres, metres, radians.
    #[arg(long, value_name = "X,Y,THETA", value_parser = parse_pose, allow_hyphen_values = true)]
    pub(super) initial_pose: Option<Pose2>,
    /// Topics of the lidars' scans in an MCAP recording, the one that takes keyframes first; all topics with
    /// scans if none is named.
    #[arg(long, value_name = "TOPIC", value_delimiter = ',')]
    pub(super) topic: Vec<String>,
    /// Topic of the odometry in an MCAP recording; /tf for the transforms from odom to the vehicle.
    #[arg(long, value_name = "TOPIC")]
    pub(super) odometry_topic: Option<String>,
    /// Mount of the lidar instead of the recording's: metres ahead of the base.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true, value_parser = parse_finite)]
    pub(super) mount_x: Option<f64>,
    /// Metres to the left of the base.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true, value_parser = parse_finite)]
    pub(super) mount_y: Option<f64>,
    /// Its heading on the base, radians, counter-clockwise.
    #[arg(long, value_name = "RADIANS", allow_hyphen_values = true, value_parser = parse_finite)]
    pub(super) mount_theta: Option<f64>,
    /// Wait until everything is processed, and print the outcome.
    #[arg(long)]
    pub(super) wait: bool,
}

impl Args {
    /// Which parts of an MCAP recording are read.
    pub(super) fn topics(&self) -> TopicChoice {
        TopicChoice {
            lidars: self.topic.clone(),
            odometry: self.odometry_topic.clone(),
            mount: MountOverride {
                x: self.mount_x,
                y: self.mount_y,
                theta: self.mount_theta,
            },
        }
    }

    /// The trip's name for a file.
    pub(super) fn trip_of(&self, path: &Path) -> anyhow::Result<TripId> {
        match &self.trip {
            Some(trip) => Ok(trip.clone()),
            None => recording::trip_of(path),
        }
    }
}

fn parse_finite(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if f64::is_finite(value) => Ok(value),
        _ => Err("give a number, like 0.25".into()),
    }
}

fn parse_pose(text: &str) -> Result<Pose2, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, theta]) if [x, y, theta].iter().all(|v| v.is_finite()) => {
            Ok(Pose2::new(*x, *y, *theta))
        }
        _ => Err("give three numbers, like 3.5,3.4,0.02 (metres, metres, radians)".into()),
    }
}

pub(in crate::cli) fn parse_beam_spacing(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor) if (0.5..=2.0).contains(&factor) => Ok(factor),
        _ => Err("give a factor from 0.5 to 2, like 0.925".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_three_numbers() {
        assert_eq!(parse_pose("1, -2,0.5"), Ok(Pose2::new(1.0, -2.0, 0.5)));
        for bad in ["", "1,2", "1,2,3,4", "1,2,nan", "a,b,c"] {
            assert!(parse_pose(bad).is_err(), "{bad}");
        }
    }
}
