//! The panels that show scans, region and vehicles in the map frame.

use super::picture::{EvidencePicture, EvidenceScan, MARGIN_PX, WIDTH_PX};
use super::text::{Ink, label, px};
use crate::change::{BeamVerdict, JudgedBeam};
use crate::geometry::{Pose2, Vector2};

/// Colours of one scan.
#[derive(Debug, Clone, Copy)]
pub(super) struct Colours {
    /// Points that the other scan confirms.
    pub plain: &'static str,
    /// Points that it contradicts; the vehicle.
    pub strong: &'static str,
    /// Points that it cannot judge.
    pub pale: &'static str,
    /// Size of the points, relative: old points show as a rim round new ones on the same wall.
    pub size: f64,
}

pub(super) const OLD: Colours = Colours {
    plain: "#6d8bab",
    strong: "#174a7c",
    pale: "#bccbdb",
    size: 1.5,
};
pub(super) const NEW: Colours = Colours {
    plain: "#ee8a22",
    strong: "#c4320a",
    pale: "#f8d0a3",
    size: 1.0,
};
pub(super) const REGION: &str = "#6b2fa0";

const TOP_PX: f64 = 84.0;
const HEIGHT_PX: f64 = 460.0;
const AROUND_WIDTH_PX: f64 = 612.0;
const GAP_PX: f64 = 20.0;
/// Space between what must be seen and the panel's border, pixels.
const PADDING_PX: f64 = 26.0;
/// Points this far from the location are in the wide panel, metres.
const AROUND_M: f64 = 5.0;
/// Least half width of the near panel, metres.
const CLOSE_HALF_MIN_M: f64 = 0.6;

/// A rectangle of the picture that shows a part of the map frame.
#[derive(Debug)]
pub(super) struct Panel {
    pub left_px: f64,
    pub top_px: f64,
    pub width_px: f64,
    pub height_px: f64,
    centre: Vector2<f64>,
    px_per_m: f64,
}

impl Panel {
    /// The left panel: the place with both vehicles and the walls nearby.
    pub(super) fn around(picture: &EvidencePicture<'_>) -> Self {
        let mut held = picture.region.to_vec();
        let reach = Vector2::repeat(0.5 * AROUND_M);
        held.extend([picture.location - reach, picture.location + reach]);
        let tied = picture.tied.iter().flatten();
        held.extend(tied.map(Pose2::translation));
        for scan in picture.scans.iter().flatten() {
            held.push(scan.map_from_base.translation());
            let ends = scan.beams.iter().filter_map(|beam| beam.end);
            held.extend(ends.filter(|end| (end - picture.location).norm() <= AROUND_M));
        }
        Self::showing(&held, MARGIN_PX, AROUND_WIDTH_PX)
    }

    /// The right panel: the region and what lies beside it.
    pub(super) fn close_up(picture: &EvidencePicture<'_>) -> Self {
        let (mut low, mut high) = (picture.location, picture.location);
        for corner in picture.region {
            (low, high) = (low.inf(corner), high.sup(corner));
        }
        let half = (0.75 * (high - low).max()).max(CLOSE_HALF_MIN_M);
        let (centre, half) = (0.5 * (low + high), Vector2::repeat(half));
        let left_px = MARGIN_PX + AROUND_WIDTH_PX + GAP_PX;
        let width_px = WIDTH_PX - MARGIN_PX - left_px;
        Self::showing(&[centre - half, centre + half], left_px, width_px)
    }

    fn showing(held: &[Vector2<f64>], left_px: f64, width_px: f64) -> Self {
        let low = held
            .iter()
            .fold(Vector2::repeat(f64::INFINITY), |l, p| l.inf(p));
        let high = held
            .iter()
            .fold(Vector2::repeat(f64::NEG_INFINITY), |h, p| h.sup(p));
        let size = high - low;
        let room = |pixels: f64, metres: f64| (pixels - 2.0 * PADDING_PX) / metres;
        Self {
            left_px,
            top_px: TOP_PX,
            width_px,
            height_px: HEIGHT_PX,
            centre: 0.5 * (low + high),
            px_per_m: room(width_px, size.x).min(room(HEIGHT_PX, size.y)),
        }
    }

