//! `mapshift export`.

mod alert_table;
mod map_server;

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use jiff::Timestamp;

use super::key_arg::KeyArg;
use super::progress::{Progress, say};
use crate::client::{AlertDetail, Gateway, NodeReport, ScanReport};
use crate::geometry::Vector2;
use crate::ids::RouteId;
use crate::ingest::{ExportedAlert, ExportedKeyframe, ExportedScan, RouteRecording};
use crate::model::{AlertStatus, TextEnum as _};

/// Arguments of `mapshift export`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The route.
    #[arg(long)]
    route: RouteId,
    /// The MCAP file to write: the map, the keyframes' poses and scans, and the alerts, as messages of
    /// ROS 2. Nothing is overwritten.
    #[arg(long, value_name = "FILE.mcap", required_unless_present = "alerts")]
    output: Option<PathBuf>,
    /// Write a table of the alerts, one a line.
    #[arg(long, value_name = "FILE.csv")]
    alerts: Option<PathBuf>,
    /// The service.
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    url: String,
    #[command(flatten)]
    key: KeyArg,
}

/// Reads a route over HTTP and writes it to files.
///
/// # Errors
/// If the service cannot be read, or a file is there already or cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    for file in args.output.iter().chain(&args.alerts) {
        if file.exists() {
            bail!(
                "{} is there already: nothing is overwritten",
                file.display()
            );
        }
    }
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?
        .block_on(export(args))
}

async fn export(args: &Args) -> anyhow::Result<()> {
    let gateway = Gateway::new(&args.url, args.key.key.as_deref(), say)?;
    let alerts = gateway.alert_details(&args.route).await?;
    if let Some(file) = &args.output {
        let nodes = gateway.nodes(&args.route).await?;
        let written = write_new(file, async |into| {
            record(&gateway, &args.route, &nodes, &alerts, into).await
        });
        let written = written.await?;
        say(&format!("{}: {written}", file.display()));
    }
    if let Some(file) = &args.alerts {
        let written = write_new(file, async |into| {
            into.write_all(alert_table::csv(&alerts).as_bytes())?;
            Ok(())
        });
        written.await?;
        say(&format!("{}: {} alerts", file.display(), alerts.len()));
    }
    Ok(())
}

/// Writes a file that gets its name when it is whole.
async fn write_new<T>(
    file: &Path,
    write: impl AsyncFnOnce(&mut std::fs::File) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let failed = || format!("cannot write {}", file.display());
    let parent = match file.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut scratch = tempfile::NamedTempFile::new_in(parent).with_context(failed)?;
    let written = write(scratch.as_file_mut()).await?;
    scratch.as_file().sync_all().with_context(failed)?;
    scratch.persist_noclobber(file).with_context(failed)?;
    Ok(written)
}

async fn record(
    gateway: &Gateway,
    route: &RouteId,
    nodes: &[NodeReport],
    alerts: &[AlertDetail],
    into: &mut std::fs::File,
) -> anyhow::Result<String> {
    let library = concat!("mapshift ", env!("CARGO_PKG_VERSION"));
    let mut recording = RouteRecording::create(BufWriter::new(into), library)?;
    let (placed, lost): (Vec<_>, Vec<_>) = nodes.iter().partition(|node| node.localised);
    let begin = placed.iter().map(|node| node.stamp).min();
    let begin_ns = nanoseconds(begin.unwrap_or_else(Timestamp::now))?;
    let version = gateway.route(route).await?.map_version;
    let (yaml, pgm) = gateway.map(route, version).await?;
    recording.grid(begin_ns, map_server::grid(&yaml, &pgm)?)?;
    let mut scans = 0;
    let progress = Progress::new(placed.len() as u64, "keyframes");
    for node in &placed {
        let scan = gateway.scan(route, node.id).await?;
        scans += usize::from(scan.is_some());
        recording.keyframe(&ExportedKeyframe {
            stamp_ns: nanoseconds(node.stamp)?,
            vehicle: node.vehicle_id.clone(),
            map_from_base: node.pose.into(),
            scan: scan.map(recorded_scan),
        })?;
        progress.advance(1);
    }
    progress.finish();
    for alert in alerts {
        recording.alert(&recorded_alert(alert)?)?;
    }
    recording.finish()?.flush()?;
    let left_out = match lost.len() {
        0 => String::new(),
        count => format!("; {count} keyframes are not localised and left out"),
    };
    Ok(format!(
        "the map, {} keyframes with {scans} scans, {} alerts{left_out}",
        placed.len(),
        alerts.len()
    ))
}

fn nanoseconds(stamp: Timestamp) -> anyhow::Result<i64> {
    i64::try_from(stamp.as_nanosecond()).with_context(|| format!("{stamp} is out of range"))
}

fn recorded_scan(scan: ScanReport) -> ExportedScan {
    let mut ranges_m = scan.ranges;
    for beam in scan.invalid_beams {
        if let Some(range_m) = ranges_m.get_mut(beam) {
            *range_m = Some(f64::NAN);
        }
    }
    ExportedScan {
        base_from_lidar: scan.lidar.mount.into(),
        angle_min_rad: scan.lidar.angle_min,
        angle_max_rad: scan.lidar.angle_max,
        angle_increment_rad: scan.lidar.angle_increment,
        range_min_m: scan.lidar.range_min,
        range_max_m: scan.lidar.range_max,
        ranges_m,
    }
}

fn recorded_alert(alert: &AlertDetail) -> anyhow::Result<ExportedAlert> {
    let status = AlertStatus::of_text(&alert.status)?;
    Ok(ExportedAlert {
        stamp_ns: nanoseconds(alert.first_seen)?,
        kind: alert.kind.clone(),
        title: format!("{} ({})", alert.title, alert.status),
        location: Vector2::new(alert.location.x, alert.location.y),
        region: alert
            .region
            .iter()
            .map(|[x, y]| Vector2::new(*x, *y))
            .collect(),
        pending: matches!(status, AlertStatus::Open | AlertStatus::Acknowledged),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invalid_reading_is_not_a_number_and_no_return_stays_none() {
        let scan = serde_json::json!({
            "lidar": {
                "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 1.0,
                "range_min": 0.05, "range_max": 20.0,
                "mount": {"x": 0.0, "y": 0.0, "theta": 0.0},
            },
            "ranges": [1.5, null, null],
            "invalid_beams": [2, 7],
        });
        let recorded = recorded_scan(serde_json::from_value(scan).unwrap());
        assert_eq!(recorded.ranges_m[..2], [Some(1.5), None]);
        assert!(recorded.ranges_m[2].is_some_and(f64::is_nan));
    }
}
