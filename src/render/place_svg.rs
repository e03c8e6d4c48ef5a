//! The observations of a place before a change and since, as one self-contained SVG without scripts, fonts
//! or links.

use std::collections::BTreeSet;

use super::Occupancy;
use super::place_grid::{PlaceGrid, SideCells};
use super::svg_text::{Ink, escaped, label, px};
use crate::geometry::Vector2;
use crate::model::ShownSide;

const WIDTH_PX: f64 = 900.0;
/// The place is drawn no higher than this, pixels.
const PLACE_HEIGHT_MAX_PX: f64 = 640.0;
const MARGIN_PX: f64 = 24.0;
const PLACE_TOP_PX: f64 = 112.0;
const LEGEND_HEIGHT_PX: f64 = 118.0;
const LINE_PX: f64 = 20.0;
/// Letters in a line of the summary.
const LINE_LETTERS: usize = 104;

// Blue and vermilion of Okabe and Ito's palette, which colour-blind people can distinguish.
const BEFORE: &str = "#0072b2";
const SINCE: &str = "#d55e00";
const BEFORE_PALE: &str = "#9cc3de";
const SINCE_PALE: &str = "#efb68e";
const BOTH: &str = "#4a4f57";
const FREE_BEFORE: &str = "#e3eff7";
const FREE_SINCE: &str = "#fdeee3";
const FREE_BOTH: &str = "#f3f3f3";
const REGION: &str = "#6b2fa0";
const INK: &str = "#1c2430";

/// What the picture shows.
#[derive(Debug, Clone)]
pub struct PlacePicture<'a> {
    /// What happened, in a few words.
    pub title: &'a str,
    /// The same in a sentence.
    pub summary: &'a str,
    /// The observations.
    pub grid: &'a PlaceGrid,
    /// A simple polygon round what changed, map frame, metres.
    pub region: &'a [Vector2<f64>],
    /// Which side's observations are drawn.
    pub shown: ShownSide,
}

/// Draws the picture: 900 pixels wide, light background, y upwards. Its view `#place` is the place alone,
/// for pages that have the text elsewhere. The same observations make the same bytes.
pub fn to_svg(picture: &PlacePicture<'_>) -> String {
    let place = Place::of(picture.grid);
    let height_px = PLACE_TOP_PX + place.height_px + LEGEND_HEIGHT_PX;
    let mut svg = String::with_capacity(128 << 10);
    svg.push_str(&format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH_PX} {0}\" width=\"{WIDTH_PX}\" height=\"{0}\" role=\"img\" font-family=\"system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif\">\n",
        px(height_px)
    ));
    svg.push_str(&format!("<title>{}</title>\n", escaped(picture.title)));
    svg.push_str(&format!("<desc>{}</desc>\n", escaped(picture.summary)));
    place.declare_view(&mut svg);
    svg.push_str("<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n");
    label(&mut svg, MARGIN_PX, 40.0, picture.title, Ink::TITLE);
    for (line, words) in (0..).zip(lines(picture.summary)) {
        let y_px = 66.0 + LINE_PX * f64::from(line);
        label(&mut svg, MARGIN_PX, y_px, &words, Ink::LARGE);
    }
    place.draw(&mut svg, picture);
    legend(&mut svg, picture, PLACE_TOP_PX + place.height_px);
    svg.push_str("</svg>\n");
    svg
}

/// A sentence in lines of words.
fn lines(sentence: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in sentence.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() < LINE_LETTERS => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// How a cell is filled; `None` where it is unknown.
fn fill_of(grid: &PlaceGrid, shown: ShownSide, cell: usize) -> Option<&'static str> {
    let (before, since) = (grid.before.occupancy(cell), grid.since.occupancy(cell));
    let (before, since) = match shown {
        ShownSide::Before => (before, Occupancy::Unknown),
        ShownSide::Since => (Occupancy::Unknown, since),
        ShownSide::Both => (before, since),
    };
    let is_alone = shown != ShownSide::Both;
    let agrees = |side: &SideCells| !is_alone && grid.is_hit_near(side, cell);
    match (before, since) {
        (Occupancy::Unknown, Occupancy::Unknown) => None,
        (Occupancy::Occupied, Occupancy::Occupied) => Some(BOTH),
        (Occupancy::Occupied, _) if agrees(&grid.since) => Some(BOTH),
        (_, Occupancy::Occupied) if agrees(&grid.before) => Some(BOTH),
        (Occupancy::Occupied, Occupancy::Free) => Some(BEFORE),
        (Occupancy::Free, Occupancy::Occupied) => Some(SINCE),
        (Occupancy::Occupied, Occupancy::Unknown) if is_alone => Some(BEFORE),
        (Occupancy::Unknown, Occupancy::Occupied) if is_alone => Some(SINCE),
        (Occupancy::Occupied, Occupancy::Unknown) => Some(BEFORE_PALE),
        (Occupancy::Unknown, Occupancy::Occupied) => Some(SINCE_PALE),
        (Occupancy::Free, Occupancy::Unknown) => Some(FREE_BEFORE),
        (Occupancy::Unknown, Occupancy::Free) => Some(FREE_SINCE),
        (Occupancy::Free, Occupancy::Free) => Some(FREE_BOTH),
    }
}

