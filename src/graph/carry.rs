//! Moving nodes of a block together with what hangs off them.

use super::edge::Node;
use super::pose_graph::PoseGraph;
use crate::geometry::Pose2;

impl PoseGraph {
    /// Moves nodes of one block, none of them its anchor, and with each node, as one rigid body,
    /// all blocks that hang off it: their edges keep their errors. Appends the place of every node
    /// whose pose is another now to `moved`. What is known of the blocks' optima stands.
    ///
    /// Costs as much as there is to move. A component's first node never moves, so there is no
    /// other side that could be moved instead.
    pub(crate) fn move_with_hanging(
        &mut self,
        to: impl IntoIterator<Item = (usize, Pose2)>,
        moved: &mut Vec<usize>,
    ) {
        // Whoever knows what a block is has asked for the blocks.
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
            open.extend_from_slice(blocks.hanging_off(position));
            if open.is_empty() {
                continue;
            }
            let swing = Swing::new(&before, &pose);
            while let Some(block) = open.pop().and_then(|index| blocks.get(index)) {
                for &carried in &block.nodes {
                    swing.carry(&mut nodes[carried]);
                    moved.push(carried);
                    open.extend_from_slice(blocks.hanging_off(carried));
                }
            }
        }
    }
}

/// A rigid motion that takes one pose to another, by turning about the first.
struct Swing {
    from: Pose2,
    to: Pose2,
    turn_rad: f64,
    sin: f64,
    cos: f64,
}

impl Swing {
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

    fn carry(&self, node: &mut Node) {
        let (dx, dy) = (node.pose.x - self.from.x, node.pose.y - self.from.y);
        node.pose = Pose2::new(
            self.to.x + self.cos * dx - self.sin * dy,
            self.to.y + self.sin * dx + self.cos * dy,
            node.pose.theta + self.turn_rad,
        );
    }
}
