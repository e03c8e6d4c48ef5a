//! A study of worlds as text for people.

use super::correlation::Correlation;
use super::table::{Table, number};
use super::world_scoring::WorldScore;
use super::worlds::{NamedCorrelation, WorldsStudy};

/// The table of worlds, and that of correlations behind it.
pub fn worlds_text(study: &WorldsStudy) -> String {
    let head = [
        "world",
        "condition",
        "laps",
        "changes",
        "never within reach",
        "found (95 %)",
        "confirmed",
        "open alerts true (95 %)",
        "ended alerts true",
        "other kind",
        "mismatches",
        "batches not merged",
    ];
    let title = format!("Worlds, {} seeds from {}", study.seeds, study.first_seed);
    let mut table = Table::new(title, &head);
    for row in &study.rows {
        let names = [row.world.to_owned(), row.condition.to_owned()];
        table.row(names.into_iter().chain(cells(&row.score)));
    }
    table.remark(
        "Never within reach: fewer than four scans have three beams on the object, or would have \
         them where it is not; found: of the others. An alert on any change of the world of its \
         kind is true, however hidden the change is, and one near no change is false.",
    );
    let correlations = correlations_text(&study.correlations);
    format!("{}\n{correlations}", table.text())
}

/// The table of how far observations of one pass err together.
fn correlations_text(measured: &[NamedCorrelation]) -> String {
    let head = [
        "drives",
        "passes that contradict the majority (95 %)",
        "correlation within a pass",
    ];
    let mut table = Table::new("Unchanged free cells", &head);
    for NamedCorrelation { name, correlation } in measured {
        table.row([
            name.clone(),
            per_cent(correlation),
            number(correlation.within_pass()),
        ]);
    }
    table.remark(
        "Of passes with at least six observations of a cell that at least two observations \
         hit, where nothing stands by most of at least three passes. Cells near an alert are left out.",
    );
    table.text()
}

fn per_cent(correlation: &Correlation) -> String {
    let share = &correlation.contradicting;
    let Some(value) = share.value() else {
        return "–".to_owned();
    };
    let (low, high) = share.interval();
    let [value, low, high] = [value, low, high].map(|v| 100.0 * v);
    format!(
        "{value:.2} % ({low:.2}–{high:.2}) {}/{}",
        share.hits, share.of
    )
}

fn cells(score: &WorldScore) -> [String; 10] {
    let ended = &score.ended_true;
    [
        score.laps.to_string(),
        score.changes.to_string(),
        score.out_of_reach.to_string(),
        score.found.text(),
        score.confirmed.to_string(),
        score.open_true.text(),
        format!("{}/{}", ended.hits, ended.of),
        score.other_kind.to_string(),
        score.mismatches.to_string(),
        score.batches_not_merged.to_string(),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::wilson::Share;
    use super::super::worlds::WorldRow;
    use super::*;

    #[test]
    fn both_tables_are_printed() {
        let intel = NamedCorrelation {
            name: "intel".to_owned(),
            correlation: Correlation {
                contradicting: Share { hits: 28, of: 1000 },
                ..Correlation::default()
            },
        };
        let score = WorldScore {
            laps: 4,
            changes: 6,
            out_of_reach: 1,
            found: Share { hits: 4, of: 5 },
            ..WorldScore::default()
        };
        let study = WorldsStudy {
            first_seed: 7,
            seeds: 1,
            rows: vec![WorldRow {
                world: "hall",
                condition: "one vehicle",
                score,
            }],
            correlations: vec![intel],
        };
        let text = worlds_text(&study);
        assert!(text.contains("### Worlds, 1 seeds from 7\n"));
        assert!(text.contains("| hall  | one vehicle | 4    | 6       | 1"));
        assert!(text.contains("| 0.80 (0.38–0.96) 4/5 |"));
        assert!(text.contains("| intel  | 2.80 % (1.94–4.02) 28/1000"));
    }
}
