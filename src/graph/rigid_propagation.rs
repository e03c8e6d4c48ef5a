//! Moves nodes of a block together with their child blocks.

use super::edge::Node;
use super::pose_graph::PoseGraph;
use crate::geometry::Pose2;

impl PoseGraph {
    /// Moves nodes of one block, none of them its anchor, and with each node, as one rigid body, all its child
    /// blocks: their edges keep their errors. Appends the index of every node whose pose has changed to
    /// `moved`.
    ///
    /// Costs as much as there is to move: a component's first node never moves.
    pub(crate) fn move_with_children(
        &mut self,
        to: impl IntoIterator<Item = (usize, Pose2)>,
        moved: &mut Vec<usize>,
    ) {
        // A caller that names nodes of a block has computed the blocks.
        let (nodes, Some(blocks)) = self.nodes_with_blocks() else {
            return;
        };
        let mut open = Vec::new();
        for (position, pose) in to {
            let before = std::mem::replace(&mut nodes[position].pose, pose);
            if before == pose {
                continue;
            }
            moved.push(position);
            open.extend_from_slice(blocks.child_blocks(position));
            if open.is_empty() {
                continue;
            }
            let motion = RigidMotion::new(&before, &pose);
            while let Some(block) = open.pop().and_then(|index| blocks.get(index)) {
                for &child in &block.nodes {
                    motion.apply(&mut nodes[child]);
                    moved.push(child);
                    open.extend_from_slice(blocks.child_blocks(child));
                }
            }
        }
    }
}

/// The rigid motion that takes one pose to another.
struct RigidMotion {
    from: Pose2,
    to: Pose2,
    turn_rad: f64,
    sin: f64,
    cos: f64,
}

impl RigidMotion {
    fn new(from: &Pose2, to: &Pose2) -> Self {
        let turn_rad = to.theta - from.theta;
        let (sin, cos) = turn_rad.sin_cos();
        Self {
            from: *from,
            to: *to,
            turn_rad,
            sin,
            cos,
        }
    }

    fn apply(&self, node: &mut Node) {
        let (dx, dy) = (node.pose.x - self.from.x, node.pose.y - self.from.y);
        node.pose = Pose2::new(
            self.to.x + self.cos * dx - self.sin * dy,
            self.to.y + self.sin * dx + self.cos * dy,
            node.pose.theta + self.turn_rad,
        );
    }
}
