//! One simulated test case of the paper's protocol (section 5.1).

use serde::Serialize;

use crate::mapping::ClosureRule;

/// The seeds of worlds and trips. Parameters are chosen on one set and scored on the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Seeds {
    /// For choosing parameters.
    Tuning,
    /// For reported results.
    Scoring,
}

impl Seeds {
    /// The seed of a base map, `map` from 1.
    pub(super) fn of_map(self, map: usize) -> u64 {
        let first = match self {
            Self::Tuning => 10,
            Self::Scoring => 1_010,
        };
        first + map as u64
    }
}

/// How strict the acceptance of closures is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Acceptance {
    /// Accepts nearly everything.
    Low,
    /// The service's own rule.
    Medium,
    /// Only near-equal views.
    High,
}

impl Acceptance {
    /// As the map has it.
    pub(super) fn rule(self) -> ClosureRule {
        let medium = ClosureRule::default();
        match self {
            Self::Low => ClosureRule {
                overlap_min: 0.2,
                inlier_share_min: 0.3,
            },
            Self::Medium => medium,
            Self::High => ClosureRule {
                overlap_min: 0.8,
                inlier_share_min: 0.85,
            },
        }
    }

    /// In tables.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Low => "low (overlap 0.2, agreement 0.3)",
            Self::Medium => "medium (overlap 0.4, agreement 0.6)",
            Self::High => "high (overlap 0.8, agreement 0.85)",
        }
    }
}

/// Laps of one vehicle in a hall that changes once, between two laps.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Case {
    /// Which base map, from 1.
    pub map: usize,
    /// Its seed.
    pub map_seed: u64,
    /// Of changes, path and noise.
    pub seed: u64,
    /// How far laps stray from the first, metres (the paper's ρ).
    pub path_noise_m: f64,
    /// Objects that appear or vanish.
    pub changes: usize,
    /// Laps before the change.
    pub laps_before: usize,
    /// Laps after it.
    pub laps_after: usize,
    /// The acceptance rule of closures.
    pub acceptance: Acceptance,
    /// Distance between scans, metres.
    pub scan_spacing_m: f64,
}

impl Case {
    /// All laps.
    pub(super) fn laps(&self) -> usize {
        self.laps_before + self.laps_after
    }

    /// `map 2, ρ 0.5 m, 5 changes, 10 + 5 laps`.
    pub(super) fn name(&self) -> String {
        let Self {
            map,
            path_noise_m,
            changes,
            laps_before,
            laps_after,
            ..
        } = self;
        format!(
            "map {map}, ρ {path_noise_m} m, {changes} changes, {laps_before} + {laps_after} laps"
        )
    }
}
