//! Tables and shelves: things that look otherwise at each height.

use super::Shape;
use crate::geometry::{Pose2, Vector2};

/// Heights of a table's top, metres above the floor.
const TOP_M: (f64, f64) = (0.72, 0.75);
/// Width of the legs of a table and of the uprights of a shelf, metres.
const LEG_M: f64 = 0.05;
/// How far legs stand in from the edge, metres.
const INSET_M: f64 = 0.05;
/// A shelf's boards, metres above the floor, …
const BOARDS_M: [f64; 5] = [0.12, 0.5, 0.88, 1.26, 1.64];
/// … how thick they are, …
const BOARD_M: f64 = 0.03;
/// … and how high its uprights.
const SHELF_M: f64 = 1.8;

/// What is put into a hall.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Furniture {
    /// A top of 1.2 m × 0.8 m on four legs.
    Table,
    /// Five boards of 1 m × 0.4 m between four uprights.
    Shelf,
    /// A board of 1 m × 0.4 m as high as a table, that hangs: nothing stands below it.
    Board,
}

/// A part: its outline, and between which heights above the floor it is, metres.
pub(super) type Part = (Shape, (f64, f64));

impl Furniture {
    fn size_m(self) -> (f64, f64) {
        match self {
            Self::Table => (1.2, 0.8),
            Self::Shelf | Self::Board => (1.0, 0.4),
        }
    }

    /// Seen from above, with its middle at `map_from_middle`.
    pub fn outline(self, map_from_middle: &Pose2) -> Shape {
        let (length_m, width_m) = self.size_m();
        Shape::rectangle(map_from_middle, length_m, width_m)
    }

    /// Its parts, where its outline is a rectangle that stands somewhere; `None` for another shape.
    pub(super) fn parts(self, outline: &Shape) -> Option<Vec<Part>> {
        let Shape::Outline(corners) = outline else {
            return None;
        };
        let (middle, _) = outline.bounding_circle();
        let along = corners.first()? - corners.get(1)?;
        let map_from_middle = Pose2::new(middle.x, middle.y, along.y.atan2(along.x));
        let (length_m, width_m) = self.size_m();
        let inset_m = INSET_M + 0.5 * LEG_M;
        let (x, y) = (0.5 * length_m - inset_m, 0.5 * width_m - inset_m);
        let legs = [(x, y), (-x, y), (-x, -y), (x, -y)].map(|(x, y)| {
            let at = map_from_middle.transform(&Vector2::new(x, y));
            Shape::rectangle(&Pose2::new(at.x, at.y, map_from_middle.theta), LEG_M, LEG_M)
        });
        let (legs_to_m, boards): (Option<f64>, Vec<(f64, f64)>) = match self {
            Self::Table => (Some(TOP_M.0), vec![TOP_M]),
            Self::Shelf => (
                Some(SHELF_M),
                BOARDS_M.map(|at_m| (at_m, at_m + BOARD_M)).into(),
            ),
            Self::Board => (None, vec![TOP_M]),
        };
        let legs = legs
            .into_iter()
            .filter_map(|leg| Some((leg, (0.0, legs_to_m?))));
        let boards = boards
            .into_iter()
            .map(|heights_m| (outline.clone(), heights_m));
        Some(legs.chain(boards).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_four_legs_and_a_top() {
        let place = Pose2::new(3.0, 2.0, 0.7);
        let parts = Furniture::Table
            .parts(&Furniture::Table.outline(&place))
            .unwrap();
        assert_eq!(parts.len(), 5);
        let cut_at = |height_m: f64| {
            let cut = parts
                .iter()
                .filter(|(_, (from_m, to_m))| (*from_m..=*to_m).contains(&height_m));
            cut.map(|(shape, _)| shape.area_m2()).sum::<f64>()
        };
        assert!((cut_at(0.3) - 4.0 * LEG_M * LEG_M).abs() < 1e-9);
        assert!((cut_at(0.74) - 1.2 * 0.8).abs() < 1e-9);
        assert!(cut_at(0.8) == 0.0);
        // Legs stand under the top.
        let (top, _) = &parts[4];
        assert!(
            parts[..4]
                .iter()
                .all(|(leg, _)| top.contains(&leg.bounding_circle().0))
        );
    }

    #[test]
    fn a_shelf_goes_all_the_way_up() {
        let shelf = Furniture::Shelf;
        let parts = shelf.parts(&shelf.outline(&Pose2::IDENTITY)).unwrap();
        assert_eq!(parts.len(), 9);
        let boards = parts
            .iter()
            .filter(|(_, (from_m, to_m))| to_m - from_m < 0.1);
        assert_eq!(boards.count(), 5);
        let board = Furniture::Board;
        let parts = board.parts(&board.outline(&Pose2::IDENTITY)).unwrap();
        assert_eq!(parts.len(), 1);
    }
}
