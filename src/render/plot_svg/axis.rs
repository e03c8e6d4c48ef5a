//! An axis of a chart.

/// About this many ticks.
const TICKS: f64 = 6.0;

/// The numbers that an axis shows, and where they are on the page.
pub(super) struct Axis {
    low: f64,
    high: f64,
    pub(super) page_low: f64,
    pub(super) page_high: f64,
}

impl Axis {
    pub(super) fn new(values: impl Iterator<Item = f64>, page_low: f64, page_high: f64) -> Self {
        let finite = values.filter(|v| v.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(v), b.max(v))
        });
        let (low, high) = match (low.is_finite(), high > low) {
            (false, _) => (0.0, 1.0),
            (true, false) => (low - 0.5, low + 0.5),
            (true, true) => (low, high),
        };
        Self {
            low,
            high,
            page_low,
            page_high,
        }
    }

    pub(super) fn place(&self, value: f64) -> f64 {
        let share = (value - self.low) / (self.high - self.low);
        self.page_low + share * (self.page_high - self.page_low)
    }

    /// Round numbers within the axis.
    pub(super) fn ticks(&self) -> Vec<f64> {
        let rough = (self.high - self.low) / TICKS;
        let magnitude = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * magnitude);
        let step = step.into_iter().find(|s| *s >= rough).unwrap_or(magnitude);
        let (first, last) = ((self.low / step).ceil(), (self.high / step).floor());
        let count = (last - first).max(0.0) as usize;
        (0..=count).map(|k| (first + k as f64) * step).collect()
    }
}

/// A short form of a number on an axis.
pub(super) fn number(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude < 1e-12 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&magnitude) {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        let text = format!("{value:.2e}");
        text.replace(".00e", "e").replace("0e", "e")
    }
}
