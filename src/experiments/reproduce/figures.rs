//! The paper's figures 1, 3, 4 and 5.

use super::case::{Case, Seeds};
use super::laps::Laps;
use super::mapped::{MadeClosure, Mapped};
use super::{paper_mode, protocol};
use crate::change::series::{ResidualSeries, SeriesEntry};
use crate::geometry::Pose2;
use crate::mapping::Weighting;
use crate::matching::{IcpParams, ReferenceCloud, align};
use crate::render::{Crossing, Curve, Guide, Plot, to_svg};
use crate::scan::surface_points;

const BLUE: &str = "#1f77b4";
const ORANGE: &str = "#ff7f0e";
const BLACK: &str = "#000000";
/// A motion this far off is wrong, metres …
const WRONG_M: f64 = 0.2;
/// … and one within this is right.
const RIGHT_M: f64 = 0.02;
/// A closure that shows the change in more of its beams than this is drawn as changed.
const CHANGED_SHARE: f64 = 0.03;

/// A figure of the paper.
#[derive(Debug, Clone)]
pub struct Figure {
    /// `figure-3.svg`.
    pub name: &'static str,
    /// The drawing.
    pub svg: String,
    /// What it shows, with the numbers read off it.
    pub caption: String,
}

/// A case driven and mapped as in the paper.
struct Run {
    laps: Laps,
    mapped: Mapped,
    series: ResidualSeries,
}

impl Run {
    fn of(case: &Case) -> anyhow::Result<Self> {
        let laps = Laps::drive(case)?;
        let mapped = Mapped::of(&laps, Weighting::AllPointsIdentity, case.acceptance)?;
        let series = paper_mode::series(&mapped, 1.0);
        Ok(Self {
            laps,
            mapped,
            series,
        })
    }

    /// The first closure of the changed world, counted from 1.
    fn change_at(&self) -> f64 {
        let before = |made: &&MadeClosure| made.place.lap < self.laps.before;
        1.0 + self.mapped.closures.iter().filter(before).count() as f64
    }

    fn curve(
        &self,
        label: &str,
        colour: &'static str,
        value: impl Fn(&SeriesEntry) -> f64,
    ) -> Curve {
        let entries = self.series.entries.iter();
        Curve {
            label: label.to_owned(),
            colour,
            joined: true,
            points: entries.map(|e| (e.n as f64, value(e))).collect(),
        }
    }

    fn guides(&self) -> Vec<Guide> {
        let mut guides = vec![Guide {
            label: "change".to_owned(),
            at: Crossing::X(self.change_at()),
        }];
        if let Some(n) = self.series.converged_at {
            guides.push(Guide {
                label: "n*".to_owned(),
                at: Crossing::X(n as f64),
            });
        }
        guides
    }

    fn threshold(&self) -> Option<Guide> {
        Some(Guide {
            label: "th".to_owned(),
            at: Crossing::Y(self.series.threshold?),
        })
    }
}

/// Draws all figures.
///
/// # Errors
/// If a case could not be driven or mapped.
pub(super) fn draw(short: bool, seeds: Seeds) -> anyhow::Result<Vec<Figure>> {
    let case = protocol::figure_3(short, seeds);
    let unchanged = Run::of(&Case {
        changes: 0,
        ..case.clone()
    })?;
    let changed = Run::of(&case)?;
    Ok(vec![
        figure_1(&changed),
        figure_3(&case, &unchanged, &changed),
        figure_4(&protocol::figure_4(short, seeds))?,
        figure_5(&protocol::figure_5(short, seeds))?,
    ])
}

/// A closure's all-points match: how far its motion is from the truth, metres, and which share
/// of the points it explains.
fn error_and_score(laps: &Laps, made: &MadeClosure) -> Option<(f64, f64)> {
    let (old, new) = (&laps.scans[made.old], &laps.scans[made.new]);
    let (old_points, new_points) = (
        surface_points(&old.scan.scan),
        surface_points(&new.scan.scan),
    );
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old_points.as_slice())])?;
    let sigma_m = new.scan.scan.lidar().range_sigma_m;
    let start = &made.closure.robust.pose;
    let params = &IcpParams::ALL_POINTS;
    let matched = align(&cloud, &new_points, start, sigma_m, None, params);
    let truth = old.truth.between(&new.truth);
    let error_m = truth.between(&matched.pose).translation().norm();
    Some((error_m, matched.explained_share()))
}

