//! What truly changed in a simulation, beside what the service found.

use crate::client::{AlertLocation, AlertReport};
use crate::geometry::Vector2;
use crate::sim::{ChangeEvent, Shape};

/// An alert is taken for a change of its kind if it is no farther than this from the object,
/// metres.
const MATCH_MAX_M: f64 = 0.5;

/// One line for each change with the alert that is nearest to it (one that still stands before
/// one that was resolved), then the alerts that fit no
/// change. `None`: the service has no alerts to show.
pub(super) fn compare(truth: &[ChangeEvent], alerts: Option<&[AlertReport]>) -> Vec<String> {
    let head = "truly changed, as far as it could be seen";
    let Some(alerts) = alerts else {
        let mut lines = vec![format!("{head}: {}", truth.len())];
        lines.extend(truth.iter().map(describe_change));
        lines.push("the service has no alerts to show".to_owned());
        return lines;
    };
    let found: Vec<_> = truth.iter().map(|event| nearest(event, alerts)).collect();
    let found_count = found.iter().flatten().count();
    let mut lines = vec![format!("{head}: {}, found: {found_count}", truth.len())];
    for (event, found) in truth.iter().zip(found) {
        let change = describe_change(event);
        lines.push(match found {
            Some(alert) => format!("{change}   found:{}", describe_alert(alert)),
            None => format!("{change}   no alert"),
        });
    }
    let fits = |alert: &&AlertReport| truth.iter().any(|e| distance_m(e, alert).is_some());
    let others: Vec<&AlertReport> = alerts.iter().filter(|alert| !fits(alert)).collect();
    lines.push(format!("alerts that fit no change: {}", others.len()));
    let line = |alert: &AlertReport| format!("  {}{}", alert.kind, describe_alert(alert));
    lines.extend(others.into_iter().map(line));
    lines
}

/// An alert in a line.
pub(super) fn announce(alert: &AlertReport) -> String {
    format!("ALERT {}{}", alert.kind, describe_alert(alert))
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

fn describe_change(event: &ChangeEvent) -> String {
    let (middle, _) = event.shape.bounding_circle();
    let what = match &event.shape {
        Shape::Outline(_) => "box",
        Shape::Round { .. } => "column",
    };
    format!(
        "  {:<11} at ({:5.2}, {:5.2}), a {what} of {:.2} m², lap {}",
        event.kind.name(),
        middle.x,
        middle.y,
        event.shape.area_m2(),
        event.lap + 1,
    )
}

fn describe_alert(alert: &AlertReport) -> String {
    let place = alert
        .location
        .map_or(String::new(), |AlertLocation { x, y }| {
            format!(" at ({x:.2}, {y:.2})")
        });
    let confidence = alert
        .confidence
        .map_or(String::new(), |c| format!(", confidence {c:.3}"));
    format!("{place}{confidence}, {}", alert.status)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::ChangeKind;
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
        let truth = [
            event(ChangeKind::Appeared, 0.0),
            event(ChangeKind::Disappeared, 10.0),
        ];
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
                "  appeared    at ( 0.00,  0.00), a box of 4.00 m², lap 3   found: at (0.90, 0.00), confidence 0.998, open",
                "  disappeared at (10.00,  0.00), a box of 4.00 m², lap 3   no alert",
                "alerts that fit no change: 1",
                "  residual at (5.00, 0.00), confidence 0.998, open",
            ]
        );
        let silent = compare(&truth, None);
        assert_eq!(silent.len(), 4);
        assert!(silent[3].contains("no alerts to show"));
    }
}
