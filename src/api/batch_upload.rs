//! The body of an upload of scans, for the OpenAPI document; it is read by
//! [`batch_json`](crate::ingest::batch_json).

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{
    AdditionalProperties, Object, ObjectBuilder, Schema, SchemaType, Type,
};
use utoipa::{PartialSchema, ToSchema};

use super::types::PoseBody;
use crate::scan::BandView;

/// Scans of a trip, from the vehicle's only lidar or from several.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = BatchUpload, example = json!({
    "vehicle_id": "agv-07", "trip_id": "2026-11-20-a", "sequence": 0,
    "lidar": {"angle_min": -0.0174533, "angle_increment": 0.0174533, "range_min": 0.05, "range_max": 20.0,
              "mount": {"x": 0.2, "y": 0.0, "theta": 0.0}, "range_sigma": 0.01},
    "initial_pose": {"x": 3.5, "y": 3.4, "theta": 0.02, "sigma_xy": 0.3, "sigma_theta": 0.1},
    "scans": [{"stamp": "2026-11-20T06:00:00Z", "odometry": {"x": 0.0, "y": 0.0, "theta": 0.0}, "ranges": [1.92, null, 1.95]}]
}))]
#[allow(dead_code)]
pub(super) struct BatchUpload {
    /// The vehicle.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: String,
    /// The trip: all its batches share one odometry frame.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    trip_id: String,
    /// 0, 1, 2 … within the trip.
    #[schema(minimum = 0)]
    sequence: u32,
    /// The lidar's geometry, for all scans of the batch. A batch has either this or `lidars`.
    lidar: Option<LidarBody>,
    /// The lidars of a vehicle that has several; each scan names the one that took it. The first one in a trip's
    /// first batch takes the keyframes; scans of the others taken within 0.1 s of a keyframe are matched together
    /// with it, and all scans count as observations.
    #[schema(min_items = 1, max_items = 8)]
    lidars: Option<Vec<NamedLidarBody>>,
    /// The approximate pose of the base in the map frame at the first scan.
    initial_pose: Option<InitialPoseBody>,
    /// In the order of time. The stamps of each lidar increase strictly, and its scans have the same number of
    /// beams; scans of different lidars may have the same stamp. At most 4,000,000 beams.
    #[schema(min_items = 1, max_items = 5000)]
    scans: Vec<ScanUpload>,
    /// For your own use: stored, and returned with the batch.
    #[schema(schema_with = extensions_schema)]
    extensions: Option<serde_json::Map<String, serde_json::Value>>,
}

/// Any object, or null.
pub(super) fn extensions_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(SchemaType::from_iter([Type::Object, Type::Null]))
        .additional_properties(Some(AdditionalProperties::FreeForm(true)))
        .description(Some(
            "Any JSON object of the sender, at most 16 KiB and 8 levels deep. It is not interpreted, but \
             stored and returned as it was sent, even after the batch's body was deleted.",
        ))
        .examples([serde_json::json!({"firmware": "4.2.1"})])
        .build()
}

/// A lidar's geometry, as in `sensor_msgs/LaserScan`; the direction of beam k is `angle_min + k · angle_increment`
/// in the lidar frame.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Lidar)]
#[allow(dead_code)]
struct LidarBody {
    /// Direction of the first beam, radians.
    #[schema(minimum = -6.29, maximum = 6.29)]
    angle_min: f64,
    /// Direction of the last beam, radians.
    angle_max: Option<f64>,
    /// Angle from one beam to the next, radians; negative for a lidar that scans clockwise, never 0.
    #[schema(minimum = -0.79, maximum = 0.79)]
    angle_increment: f64,
    /// Shorter ranges, including 0 and less, are invalid. Metres.
    #[schema(minimum = 0)]
    range_min: f64,
    /// Ranges of this length or more count as no return, metres.
    #[schema(exclusive_minimum = 0.0, maximum = 500)]
    range_max: f64,
    /// `base_from_lidar`; identity by default.
    mount: Option<PoseBody>,
    /// Standard deviation of one range, metres; 0.01 by default.
    #[schema(exclusive_minimum = 0.0, maximum = 1)]
    range_sigma: Option<f64>,
    /// Time from one beam to the next in the order in which they are sent, seconds; the stamp of a scan is that of
    /// its first beam. If given, scans are corrected for the vehicle's motion.
    #[schema(minimum = 0)]
    time_increment: Option<f64>,
    /// Time from one scan to the next, seconds. Without `time_increment` it is taken to be one revolution of the
    /// lidar.
    #[schema(minimum = 0, maximum = 2)]
    scan_time: Option<f64>,
    /// For virtual scans made from a point cloud, the height band that they were made from.
    band: Option<BandBody>,
}