/// Where on the picture the place is.
struct Place {
    left_px: f64,
    width_px: f64,
    height_px: f64,
    px_per_cell: f64,
}

impl Place {
    fn of(grid: &PlaceGrid) -> Self {
        let (columns, rows) = (grid.width as f64, grid.height as f64);
        let room_px = WIDTH_PX - 2.0 * MARGIN_PX;
        let px_per_cell = (room_px / columns).min(PLACE_HEIGHT_MAX_PX / rows);
        let width_px = columns * px_per_cell;
        Self {
            left_px: 0.5 * (WIDTH_PX - width_px),
            width_px,
            height_px: rows * px_per_cell,
            px_per_cell,
        }
    }

    /// Metres of the map frame to pixels.
    fn at(&self, grid: &PlaceGrid, point: &Vector2<f64>) -> (f64, f64) {
        let cells = (point - grid.origin) / grid.resolution_m;
        (
            self.left_px + cells.x * self.px_per_cell,
            PLACE_TOP_PX + self.height_px - cells.y * self.px_per_cell,
        )
    }

    fn declare_view(&self, svg: &mut String) {
        svg.push_str(&format!(
            "<view id=\"place\" viewBox=\"{} {} {} {}\"/>\n",
            px(self.left_px),
            px(PLACE_TOP_PX),
            px(self.width_px),
            px(self.height_px)
        ));
    }

    fn draw(&self, svg: &mut String, picture: &PlacePicture<'_>) {
        self.draw_cells(svg, picture);
        if picture.shown != ShownSide::Since {
            self.draw_eyes(svg, picture.grid, &picture.grid.before, BEFORE);
        }
        if picture.shown != ShownSide::Before {
            self.draw_eyes(svg, picture.grid, &picture.grid.since, SINCE);
        }
        let corner = |corner: &Vector2<f64>| {
            let (x, y) = self.at(picture.grid, corner);
            format!("{},{}", px(x), px(y))
        };
        let corners: Vec<String> = picture.region.iter().map(corner).collect();
        svg.push_str(&format!(
            "<polygon points=\"{}\" fill=\"none\" stroke=\"{REGION}\" stroke-width=\"2.5\" stroke-linejoin=\"round\"/>\n",
            corners.join(" ")
        ));
        svg.push_str(&format!(
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#9aa3ae\"/>\n",
            px(self.left_px),
            px(PLACE_TOP_PX),
            px(self.width_px),
            px(self.height_px)
        ));
        self.draw_scale(svg, picture.grid);
    }

    /// Draws the cells, one path a colour, with one rectangle for each run of a row; in units of cells.
    fn draw_cells(&self, svg: &mut String, picture: &PlacePicture<'_>) {
        let grid = picture.grid;
        svg.push_str(&format!(
            "<g transform=\"translate({} {}) scale({2:.4} -{2:.4})\" shape-rendering=\"crispEdges\">\n",
            px(self.left_px),
            px(PLACE_TOP_PX + self.height_px),
            self.px_per_cell
        ));
        for colour in [
            FREE_BOTH,
            FREE_BEFORE,
            FREE_SINCE,
            BEFORE_PALE,
            SINCE_PALE,
            BOTH,
            BEFORE,
            SINCE,
        ] {
            let mut path = String::new();
            for row in 0..grid.height {
                let fill = |column: &usize| {
                    fill_of(grid, picture.shown, row * grid.width + column) == Some(colour)
                };
                let columns: Vec<usize> = (0..grid.width).filter(fill).collect();
                for run in columns.chunk_by(|a, b| a + 1 == *b) {
                    path.push_str(&format!("M{} {row}h{1}v1h-{1}z", run[0], run.len()));
                }
            }
            if !path.is_empty() {
                svg.push_str(&format!("<path fill=\"{colour}\" d=\"{path}\"/>\n"));
            }
        }
        svg.push_str("</g>\n");
    }

