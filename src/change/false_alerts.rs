//! The allowed rate of false alerts, and the support that it requires of a change.

/// The default rate of allowed false alerts per lap.
pub const FALSE_ALERTS_PER_LAP: f64 = 0.01;

/// How much more a change must be supported than at [`FALSE_ALERTS_PER_LAP`], in nats: a tenth of
/// the false alerts asks for ten times the odds.
pub fn support_for_rate(false_alerts_per_lap: f64) -> f64 {
    (FALSE_ALERTS_PER_LAP / false_alerts_per_lap).ln()
}