    /// Metres to pixels; y upwards in the map is upwards in the picture.
    fn at(&self, point: &Vector2<f64>) -> (f64, f64) {
        let from_centre = (point - self.centre) * self.px_per_m;
        (
            self.left_px + 0.5 * self.width_px + from_centre.x,
            self.top_px + 0.5 * self.height_px - from_centre.y,
        )
    }

    fn holds(&self, (x, y): (f64, f64)) -> bool {
        let (right, bottom) = (self.left_px + self.width_px, self.top_px + self.height_px);
        (self.left_px..=right).contains(&x) && (self.top_px..=bottom).contains(&y)
    }

    fn rectangle(&self) -> String {
        format!(
            "x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"4\"",
            px(self.left_px),
            px(self.top_px),
            px(self.width_px),
            px(self.height_px)
        )
    }

    /// Begins a group that is cut off at the panel's border.
    pub(super) fn open(&self, svg: &mut String, id: &str) {
        let rectangle = self.rectangle();
        svg.push_str(&format!(
            "<clipPath id=\"{id}\"><rect {rectangle}/></clipPath>\n<g clip-path=\"url(#{id})\">\n<rect {rectangle} fill=\"#fafbfc\"/>\n"
        ));
    }

    /// Ends the group.
    pub(super) fn close(&self, svg: &mut String) {
        svg.push_str("</g>\n");
    }

    /// Draws the closure between two nodes, and a vehicle at each.
    pub(super) fn draw_tie(&self, svg: &mut String, tied: Option<&[Pose2; 2]>) {
        let Some([old, new]) = tied else { return };
        let [from, to] = [old, new].map(|pose| self.at(&pose.translation()));
        let ([x1, y1], [x2, y2]) = ([from.0, from.1].map(px), [to.0, to.1].map(px));
        svg.push_str(&format!(
            "<line x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\" stroke=\"{REGION}\" stroke-width=\"1.5\" stroke-dasharray=\"5 4\"/>\n"
        ));
        self.draw_vehicle(svg, old, OLD);
        self.draw_vehicle(svg, new, NEW);
    }

    /// Draws the border.
    pub(super) fn frame(&self, svg: &mut String) {
        let rectangle = self.rectangle();
        svg.push_str(&format!(
            "<rect {rectangle} fill=\"none\" stroke=\"#d0d5dc\"/>\n"
        ));
    }

    pub(super) fn draw_region(&self, svg: &mut String, region: &[Vector2<f64>]) {
        if region.len() < 3 {
            return;
        }
        let corner = |point: &Vector2<f64>| {
            let (x, y) = self.at(point);
            format!("{},{}", px(x), px(y))
        };
        let corners: Vec<String> = region.iter().map(corner).collect();
        svg.push_str(&format!(
            "<polygon points=\"{}\" fill=\"{REGION}\" fill-opacity=\"0.12\" stroke=\"{REGION}\" stroke-width=\"1.5\" stroke-linejoin=\"round\"/>\n",
            corners.join(" ")
        ));
    }

    /// Draws a scan's points: the contradicted ones last, larger and darker.
    pub(super) fn draw_points(&self, svg: &mut String, scan: &EvidenceScan<'_>, colours: Colours) {
        // Points grow with the scale, so that they stay apart in the near panel.
        let near_px = (0.02 * self.px_per_m).clamp(2.6, 6.0);
        let size_px = colours.size * near_px;
        for (wanted, colour, size_px) in [
            (Class::Unjudged, colours.pale, size_px),
            (Class::Confirmed, colours.plain, size_px),
            (Class::Contradicted, colours.strong, 1.9 * near_px),
        ] {
            let ends = scan.beams.iter().filter(|beam| class(beam) == wanted);
            let ends = ends.filter_map(|beam| beam.end).map(|end| self.at(&end));
            dots(svg, ends.filter(|end| self.holds(*end)), colour, size_px);
        }
    }

    /// Draws a vehicle as an arrow.
    pub(super) fn draw_vehicle(&self, svg: &mut String, map_from_base: &Pose2, colours: Colours) {
        let tip = self.at(&map_from_base.translation());
        if self.holds(tip) {
            arrow(svg, tip, map_from_base.theta, colours.strong);
        }
    }

