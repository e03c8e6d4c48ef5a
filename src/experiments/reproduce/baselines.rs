//! Published tests for closures that contradict the map.

use std::collections::BTreeSet;

use anyhow::Context;

use super::mapped::{MadeClosure, Mapped};
use super::method::{Judged, Measurement};
use crate::change::threshold::chi_squared_threshold;
use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, EdgeKind, PoseGraph};
use crate::ids::EdgeId;
use crate::solver::{SolveOptions, solve_robust};

/// RTAB-Map's `RGBD/OptimizeMaxError`.
const ERROR_RATIO_MAX: f64 = 3.0;
/// IPC's confidence is 90 %.
const CHI_SQUARED_RATE: f64 = 0.1;

fn measured(made: &MadeClosure, which: Measurement) -> (Pose2, Information) {
    let closure = &made.closure;
    match which {
        Measurement::AllPoints => (
            closure.all_points_measurement,
            closure.all_points_information,
        ),
        Measurement::Robust => (closure.robust.pose, closure.robust.information),
    }
}

/// The largest error of a closure over its standard deviation, at the optimum of all laps.
pub(super) fn error_ratio(mapped: &Mapped, which: Measurement) -> anyhow::Result<Judged> {
    let graph = mapped.map.graph();
    let ratio = |made: &MadeClosure| {
        let edge = graph.edge(made.closure.edge)?;
        let pose = |node| Some(graph.nodes()[graph.node_position(node)?].pose);
        let (measurement, information) = measured(made, which);
        let error = Pose2::edge_error(&pose(edge.from)?, &pose(edge.to)?, &measurement);
        let weights = information.matrix();
        let ratios = (0..3).map(|k| error[k].abs() * weights[(k, k)].max(0.0).sqrt());
        Some(ratios.fold(0.0, f64::max))
    };
    let ratios: Option<Vec<f64>> = mapped.closures.iter().map(ratio).collect();
    let ratios = ratios.context("a closure without its nodes")?;
    let reported = ratios.iter().map(|r| *r > ERROR_RATIO_MAX).collect();
    Ok(Judged::by_closure(mapped, Some(ratios), reported))
}

/// Each closure when it was made: eᵀΩe if it is only compared, ΔF if it is optimised. For one new closure that
/// is the normalised innovation squared.
pub(super) fn chi_squared(mapped: &Mapped, which: Measurement) -> Judged {
    let bound = chi_squared_threshold(CHI_SQUARED_RATE, 3);
    let residual = |made: &MadeClosure| match which {
        Measurement::AllPoints => made.closure.all_points_residual,
        Measurement::Robust => made.closure.delta_f,
    };
    let residuals: Vec<f64> = mapped.closures.iter().map(residual).collect();
    let reported = residuals.iter().map(|r| *r > bound).collect();
    Judged::by_closure(mapped, Some(residuals), reported)
}

/// Closures that a robust solve of all laps switches off.
pub(super) fn gnc(mapped: &Mapped, which: Measurement) -> anyhow::Result<Judged> {
    let mut graph = PoseGraph::new();
    for node in mapped.map.graph().nodes() {
        graph.add_node(*node)?;
    }
    let mut closures = mapped.closures.iter();
    for edge in mapped.map.graph().edges() {
        let (measurement, information) = match edge.kind {
            EdgeKind::Odometry => (edge.measurement, edge.information),
            EdgeKind::LoopClosure => {
                let made = closures.next().context("an edge without its closure")?;
                measured(made, which)
            }
        };
        graph.add_edge(Edge {
            measurement,
            information,
            ..*edge
        })?;
    }
    let summary = solve_robust(&mut graph, &SolveOptions::default());
    let off: BTreeSet<EdgeId> = summary.switched_off.into_iter().collect();
    let is_off = |made: &MadeClosure| off.contains(&made.closure.edge);
    let reported = mapped.closures.iter().map(is_off).collect();
    Ok(Judged::by_closure(mapped, None, reported))
}

#[cfg(test)]
mod tests {
    use super::super::case::Seeds;
    use super::super::laps::Laps;
    use super::super::protocol;
    use super::*;
    use crate::mapping::Weighting;

    #[test]
    fn baselines_judge_every_closure_after_two_laps() {
        let case = protocol::cases(true, Seeds::Tuning).remove(1);
        let laps = Laps::drive(&case).unwrap();
        let mapped = Mapped::of(&laps, Weighting::Robust, case.acceptance).unwrap();
        for which in [Measurement::AllPoints, Measurement::Robust] {
            let all = [
                error_ratio(&mapped, which).unwrap(),
                chi_squared(&mapped, which),
                gnc(&mapped, which).unwrap(),
            ];
            for judged in all {
                for (made, (judged, reported)) in mapped
                    .closures
                    .iter()
                    .zip(judged.judged.iter().zip(&judged.reported))
                {
                    assert_eq!(*judged, made.place.lap >= 2);
                    assert!(*judged || !reported);
                }
            }
        }
        // The robust measurements agree with the map that was made from them.
        let ratio = error_ratio(&mapped, Measurement::Robust).unwrap();
        let off = ratio.reported.iter().filter(|reported| **reported).count();
        assert!(20 * off < ratio.reported.len(), "{off}");
    }
}
