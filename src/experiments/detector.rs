//! The detectors that are scored: a row of the table each.

use serde::Serialize;

use super::alert::ScoredAlert;
use super::baselines::{map_updating, paper_rule};
use super::cpu::CpuWatch;
use super::placed::placed_scans;
use super::recording::Recording;
use super::route::RouteRun;

/// A change detector. To add one: a variant here, its name, and its arm in `alerts`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Detector {
    /// The service's own detector.
    Service,
    /// The closest published method for 2D lidars, on the service's poses.
    MapUpdating,
    /// The paper's rule, on a map made as by the service's detector `seed`.
    ///
    /// Its alerts name a closure, not what changed: one within 1 m of an object, beyond the 1 m about the
    /// closure's nodes, counts as a report of it, whatever its kind.
    PaperRule,
}

impl Detector {
    /// Every detector, in the order of the table.
    pub const ALL: [Self; 3] = [Self::Service, Self::MapUpdating, Self::PaperRule];

    /// In tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Service => "mapshift",
            Self::MapUpdating => "map updating",
            Self::PaperRule => "paper's rule",
        }
    }

    /// Its open alerts at the end of a run, and the CPU time that they took, seconds: the
    /// service's and the paper's rule's with their maps, others' without.
    ///
    /// # Errors
    /// If a map could not be made.
    pub(super) fn alerts(
        self,
        recordings: &[Recording],
        run: &RouteRun,
    ) -> anyhow::Result<(Vec<ScoredAlert>, f64)> {
        let watch = CpuWatch::start();
        let alerts = match self {
            Self::Service => return Ok((run.open_alerts(), run.cpu_s)),
            Self::MapUpdating => map_updating::alerts(&placed_scans(recordings, &run.poses)),
            Self::PaperRule => paper_rule::alerts(recordings, &run.poses)?,
        };
        Ok((alerts, watch.seconds()))
    }
}
