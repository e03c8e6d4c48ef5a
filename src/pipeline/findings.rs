//! What a route's map says about changes, by the route's rule: one file a detector, all of them in
//! [`rule_of`].

mod fused;
mod rule;
mod seed;

use super::workspace::Workspace;
use crate::change::{Detector, Finding};
use rule::Rule;

pub(super) use rule::Detected;

/// The rule of a detector.
fn rule_of(detector: Detector) -> &'static dyn Rule {
    match detector {
        Detector::Fused => &fused::Fused,
        Detector::Seed => &seed::Seed,
    }
}

/// Asks the scans where something was seen since the last time, and mends the map where they prove where a
/// segment belongs.
///
/// # Errors
/// If the graph refuses an id; the workspace is lost then.
pub(super) fn detect_in_scans(workspace: &mut Workspace) -> anyhow::Result<Detected> {
    rule_of(workspace.detector).detect_in_scans(workspace)
}

/// What the scans say where every place is judged anew; nothing is mended.
pub(super) fn detect_everywhere(workspace: &mut Workspace) -> Vec<Finding> {
    rule_of(workspace.detector).detect_everywhere(workspace)
}

/// All findings that stand, those of the scans among them.
pub(super) fn findings(workspace: &Workspace, observed: Vec<Finding>) -> Vec<Finding> {
    rule_of(workspace.detector).findings(workspace, observed)
}
