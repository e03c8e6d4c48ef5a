//! What is printed.

use crate::row::{Row, Verdict};

/// Lines that are printed of what does not hold …
const FAULTS_MAX: usize = 10;
/// … and of what a control found.
const CONTROL_MAX: usize = 1;

pub fn print_list(rows: &[&Row]) {
    for row in rows {
        println!("{:<16} {}", row.name, row.shows);
    }
}

/// A row's verdict, its figures, what does not hold, and what its control found.
pub fn print_verdict(row: &Row, verdict: &Verdict) {
    match verdict {
        Verdict::Run { finding, took } => {
            let word = if verdict.is_no_failure() {
                "holds"
            } else {
                "FAILS"
            };
            println!("{:<16} {word:<8} {:.1} s", row.name, took.as_secs_f64());
            print_lines("", &finding.figures, usize::MAX);
            print_lines("does not hold: ", &finding.faults, FAULTS_MAX);
            match finding.control.is_empty() {
                true => println!("    the control finds nothing, so that this row shows nothing"),
                false => print_lines("control finds: ", &finding.control, CONTROL_MAX),
            }
        }
        Verdict::Skipped(why) => println!("{:<16} SKIPPED  {why}", row.name),
        Verdict::Broken(why) => println!("{:<16} FAILS    broken off: {why}", row.name),
    }
}

fn print_lines(head: &str, lines: &[String], most: usize) {
    for line in lines.iter().take(most) {
        println!("    {head}{line}");
    }
    if lines.len() > most {
        println!("    {head}… and {} more", lines.len() - most);
    }
}