/// A height band of the point clouds of a 3D lidar. Scans are compared only with scans of the same band; scans
/// without a band are compared among themselves. A beam without a return (null) says that the band is free; send
/// 0 where it was not measured.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = HeightBand)]
pub(super) struct BandBody {
    /// Its lower end, metres above the floor.
    #[schema(minimum = -1, maximum = 10)]
    pub from: f64,
    /// Its upper end, metres above the floor; at least 0.02 above the lower one.
    #[schema(minimum = -1, maximum = 10)]
    pub to: f64,
    /// Nearer than this, the lidar sees too little of the band to say that it is free: metres from the lidar along
    /// the floor; 0 by default.
    #[schema(minimum = 0, maximum = 500)]
    pub clear_from: Option<f64>,
    /// The same for distances beyond this, metres; `range_max` by default.
    #[schema(exclusive_minimum = 0.0, maximum = 500)]
    pub clear_to: Option<f64>,
}

impl From<BandView> for BandBody {
    fn from(view: BandView) -> Self {
        Self {
            from: view.band.from_m,
            to: view.band.to_m,
            clear_from: Some(view.clear_from_m),
            clear_to: Some(view.clear_to_m),
        }
    }
}

/// A [`LidarBody`] with a name.
#[derive(Deserialize)]
struct NamedLidarBody {}

impl PartialSchema for NamedLidarBody {
    /// A single object: nothing is valid against an `allOf` of closed objects.
    fn schema() -> RefOr<Schema> {
        let id = ObjectBuilder::new()
            .schema_type(Type::String)
            .description(Some("Chosen by the client, the same in every batch."))
            .pattern(Some("^[A-Za-z0-9._-]{1,64}$"))
            .examples(["rear"]);
        let mut schema = LidarBody::schema();
        if let RefOr::T(Schema::Object(lidar)) = &mut schema {
            lidar.description = Some("One of several lidars.".to_owned());
            lidar.properties.insert("id".to_owned(), id.into());
            lidar.required.push("id".to_owned());
        }
        schema
    }
}

impl ToSchema for NamedLidarBody {
    fn name() -> Cow<'static, str> {
        Cow::Borrowed("NamedLidar")
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        LidarBody::schemas(schemas);
    }
}

/// A rough pose in the map frame.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = InitialPose)]
#[allow(dead_code)]
struct InitialPoseBody {
    /// Metres.
    x: f64,
    /// Metres.
    y: f64,
    /// Radians.
    theta: f64,
    /// Standard deviation of x and of y, metres; 0.5 by default.
    #[schema(exclusive_minimum = 0.0, maximum = 100)]
    sigma_xy: Option<f64>,
    /// Standard deviation of the heading, radians; 0.2 by default.
    #[schema(exclusive_minimum = 0.0, maximum = 3.15)]
    sigma_theta: Option<f64>,
}

/// One sweep, and the vehicle's odometry.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
struct ScanUpload {
    /// RFC 3339, between 1970 and 2100. A time before 2000 is taken to be simulated.
    #[schema(format = DateTime)]
    stamp: String,
    /// Which of `lidars` took it; only in a batch with `lidars`, and required there.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    lidar: Option<String>,
    /// The base in the vehicle's own odometry frame; only differences are used.
    odometry: PoseBody,
    /// Metres, in beam order. Null means no return (REP-117), which is not evidence of free space; so does a reading
    /// of `range_max` or more. A reading below `range_min` is invalid.
    #[schema(min_items = 1, max_items = 8192)]
    ranges: Vec<Option<f64>>,
    /// Accepted but not used.
    #[schema(max_items = 8192)]
    intensities: Option<Vec<Option<f64>>>,
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;
    use crate::ingest::batch_json;

    #[test]
    fn the_documented_example_is_taken() {
        let schema = serde_json::to_value(BatchUpload::schema()).unwrap();
        let example = schema
            .get("example")
            .or_else(|| schema.pointer("/examples/0"));
        let body = serde_json::to_vec(example.unwrap()).unwrap();
        let batch = batch_json::decode(&body, Timestamp::now()).unwrap();
        assert_eq!(batch.scans.len(), 1);
    }
}
