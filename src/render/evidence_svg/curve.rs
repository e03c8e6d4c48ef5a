//! The residuals around the alert's closure, against the paper's threshold.

use super::picture::{Curve, MARGIN_PX, WIDTH_PX};
use super::text::{Ink, label, power_of_ten, px, short};
use crate::change::series::SeriesEntry;

const HEADING_PX: f64 = 646.0;
const TOP_PX: f64 = 660.0;
const BOTTOM_PX: f64 = 812.0;
const LEFT_PX: f64 = 78.0;
const RIGHT_PX: f64 = WIDTH_PX - MARGIN_PX;

/// Values of ΔF that span more than this are drawn on a logarithmic axis.
const LINEAR_SPAN_MAX: f64 = 100.0;
/// Decades of a logarithmic axis at most: what is smaller lies on its foot.
const DECADES_MAX: i32 = 6;

const BAR: &str = "#8b97a6";
const MARKED: &str = "#b3261e";

/// Draws the chart, or says that there is nothing to draw.
pub(super) fn draw(svg: &mut String, curve: Option<&Curve<'_>>) {
    let heading = "Residual ΔF of the loop closures around it, in the order of insertion";
    label(svg, MARGIN_PX, HEADING_PX, heading, Ink::HEADING);
    match curve.filter(|curve| !curve.entries.is_empty()) {
        None => label(
            svg,
            MARGIN_PX,
            TOP_PX + 20.0,
            "No loop closure carries this alert.",
            Ink::QUIET,
        ),
        Some(curve) => draw_chart(svg, curve),
    }
}

fn draw_chart(svg: &mut String, curve: &Curve<'_>) {
    let axis = Axis::of(curve);
    axis.draw(svg);
    let count = curve.entries.len() as f64;
    let slot_px = (RIGHT_PX - LEFT_PX) / count;
    let bar_px = (0.7 * slot_px).clamp(1.0, 14.0);
    let middle = |k: usize| LEFT_PX + slot_px * (k as f64 + 0.5);
    let marked = curve
        .entries
        .iter()
        .position(|entry| entry.edge_id == curve.edge);
    for (k, entry) in curve.entries.iter().enumerate() {
        let colour = if Some(k) == marked { MARKED } else { BAR };
        // One pixel is left of the smallest: a closure without residual is a closure still.
        let top = axis.y(entry.delta_f).min(BOTTOM_PX - 1.0);
        svg.push_str(&format!(
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{colour}\"/>\n",
            px(middle(k) - 0.5 * bar_px),
            px(top),
            px(bar_px),
            px(BOTTOM_PX - top)
        ));
    }
    draw_threshold(svg, curve.threshold, &axis);
    if let Some((k, entry)) = marked.and_then(|k| Some((k, curve.entries.get(k)?))) {
        draw_mark(
            svg,
            middle(k),
            axis.y(entry.delta_f),
            entry,
            curve.threshold,
        );
    }
    let ends = curve.entries.first().zip(curve.entries.last());
    if let Some((first, last)) = ends {
        let y = BOTTOM_PX + 18.0;
        label(svg, LEFT_PX, y, &format!("closure {}", first.n), Ink::TICK);
        let ink = Ink::TICK.anchored("end");
        label(svg, RIGHT_PX, y, &format!("closure {}", last.n), ink);
    }
}

fn draw_threshold(svg: &mut String, threshold: Option<f64>, axis: &Axis) {
    let Some(threshold) = threshold else {
        let words = "No threshold yet: f(n) has not settled.";
        let ink = Ink::TICK.anchored("end");
        return label(svg, RIGHT_PX, HEADING_PX, words, ink);
    };
    let y = px(axis.y(threshold));
    svg.push_str(&format!(
        "<path d=\"M{LEFT_PX} {y}H{RIGHT_PX}\" stroke=\"{MARKED}\" stroke-width=\"1.2\" stroke-dasharray=\"6 4\"/>\n"
    ));
    let words = format!("dashed: the paper's threshold, {}", short(threshold));
    let ink = Ink::TICK.anchored("end");
    label(svg, RIGHT_PX, HEADING_PX, &words, ink);
}