fn figure_1(run: &Run) -> Figure {
    let (mut unchanged, mut changed) = (Vec::new(), Vec::new());
    for made in &run.mapped.closures {
        let share = run.laps.changed_share(made.old, made.new);
        let side = match share {
            0.0 => &mut unchanged,
            share if share > CHANGED_SHARE => &mut changed,
            _ => continue,
        };
        side.extend(error_and_score(&run.laps, made));
    }
    let by_score = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
    let wrong = changed.iter().filter(|p| p.0 > WRONG_M).max_by(by_score);
    let right = unchanged.iter().filter(|p| p.0 < RIGHT_M).min_by(by_score);
    let pair: Vec<(f64, f64)> = wrong.into_iter().chain(right).copied().collect();
    let caption = match pair.as_slice() {
        [wrong, right] => format!(
            "Score against correctness. In the changed world a motion that is wrong by {:.2} m \
             explains {:.0} % of the points; in the unchanged world one that is right to {:.3} m \
             explains {:.0} %.",
            wrong.0,
            100.0 * wrong.1,
            right.0,
            100.0 * right.1
        ),
        _ => "Score against correctness; no motion is wrong here.".to_owned(),
    };
    let curve = |label: &str, colour, joined, points| Curve {
        label: label.to_owned(),
        colour,
        joined,
        points,
    };
    let plot = Plot {
        title: "1: score and error of all-points matches".to_owned(),
        x_label: "error of the motion, m".to_owned(),
        y_label: "share of points explained".to_owned(),
        curves: vec![
            curve("unchanged", BLUE, false, unchanged),
            curve("changed", ORANGE, false, changed),
            curve("", BLACK, true, pair),
        ],
        guides: Vec::new(),
    };
    Figure {
        name: "figure-1.svg",
        svg: to_svg(&[plot]),
        caption,
    }
}

fn figure_3(case: &Case, unchanged: &Run, changed: &Run) -> Figure {
    type Value = fn(&SeriesEntry) -> f64;
    let quantities: [(&str, Value); 4] = [
        ("F(n)", |e| e.total),
        ("f(n) = F(n)/n", |e| e.mean),
        ("d/dn [G∗F]", |e| e.smoothed),
        ("d/dn [G∗f]", |e| e.mean_change),
    ];
    let panel = |(name, value): &(&str, Value)| Plot {
        title: format!("3: {name}"),
        x_label: "loop closures n".to_owned(),
        y_label: (*name).to_owned(),
        curves: vec![
            unchanged.curve("unchanged", BLUE, value),
            changed.curve("changed", ORANGE, value),
        ],
        guides: changed.guides(),
    };
    let panels: Vec<Plot> = quantities.iter().map(panel).collect();
    let total = |run: &Run| run.series.entries.last().map_or(0.0, |e| e.total);
    Figure {
        name: "figure-3.svg",
        svg: to_svg(&panels),
        caption: format!(
            "{}: F ends at {:.4} without changes and at {:.4} with them.",
            case.name(),
            total(unchanged),
            total(changed)
        ),
    }
}

fn figure_4(case: &Case) -> anyhow::Result<Figure> {
    let run = Run::of(case)?;
    let ends = |n: usize| run.series.entries.get(n).map_or(0.0, |e| e.mean);
    let last = run.series.entries.len().saturating_sub(1);
    let plot = Plot {
        title: "4: f(n), nothing strays and nothing changes".to_owned(),
        x_label: "loop closures n".to_owned(),
        y_label: "f(n)".to_owned(),
        curves: vec![run.curve("", BLUE, |e| e.mean)],
        guides: Vec::new(),
    };
    Ok(Figure {
        name: "figure-4.svg",
        svg: to_svg(&[plot]),
        caption: format!(
            "{}: f is {:.2e} halfway and {:.2e} at the end.",
            case.name(),
            ends(last / 2),
            ends(last)
        ),
    })
}

fn figure_5(case: &Case) -> anyhow::Result<Figure> {
    let run = Run::of(case)?;
    let total = Plot {
        title: "5: F(n), laps over one path".to_owned(),
        x_label: "loop closures n".to_owned(),
        y_label: "F(n)".to_owned(),
        curves: vec![run.curve("", BLUE, |e| e.total)],
        guides: run.guides(),
    };
    let derivative = Plot {
        title: "5: dF/dn and d/dn [G∗F]".to_owned(),
        y_label: "dF/dn".to_owned(),
        curves: vec![
            run.curve("as it is", ORANGE, |e| e.delta_f),
            run.curve("smoothed", BLUE, |e| e.smoothed),
        ],
        guides: run.guides().into_iter().chain(run.threshold()).collect(),
        ..total.clone()
    };
    let judged = || run.series.entries.iter().filter(|e| e.ratio.is_some());
    let highest = judged().max_by(|a, b| a.delta_f.total_cmp(&b.delta_f));
    let caption = match highest {
        Some(entry) => format!(
            "{}: after n* the largest ΔF is {:.1} th, in lap {} (the change is between laps {} and \
             {}).",
            case.name(),
            entry.ratio.unwrap_or_default(),
            1 + run.mapped.closures[entry.n - 1].place.lap,
            run.laps.before,
            1 + run.laps.before,
        ),
        None => format!("{}: f does not settle.", case.name()),
    };
    Ok(Figure {
        name: "figure-5.svg",
        svg: to_svg(&[total, derivative]),
        caption,
    })
}
