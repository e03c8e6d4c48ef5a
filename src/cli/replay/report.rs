//! The report of a replay: for programs, and in a few lines for people.

use std::io::{self, Write};

use serde::Serialize;

use crate::ids::RouteId;
use crate::pipeline::Replayed;
use crate::render::DifferingCells;
use crate::store::{Comparison, There};

/// The replay of one route.
#[derive(Serialize)]
pub(super) struct Report {
    pub(super) route: RouteId,
    #[serde(flatten)]
    pub(super) replayed: Option<Replayed>,
    /// Why it could not be rebuilt.
    pub(super) error: Option<&'static str>,
    pub(super) comparison: Option<Comparison>,
    /// Cells of the map's picture that differ; null where they are not compared, or there is no map.
    pub(super) cells: Option<DifferingCells>,
}

impl Report {
    /// Whether it was rebuilt and, if compared, equals the stored one.
    pub(super) fn is_good(&self) -> bool {
        let is_same = self.comparison.as_ref().is_none_or(|found| found.same);
        self.error.is_none() && is_same
    }

    /// Writes it for people.
    pub(super) fn write_summary(&self, out: &mut impl Write) -> io::Result<()> {
        let route = &self.route;
        let Some(replayed) = &self.replayed else {
            return writeln!(out, "route {route}: {}", self.error.unwrap_or_default());
        };
        let (inputs, batches) = (replayed.inputs, replayed.batches);
        writeln!(out, "route {route}: {inputs} inputs, {batches} batches")?;
        for (count, what) in [
            (
                replayed.without_body,
                "batches left out: their bodies are not kept any more",
            ),
            (
                replayed.decisions_left_out.len() as u64,
                "decisions left out",
            ),
            (replayed.versions_left_out.len() as u64, "releases left out"),
        ] {
            if count > 0 {
                writeln!(out, "  {count} {what}")?;
            }
        }
        match &self.comparison {
            None => Ok(()),
            Some(comparison) if comparison.same => writeln!(out, "  the same to the bit"),
            Some(comparison) => write_differences(self, comparison, out),
        }
    }
}

fn write_differences(
    report: &Report,
    comparison: &Comparison,
    out: &mut impl Write,
) -> io::Result<()> {
    let poses = comparison.poses;
    writeln!(
        out,
        "  poses: {} of {} nodes moved, by {:.3} m and {:.4} rad at most",
        poses.moved, poses.nodes, poses.max_m, poses.max_rad
    )?;
    if let Some(cells) = report.cells {
        writeln!(
            out,
            "  map cells: {} become occupied, {} free, {} unknown, {} newly observed",
            cells.to_occupied, cells.to_free, cells.to_unknown, cells.from_unknown
        )?;
    }
    let counts = comparison.alert_counts;
    writeln!(
        out,
        "  alerts: {} disappear, {} appear, {} change",
        counts.only_before, counts.only_now, counts.changed
    )?;
    for alert in &comparison.alerts {
        let there = match alert.there {
            There::OnlyBefore => "disappears",
            There::OnlyNow => "appears",
            There::Changed => "changes",
        };
        writeln!(
            out,
            "    {there}: {} at ({:.2}, {:.2}), {}, {}",
            alert.kind, alert.x, alert.y, alert.status, alert.id
        )?;
    }
    for (table, apart) in &comparison.tables {
        let (before, now) = (apart.only_before, apart.only_now);
        writeln!(
            out,
            "  rows of {table}: {before} only before, {now} only now"
        )?;
    }
    Ok(())
}
