//! An alert's evidence as one picture: the two scans that disagree, and the residual of their
//! closure among those around it. A self-contained SVG without scripts, fonts or links.

mod curve;
mod picture;
mod place;

#[cfg(test)]
mod tests;

use super::svg_text as text;
use crate::change::BeamVerdict;

pub use picture::{Curve, EvidencePicture, EvidenceScan};
use picture::{HEIGHT_PX, MARGIN_PX, WIDTH_PX};
use place::{Panel, scale_bar};
use text::{Ink, label, px};

/// Draws the picture: 1080 × 850 pixels, light background, y upwards. The same evidence makes
/// the same bytes.
pub fn to_svg(picture: &EvidencePicture<'_>) -> String {
    let mut svg = String::with_capacity(64 << 10);
    svg.push_str(&format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0} {1}\" width=\"{0}\" height=\"{1}\" role=\"img\" font-family=\"system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif\">\n",
        WIDTH_PX, HEIGHT_PX
    ));
    let (title, subtitle) = headings(picture);
    svg.push_str(&format!("<title>{}</title>\n", text::escaped(&title)));
    svg.push_str(&format!(
        "<rect width=\"{WIDTH_PX}\" height=\"{HEIGHT_PX}\" fill=\"#ffffff\"/>\n"
    ));
    label(&mut svg, MARGIN_PX, 42.0, &title, Ink::TITLE);
    label(&mut svg, MARGIN_PX, 65.0, &subtitle, Ink::QUIET);
    draw_place(&mut svg, picture);
    draw_legend(&mut svg, picture);
    curve::draw(&mut svg, picture.curve.as_ref());
    svg.push_str("</svg>\n");
    svg
}

fn headings(picture: &EvidencePicture<'_>) -> (String, String) {
    let what = heading(picture.kind.name());
    let at = picture.location;
    let title = format!("{what} at x {:.2} m, y {:.2} m", at.x, at.y);
    let times = |count: usize, one: &str, many: &str| match count {
        1 => format!("1 {one}"),
        _ => format!("{count} {many}"),
    };
    let subtitle = format!(
        "Route {} · {} · {} · confidence {:.3} · {}",
        picture.route,
        times(picture.laps, "pass", "passes"),
        times(picture.views, "view", "views"),
        picture.confidence,
        picture.status,
    );
    (title, subtitle)
}

/// A text of the model as the beginning of a sentence: `map_mismatch` becomes "Map mismatch".
fn heading(text: &str) -> String {
    let words = text.replace('_', " ");
    let (first, rest) = words.split_at(words.len().min(1));
    format!("{}{rest}", first.to_uppercase())
}

fn draw_place(svg: &mut String, picture: &EvidencePicture<'_>) {
    let around = Panel::around(picture);
    let close = Panel::close_up(picture);
    for (panel, id, caption) in [
        (&around, "around", "Where it is"),
        (&close, "close", "Close up"),
    ] {
        panel.open(svg, id);
        panel.draw_region(svg, picture.region);
        match &picture.scans {
            None => panel.draw_tie(svg, picture.tied.as_ref()),
            Some([old, new]) => {
                panel.draw_points(svg, old, place::OLD);
                panel.draw_points(svg, new, place::NEW);
                panel.draw_vehicle(svg, &old.map_from_base, place::OLD);
                panel.draw_vehicle(svg, &new.map_from_base, place::NEW);
            }
        }
        panel.draw_location(svg, &picture.location, picture.sigma_m);
        panel.close(svg);
        panel.frame(svg);
        label(
            svg,
            panel.left_px + 12.0,
            panel.top_px + 22.0,
            caption,
            Ink::ON_MAP,
        );
        scale_bar(svg, panel);
    }
    if picture.scans.is_none() {
        let (x, y) = (around.left_px + 12.0, around.top_px + 42.0);
        label(svg, x, y, "There are no scans to compare.", Ink::ON_MAP);
    }
}

/// The legend under the panels.
fn draw_legend(svg: &mut String, picture: &EvidencePicture<'_>) {
    const OLD_PX: f64 = 567.0;
    const NEW_PX: f64 = 588.0;
    const SIGNS_PX: f64 = 611.0;
    if let Some([old, new]) = &picture.scans {
        for (scan, colours, when, y) in [
            (old, place::OLD, "Old", OLD_PX),
            (new, place::NEW, "New", NEW_PX),
        ] {
            place::dots(svg, [(MARGIN_PX + 6.0, y - 4.0)], colours.plain, 7.0);
            let contradicting = scan.beams.iter();
            let contradicting = contradicting.filter(|b| b.verdict == BeamVerdict::Contradicts);
            let caption = format!(
                "{when}: {}; {} of {} points contradicted",
                scan.caption,
                contradicting.count(),
                scan.beams.iter().filter(|b| b.end.is_some()).count(),
            );
            label(svg, MARGIN_PX + 20.0, y, &caption, Ink::PLAIN);
        }
        let y = SIGNS_PX - 4.0;
        let x = MARGIN_PX;
        place::dots(svg, [(x + 6.0, y)], place::NEW.strong, 9.0);
        place::dots(svg, [(x + 18.0, y)], place::OLD.strong, 9.0);
        let caption = "lies where the other scan saw through";
        label(svg, x + 30.0, SIGNS_PX, caption, Ink::PLAIN);
        place::dots(svg, [(x + 306.0, y)], place::NEW.pale, 5.0);
        place::dots(svg, [(x + 316.0, y)], place::OLD.pale, 5.0);
        let caption = "not seen by the other scan";
        label(svg, x + 328.0, SIGNS_PX, caption, Ink::PLAIN);
    }
    let (x, y) = (0.5 * WIDTH_PX + 28.0, SIGNS_PX);
    let (left, top, colour) = (px(x), px(y - 10.0), place::REGION);
    svg.push_str(&format!(
        "<rect x=\"{left}\" y=\"{top}\" width=\"14\" height=\"12\" fill=\"{colour}\" fill-opacity=\"0.12\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\n"
    ));
    label(svg, x + 20.0, y, "region", Ink::PLAIN);
    place::cross(svg, (x + 92.0, y - 4.0));
    let caption = format!("location, its σ of {:.2} m as a circle", picture.sigma_m);
    label(svg, x + 104.0, y, &caption, Ink::PLAIN);
    place::arrow(svg, (x + 354.0, y - 4.0), 0.0, place::OLD.strong);
    label(svg, x + 370.0, y, "vehicle", Ink::PLAIN);
}
