//! One case, mapped three times and judged by every method.

use std::collections::BTreeMap;

use serde::Serialize;

use super::case::Case;
use super::laps::Laps;
use super::mapped::{Exclusion, MapError, Mapped};
use super::method::{Method, PaperMap};
use super::paper_mode::PaperColumns;
use super::score::Score;
use super::{baselines, fused_mode, paper_mode};
use crate::mapping::Weighting;

/// The result of a case.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Outcome {
    /// The case.
    pub case: Case,
    /// Visible changes.
    pub visible_changes: usize,
    /// Of each map.
    pub maps: Maps<MapOutcome>,
    /// Columns of table 1, at th.
    pub paper_columns: BTreeMap<PaperMap, PaperColumns>,
    /// By method.
    pub scores: BTreeMap<Method, Score>,
}

/// A value for each of a case's maps.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct Maps<T> {
    /// All-points estimates with Ω = I, gated as in the service.
    pub seed: T,
    /// The paper's own.
    pub faithful: T,
    /// Robust estimates.
    pub robust: T,
}

impl<T> Maps<T> {
    /// The value of a map that the paper's rule uses.
    pub(super) fn of_paper(&self, map: PaperMap) -> &T {
        match map {
            PaperMap::Seed => &self.seed,
            PaperMap::Faithful => &self.faithful,
        }
    }

    /// The value of the map that a method uses.
    pub(super) fn of_method(&self, method: Method) -> &T {
        match method {
            Method::Paper(map) | Method::PaperRaised(map) => self.of_paper(map),
            Method::Fused | Method::ErrorRatio(_) | Method::ChiSquared(_) | Method::Gnc(_) => {
                &self.robust
            }
        }
    }

    /// Maps each value.
    pub(super) fn each<U>(&self, of: impl Fn(&T) -> U) -> Maps<U> {
        Maps {
            seed: of(&self.seed),
            faithful: of(&self.faithful),
            robust: of(&self.robust),
        }
    }
}

/// A map in numbers.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct MapOutcome {
    /// Loop closures.
    pub closures: usize,
    /// Its errors.
    pub error: MapError,
    /// Why it is not scored.
    pub exclusion: Option<Exclusion>,
}

impl Outcome {
    /// Why a method's score of this case is left out, by its map.
    pub(super) fn exclusion(&self, method: Method) -> Option<Exclusion> {
        self.maps.of_method(method).exclusion
    }
}

/// Runs a case.
///
/// # Errors
/// If the laps could not be driven or mapped.
pub(super) fn run(case: &Case) -> anyhow::Result<Outcome> {
    let laps = Laps::drive(case)?;
    let map = |weighting| Mapped::of(&laps, weighting, case.acceptance);
    let maps = Maps {
        seed: map(PaperMap::Seed.weighting())?,
        faithful: map(PaperMap::Faithful.weighting())?,
        robust: map(Weighting::Robust)?,
    };
    let mut scores = BTreeMap::new();
    for method in Method::ALL {
        let mapped = maps.of_method(method);
        let judged = match method {
            Method::Paper(_) => paper_mode::judge(mapped, 1.0),
            Method::PaperRaised(_) => paper_mode::judge(mapped, 2.5),
            Method::Fused => fused_mode::judge(mapped),
            Method::ErrorRatio(which) => baselines::error_ratio(mapped, which)?,
            Method::ChiSquared(which) => baselines::chi_squared(mapped, which),
            Method::Gnc(which) => baselines::gnc(mapped, which)?,
        };
        scores.insert(method, Score::of(&laps, mapped, &judged));
    }
    let columns = |map| (map, paper_mode::columns(&laps, maps.of_paper(map)));
    Ok(Outcome {
        visible_changes: laps.changes.iter().filter(|c| c.visible).count(),
        maps: maps.each(|mapped| MapOutcome {
            closures: mapped.closures.len(),
            error: mapped.error,
            exclusion: mapped.exclusion,
        }),
        paper_columns: PaperMap::ALL.map(columns).into(),
        scores,
        case: case.clone(),
    })
}
