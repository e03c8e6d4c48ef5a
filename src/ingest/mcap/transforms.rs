//! The tree of frames, where a lidar is in it, and the odometry that it holds.

use std::collections::BTreeMap;

use nalgebra::Isometry3;

use super::container::NAME_BYTES_MAX;
use super::messages::{TransformMessage, from_above};
use super::odometry::Track;

/// Most frames that are kept; robots have some dozens.
const FRAMES_MAX: usize = 1_000;
/// No lidar is this many frames away from its vehicle.
const CHAIN_MAX: usize = 64;
/// The frames that are taken for the vehicle's, after the one that the odometry names.
const BASES: [&str; 2] = ["base_footprint", "base_link"];

/// The transforms of a recording.
#[derive(Debug, Default)]
pub(super) struct Transforms {
    /// By child: its parent, and the first transform between them. What moves on a vehicle is no
    /// lidar.
    first: BTreeMap<String, (String, Isometry3<f64>)>,
    /// Of every child of an odometry frame, where it was over time.
    odometry: BTreeMap<String, Track>,
}

/// Where a lidar's frame is on the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OnVehicle {
    /// The vehicle's frame.
    pub base: String,
    pub base_from_frame: Isometry3<f64>,
}

impl Transforms {
    /// Takes a transform that was recorded at a time; says whether it is one more pose of an odometry.
    pub fn add(&mut self, message: TransformMessage, log_time_ns: i64) -> bool {
        let child = plain(&message.child);
        let is_known = self.first.contains_key(child);
        let is_name_long = child.len().max(message.parent.len()) > NAME_BYTES_MAX;
        if is_name_long || !is_known && self.first.len() >= FRAMES_MAX {
            return false;
        }
        if !is_known {
            let parent = plain(&message.parent).to_owned();
            let transform = (parent, message.parent_from_child);
            self.first.insert(child.to_owned(), transform);
        }
        let is_odometry = last_part(&message.parent).contains("odom");
        if is_odometry {
            let track = self.odometry.entry(child.to_owned()).or_default();
            let stamp_ns = match message.stamp_ns {
                0 => log_time_ns,
                stamp_ns => stamp_ns,
            };
            track.push(stamp_ns, from_above(&message.parent_from_child));
        }
        is_odometry
    }

    /// Where a frame is on the vehicle, whose frame the odometry may name; `None` if no transforms lead
    /// there.
    pub fn on_vehicle(&self, frame: &str, named_base: Option<&str>) -> Option<OnVehicle> {
        let mut chain = vec![(plain(frame), Isometry3::identity())];
        while chain.len() < CHAIN_MAX
            && let Some((below, so_far)) = chain.last()
            && let Some((parent, transform)) = self.first.get(*below)
        {
            let farther = transform * so_far;
            chain.push((parent, farther));
        }
        let bases = named_base.map(last_part).into_iter().chain(BASES);
        let found = bases.filter_map(|base| chain.iter().find(|(at, _)| last_part(at) == base));
        found
            .map(|(base, transform)| OnVehicle {
                base: (*base).to_owned(),
                base_from_frame: *transform,
            })
            .next()
    }

    /// The odometry as transforms, with the vehicle's frame: of several the one that a frame hangs on,
    /// else the one with the most poses.
    pub fn odometry_of(&self, frame: &str) -> Option<(String, Track)> {
        let is_above = |base: &&String| {
            self.on_vehicle(frame, Some(base))
                .is_some_and(|on| on.base == **base)
        };
        let above = self.odometry.keys().find(is_above);
        let busiest = || {
            self.odometry
                .iter()
                .max_by_key(|(_, track)| track.len())
                .map(|(base, _)| base)
        };
        let base = above.or_else(busiest)?;
        Some((base.clone(), self.odometry[base].clone()))
    }
}

/// A frame's name without a leading slash, which early versions of ROS had.
fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// A frame's name without the vehicle's.
fn last_part(frame: &str) -> &str {
    frame.rsplit('/').next().unwrap_or(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn transform(parent: &str, child: &str, x: f64, yaw_rad: f64) -> TransformMessage {
        let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw_rad);
        TransformMessage {
            stamp_ns: 0,
            parent: parent.to_owned(),
            child: child.to_owned(),
            parent_from_child: Isometry3::from_parts(Translation3::new(x, 0.0, 0.1), rotation),
        }
    }

    fn tree(edges: &[(&str, &str)]) -> Transforms {
        let mut transforms = Transforms::default();
        for (k, (parent, child)) in edges.iter().enumerate() {
            let turn_rad = std::f64::consts::FRAC_PI_2;
            transforms.add(transform(parent, child, 1.0, turn_rad), k as i64);
        }
        transforms
    }

    #[test]
    fn a_lidar_is_followed_to_the_frame_of_the_odometry() {
        let transforms = tree(&[
            ("odom", "base_footprint"),
            ("base_footprint", "base_link"),
            ("base_link", "/base_scan"),
        ]);
        let on = transforms
            .on_vehicle("base_scan", Some("base_footprint"))
            .unwrap();
        assert_eq!(on.base, "base_footprint");
        let seen = from_above(&on.base_from_frame);
        assert!((seen.x - 1.0).abs() < 1e-12 && (seen.y - 1.0).abs() < 1e-12);
        assert!(
            (seen.theta.abs() - std::f64::consts::PI).abs() < 1e-12,
            "{seen:?}"
        );
        let nearer = transforms
            .on_vehicle("base_scan", Some("base_link"))
            .unwrap();
        let seen = from_above(&nearer.base_from_frame);
        let off_rad = seen.theta - std::f64::consts::FRAC_PI_2;
        assert!(
            (seen.x - 1.0).abs() < 1e-12 && off_rad.abs() < 1e-12,
            "{seen:?}"
        );
    }

    #[test]
    fn names_of_vehicles_do_not_matter_and_circles_end() {
        let transforms = tree(&[("amr1/base_link", "amr1/laser"), ("a", "b"), ("b", "a")]);
        assert!(transforms.on_vehicle("amr1/laser", None).is_some());
        assert!(
            transforms
                .on_vehicle("amr1/base_link", Some("amr1/base_link"))
                .is_some()
        );
        assert_eq!(transforms.on_vehicle("a", Some("base_link")), None);
        assert_eq!(transforms.on_vehicle("camera", None), None);
    }

    #[test]
    fn odometry_is_that_of_the_lidars_vehicle() {
        let transforms = tree(&[
            ("odom", "base_link"),
            ("odom", "a_visual_frame"),
            ("odom", "a_visual_frame"),
            ("base_link", "laser"),
        ]);
        assert_eq!(transforms.odometry_of("laser").unwrap().0, "base_link");
        assert_eq!(
            transforms.odometry_of("unknown").unwrap().0,
            "a_visual_frame"
        );
        assert!(tree(&[("map", "odom")]).odometry_of("laser").is_none());
    }
}