    /// Draws a dot in each cell in which a lidar was.
    fn draw_eyes(&self, svg: &mut String, grid: &PlaceGrid, side: &SideCells, colour: &str) {
        let size = Vector2::new(grid.width as f64, grid.height as f64);
        let in_cells = side
            .eyes
            .iter()
            .map(|eye| (eye - grid.origin) / grid.resolution_m);
        let inside = in_cells.filter(|c| c.x >= 0.0 && c.y >= 0.0 && c.x < size.x && c.y < size.y);
        let cells: BTreeSet<(usize, usize)> =
            inside.map(|c| (c.y as usize, c.x as usize)).collect();
        let mut path = String::new();
        for (row, column) in cells {
            let centre = Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
            let (x, y) = self.at(grid, &(grid.origin + centre * grid.resolution_m));
            path.push_str(&format!("M{} {}h0", px(x), px(y)));
        }
        if !path.is_empty() {
            svg.push_str(&format!(
                "<path d=\"{path}\" fill=\"none\" stroke=\"#ffffff\" stroke-width=\"9\" stroke-linecap=\"round\"/>\n<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"6\" stroke-linecap=\"round\"/>\n"
            ));
        }
    }

    fn draw_scale(&self, svg: &mut String, grid: &PlaceGrid) {
        let metre_px = self.px_per_cell / grid.resolution_m;
        let (x, y) = (self.left_px + 16.0, PLACE_TOP_PX + self.height_px - 16.0);
        for (colour, width) in [("#ffffff", 6.0), (INK, 2.5)] {
            svg.push_str(&format!(
                "<path d=\"M{0} {1}v10M{0} {2}h{3}M{4} {1}v10\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>\n",
                px(x),
                px(y - 5.0),
                px(y),
                px(metre_px),
                px(x + metre_px)
            ));
        }
        label(svg, x + 6.0, y - 10.0, "1 m", Ink::SCALE);
    }
}

/// The legend under the place.
fn legend(svg: &mut String, picture: &PlacePicture<'_>, top_px: f64) {
    let grid = picture.grid;
    let left = [MARGIN_PX, MARGIN_PX + 440.0];
    let row = |row: f64| top_px + 28.0 + 26.0 * row;
    let (before, since) = (
        observations("before", &grid.before),
        observations("since", &grid.since),
    );
    match picture.shown {
        ShownSide::Before => key(svg, (left[0], row(0.0)), &[BEFORE], "hit before the change"),
        ShownSide::Since => key(svg, (left[0], row(0.0)), &[SINCE], "hit since the change"),
        ShownSide::Both => {
            let words = "hit before, free since";
            key(svg, (left[0], row(0.0)), &[BEFORE], words);
            key(svg, (left[1], row(0.0)), &[SINCE], "hit since, free before");
            key(svg, (left[0], row(1.0)), &[BOTH], "hit before and since");
            let words = "hit before or since, not seen otherwise";
            key(svg, (left[1], row(1.0)), &[BEFORE_PALE, SINCE_PALE], words);
        }
    }
    let free: &[&str] = match picture.shown {
        ShownSide::Before => &[FREE_BEFORE],
        ShownSide::Since => &[FREE_SINCE],
        ShownSide::Both => &[FREE_BOTH, FREE_BEFORE, FREE_SINCE],
    };
    let words = match picture.shown {
        ShownSide::Both => "free (both, before, since)",
        _ => "free",
    };
    key(svg, (left[0], row(2.0)), free, words);
    svg.push_str(&format!(
        "<rect x=\"{}\" y=\"{}\" width=\"16\" height=\"16\" fill=\"none\" stroke=\"{REGION}\" stroke-width=\"2.5\"/>\n",
        px(left[1]),
        px(row(2.0) - 13.0)
    ));
    label(
        svg,
        left[1] + 26.0,
        row(2.0),
        "region of the alert",
        Ink::LARGE,
    );
    if picture.shown != ShownSide::Since {
        dot(svg, (left[0], row(3.0)), BEFORE, &before);
    }
    if picture.shown != ShownSide::Before {
        dot(svg, (left[1], row(3.0)), SINCE, &since);
    }
}

fn observations(when: &str, side: &SideCells) -> String {
    match side.eyes.len() {
        0 => format!("not observed {when}"),
        1 => format!("lidar: 1 observation {when}"),
        count => format!("lidar: {count} observations {when}"),
    }
}

