//! What a detector decides.

use crate::change::Finding;
use crate::mapping::Mending;
use crate::pipeline::workspace::Workspace;

/// A rule by which changes are found in a route's map. What it keeps is in the map: it has no state of its
/// own, and the same map gives the same findings.
pub(super) trait Rule {
    /// What the scans say of the places that something was seen of since the last time, and what was put
    /// right in the map by it.
    ///
    /// # Errors
    /// If the graph refuses an id; the workspace is lost then.
    fn detect_in_scans(&self, _workspace: &mut Workspace) -> anyhow::Result<Detected> {
        Ok(Detected::default())
    }

    /// What the scans say where every place is judged anew; nothing is mended.
    fn detect_everywhere(&self, _workspace: &mut Workspace) -> Vec<Finding> {
        Vec::new()
    }

    /// All findings that stand, those of the scans among them.
    fn findings(&self, workspace: &Workspace, observed: Vec<Finding>) -> Vec<Finding>;
}

/// What the scans of a map say, and what was put right in it.
#[derive(Default)]
pub(in crate::pipeline) struct Detected {
    pub findings: Vec<Finding>,
    pub mendings: Vec<Mending>,
}
