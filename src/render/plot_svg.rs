//! Line charts and scatter plots as SVG.

mod axis;

use std::fmt::Write;

use axis::{Axis, number};

const WIDTH: f64 = 760.0;
const PANEL_HEIGHT: f64 = 250.0;
const MARGIN_LEFT: f64 = 78.0;
const MARGIN_RIGHT: f64 = 18.0;
const MARGIN_TOP: f64 = 34.0;
const MARGIN_BOTTOM: f64 = 48.0;
const GREY: &str = "#777777";

/// One chart: axes, curves, and lines across it.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Above the chart.
    pub title: String,
    /// What is counted along x, with its unit.
    pub x_label: String,
    /// What is counted along y, with its unit.
    pub y_label: String,
    /// What is drawn, the first at the bottom.
    pub curves: Vec<Curve>,
    /// Dashed lines across the chart.
    pub guides: Vec<Guide>,
}

/// Points of one colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// In the legend; empty for none.
    pub label: String,
    /// As CSS has it.
    pub colour: &'static str,
    /// Joined by a line, or drawn as dots.
    pub joined: bool,
    /// x and y; those that are not numbers are left out.
    pub points: Vec<(f64, f64)>,
}

/// A dashed line across a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Guide {
    /// Beside the line.
    pub label: String,
    /// Where it crosses an axis.
    pub at: Crossing,
}

/// Where a guide crosses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Crossing {
    /// Upright, at this x.
    X(f64),
    /// Level, at this y.
    Y(f64),
}

/// Draws charts one below the other. Equal charts give equal text.
pub fn to_svg(plots: &[Plot]) -> String {
    let height = PANEL_HEIGHT * plots.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (k, plot) in plots.iter().enumerate() {
        Panel::new(plot, k as f64 * PANEL_HEIGHT).draw(plot, &mut svg);
    }
    svg.push_str("</svg>\n");
    svg
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;");
    text.replace('<', "&lt;").replace('>', "&gt;")
}

struct Panel {
    x: Axis,
    y: Axis,
}

impl Panel {
    fn new(plot: &Plot, top: f64) -> Self {
        let points = || plot.curves.iter().flat_map(|curve| &curve.points);
        let level = plot.guides.iter().filter_map(|guide| match guide.at {
            Crossing::Y(y) => Some(y),
            Crossing::X(_) => None,
        });
        let upright = plot.guides.iter().filter_map(|guide| match guide.at {
            Crossing::X(x) => Some(x),
            Crossing::Y(_) => None,
        });
        let (bottom, right) = (top + PANEL_HEIGHT - MARGIN_BOTTOM, WIDTH - MARGIN_RIGHT);
        Self {
            x: Axis::new(points().map(|p| p.0).chain(upright), MARGIN_LEFT, right),
            y: Axis::new(points().map(|p| p.1).chain(level), bottom, top + MARGIN_TOP),
        }
    }

    fn draw(&self, plot: &Plot, svg: &mut String) {
        self.frame(plot, svg);
        for guide in &plot.guides {
            self.guide(guide, svg);
        }
        for curve in &plot.curves {
            self.curve(curve, svg);
        }
        self.legend(plot, svg);
    }

    fn frame(&self, plot: &Plot, svg: &mut String) {
        let (left, right) = (self.x.page_low, self.x.page_high);
        let (bottom, top) = (self.y.page_low, self.y.page_high);
        for tick in self.x.ticks() {
            let (x, text) = (self.x.place(tick), number(tick));
            line(svg, (x, bottom), (x, bottom + 4.0), GREY, "");
            write_text(svg, (x, bottom + 17.0), "middle", &text);
        }
        for tick in self.y.ticks() {
            let (y, text) = (self.y.place(tick), number(tick));
            line(svg, (left, y), (right, y), "#e6e6e6", "");
            write_text(svg, (left - 6.0, y + 4.0), "end", &text);
        }
        line(svg, (left, bottom), (right, bottom), GREY, "");
        line(svg, (left, bottom), (left, top), GREY, "");
        write_text(svg, (left, top - 14.0), "start", &plot.title);
        let middle = 0.5 * (left + right);
        write_text(svg, (middle, bottom + 36.0), "middle", &plot.x_label);
        let (x, y) = (16.0, 0.5 * (bottom + top));
        let label = escaped(&plot.y_label);
        let _ = writeln!(
            svg,
            "<text transform=\"translate({x:.1} {y:.1}) rotate(-90)\" \
             text-anchor=\"middle\">{label}</text>"
        );
    }

    fn guide(&self, guide: &Guide, svg: &mut String) {
        let (left, right) = (self.x.page_low, self.x.page_high);
        let (bottom, top) = (self.y.page_low, self.y.page_high);
        match guide.at {
            Crossing::X(x) => {
                let x = self.x.place(x);
                line(
                    svg,
                    (x, bottom),
                    (x, top),
                    GREY,
                    " stroke-dasharray=\"5 4\"",
                );
                write_text(svg, (x + 4.0, top + 10.0), "start", &guide.label);
            }
            Crossing::Y(y) => {
                let y = self.y.place(y);
                line(
                    svg,
                    (left, y),
                    (right, y),
                    GREY,
                    " stroke-dasharray=\"5 4\"",
                );
                write_text(svg, (left + 4.0, y - 4.0), "start", &guide.label);
            }
        }
    }

    fn curve(&self, curve: &Curve, svg: &mut String) {
        let finite = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let placed = curve.points.iter().filter(finite);
        let placed = placed.map(|p| (self.x.place(p.0), self.y.place(p.1)));
        let colour = curve.colour;
        if curve.joined {
            let points: Vec<_> = placed.map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
            let points = points.join(" ");
            let _ = writeln!(
                svg,
                "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\" \
                 points=\"{points}\"/>"
            );
            return;
        }
        for (x, y) in placed {
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2\" fill=\"{colour}\" \
                 fill-opacity=\"0.7\"/>"
            );
        }
    }

    /// Beside the title, from the right.
    fn legend(&self, plot: &Plot, svg: &mut String) {
        let y = self.y.page_high - 18.0;
        let mut x = self.x.page_high;
        for curve in plot.curves.iter().rev().filter(|c| !c.label.is_empty()) {
            write_text(svg, (x, y + 4.0), "end", &curve.label);
            x -= 7.0 * curve.label.chars().count() as f64 + 8.0;
            let _ = writeln!(
                svg,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"12\" height=\"4\" fill=\"{}\"/>",
                x - 12.0,
                y - 2.0,
                curve.colour
            );
            x -= 26.0;
        }
    }
}

fn line(svg: &mut String, from: (f64, f64), to: (f64, f64), colour: &str, more: &str) {
    let ((x1, y1), (x2, y2)) = (from, to);
    let _ = writeln!(
        svg,
        "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" \
         stroke=\"{colour}\"{more}/>"
    );
}

fn write_text(svg: &mut String, (x, y): (f64, f64), anchor: &str, text: &str) {
    let text = escaped(text);
    let _ = writeln!(
        svg,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>"
    );
}

#[cfg(test)]
mod tests;
