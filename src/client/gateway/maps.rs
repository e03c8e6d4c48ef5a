//! Reads a route's map, nodes, scans and alerts.

use jiff::Timestamp;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::{Gateway, GatewayError};
use crate::geometry::Pose2;
use crate::ids::RouteId;

/// A pose, metres and radians.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct PoseReport {
    pub x: f64,
    pub y: f64,
    pub theta: f64,
}

impl From<PoseReport> for Pose2 {
    fn from(pose: PoseReport) -> Self {
        Self::new(pose.x, pose.y, pose.theta)
    }
}

/// A node.
#[derive(Debug, Clone, Deserialize)]
pub struct NodeReport {
    pub id: i64,
    /// `map_from_base`.
    pub pose: PoseReport,
    pub vehicle_id: String,
    pub stamp: Timestamp,
    /// Whether it is localised.
    pub localised: bool,
}

/// A node's scan.
#[derive(Debug, Clone, Deserialize)]
pub struct ScanReport {
    pub lidar: LidarReport,
    /// Metres; `None` is no return, or an invalid reading.
    pub ranges: Vec<Option<f64>>,
    /// The beams with invalid readings; older services do not state them.
    #[serde(default)]
    pub invalid_beams: Vec<usize>,
}

/// The lidar of a scan: radians and metres.
#[derive(Debug, Clone, Deserialize)]
pub struct LidarReport {
    pub angle_min: f64,
    pub angle_max: f64,
    pub angle_increment: f64,
    pub range_min: f64,
    pub range_max: f64,
    /// `base_from_lidar`.
    pub mount: PoseReport,
}

/// An alert as in a list.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct AlertDetail {
    pub id: String,
    pub kind: String,
    pub status: String,
    pub tier: String,
    pub title: String,
    pub summary: String,
    pub confidence: f64,
    pub location: AlertPlace,
    /// Corners in the map frame, metres.
    pub region: Vec<[f64; 2]>,
    pub size: Option<AlertSize>,
    pub first_seen: Timestamp,
    pub last_seen: Timestamp,
    pub raised_at: Timestamp,
}

/// Where an alert is, map frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct AlertPlace {
    pub x: f64,
    pub y: f64,
    pub sigma: f64,
}

/// Extent of an alert, metres.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct AlertSize {
    pub length: f64,
    pub width: f64,
}

#[derive(Deserialize)]
struct Page<T> {
    items: Vec<T>,
    next_cursor: Option<String>,
}

impl Gateway {
    /// Every node of a route.
    pub async fn nodes(&self, route: &RouteId) -> Result<Vec<NodeReport>, GatewayError> {
        let path = format!("/v1/routes/{route}/nodes?limit=1000");
        self.list(&path, &format!("the nodes of route {route}"))
            .await
    }

    /// A node's scan; `None` of a node that has none.
    pub async fn scan(
        &self,
        route: &RouteId,
        node: i64,
    ) -> Result<Option<ScanReport>, GatewayError> {
        let path = format!("/v1/routes/{route}/nodes/{node}/scan");
        match self.get(path, format!("the scan of node {node}")).await {
            Ok(scan) => Ok(Some(scan)),
            Err(GatewayError::Refused { problem, .. }) if problem.status == 404 => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Every alert of a route with all that a list shows, the newest first.
    pub async fn alert_details(&self, route: &RouteId) -> Result<Vec<AlertDetail>, GatewayError> {
        let path = format!("/v1/alerts?route_id={route}&limit=1000");
        self.list(&path, &format!("the alerts of route {route}"))
            .await
    }

    /// A version of a route's map as ROS's `map_server` reads it: the YAML and the PGM.
    pub async fn map(
        &self,
        route: &RouteId,
        version: i64,
    ) -> Result<(Vec<u8>, Vec<u8>), GatewayError> {
        let path = format!("/v1/routes/{route}/versions/{version}/map");
        let what = || format!("the map of route {route}");
        let yaml = self.get_bytes(format!("{path}.yaml"), what()).await?;
        let pgm = self.get_bytes(format!("{path}.pgm"), what()).await?;
        Ok((yaml, pgm))
    }

    async fn list<T: DeserializeOwned>(
        &self,
        path: &str,
        what: &str,
    ) -> Result<Vec<T>, GatewayError> {
        let mut items = Vec::new();
        let mut cursor = String::new();
        loop {
            let page: Page<T> = self.get(format!("{path}{cursor}"), what.to_owned()).await?;
            items.extend(page.items);
            match page.next_cursor {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return Ok(items),
            }
        }
    }
}
