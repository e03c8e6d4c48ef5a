//! How uncertain the map's poses are: their marginals, scaled by how well loop closures agree.
//!
//! Marginal covariances take the errors of edges for independent of each other. Those of matched
//! scans are not: scans of one pass see the same wall a little askew, and what they have in common no
//! closure contradicts. But how far closures disagree tells how much of it there is.

use super::route_map::{RouteMap, Weighting};
use crate::geometry::PoseSigma;
use crate::solver::{ClosureError, PoseErrors};

/// What covariances of an open chain are multiplied with: nothing tells how well it was matched. As
/// measured in simulated worlds where the scans of a lap err together.
const SCALE_OF_OPEN_CHAINS: f64 = 2.0;
/// So many closures weigh as much as that does.
const PRIOR_CLOSURES: f64 = 30.0;
/// What covariances are multiplied with where matched scans disagree just as their information
/// says. Where their noise alone makes them err they disagree a hundred times less; the rest they
/// have in common with their pass, and many of them are as good as one. As measured, like the above.
const SCALE_OF_MATCHED: f64 = 100.0;
/// Closures that the rest of the graph would know less of than this do not say how they agree.
const REDUNDANCY_MIN: f64 = 0.3;
/// The median of χ²₃, divided by three.
const MEDIAN_OF_CHI_SQUARED: f64 = 0.789;

impl RouteMap {
    /// How uncertain each pose is, in the order of the graph's nodes: standard deviations in the
    /// map frame, relative to the first node that the node hangs together with, which has zeros.
    /// `None` for nodes of which it is not known where they are, and where nothing tells.
    ///
    /// A function of the active edges and the poses alone. Costs about three factorisations of the
    /// whole graph.
    pub fn pose_sigmas(&self) -> Vec<Option<PoseSigma>> {
        let Some(errors) = PoseErrors::of(&self.graph) else {
            return vec![None; self.keyframes.len()];
        };
        let scales = self.covariance_scales(&errors);
        let nodes = errors.covariances.iter().zip(&self.keyframes).enumerate();
        let sigmas = nodes.map(|(k, (covariance, keyframe))| {
            if keyframe.is_lost() {
                return None;
            }
            let scale = scales[errors.first_of_component[k]]?;
            PoseSigma::from_covariance(&(covariance * scale))
        });
        sigmas.collect()
    }

    /// By the place of a component's first node: what its covariances are multiplied with; `None`
    /// where Ω has no unit and no closure gives it one.
    fn covariance_scales(&self, errors: &PoseErrors) -> Vec<Option<f64>> {
        let mut of_components = vec![Vec::new(); self.keyframes.len()];
        for closure in &errors.closures {
            let (from, _) = self.graph.ends()[closure.edge];
            if closure.redundancy >= REDUNDANCY_MIN {
                let scales = &mut of_components[errors.first_of_component[from]];
                scales.push(self.scale_by(closure));
            }
        }
        let scale = |mut scales: Vec<f64>| {
            scales.sort_by(f64::total_cmp);
            let median = scales.get(scales.len() / 2).copied();
            match self.weighting {
                Weighting::Robust => {
                    let closures = scales.len() as f64;
                    let sum = PRIOR_CLOSURES * SCALE_OF_OPEN_CHAINS
                        + closures * median.unwrap_or(0.0).max(1.0);
                    Some(sum / (PRIOR_CLOSURES + closures))
                }
                Weighting::AllPointsIdentity | Weighting::Paper => median,
            }
        };
        of_components.into_iter().map(scale).collect()
    }

