//! What an upload of scans holds, for the OpenAPI document: the bodies are read by
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

/// A drive's scans, from the vehicle's one lidar or from several.
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
    /// Who drove.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: String,
    /// Which drive: all its batches share one odometry frame.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    trip_id: String,
    /// 0, 1, 2 … within the trip.
    #[schema(minimum = 0)]
    sequence: u32,
    /// The lidar's geometry, for all scans of the batch. A batch has either this or `lidars`.
    lidar: Option<LidarBody>,
    /// The lidars of a vehicle that has several; each scan names the one that took it. The first of
    /// a trip's first batch takes the keyframes; scans of the others taken within 0.1 s of a
    /// keyframe's are matched together with it, and all of them observe.
    #[schema(min_items = 1, max_items = 8)]
    lidars: Option<Vec<NamedLidarBody>>,
    /// Where the first scan's base is in the map frame, roughly.
    initial_pose: Option<InitialPoseBody>,
    /// In the order of time. Of one lidar stamps increase strictly, and all scans have the same
    /// number of beams; scans of different lidars may share a stamp. At most 4,000,000 beams.
    #[schema(min_items = 1, max_items = 5000)]
    scans: Vec<ScanUpload>,
    /// For your own use: kept, and returned with the batch.
    #[schema(schema_with = extensions_schema)]
    extensions: Option<serde_json::Map<String, serde_json::Value>>,
}

/// Any object, or null.
pub(super) fn extensions_schema() -> Object {
    ObjectBuilder::new()
        .schema_type(SchemaType::from_iter([Type::Object, Type::Null]))
        .additional_properties(Some(AdditionalProperties::FreeForm(true)))
        .description(Some(
            "Any JSON object of the sender's own, at most 16 KiB and 8 levels deep: it is kept and \
             returned as it was sent, also after the batch's body was deleted, and not interpreted.",
        ))
        .examples([serde_json::json!({"firmware": "4.2.1"})])
        .build()
}

/// A lidar's geometry, as in `sensor_msgs/LaserScan`; beam k looks along
/// `angle_min + k · angle_increment` in the lidar frame.
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
    /// Turn from a beam to the next, radians; below 0 for a lidar that scans clockwise, never 0.
    #[schema(minimum = -0.79, maximum = 0.79)]
    angle_increment: f64,
    /// Shorter ranges, 0 and less included, are invalid: they say nothing. Metres.
    #[schema(minimum = 0)]
    range_min: f64,
    /// Ranges of this length or longer count as no return, metres.
    #[schema(exclusive_minimum = 0.0, maximum = 500)]
    range_max: f64,
    /// `base_from_lidar`; the base itself if left out.
    mount: Option<PoseBody>,
    /// Standard deviation of one range, metres; 0.01 if left out.
    #[schema(exclusive_minimum = 0.0, maximum = 1)]
    range_sigma: Option<f64>,
    /// Time from a beam to the next in the order in which they are sent, seconds; a scan's stamp is its
    /// first beam's. Where it is sent,
    /// the motion of the vehicle during a scan is taken out of it.
    #[schema(minimum = 0)]
    time_increment: Option<f64>,
    /// Time from a scan to the next, seconds. Without `time_increment` it is taken for one turn of
    /// the lidar.
    #[schema(minimum = 0, maximum = 2)]
    scan_time: Option<f64>,
    /// Of virtual scans, made of a cloud: the heights that they are made of.
    band: Option<BandBody>,
}

/// A height band of the clouds of a 3D lidar. Scans of different bands are compared with their like
/// alone; those of lidars without a band are a layer of their own. A beam without a return (null) says
/// that the band is free; where it was not measured, send 0.
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
    /// The lidar does not see enough of the band nearer than this to say that it is free: metres from
    /// the lidar, along the floor; 0 if left out.
    #[schema(minimum = 0, maximum = 500)]
    pub clear_from: Option<f64>,
    /// Nor farther away than this, metres; `range_max` if left out.
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
    /// One plain object: of `allOf` with closed objects nothing would be valid.
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
    /// Standard deviation of x and of y, metres; 0.5 if left out.
    #[schema(exclusive_minimum = 0.0, maximum = 100)]
    sigma_xy: Option<f64>,
    /// Standard deviation of the heading, radians; 0.2 if left out.
    #[schema(exclusive_minimum = 0.0, maximum = 3.15)]
    sigma_theta: Option<f64>,
}

/// One sweep and where the vehicle took itself to be.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
struct ScanUpload {
    /// RFC 3339, between 1970 and 2100. Before 2000 it is taken for the time of a simulation.
    #[schema(format = DateTime)]
    stamp: String,
    /// Which of `lidars` took it; only in a batch with `lidars`, and required there.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    lidar: Option<String>,
    /// The base in the vehicle's own odometry frame; only differences are used.
    odometry: PoseBody,
    /// Metres, in beam order; null is "no return" (REP-117), which is not evidence of free space. So is
    /// what is `range_max` or longer; below `range_min` a reading says nothing.
    #[schema(min_items = 1, max_items = 8192)]
    ranges: Vec<Option<f64>>,
    /// Taken and not used.
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
