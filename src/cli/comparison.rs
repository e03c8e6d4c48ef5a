//! Compares the true changes of a simulation with the service's alerts.

use super::plan::FAULT_DEG;
use crate::change::ChangeKind;
use crate::client::{AlertLocation, AlertReport};
use crate::geometry::Vector2;
use crate::ids::VehicleId;
use crate::sim::{ChangeEvent, Shape};

/// An alert matches a change of its kind within this distance of the object, metres.
const MATCH_MAX_M: f64 = 0.5;

/// The truth of a simulation.
pub(super) struct Truth {
    /// The visible changes.
    pub changes: Vec<ChangeEvent>,
    /// The vehicle whose lidar was knocked aside.
    pub knocked: Option<Knocked>,
}

/// A vehicle whose lidar was knocked aside.
pub(super) struct Knocked {
    pub vehicle: VehicleId,
    /// The first lap afterwards.
    pub lap: usize,
}

impl Truth {
    /// What happened before a lap, printed after its number; empty if nothing did.
    pub(super) fn before_lap(&self, lap: usize) -> String {
        let count = |kind| {
            let events = self.changes.iter();
            events.filter(|e| e.lap == lap && e.kind == kind).count()
        };
        let came = count(ChangeKind::Appeared);
        let went = count(ChangeKind::Disappeared);
        let mut happened = Vec::new();
        if came > 0 {
            happened.push(format!("something new stands in {}", places(came)));
        }
        if went > 0 {
            happened.push(format!("something has gone from {}", places(went)));
        }
        let knocked = self.knocked.iter().filter(|knocked| knocked.lap == lap);
        happened.extend(knocked.map(Knocked::describe));
        match happened.is_empty() {
            true => String::new(),
            false => format!(": {}", happened.join(", ")),
        }
    }

    /// The first lap without an object that appeared after the first lap.
    fn end_of(&self, event: &ChangeEvent) -> Option<usize> {
        let mut others = self.changes.iter().filter(|e| e.object == event.object);
        let gone = others.find(|e| e.kind == ChangeKind::Disappeared && e.lap > event.lap)?;
        (event.kind == ChangeKind::Appeared).then_some(gone.lap)
    }

    /// Whether it is the end of an object that appeared after the first lap: its alert is then resolved.
    fn is_end(&self, event: &ChangeEvent) -> bool {
        let mut others = self.changes.iter().filter(|e| e.object == event.object);
        event.kind == ChangeKind::Disappeared && others.any(|e| e.kind == ChangeKind::Appeared)
    }

    fn explains(&self, alert: &AlertReport) -> bool {
        let names = |k: &Knocked| k.is_named_by(alert);
        let fits = |event| distance_m(event, alert).is_some();
        self.changes.iter().any(fits) || self.knocked.as_ref().is_some_and(names)
    }
}

impl Knocked {
    fn describe(&self) -> String {
        let Self { vehicle, .. } = self;
        format!("the lidar of {vehicle} has been knocked aside by {FAULT_DEG}°")
    }

    fn is_named_by(&self, alert: &AlertReport) -> bool {
        alert.kind == ChangeKind::VehicleSuspect.name()
            && alert.vehicle_ids == [self.vehicle.as_str()]
    }
}

/// One line for each true change with its nearest alert (pending ones before resolved ones), then the alerts
/// without a true change. An object that appeared and disappeared again is one line. `None`: alerts cannot be
/// read.
pub(super) fn compare(truth: &Truth, alerts: Option<&[AlertReport]>) -> Vec<String> {
    let changes = truth.changes.iter().filter(|event| !truth.is_end(event));
    let mut happened: Vec<(String, Option<&AlertReport>)> = changes
        .map(|event| {
            let until = truth.end_of(event);
            let alert = alerts.and_then(|alerts| nearest(event, alerts));
            (describe_change(event, until), alert)
        })
        .collect();
    happened.extend(truth.knocked.iter().map(|knocked| {
        let mut alerts = alerts.iter().flat_map(|alerts| alerts.iter());
        let line = format!("  {}, lap {}", knocked.describe(), knocked.lap + 1);
        (line, alerts.find(|alert| knocked.is_named_by(alert)))
    }));
    let head = "truly changed, as far as it could be seen";
    let count = happened.len();
    let Some(alerts) = alerts else {
        let mut lines = vec![format!("{head}: {count}")];
        lines.extend(happened.into_iter().map(|(line, _)| line));
        lines.push("the service has no alerts to show".to_owned());
        return lines;
    };
    let found = happened.iter().filter(|(_, alert)| alert.is_some());
    let mut lines = vec![format!("{head}: {count}, found: {}", found.count())];
    lines.extend(happened.into_iter().map(|(line, alert)| match alert {
        Some(alert) => format!("{line}   found{}", describe_alert(alert)),
        None => format!("{line}   no alert"),
    }));
    let others: Vec<&AlertReport> = alerts.iter().filter(|a| !truth.explains(a)).collect();
    lines.push(format!("alerts that fit no change: {}", others.len()));
    let line = |alert: &AlertReport| format!("  {}{}", alert.kind, describe_alert(alert));
    lines.extend(others.into_iter().map(line));
    lines
}

