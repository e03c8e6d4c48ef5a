//! The tables that are printed.

use std::collections::BTreeMap;

use super::mapped::Exclusion;
use super::method::{Method, PaperMap};
use super::summary::{Level, Row, SIZE_BOUNDS, Summary};
use crate::experiments::{Table, number};

/// A row of the paper's table 1.
struct PrintedRow {
    path_noise_m: f64,
    factor: f64,
    /// Precision, recall, F, F of "unchanged".
    rates: [f64; 4],
    /// ΔF at changes and the largest without, in units of the row's threshold.
    columns: [f64; 2],
}

/// Table 1. The second row's columns are misprinted: 8.86 and 0.23 follow from the first.
const PRINTED: [PrintedRow; 4] = [
    PrintedRow {
        path_noise_m: 0.0,
        factor: 1.0,
        rates: [1.0, 0.83, 0.91, 0.99],
        columns: [22.14, 0.57],
    },
    PrintedRow {
        path_noise_m: 0.0,
        factor: 2.5,
        rates: [1.0, 0.5, 0.66, 0.99],
        columns: [0.23, 0.3325],
    },
    PrintedRow {
        path_noise_m: 0.5,
        factor: 1.0,
        rates: [0.46, 1.0, 0.63, 0.96],
        columns: [14.29, 2.22],
    },
    PrintedRow {
        path_noise_m: 0.5,
        factor: 2.5,
        rates: [1.0, 0.83, 0.91, 0.99],
        columns: [5.71, 0.88],
    },
];

/// What distinguishes the two forms of the paper's map.
const FORMS: &str = "Both maps optimise all-points estimates with Ω = I. As the service's `seed`: \
                     a robust match and a comparison with free space accept a closure first, and \
                     odometry edges are robust matches with a local map. Faithful: the score of \
                     the all-points match alone accepts a closure, and odometry edges are \
                     all-points matches of one scan with the next.";

/// All tables, in the order in which they are printed.
pub(super) fn tables(summary: &Summary) -> Vec<Table> {
    vec![
        table_1(summary),
        event_table(summary),
        size_table(summary),
        lap_table(summary),
        closure_table(summary),
        acceptance_table(summary),
        excluded_table(summary),
    ]
}

fn noise(level: &Level) -> String {
    format!("{} m", level.path_noise_m)
}

fn table_1(summary: &Summary) -> Table {
    let head = [
        "ρ, threshold",
        "map",
        "paper: P, R, F, F unchanged",
        "paper: ΔF/th changed, unchanged",
        "precision",
        "recall",
        "F",
        "F unchanged",
        "ΔF/th changed, unchanged",
    ];
    let mut table = Table::new(
        "Table 1: laps, the paper's rule, as printed and here",
        &head,
    );
    for level in &summary.levels {
        type OfMap = fn(PaperMap) -> Method;
        let methods: [(OfMap, f64); 2] = [(Method::Paper, 1.0), (Method::PaperRaised, 2.5)];
        let rows = methods
            .into_iter()
            .flat_map(|(of, factor)| PaperMap::ALL.map(|map| (of(map), map, factor)));
        for (method, map, factor) in rows {
            let printed = PRINTED
                .iter()
                .find(|p| p.path_noise_m == level.path_noise_m && p.factor == factor);
            let (rates, columns) = printed.map_or(("–".to_owned(), "–".to_owned()), |printed| {
                let [precision, recall, f, unchanged] = printed.rates;
                let [at_change, without] = printed.columns;
                (
                    format!("{precision:.2}, {recall:.2}, {f:.2}, {unchanged:.2}"),
                    format!("{at_change:.2}, {without:.2}"),
                )
            });
            let laps = &level.rows[&method].score.laps;
            let in_thresholds = |value: Option<f64>| number(value.map(|v| v / factor));
            let ours = &level.paper_columns[&map];
            table.row([
                format!("{}, {factor} th", noise(level)),
                map.name().to_owned(),
                rates,
                columns,
                laps.precision().text(),
                laps.recall().text(),
                number(laps.f_score()),
                number(laps.f_score_unchanged()),
                format!(
                    "{}, {}",
                    in_thresholds(ours.changed),
                    in_thresholds(ours.unchanged)
                ),
            ]);
        }
    }
    table.remark(
        "A lap is changed if it is the first after the change, and unchanged before it. ΔF/th: \
         the median over cases of the largest at the change (the paper has the mean), and the \
         largest of all without one. The \
         paper has no row for ρ = 1 m; its row 0 m, 2.5 th has misprinted columns.",
    );
    table.remark(FORMS);
    table
}

fn event_table(summary: &Summary) -> Table {
    let head = [
        "ρ",
        "method",
        "changes found",
        "alerts true",
        "F",
        "location error: median, 90 %, m",
        "raised in lap 1 / 2 / later",
    ];
    let mut table = Table::new("Changes found", &head);
    for level in &summary.levels {
        let named = level.rows.iter().map(|(method, row)| (method.name(), row));
        let everywhere = ("fused, no case left out", &level.fused_everywhere);
        for (name, row) in named.chain([everywhere]) {
            let [first, second, later] = row.laps_until_raised;
            table.row([
                noise(level),
                name.to_owned(),
                row.events_found.text(),
                row.alerts_true.text(),
                number(row.event_f_score),
                row.location_error_m.map(number).join(", "),
                format!("{first} / {second} / {later}"),
            ]);
        }
    }
    table.remark(
        "A change counts if at least 3 beams of at least 4 scans meet the object before it goes or \
         after it comes. A closure reports every change that one of its two scans observes with 3 \
         beams; a region reports the changes of its kind within 0.35 m. The location error is the \
         distance to the object's middle. The paper's rule and the fused one raise a change \
         once; the others keep no memory and alert anew in each lap.",
    );
    table
}

