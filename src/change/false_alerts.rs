//! How many false alerts are allowed, and what that asks of a change.

/// False alerts per lap that are allowed unless somebody says otherwise.
pub const FALSE_ALERTS_PER_LAP: f64 = 0.01;

/// How much more a change must be supported than at [`FALSE_ALERTS_PER_LAP`], in nats: a tenth of
/// the false alerts asks for ten times the odds.
pub fn support_for_rate(false_alerts_per_lap: f64) -> f64 {
    (FALSE_ALERTS_PER_LAP / false_alerts_per_lap).ln()
}