    /// What one closure says of the scale.
    fn scale_by(&self, closure: &ClosureError) -> f64 {
        let (from, to) = self.graph.ends()[closure.edge];
        let is_matched = [from, to].iter().all(|&k| self.keyframes[k].scan.is_some());
        let agreement = closure.squared_error / closure.redundancy / MEDIAN_OF_CHI_SQUARED;
        match is_matched {
            true => SCALE_OF_MATCHED * agreement,
            false => agreement,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::drift::LOST_DRIFT_M;
    use super::super::keyframe::Keyframe;
    use super::super::testing::blind_keyframe;
    use super::*;
    use crate::geometry::{Information, Pose2};
    use crate::graph::{Edge, EdgeKind, EdgeStatus};
    use crate::ids::{EdgeId, NodeId, StampNs, TripId};

    const SIGMA_M: f64 = 0.02;
    const SIGMA_RAD: f64 = 0.01;

    /// Without a scan: its closures were matched by whoever sent them.
    fn keyframe(id: i64) -> Keyframe {
        let trip = TripId::new("t").unwrap();
        Keyframe::without_scan(NodeId(id), trip, StampNs(id), Pose2::IDENTITY)
    }

    /// Nodes a metre apart, and closures without length from each to the one at `tied` metres less
    /// that are `off` sigmas off, to one side and the other by turns.
    fn chain(weighting: Weighting, nodes: i64, tied: Option<i64>, off: f64) -> RouteMap {
        let placed = (1..=nodes).map(|id| (Pose2::new(id as f64, 2.0, 0.0), keyframe(id)));
        let edge = |id, from, to, y, kind| Edge {
            id: EdgeId(id),
            from: NodeId(from),
            to: NodeId(to),
            measurement: Pose2::new((to - from) as f64, y, 0.0),
            information: Information::from_sigmas(SIGMA_M, SIGMA_RAD),
            kind,
            status: EdgeStatus::Active,
        };
        let odometry = (1..nodes).map(|k| edge(k, k, k + 1, 0.0, EdgeKind::Odometry));
        let closures = tied.into_iter().flat_map(|back| {
            (back + 1..=nodes).map(move |k| {
                let side = if k % 2 == 0 { 1.0 } else { -1.0 };
                edge(
                    nodes + k,
                    k - back,
                    k,
                    side * off * SIGMA_M,
                    EdgeKind::LoopClosure,
                )
            })
        });
        let edges: Vec<Edge> = odometry.chain(closures).collect();
        let next = (NodeId(nodes + 1), EdgeId(2 * nodes + 1));
        let mut map = RouteMap::restore(weighting, placed, edges.clone(), next.0, next.1).unwrap();
        map.solve_anew(edges.iter().map(|edge| edge.id).collect());
        map
    }

    fn y_m(map: &RouteMap, k: usize) -> f64 {
        map.pose_sigmas()[k].unwrap().y_m
    }

    #[test]
    fn an_open_chain_adds_up_from_its_first_node() {
        let map = chain(Weighting::Robust, 4, None, 0.0);
        let scale = SCALE_OF_OPEN_CHAINS.sqrt();
        let zero = PoseSigma {
            x_m: 0.0,
            y_m: 0.0,
            theta_rad: 0.0,
        };
        assert_eq!(map.pose_sigmas()[0], Some(zero));
        let last = map.pose_sigmas()[3].unwrap();
        // Two digits are kept.
        let is = |sigma: f64, expected: f64| (sigma / (scale * expected) - 1.0).abs() <= 0.05;
        assert!(is(last.x_m, SIGMA_M * 3.0_f64.sqrt()));
        assert!(is(last.theta_rad, SIGMA_RAD * 3.0_f64.sqrt()));
        // Turns act with levers of 2 and 1 metres.
        let y_m = (3.0 * SIGMA_M * SIGMA_M + 5.0 * SIGMA_RAD * SIGMA_RAD).sqrt();
        assert!(is(last.y_m, y_m));
    }

    #[test]
    fn closures_that_disagree_make_poses_less_certain() {
        let at = |off| y_m(&chain(Weighting::Robust, 60, Some(3), off), 59);
        let open_m = y_m(&chain(Weighting::Robust, 60, None, 0.0), 59);
        assert!(at(0.0) < 0.5 * open_m);
        // Up to what their information says they are all as good.
        assert!((at(0.2) - at(0.0)).abs() < 1e-5);
        assert!(at(6.0) > 2.0 * at(0.0), "{} {}", at(6.0), at(0.0));
    }

    #[test]
    fn what_scans_have_in_common_is_allowed_for() {
        let given = chain(Weighting::Robust, 60, Some(3), 1.0);
        let mut matched = chain(Weighting::Robust, 60, Some(3), 1.0);
        for keyframe in &mut matched.keyframes {
            *keyframe = blind_keyframe(keyframe.node.0, keyframe.trip.clone(), keyframe.stamp);
        }
        assert!(y_m(&matched, 59) > 3.0 * y_m(&given, 59));
    }

    #[test]
    fn without_a_unit_only_closures_tell() {
        let open = chain(Weighting::AllPointsIdentity, 5, None, 0.0);
        assert!(open.pose_sigmas().iter().all(Option::is_none));
        let tied = |off| y_m(&chain(Weighting::AllPointsIdentity, 60, Some(3), off), 59);
        assert!((tied(0.2) / tied(0.1) - 2.0).abs() < 0.05);
    }

    #[test]
    fn nobody_knows_how_far_off_a_lost_node_is() {
        let mut map = chain(Weighting::Robust, 4, None, 0.0);
        map.keyframes[2].drift_m = LOST_DRIFT_M;
        let known: Vec<bool> = map.pose_sigmas().iter().map(Option::is_some).collect();
        assert_eq!(known, [true, true, false, true]);
    }
}