/// Squares and what they mean.
fn key(svg: &mut String, (x_px, y_px): (f64, f64), colours: &[&str], words: &str) {
    for (place, colour) in (0..).zip(colours) {
        svg.push_str(&format!(
            "<rect x=\"{}\" y=\"{}\" width=\"16\" height=\"16\" fill=\"{colour}\" stroke=\"#9aa3ae\" stroke-width=\"0.5\"/>\n",
            px(x_px + 18.0 * f64::from(place)),
            px(y_px - 13.0)
        ));
    }
    let after_px = 8.0 + 18.0 * colours.len() as f64;
    label(svg, x_px + after_px, y_px, words, Ink::LARGE);
}

fn dot(svg: &mut String, (x_px, y_px): (f64, f64), colour: &str, words: &str) {
    svg.push_str(&format!(
        "<circle cx=\"{}\" cy=\"{}\" r=\"5\" fill=\"{colour}\"/>\n",
        px(x_px + 8.0),
        px(y_px - 5.0)
    ));
    label(svg, x_px + 26.0, y_px, words, Ink::LARGE);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every third cell of a row: hit before, since, both; free; and one beside it hit on another side.
    fn grid() -> PlaceGrid {
        let mut grid = PlaceGrid::around(&[Vector2::zeros()]);
        for (cell, [before, since]) in [
            [[2, 0], [0, 2]],
            [[0, 2], [2, 0]],
            [[2, 0], [2, 0]],
            [[0, 2], [0, 2]],
        ]
        .into_iter()
        .enumerate()
        {
            let cell = 3 * cell;
            [grid.before.hits[cell], grid.before.misses[cell]] = before;
            [grid.since.hits[cell], grid.since.misses[cell]] = since;
        }
        [grid.before.hits[12], grid.since.hits[13]] = [2, 2];
        grid.before.eyes = vec![Vector2::new(0.3, 0.4), Vector2::new(0.31, 0.41)];
        grid.since.eyes = vec![Vector2::new(9.0, 0.4)];
        grid
    }

    fn drawn(grid: &PlaceGrid, shown: ShownSide) -> String {
        to_svg(&PlacePicture {
            title: "Appeared: about 0.4 × 0.4 m",
            summary: "Something <large> stands here.",
            grid,
            region: &[],
            shown,
        })
    }

    #[test]
    fn each_side_has_its_colour() {
        let grid = grid();
        let path = |colour: &str, column: usize| {
            format!("<path fill=\"{colour}\" d=\"M{column} 0h1v1h-1z\"/>")
        };
        let both = drawn(&grid, ShownSide::Both);
        for (colour, column) in [(BEFORE, 0), (SINCE, 3), (FREE_BOTH, 9)] {
            assert!(both.contains(&path(colour, column)), "{colour}");
        }
        let both_sides = format!("<path fill=\"{BOTH}\" d=\"M6 0h1v1h-1zM12 0h2v1h-2z\"/>");
        assert!(both.contains(&both_sides), "{both}");
        let before = drawn(&grid, ShownSide::Before);
        let runs = "M0 0h1v1h-1zM6 0h1v1h-1zM12 0h1v1h-1z";
        assert!(before.contains(&format!("<path fill=\"{BEFORE}\" d=\"{runs}\"/>")));
        assert!(!before.contains(SINCE));
        let since = drawn(&grid, ShownSide::Since);
        let runs = "M3 0h1v1h-1zM6 0h1v1h-1zM13 0h1v1h-1z";
        assert!(since.contains(&format!("<path fill=\"{SINCE}\" d=\"{runs}\"/>")));
        assert!(!since.contains(BEFORE));
    }

    #[test]
    fn the_picture_says_what_it_shows() {
        let svg = drawn(&grid(), ShownSide::Both);
        assert!(svg.contains("lidar: 2 observations before"));
        assert!(svg.contains("lidar: 1 observation since"));
        assert!(svg.contains("Something &lt;large&gt; stands here.</text>"));
        // One dot for two in a cell, and none outside.
        assert_eq!(svg.matches("h0\"").count(), 2, "its rim and itself");
        assert!(svg.contains(">1 m</text>"));
    }

    #[test]
    fn long_sentences_are_broken_between_words() {
        let sentence = ["word"; 60].join(" ");
        let lines = lines(&sentence);
        assert_eq!(lines.len(), 3);
        assert!(
            lines
                .iter()
                .all(|line| line.chars().count() <= LINE_LETTERS)
        );
        assert_eq!(lines.join(" "), sentence);
    }
}
