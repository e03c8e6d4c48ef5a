//! What the log and the metrics say of what was written. Called by [`Request::committed`], so that what
//! is rolled back is in neither, and what is executed again is counted once.
//!
//! [`Request::committed`]: super::request::Request::committed

use super::alert_records::AlertRecord;
use super::records::BatchOutcome;
use crate::calibration::VehicleFault;
use crate::ids::{RouteId, VehicleId};
use crate::model::{Actor, AlertAction, AlertStatus, BatchStatus, ChangeKind};

/// A batch that was given up.
#[derive(Debug)]
pub(super) struct GivenUp {
    /// The route's name.
    pub(super) route_id: String,
    /// Chosen by the client.
    pub(super) batch_id: String,
    /// Why, for people.
    pub(super) reason: String,
}

impl GivenUp {
    /// Says so.
    pub(super) fn report(&self) {
        quarantined(&self.route_id, &self.batch_id, &self.reason);
    }
}

/// A batch was quarantined.
pub(super) fn quarantined(route: &str, batch: &str, reason: &str) {
    tracing::warn!(route, batch, reason, "a batch was quarantined");
    count_ended(BatchStatus::Quarantined, 1);
}

/// A job has ended its batches.
pub(super) fn batches_ended(route: &RouteId, outcomes: &[BatchOutcome]) {
    for outcome in outcomes {
        let reason = outcome.reason.as_deref().unwrap_or_default();
        match outcome.status {
            BatchStatus::Quarantined => {
                quarantined(route.as_str(), outcome.batch_id.as_str(), reason);
            }
            status => count_ended(status, 1),
        }
    }
}

/// Batches were taken out of a map.
pub(super) fn batches_removed(count: usize) {
    count_ended(BatchStatus::Removed, count as u64);
}

fn count_ended(status: BatchStatus, count: u64) {
    metrics::counter!("mapshift_batches_ended_total", "status" => status.name()).increment(count);
}

/// Alerts were written by what the service computed: says which of them it has raised or resolved.
pub(super) fn alerts_written(alerts: &[AlertRecord]) {
    for alert in alerts {
        let entry = alert.history.last();
        if entry.is_none_or(|entry| entry.at != alert.updated_at) {
            continue;
        }
        let (route, id, kind) = (&alert.route_id, alert.id, alert.evidence.kind);
        match (alert.status, kind) {
            (AlertStatus::Open, ChangeKind::VehicleSuspect) => suspect(alert),
            (AlertStatus::Open, _) => tracing::info!(
                %route, alert = %id, kind = kind.name(), tier = alert.evidence.tier.name(),
                x_m = alert.evidence.location.x, y_m = alert.evidence.location.y,
                "an alert was raised"
            ),
            (AlertStatus::Resolved, _) => {
                tracing::info!(%route, alert = %id, kind = kind.name(), "an alert was resolved");
            }
            _ => {}
        }
    }
}

fn suspect(alert: &AlertRecord) {
    let faults = alert.evidence.suspect.iter().flat_map(|of| &of.faults);
    let faults: Vec<&str> = faults
        .map(|VehicleFault { text, .. }| text.as_str())
        .collect();
    tracing::warn!(
        route = %alert.route_id,
        alert = %alert.id,
        vehicle = alert.vehicles.first().map(VehicleId::as_str),
        reason = faults.join("; "),
        "a vehicle is suspect"
    );
}

/// Somebody decided about alerts.
pub(super) fn decided(action: AlertAction, actor: &Actor, alerts: &[AlertRecord]) {
    for alert in alerts {
        tracing::info!(
            by = alert.history.last().map(|entry| entry.by.as_str()),
            address = actor.address(),
            action = action.name(),
            route = %alert.route_id,
            alert = %alert.id,
            kind = alert.evidence.kind.name(),
            "a decision was made"
        );
    }
}

/// Somebody keeps a vehicle's uploads out of a map from now on, or no longer.
pub(super) fn vehicle_kept_out(route: &RouteId, vehicle: &VehicleId, is_out: bool, by: &Actor) {
    let (by, address) = (by.name(), by.address());
    match is_out {
        true => tracing::info!(by, address, %route, %vehicle, "a vehicle was quarantined"),
        false => tracing::info!(by, address, %route, %vehicle, "a vehicle was released"),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{self, Write};
    use std::sync::{Arc, Mutex};

    use jiff::Timestamp;

    use super::*;
    use crate::change::{Suspect, Tier};
    use crate::geometry::Vector2;
    use crate::ids::{AlertId, NodeId, StampNs, TripId};
    use crate::store::{Handling, HistoryEntry, SYSTEM};

    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// What is logged meanwhile.
    fn logged(work: impl FnOnce()) -> String {
        let lines = Lines::default();
        let writer = lines.clone();
        let log = tracing_subscriber::fmt()
            .with_ansi(false)
            .with_writer(move || writer.clone());
        tracing::subscriber::with_default(log.finish(), work);
        String::from_utf8(lines.0.lock().unwrap().clone()).unwrap()
    }

    fn of_a_vehicle(status: AlertStatus, at: Timestamp) -> AlertRecord {
        let vehicle = VehicleId::new("agv-07").unwrap();
        let suspect = Suspect {
            vehicle: vehicle.clone(),
            faults: vec![VehicleFault::uncorrectable(None, "wheels slip")],
            trips: vec![TripId::new("t").unwrap()],
            scans: 150,
            sound_until: None,
            since: StampNs(0),
            last_seen: StampNs(0),
            until: None,
            tier: Tier::Confirmed,
            significance: 5.0,
        };
        AlertRecord {
            id: AlertId(uuid::Uuid::nil()),
            route_id: RouteId::new("hall").unwrap(),
            revision: 1,
            decision_revision: 1,
            decision_region: Vec::new(),
            status,
            evidence: suspect.finding(NodeId(1), Vector2::new(0.0, 0.0)),
            first_seen: StampNs(0),
            vehicles: vec![vehicle],
            passes: None,
            clearance: None,
            residual: None,
            map_version: 1,
            related: Vec::new(),
            raised_at: at,
            updated_at: at,
            history: vec![HistoryEntry {
                status,
                at,
                by: SYSTEM.to_owned(),
                note: None,
                reason: None,
            }],
            handling: Handling::default(),
        }
    }

    #[test]
    fn a_vehicle_that_becomes_suspect_is_one_line_with_the_reason() {
        let mut alert = of_a_vehicle(AlertStatus::Open, Timestamp::UNIX_EPOCH);
        let line = logged(|| alerts_written(std::slice::from_ref(&alert)));
        assert_eq!(line.lines().count(), 1, "{line}");
        for part in [
            "WARN",
            "a vehicle is suspect",
            "vehicle=\"agv-07\"",
            "route=hall",
            "reason=\"wheels slip\"",
        ] {
            assert!(line.contains(part), "{part} is not in {line}");
        }
        // Evidence that grows is no news.
        alert.updated_at = Timestamp::MAX;
        assert_eq!(logged(|| alerts_written(&[alert])), "");
        let resolved = of_a_vehicle(AlertStatus::Resolved, Timestamp::UNIX_EPOCH);
        let line = logged(|| alerts_written(&[resolved]));
        assert!(line.contains("an alert was resolved"), "{line}");
    }
}
