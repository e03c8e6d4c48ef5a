//! From a route's map frame to geographic coordinates.

use crate::geometry::Vector2;
use crate::store::GeoAnchor;

/// The ellipsoid of WGS 84: its semi-major axis, metres, and its first eccentricity squared.
const HALF_AXIS_M: f64 = 6_378_137.0;
const ECCENTRICITY2: f64 = 6.694_379_990_141_316e-3;
/// Nearer to a pole than this latitude, degrees, meridians converge too fast for a plane.
const LATITUDE_MAX_DEG: f64 = 89.0;

/// The plane that touches the ellipsoid at a route's anchor: good to a millimetre for maps of a
/// kilometre at moderate latitudes.
#[derive(Debug, Clone, Copy)]
pub(super) struct TangentPlane {
    anchor: GeoAnchor,
    /// Degrees a metre.
    latitude_deg_per_m: f64,
    longitude_deg_per_m: f64,
}

impl TangentPlane {
    /// The plane at the origin of a map; `None` if the anchor is not on the Earth, or near a pole.
    pub(super) fn at(anchor: &GeoAnchor) -> Option<Self> {
        let on_earth = anchor.latitude.abs() <= LATITUDE_MAX_DEG
            && anchor.longitude.abs() <= 180.0
            && anchor.heading.is_finite();
        if !on_earth {
            return None;
        }
        let (sin, cos) = anchor.latitude.to_radians().sin_cos();
        let flattening = 1.0 - ECCENTRICITY2 * sin * sin;
        let across_m = HALF_AXIS_M / flattening.sqrt();
        let along_m = across_m * (1.0 - ECCENTRICITY2) / flattening;
        Some(Self {
            anchor: *anchor,
            latitude_deg_per_m: (1.0 / along_m).to_degrees(),
            longitude_deg_per_m: (1.0 / (across_m * cos)).to_degrees(),
        })
    }

    /// A point of the map frame, metres, as longitude and latitude, degrees. Longitudes continue beyond ±180° at the date
    /// line, so that a polygon stays in one piece.
    pub(super) fn longitude_latitude(&self, point: &Vector2<f64>) -> [f64; 2] {
        let (sin, cos) = self.anchor.heading.to_radians().sin_cos();
        let east_m = point.x * sin - point.y * cos;
        let north_m = point.x * cos + point.y * sin;
        [
            self.anchor.longitude + east_m * self.longitude_deg_per_m,
            self.anchor.latitude + north_m * self.latitude_deg_per_m,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn anchor(latitude: f64, longitude: f64, heading: f64) -> GeoAnchor {
        GeoAnchor {
            latitude,
            longitude,
            heading,
        }
    }

    fn at(heading: f64, x: f64, y: f64) -> [f64; 2] {
        let plane = TangentPlane::at(&anchor(47.5, 19.0, heading)).unwrap();
        let [longitude, latitude] = plane.longitude_latitude(&Vector2::new(x, y));
        [longitude - 19.0, latitude - 47.5]
    }

    #[test]
    fn headings_are_clockwise_from_north() {
        for (heading, east, north) in [(0.0, 0.0, 1.0), (90.0, 1.0, 0.0), (225.0, -1.0, -1.0)] {
            let [longitude, latitude] = at(heading, 100.0, 0.0);
            assert!(longitude * east >= 0.0 && latitude * north >= 0.0);
            assert_eq!(longitude.abs() > 1e-9, east != 0.0, "{heading}");
            assert_eq!(latitude.abs() > 1e-9, north != 0.0, "{heading}");
        }
        // Left of an x axis that points north is west.
        assert!(at(0.0, 0.0, 100.0)[0] < -1e-4);
    }

    /// Lengths of a degree at latitude 47.5° by the usual series in cosines of the latitude.
    #[test]
    fn a_degree_has_its_length() {
        let [_, latitude] = at(0.0, 1_000.0, 0.0);
        assert!((1_000.0 / latitude - 111_180.0).abs() < 10.0, "{latitude}");
        let [longitude, _] = at(90.0, 1_000.0, 0.0);
        assert!((1_000.0 / longitude - 75_346.0).abs() < 10.0, "{longitude}");
    }

    #[test]
    fn there_is_no_plane_near_a_pole_or_off_the_earth() {
        for bad in [
            anchor(90.0, 0.0, 0.0),
            anchor(-89.5, 0.0, 0.0),
            anchor(f64::NAN, 0.0, 0.0),
            anchor(10.0, 181.0, 0.0),
            anchor(10.0, 0.0, f64::INFINITY),
        ] {
            assert!(TangentPlane::at(&bad).is_none(), "{bad:?}");
        }
    }

    proptest! {
        /// A left turn in the map is a left turn on the Earth, so rings keep their orientation.
        #[test]
        fn polygons_keep_their_orientation(
            latitude in -85.0..85.0_f64, heading in 0.0..360.0_f64,
            x in -50.0..50.0_f64, y in -50.0..50.0_f64,
        ) {
            let plane = TangentPlane::at(&anchor(latitude, 0.0, heading)).unwrap();
            let corner = |dx: f64, dy: f64| {
                let corner = Vector2::new(x + dx, y + dy);
                Vector2::from(plane.longitude_latitude(&corner))
            };
            let (a, b, c) = (corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0));
            prop_assert!((b - a).perp(&(c - a)) > 0.0);
        }
    }
}
