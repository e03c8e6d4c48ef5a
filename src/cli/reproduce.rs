//! `mapshift reproduce`.

mod area;
mod baselines;
mod case;
mod counts;
mod fused_mode;
mod laps;
mod mapped;
mod method;
mod paper_mode;
mod protocol;
mod run_one;
mod score;
mod wilson;

use std::path::PathBuf;

use case::Seeds;

/// Arguments of `mapshift reproduce`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A few small cases only: shows that everything runs, says little.
    #[arg(long)]
    short: bool,
    /// Which seeds: numbers are chosen on the one set and reported on the other.
    #[arg(long, value_enum, default_value = "scoring")]
    seeds: Seeds,
    /// Where tables, figures and the numbers behind them are written.
    #[arg(long, value_name = "DIR", default_value = "reproduced")]
    output: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// If a case could not be run or the results could not be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let only: Vec<usize> = std::env::var("ONLY").unwrap_or_default().split(',').filter_map(|s| s.parse().ok()).collect();
    for (k, case) in protocol::cases(args.short, args.seeds).into_iter().enumerate() {
        if !only.is_empty() && !only.contains(&k) { continue; }
        let t = std::time::Instant::now();
        let laps = laps::Laps::drive(&case)?;
        let a = t.elapsed();
        let paper = mapped::Mapped::of(
            &laps,
            crate::mapping::Weighting::AllPointsIdentity,
            case.acceptance,
        )?;
        let b = t.elapsed();
        let outcome = run_one::run(&case)?;
        let c = t.elapsed();
        println!(
            "{} drive {a:?} paper {:?} all {:?}",
            case.name(),
            b - a,
            c - b
        );
        println!(
            "{:?} {:?} vis {}",
            outcome.maps, outcome.paper_columns, outcome.visible_changes
        );
        for (m, s) in &outcome.scores {
            println!(
                "  {:14} closures {:?} between {} auc {:?} laps {:?} later {:?} events {}/{} alerts {}+{}",
                m.name(),
                s.closures,
                s.closures_between,
                s.roc.as_ref().and_then(|r| counts::roc_area(&r.0, &r.1)),
                s.laps,
                s.laps_later,
                s.events.iter().filter(|e| e.found).count(),
                s.events.len(),
                s.true_alerts,
                s.false_alerts
            );
        }
        drop(paper);
    }
    Ok(())
}