/// Marks the alert's closure with a pointer and its numbers.
fn draw_mark(svg: &mut String, x: f64, top: f64, entry: &SeriesEntry, threshold: Option<f64>) {
    let tip = BOTTOM_PX + 4.0;
    svg.push_str(&format!(
        "<path d=\"M{} {}l6 9h-12z\" fill=\"{MARKED}\"/>\n",
        px(x),
        px(tip)
    ));
    let ratio = threshold
        .filter(|th| *th > 0.0)
        .map(|th| entry.delta_f / th);
    let ratio = ratio.map(|ratio| format!(", {} × threshold", short(ratio)));
    let words = format!(
        "edge {}: ΔF {}{}",
        entry.edge_id,
        short(entry.delta_f),
        ratio.unwrap_or_default()
    );
    let (x, anchor) = if x > 0.5 * (LEFT_PX + RIGHT_PX) {
        (x - 12.0, "end")
    } else {
        (x + 12.0, "start")
    };
    let y = (top + 12.0).min(BOTTOM_PX - 8.0);
    label(svg, x, y, &words, Ink::ALARM.anchored(anchor));
}

/// The axis of ΔF.
enum Axis {
    /// From 0 to the given value.
    Linear { most: f64 },
    /// From 10^low to 10^high.
    Logarithmic { low: i32, high: i32 },
}

impl Axis {
    fn of(curve: &Curve<'_>) -> Self {
        let values = curve.entries.iter().map(|entry| entry.delta_f);
        let values = values.chain(curve.threshold);
        let positive = values.filter(|value| value.is_finite() && *value > 0.0);
        let (least, most) = positive.fold((f64::INFINITY, 0.0_f64), |(least, most), value| {
            (least.min(value), most.max(value))
        });
        if most <= 0.0 {
            return Self::Linear { most: 1.0 };
        }
        if most / least <= LINEAR_SPAN_MAX {
            return Self::Linear { most: 1.08 * most };
        }
        let high = most.log10().ceil() as i32;
        let low = (least.log10().floor() as i32).max(high - DECADES_MAX);
        Self::Logarithmic { low, high }
    }

    fn y(&self, value: f64) -> f64 {
        let share = match *self {
            Self::Linear { most } => value / most,
            Self::Logarithmic { low, high } if value > 0.0 => {
                (value.log10() - f64::from(low)) / f64::from(high - low)
            }
            Self::Logarithmic { .. } => 0.0,
        };
        BOTTOM_PX - (BOTTOM_PX - TOP_PX) * share.clamp(0.0, 1.0)
    }

    fn ticks(&self) -> Vec<(f64, String)> {
        match *self {
            Self::Linear { most } => {
                let decade = 10f64.powi(most.log10().floor() as i32);
                let fine = [0.2, 0.5, 1.0, 2.0].map(|step| step * decade);
                let step = fine.into_iter().find(|step| most / step <= 5.0);
                let step = step.unwrap_or(decade);
                let count = (most / step).floor() as usize;
                let values = (0..=count).map(|k| k as f64 * step);
                values.map(|value| (value, short(value))).collect()
            }
            Self::Logarithmic { low, high } => (low..=high)
                .map(|exponent| (10f64.powi(exponent), power_of_ten(exponent)))
                .collect(),
        }
    }

    fn draw(&self, svg: &mut String) {
        for (value, words) in self.ticks() {
            let y = self.y(value);
            let line = px(y);
            svg.push_str(&format!(
                "<path d=\"M{LEFT_PX} {line}H{RIGHT_PX}\" stroke=\"#e6e9ed\"/>\n"
            ));
            let ink = Ink::TICK.anchored("end");
            label(svg, LEFT_PX - 8.0, y + 4.0, &words, ink);
        }
        svg.push_str(&format!(
            "<path d=\"M{LEFT_PX} {BOTTOM_PX}H{RIGHT_PX}\" stroke=\"#5a6472\"/>\n"
        ));
    }
}
