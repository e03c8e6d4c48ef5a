//! The detectors that are scored: a row of the table each.

use serde::Serialize;

use super::alert::ScoredAlert;
use super::baselines::map_updating;
use super::cpu::CpuWatch;
use super::placed::placed_scans;
use super::recording::Recording;
use super::route::RouteRun;

/// A way to find changes. Another one is a variant here, its name, and its arm in `alerts`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Detector {
    /// The service's own.
    Service,
    /// The closest published one for 2D lidars, on the service's poses.
    MapUpdating,
}

impl Detector {
    /// Every detector, in the order of the table.
    pub const ALL: [Self; 2] = [Self::Service, Self::MapUpdating];

    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Service => "mapshift",
            Self::MapUpdating => "map updating",
        }
    }

    /// Its open alerts at the end of a run, and the CPU time that they took, seconds: the
    /// service's with its map, others' without.
    pub(super) fn alerts(
        self,
        recordings: &[Recording],
        run: &RouteRun,
    ) -> (Vec<ScoredAlert>, f64) {
        match self {
            Self::Service => (run.open_alerts(), run.cpu_s),
            Self::MapUpdating => {
                let watch = CpuWatch::start();
                let alerts = map_updating::alerts(&placed_scans(recordings, &run.poses));
                (alerts, watch.seconds())
            }
        }
    }
}
