//! Shares with the uncertainty of their counts.

use serde::Serialize;

/// Quantile of the normal distribution for 95 % on both sides.
const Z: f64 = 1.959_963_984_540_054;

/// A share as a count of a total.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(into = "ShareNumbers")]
pub struct Share {
    /// Hits.
    pub hits: usize,
    /// Trials.
    pub of: usize,
}

/// A share as it is written to files.
#[derive(Serialize)]
struct ShareNumbers {
    hits: usize,
    of: usize,
    value: Option<f64>,
    low: f64,
    high: f64,
}

impl From<Share> for ShareNumbers {
    fn from(share: Share) -> Self {
        let (low, high) = share.interval();
        Self {
            hits: share.hits,
            of: share.of,
            value: share.value(),
            low,
            high,
        }
    }
}

impl Share {
    /// The share; `None` of nothing.
    pub fn value(&self) -> Option<f64> {
        (self.of > 0).then(|| self.hits as f64 / self.of as f64)
    }

    /// Wilson's 95 % interval: also at 0 and 1 it says how little a few trials tell.
    pub fn interval(&self) -> (f64, f64) {
        let Some(share) = self.value() else {
            return (0.0, 1.0);
        };
        let n = self.of as f64;
        let squared = Z * Z / n;
        let middle = share + 0.5 * squared;
        let half = (squared * (share * (1.0 - share) + 0.25 * squared)).sqrt();
        let at = |v: f64| (v / (1.0 + squared)).clamp(0.0, 1.0);
        (at(middle - half), at(middle + half))
    }

    /// `0.83 (0.44–0.97) 5/6`, or a dash of nothing.
    pub fn text(&self) -> String {
        match self.value() {
            None => "–".to_owned(),
            Some(value) => {
                let (low, high) = self.interval();
                format!("{value:.2} ({low:.2}–{high:.2}) {}/{}", self.hits, self.of)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_agree_with_published_ones() {
        // Wilson's interval of 5 of 6, as the method's page has it, and of 0 of 10 (0 to 0.278).
        let (low, high) = Share { hits: 5, of: 6 }.interval();
        assert!((low - 0.4365).abs() < 1e-3 && (high - 0.9699).abs() < 1e-3);
        let (low, high) = Share { hits: 0, of: 10 }.interval();
        assert!(low == 0.0 && (high - 0.2775).abs() < 1e-3);
    }

    #[test]
    fn an_interval_holds_its_share_and_narrows() {
        for hits in 0..=40 {
            let few = Share { hits, of: 40 };
            let many = Share {
                hits: 100 * hits,
                of: 4_000,
            };
            let (a, b) = (few.interval(), many.interval());
            let value = few.value().unwrap();
            assert!(a.0 <= value + 1e-12 && value <= a.1 + 1e-12);
            assert!(b.1 - b.0 < a.1 - a.0);
        }
        assert_eq!(Share::default().text(), "–");
        assert_eq!(Share { hits: 5, of: 6 }.text(), "0.83 (0.44–0.97) 5/6");
    }
}
