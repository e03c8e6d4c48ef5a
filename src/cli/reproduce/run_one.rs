//! One case, mapped twice and judged by every method.

use std::collections::BTreeMap;

use serde::Serialize;

use super::case::Case;
use super::laps::Laps;
use super::mapped::{Exclusion, Mapped};
use super::method::Method;
use super::paper_mode::PaperColumns;
use super::score::Score;
use super::{baselines, fused_mode, paper_mode};
use crate::mapping::Weighting;

/// What came of a case.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Outcome {
    /// The case.
    pub case: Case,
    /// Visible changes.
    pub visible_changes: usize,
    /// Of the paper's map and of the robust one.
    pub maps: [MapOutcome; 2],
    /// Columns of table 1, at th.
    pub paper_columns: PaperColumns,
    /// By method.
    pub scores: BTreeMap<Method, Score>,
}

/// A map in numbers.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct MapOutcome {
    /// Loop closures.
    pub closures: usize,
    /// Why it is not scored.
    pub exclusion: Option<Exclusion>,
}

impl Outcome {
    /// Why a method's score of this case is left out: what its map says.
    pub(super) fn exclusion(&self, method: Method) -> Option<Exclusion> {
        let [paper, robust] = &self.maps;
        match method {
            Method::Paper | Method::PaperRaised => paper.exclusion,
            _ => robust.exclusion,
        }
    }
}

/// Runs a case.
///
/// # Errors
/// If the laps could not be driven or mapped.
pub(super) fn run(case: &Case) -> anyhow::Result<Outcome> {
    let laps = Laps::drive(case)?;
    let paper = Mapped::of(&laps, Weighting::AllPointsIdentity, case.acceptance)?;
    let robust = Mapped::of(&laps, Weighting::Robust, case.acceptance)?;
    let mut scores = BTreeMap::new();
    for method in Method::ALL {
        let (mapped, judged) = match method {
            Method::Paper => (&paper, paper_mode::judge(&paper, 1.0)),
            Method::PaperRaised => (&paper, paper_mode::judge(&paper, 2.5)),
            Method::Fused => (&robust, fused_mode::judge(&robust)),
            Method::ErrorRatio(which) => (&robust, baselines::error_ratio(&robust, which)?),
            Method::ChiSquared(which) => (&robust, baselines::chi_squared(&robust, which)),
            Method::Gnc(which) => (&robust, baselines::gnc(&robust, which)?),
        };
        scores.insert(method, Score::of(&laps, mapped, &judged));
    }
    let map_outcome = |mapped: &Mapped| MapOutcome {
        closures: mapped.closures.len(),
        exclusion: mapped.exclusion,
    };
    Ok(Outcome {
        visible_changes: laps.changes.iter().filter(|c| c.visible).count(),
        maps: [map_outcome(&paper), map_outcome(&robust)],
        paper_columns: paper_mode::columns(&laps, &paper),
        scores,
        case: case.clone(),
    })
}