    /// Draws the location with its standard deviation.
    pub(super) fn draw_location(&self, svg: &mut String, location: &Vector2<f64>, sigma_m: f64) {
        let (x, y) = self.at(location);
        svg.push_str(&format!(
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" fill=\"none\" stroke=\"{REGION}\" stroke-width=\"1.2\" stroke-dasharray=\"4 3\"/>\n",
            px(x),
            px(y),
            px(sigma_m * self.px_per_m)
        ));
        cross(svg, (x, y));
    }
}

#[derive(PartialEq, Clone, Copy)]
enum Class {
    Unjudged,
    Confirmed,
    Contradicted,
}

fn class(beam: &JudgedBeam) -> Class {
    match beam.verdict {
        BeamVerdict::Agrees => Class::Confirmed,
        BeamVerdict::Contradicts => Class::Contradicted,
        BeamVerdict::Occluded | BeamVerdict::Unseen | BeamVerdict::NoReturn => Class::Unjudged,
    }
}

/// Draws round dots as one path: strokes without length that have round ends.
pub(super) fn dots(
    svg: &mut String,
    middles: impl IntoIterator<Item = (f64, f64)>,
    colour: &str,
    size_px: f64,
) {
    let dot = |(x, y)| format!("M{} {}h0", px(x), px(y));
    let path: String = middles.into_iter().map(dot).collect();
    if !path.is_empty() {
        svg.push_str(&format!(
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{}\" stroke-linecap=\"round\"/>\n",
            px(size_px)
        ));
    }
}

/// Draws a vehicle that heads along `heading_rad`, counter-clockwise from the picture's right.
pub(super) fn arrow(svg: &mut String, (x, y): (f64, f64), heading_rad: f64, colour: &str) {
    let (sin, cos) = heading_rad.sin_cos();
    let corners = [(11.0, 0.0), (-7.0, 6.5), (-3.5, 0.0), (-7.0, -6.5)].map(|(ahead, left)| {
        let (right, up) = (ahead * cos - left * sin, ahead * sin + left * cos);
        format!("{},{}", px(x + right), px(y - up))
    });
    svg.push_str(&format!(
        "<polygon points=\"{}\" fill=\"{colour}\" stroke=\"#ffffff\" stroke-width=\"1.2\" stroke-linejoin=\"round\"/>\n",
        corners.join(" ")
    ));
}

/// Draws the sign of a location.
pub(super) fn cross(svg: &mut String, (x, y): (f64, f64)) {
    svg.push_str(&format!(
        "<path d=\"M{} {}h12M{} {}v12\" stroke=\"{REGION}\" stroke-width=\"1.8\"/>\n",
        px(x - 6.0),
        px(y),
        px(x),
        px(y - 6.0)
    ));
}

/// Draws a bar of a round length in the panel's lower left corner.
pub(super) fn scale_bar(svg: &mut String, panel: &Panel) {
    const LENGTH_MAX_PX: f64 = 140.0;
    let most_m = LENGTH_MAX_PX / panel.px_per_m;
    let decade_m = 10f64.powi(most_m.log10().floor() as i32);
    let fits = [5.0, 2.0]
        .into_iter()
        .find(|steps| steps * decade_m <= most_m);
    let length_m = fits.unwrap_or(1.0) * decade_m;
    let words = match length_m {
        length_m if length_m >= 1.0 => format!("{length_m:.0} m"),
        length_m => format!("{:.0} cm", 100.0 * length_m),
    };
    let (x, y) = (panel.left_px + 14.0, panel.top_px + panel.height_px - 16.0);
    let length_px = length_m * panel.px_per_m;
    for (colour, width) in [("#ffffff", 5.0), ("#1c2430", 2.0)] {
        svg.push_str(&format!(
            "<path d=\"M{} {}v8M{} {}h{}M{} {}v8\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>\n",
            px(x),
            px(y - 4.0),
            px(x),
            px(y),
            px(length_px),
            px(x + length_px),
            px(y - 4.0),
        ));
    }
    label(svg, x + length_px + 8.0, y + 4.5, &words, Ink::ON_MAP);
}
