//! A study as text for people.

use std::fmt::Write;

use super::study::{Place, Row, Study};
use super::table::{Table, number};

/// The table, then what was missed and what was false.
pub fn text_of(study: &Study) -> String {
    let head = [
        "detector",
        "seeds",
        "found (95 %)",
        "precision (95 %)",
        "F",
        "false",
        "other kind",
        "location error, m",
        "confirmed / tentative",
        "passes until raised",
        "not merged",
        "scans",
        "CPU ms/scan",
        "untouched",
        "labelled",
    ];
    let mut table = Table::new(study.recordings.join(", "), &head);
    for row in &study.rows {
        table.row(cells(row));
    }
    table.remark(
        "Location error and passes are medians; CPU time is that of map and alerts (of map updating: \
         alerts alone). The paper's rule runs on a map of its own and says neither what changed nor \
         where: its alert counts within 1 m of any object, beyond the 1 m about its closure's nodes.",
    );
    let mut text = table.text();
    for row in &study.rows {
        let name = row.detector.name();
        list(&mut text, &format!("{name}: missed"), &row.missed);
        list(
            &mut text,
            &format!("{name}: false alerts"),
            &row.false_alerts,
        );
        let other = format!("{name}: alerts near an object, not of its kind");
        list(&mut text, &other, &row.other_kind_alerts);
        let untouched = format!("{name}: alerts of the untouched recordings");
        list(&mut text, &untouched, &row.untouched);
        list(
            &mut text,
            &format!("{name}: labels not raised"),
            &row.labels_missed,
        );
    }
    text
}

fn cells(row: &Row) -> [String; 15] {
    let score = &row.score;
    let passes = score.passes_when_raised.iter().map(|passes| *passes as f64);
    let labelled = row
        .labelled
        .map(|share| format!("{}/{}", share.hits, share.of));
    let states_tiers = score.confirmed + score.tentative > 0;
    let tiers = states_tiers.then(|| format!("{} / {}", score.confirmed, score.tentative));
    let dash = || "–".to_owned();
    [
        row.detector.name().to_owned(),
        score.seeds.to_string(),
        score.found.text(),
        score.precision().text(),
        number(score.f_score()),
        score.false_alerts.to_string(),
        score.other_kind_alerts.to_string(),
        number(median(score.location_errors_m.clone())),
        tiers.unwrap_or_else(dash),
        median(passes.collect()).map_or_else(dash, |passes| passes.to_string()),
        format!("{}/{}", score.batches_not_merged, score.batches),
        score.scans.to_string(),
        format!("{:.2}", score.cpu_ms_per_scan()),
        row.untouched.len().to_string(),
        labelled.unwrap_or_else(dash),
    ]
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn list(text: &mut String, title: &str, places: &[Place]) {
    if places.is_empty() {
        return;
    }
    let _ = writeln!(text, "\n{title}:");
    for place in places {
        let Place { x, y, note, .. } = place;
        let seed = place.seed.map(|seed| format!("seed {seed}, "));
        let (seed, kind) = (seed.unwrap_or_default(), place.kind.name());
        let line = format!("- {seed}{kind} at ({x:.2}, {y:.2}): {note}");
        let _ = writeln!(text, "{}", line.trim_end_matches(": "));
    }
}