fn places(count: usize) -> String {
    match count {
        1 => "1 place".to_owned(),
        count => format!("{count} places"),
    }
}

/// An alert in a line.
pub(super) fn announce(alert: &AlertReport) -> String {
    let place = place_of(alert);
    format!("ALERT {}: {}{place}", alert.status, alert.title)
}

fn nearest<'a>(event: &ChangeEvent, alerts: &'a [AlertReport]) -> Option<&'a AlertReport> {
    let fitting = alerts
        .iter()
        .filter_map(|alert| Some((distance_m(event, alert)?, alert)));
    let is_over = |alert: &AlertReport| alert.status == "resolved";
    let nearest = fitting
        .min_by(|(a_m, a), (b_m, b)| is_over(a).cmp(&is_over(b)).then(a_m.total_cmp(b_m)))?;
    Some(nearest.1)
}

/// Metres from an alert to the object of a change, 0 inside; `None` if the alert does not fit.
fn distance_m(event: &ChangeEvent, alert: &AlertReport) -> Option<f64> {
    let AlertLocation { x, y } = alert.location?;
    let place = Vector2::new(x, y);
    let distance_m = match &event.shape {
        shape if shape.contains(&place) => 0.0,
        shape => shape.distance_to(&place),
    };
    (alert.kind == event.kind.name() && distance_m <= MATCH_MAX_M).then_some(distance_m)
}

fn describe_change(event: &ChangeEvent, until: Option<usize>) -> String {
    let (middle, _) = event.shape.bounding_circle();
    let what = match &event.shape {
        Shape::Outline(_) => "box",
        Shape::Round { .. } => "column",
    };
    let gone = until.map_or(String::new(), |lap| format!(", gone in lap {}", lap + 1));
    format!(
        "  {:<11} at ({:5.2}, {:5.2}), a {what} of {:.2} m², lap {}{gone}",
        event.kind.name(),
        middle.x,
        middle.y,
        event.shape.area_m2(),
        event.lap + 1,
    )
}

fn place_of(alert: &AlertReport) -> String {
    let place = alert.location;
    place.map_or(String::new(), |AlertLocation { x, y }| {
        format!(" at ({x:.2}, {y:.2})")
    })
}

