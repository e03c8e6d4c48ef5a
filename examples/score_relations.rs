//! Scores a trajectory against relations that a human confirmed (Kümmerle et al. 2009).
//!
//! `cargo run --release --example score_relations -- TRAJECTORY.tum FILE.relations LOG` takes the
//! relations whose two times both lie within 0.1 s of a scan of the CARMEN log, and prints the
//! mean, median and largest error of the estimated relative pose. Poses between two entries of
//! the trajectory are interpolated.

use std::io::Write;
use std::path::Path;

use anyhow::Context;
use mapshift::geometry::Pose2;
use mapshift::ingest::CarmenLog;

const SCAN_DISTANCE_MAX_S: f64 = 0.1;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [trajectory, relations, log] = arguments.as_slice() else {
        anyhow::bail!("usage: score_relations TRAJECTORY.tum FILE.relations LOG");
    };
    let trajectory = read_numbers(trajectory)?;
    let poses: Vec<(f64, Pose2)> = trajectory
        .iter()
        .filter(|line| line.len() == 8)
        .map(|n| (n[0], Pose2::new(n[1], n[2], 2.0 * n[6].atan2(n[7]))))
        .collect();
    let scan_times = scan_times(Path::new(log))?;
    let near_scan = |t: f64| {
        let next = scan_times.partition_point(|&s| s < t);
        let around = scan_times[next.saturating_sub(1)..].iter().take(2);
        around
            .into_iter()
            .any(|s| (s - t).abs() <= SCAN_DISTANCE_MAX_S)
    };
    let (mut shifts_m, mut turns_deg, mut outside) = (Vec::new(), Vec::new(), 0);
    for n in read_numbers(relations)?
        .iter()
        .filter(|line| line.len() == 8)
    {
        if !(near_scan(n[0]) && near_scan(n[1])) {
            continue;
        }
        let (Some(from), Some(to)) = (interpolate(&poses, n[0]), interpolate(&poses, n[1])) else {
            outside += 1;
            continue;
        };
        let truth = Pose2::new(n[2], n[3], n[7]);
        let error = truth.between(&from.between(&to));
        shifts_m.push(error.translation().norm());
        turns_deg.push(error.theta.abs().to_degrees());
    }
    let mut console = std::io::stdout();
    writeln!(
        console,
        "relations: {} scored, {outside} outside the trajectory",
        shifts_m.len()
    )?;
    for (name, errors) in [
        ("translation, m", &mut shifts_m),
        ("rotation, °", &mut turns_deg),
    ] {
        errors.sort_by(f64::total_cmp);
        let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let quantile = |q: f64| errors.get((q * errors.len() as f64) as usize).copied();
        let median = quantile(0.5).unwrap_or(f64::NAN);
        let ninety = quantile(0.9).unwrap_or(f64::NAN);
        let worst = errors.last().copied().unwrap_or(f64::NAN);
        writeln!(
            console,
            "{name}: mean {mean:.4}, median {median:.4}, 90 % {ninety:.4}, largest {worst:.4}"
        )?;
    }
    Ok(())
}

fn read_numbers(path: &str) -> anyhow::Result<Vec<Vec<f64>>> {
    let text = std::fs::read_to_string(path).with_context(|| path.to_owned())?;
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            Ok(line
                .split_whitespace()
                .map(str::parse)
                .collect::<Result<_, _>>()?)
        })
        .collect()
}

fn scan_times(path: &Path) -> anyhow::Result<Vec<f64>> {
    let file = std::fs::File::open(path).with_context(|| path.display().to_string())?;
    let reader: Box<dyn std::io::Read> = if path.extension().is_some_and(|e| e == "gz") {
        Box::new(flate2::read::GzDecoder::new(file))
    } else {
        Box::new(file)
    };
    let log = CarmenLog::read(std::io::BufReader::new(reader))?;
    Ok(log.scans.iter().map(|scan| scan.stamp.seconds()).collect())
}

fn interpolate(poses: &[(f64, Pose2)], t: f64) -> Option<Pose2> {
    let next = poses.partition_point(|(s, _)| *s < t);
    let (t1, after) = poses.get(next)?;
    if next == 0 {
        return (t1 - t <= SCAN_DISTANCE_MAX_S).then_some(*after);
    }
    let (t0, before) = poses[next - 1];
    let share = (t - t0) / (t1 - t0);
    let step = before.between(after).log() * share;
    Some(before.compose(&Pose2::exp(&step)))
}
