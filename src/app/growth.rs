//! How fast the database grows, measured since the start.

use std::collections::VecDeque;
use std::time::Duration;

/// Time between samples.
const APART: Duration = Duration::from_secs(60 * 60);
/// Samples kept: a week, so that nights and Sundays count.
const SAMPLES_MAX: usize = 7 * 24 + 1;
/// No growth is reported before this: a shift or a bulk upload is not representative of a day.
const WATCHED_MIN: Duration = Duration::from_secs(24 * 60 * 60);
const DAY_S: f64 = 24.0 * 60.0 * 60.0;

/// Bytes in use, hour by hour.
#[derive(Debug, Default)]
pub(super) struct Growth {
    /// The oldest first: time since the start, bytes.
    samples: VecDeque<(Duration, u64)>,
    newest: Option<(Duration, u64)>,
}

impl Growth {
    /// Notes how many bytes are in use; times do not decrease.
    pub(super) fn note(&mut self, at: Duration, bytes: u64) {
        self.newest = Some((at, bytes));
        let is_due = |&(last, _): &(Duration, u64)| at.saturating_sub(last) >= APART;
        if self.samples.back().is_none_or(is_due) {
            self.samples.push_back((at, bytes));
        }
        if self.samples.len() > SAMPLES_MAX {
            self.samples.pop_front();
        }
    }

    /// The growth over the last week, or since the start, bytes a day; `None` on the first day.
    pub(super) fn bytes_per_day(&self) -> Option<f64> {
        let (first_at, first) = self.samples.front().copied()?;
        let (at, bytes) = self.newest?;
        let watched = at.saturating_sub(first_at);
        let grown = bytes as f64 - first as f64;
        (watched >= WATCHED_MIN).then(|| grown / watched.as_secs_f64() * DAY_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hours(count: u64) -> Duration {
        Duration::from_secs(3600 * count)
    }

    #[test]
    fn no_growth_is_reported_before_a_day_has_passed() {
        let mut growth = Growth::default();
        assert_eq!(growth.bytes_per_day(), None);
        growth.note(Duration::ZERO, 1_000);
        growth.note(hours(24) - Duration::from_secs(1), 2_000);
        assert_eq!(growth.bytes_per_day(), None);
        growth.note(hours(24), 3_000);
        assert_eq!(growth.bytes_per_day(), Some(2_000.0));
    }

    #[test]
    fn only_the_last_week_counts() {
        let mut growth = Growth::default();
        // A fast first day, then 100 bytes an hour for ten days.
        for hour in 0..24 {
            growth.note(hours(hour), 1_000_000 * hour);
        }
        for hour in 24..=264 {
            growth.note(hours(hour), 23_000_000 + 100 * hour);
        }
        assert_eq!(growth.bytes_per_day(), Some(2_400.0));
        assert_eq!(growth.samples.len(), SAMPLES_MAX);
    }

    #[test]
    fn a_shrinking_database_has_negative_growth() {
        let mut growth = Growth::default();
        growth.note(Duration::ZERO, 5_000);
        growth.note(hours(48), 4_000);
        assert_eq!(growth.bytes_per_day(), Some(-500.0));
    }
}