fn describe_alert(alert: &AlertReport) -> String {
    let place = place_of(alert);
    let confidence = alert
        .confidence
        .map_or(String::new(), |c| format!(", confidence {c:.3}"));
    format!("{place}{confidence}, {}", alert.status)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;

    fn event(kind: ChangeKind, x: f64) -> ChangeEvent {
        let shape = Shape::rectangle(&Pose2::new(x, 0.0, 0.0), 2.0, 2.0);
        ChangeEvent {
            kind,
            object: 3,
            lap: 2,
            shape,
        }
    }

    fn alert(kind: &str, x: f64) -> AlertReport {
        AlertReport {
            id: format!("{kind}-{x}"),
            kind: kind.to_owned(),
            status: "open".to_owned(),
            title: format!("{kind}: about 1 × 1 m"),
            vehicle_ids: vec!["agv-02".to_owned()],
            location: Some(AlertLocation { x, y: 0.0 }),
            confidence: Some(0.998),
        }
    }

    #[test]
    fn an_alert_fits_a_change_of_its_kind_and_place() {
        let appeared = event(ChangeKind::Appeared, 0.0);
        let at = |x| distance_m(&appeared, &alert("appeared", x));
        assert_eq!(at(0.2), Some(0.0));
        assert!((at(1.4).unwrap() - 0.4).abs() < 1e-9);
        assert_eq!(at(1.6), None);
        assert_eq!(distance_m(&appeared, &alert("disappeared", 0.0)), None);
        let mut placeless = alert("appeared", 0.0);
        placeless.location = None;
        assert_eq!(distance_m(&appeared, &placeless), None);
    }

    #[test]
    fn truth_and_alerts_stand_side_by_side() {
        let mut gone = event(ChangeKind::Disappeared, 10.0);
        gone.object = 4;
        let truth = Truth {
            changes: vec![event(ChangeKind::Appeared, 0.0), gone],
            knocked: None,
        };
        let alerts = [
            alert("appeared", 1.3),
            alert("appeared", 0.9),
            alert("residual", 5.0),
        ];
        let lines = compare(&truth, Some(&alerts));
        assert_eq!(
            lines,
            [
                "truly changed, as far as it could be seen: 2, found: 1",
                "  appeared    at ( 0.00,  0.00), a box of 4.00 m², lap 3   found at (0.90, 0.00), confidence 0.998, open",
                "  disappeared at (10.00,  0.00), a box of 4.00 m², lap 3   no alert",
                "alerts that fit no change: 1",
                "  residual at (5.00, 0.00), confidence 0.998, open",
            ]
        );
        let silent = compare(&truth, None);
        assert_eq!(silent.len(), 4);
        assert!(silent[3].contains("no alerts to show"));
        assert_eq!(
            announce(&alerts[0]),
            "ALERT open: appeared: about 1 × 1 m at (1.30, 0.00)"
        );
    }

    /// One that came and went is one line, whose alert is resolved; its end needs no alert of its own.
    #[test]
    fn what_comes_and_goes_is_one_line() {
        let mut gone = event(ChangeKind::Disappeared, 0.0);
        gone.lap = 3;
        let truth = Truth {
            changes: vec![event(ChangeKind::Appeared, 0.0), gone],
            knocked: None,
        };
        assert_eq!(truth.before_lap(2), ": something new stands in 1 place");
        assert_eq!(truth.before_lap(3), ": something has gone from 1 place");
        assert_eq!(truth.before_lap(4), "");
        let mut resolved = alert("appeared", 0.9);
        resolved.status = "resolved".to_owned();
        let line = |found: &str| {
            [
                format!(
                    "truly changed, as far as it could be seen: 1, found: {}",
                    u8::from(found != "no alert")
                ),
                format!(
                    "  appeared    at ( 0.00,  0.00), a box of 4.00 m², lap 3, gone in lap 4   {found}"
                ),
                "alerts that fit no change: 0".to_owned(),
            ]
        };
        assert_eq!(compare(&truth, Some(&[])), line("no alert"));
        assert_eq!(
            compare(&truth, Some(&[resolved])),
            line("found at (0.90, 0.00), confidence 0.998, resolved")
        );
    }

    #[test]
    fn a_knocked_lidar_is_found_if_its_vehicle_is_named() {
        let truth = Truth {
            changes: Vec::new(),
            knocked: Some(Knocked {
                vehicle: VehicleId::new("agv-02").unwrap(),
                lap: 3,
            }),
        };
        let mut suspect = alert("vehicle_suspect", 0.0);
        suspect.location = None;
        let mut another = suspect.clone();
        another.vehicle_ids = vec!["agv-01".to_owned()];
        let knocked = "the lidar of agv-02 has been knocked aside by 2°";
        assert_eq!(truth.before_lap(3), format!(": {knocked}"));
        let lines = compare(&truth, Some(&[another, suspect]));
        assert_eq!(
            lines,
            [
                "truly changed, as far as it could be seen: 1, found: 1".to_owned(),
                format!("  {knocked}, lap 4   found, confidence 0.998, open"),
                "alerts that fit no change: 1".to_owned(),
                "  vehicle_suspect, confidence 0.998, open".to_owned(),
            ]
        );
    }
}