fn size_table(summary: &Summary) -> Table {
    let [a, b, c] = SIZE_BOUNDS.map(|bound| format!("{:.1} %", 100.0 * bound));
    let heads = [
        "method".to_owned(),
        format!("below {a}"),
        format!("{a} to {b}"),
        format!("{b} to {c}"),
        format!("{c} and more"),
    ];
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let title = "Changes found, by the object's share of the original objects' area";
    let mut table = Table::new(title, &heads);
    for method in Method::ALL {
        let row = summary.everywhere(method);
        let classes = row.by_size.iter().map(|share| share.text());
        table.row([method.name().to_owned()].into_iter().chain(classes));
    }
    table
}

fn lap_table(summary: &Summary) -> Table {
    let head = [
        "ρ",
        "method",
        "precision",
        "recall",
        "F",
        "F unchanged",
        "false alarms in unchanged laps",
        "reported again later",
        "not judged, not visible",
    ];
    let mut table = Table::new("Laps", &head);
    each_row(summary, |level, method, row| {
        let (score, laps) = (&row.score, &row.score.laps);
        table.row([
            noise(level),
            method.name().to_owned(),
            laps.precision().text(),
            laps.recall().text(),
            number(laps.f_score()),
            number(laps.f_score_unchanged()),
            laps.false_alarm_rate().text(),
            score.laps_later.text(),
            format!("{}, {}", score.laps_not_judged, score.laps_unseen),
        ]);
    });
    table
}

fn closure_table(summary: &Summary) -> Table {
    let head = [
        "ρ",
        "method",
        "precision",
        "recall",
        "F",
        "false alarms",
        "ROC area",
        "between, not judged",
    ];
    let mut table = Table::new("Closures", &head);
    each_row(summary, |level, method, row| {
        let (score, closures) = (&row.score, &row.score.closures);
        table.row([
            noise(level),
            method.name().to_owned(),
            closures.precision().text(),
            closures.recall().text(),
            number(closures.f_score()),
            closures.false_alarm_rate().text(),
            number(row.roc_area),
            format!("{}, {}", score.closures_between, score.closures_not_judged),
        ]);
    });
    table.remark(
        "A closure is changed if the change shows in more than 3 % of the beams of one of its scans, \
         unchanged if in none; those between are not scored.",
    );
    table
}

fn each_row(summary: &Summary, mut write: impl FnMut(&Level, Method, &Row)) {
    for level in &summary.levels {
        for (method, row) in &level.rows {
            write(level, *method, row);
        }
    }
}

fn acceptance_table(summary: &Summary) -> Table {
    let head = [
        "closure rule",
        "map",
        "ρ",
        "closures a lap",
        "cases left out",
        "laps: precision",
        "laps: recall",
        "closures: recall",
        "closures: false alarms",
    ];
    let mut table = Table::new("The closure threshold, the paper's rule at th", &head);
    for row in &summary.acceptances {
        table.row([
            row.acceptance.name().to_owned(),
            row.map.name().to_owned(),
            format!("{} m", row.path_noise_m),
            format!("{:.1}", row.closures_per_lap),
            excluded(&row.excluded, row.cases),
            row.laps.precision().text(),
            row.laps.recall().text(),
            row.closures.recall().text(),
            row.closures.false_alarm_rate().text(),
        ]);
    }
    table.remark(
        "The faithful map has one number: the all-points match must explain as large a share of the \
         new scan's points as the product of the rule's two.",
    );
    table
}

fn excluded(reasons: &BTreeMap<Exclusion, usize>, of: usize) -> String {
    let all: usize = reasons.values().sum();
    let named: Vec<String> = reasons
        .iter()
        .map(|(reason, count)| format!("{} {count}", reason.name()))
        .collect();
    if named.is_empty() {
        return format!("0 of {of}");
    }
    format!("{all} of {of}: {}", named.join(", "))
}

fn excluded_table(summary: &Summary) -> Table {
    let head = ["case", "map as `seed`", "faithful map", "robust map"];
    let mut table = Table::new("Cases left out", &head);
    for outcome in &summary.outcomes {
        let reasons = outcome.maps.each(|map| map.exclusion);
        let reasons = [reasons.seed, reasons.faithful, reasons.robust];
        if reasons.iter().any(Option::is_some) {
            let names = reasons.map(|r| r.map_or("–", Exclusion::name).to_owned());
            let case = &outcome.case;
            let case = format!("{}, {:?} rule", case.name(), case.acceptance);
            table.row([case].into_iter().chain(names));
        }
    }
    table.remark(format!(
        "Of {} cases. Incorrect map: a node more than 1 m or 0.1 rad from the truth. Dropped \
         closures: fewer than half as many a lap after the change as before. Too much change: more \
         area appeared than all original objects have.",
        summary.cases
    ));
    table
}
