use super::*;
use crate::calibration::VehicleFault;
use crate::change::testing::finding;
use crate::change::{AlertStatus, SilencedChange, SuspectEvidence, Tier};
use crate::geometry::Vector2;
use crate::ids::{AlertId, RouteId, TripId, VehicleId};
use crate::store::Handling;

/// 2026-11-20T06:12:30Z, in seconds.
const SINCE_S: i64 = 1_795_155_150;
const HOUR_NS: i64 = 3_600_000_000_000;

fn counts(saw_free: u32, saw_occupied: u32, could_not_see: u32) -> PassCounts {
    PassCounts {
        saw_free,
        saw_occupied,
        could_not_see,
    }
}

/// An alert about a place of 0.9 m by 0.4 m that agv-07 saw.
fn alert(kind: ChangeKind) -> AlertRecord {
    let mut evidence = finding(kind, [2.0, 1.0], 0.2, SINCE_S);
    let corners = [[0.0, 0.0], [0.9, 0.0], [0.9, 0.4], [0.0, 0.4]];
    evidence.region = corners.map(Vector2::from).to_vec();
    evidence.location = Vector2::new(0.45, 0.2);
    evidence.tier = Tier::Confirmed;
    evidence.laps = 2;
    AlertRecord {
        id: AlertId(uuid::Uuid::nil()),
        route_id: RouteId::new("hall").unwrap(),
        revision: 1,
        decision_revision: 1,
        decision_region: evidence.region.clone(),
        status: AlertStatus::Open,
        first_seen: evidence.since,
        vehicles: vec![VehicleId::new("agv-07").unwrap()],
        passes: Some(JudgedPasses {
            before: counts(7, 0, 1),
            since: counts(0, 2, 1),
            listed: Vec::new(),
        }),
        clearance: None,
        residual: None,
        map_version: 1,
        related: Vec::new(),
        raised_at: Timestamp::UNIX_EPOCH,
        updated_at: Timestamp::UNIX_EPOCH,
        history: Vec::new(),
        handling: Handling::default(),
        evidence,
    }
}

fn gone() -> AlertRecord {
    let mut gone = alert(ChangeKind::Disappeared);
    if let Some(passes) = &mut gone.passes {
        passes.before = counts(0, 1, 0);
        passes.since = counts(1, 0, 0);
    }
    gone
}

fn said(alert: &AlertRecord) -> (String, String) {
    let size = Size::of(&alert.evidence.region);
    (title(alert, size), summary(alert, size))
}

#[test]
fn what_appeared_stands_where_others_saw_free_space() {
    let (title, summary) = said(&alert(ChangeKind::Appeared));
    assert_eq!(title, "Appeared: about 0.9 × 0.4 m");
    assert_eq!(
        summary,
        "Something about 0.9 × 0.4 m stands where 7 earlier passes saw free space, since 06:12; seen by \
         agv-07 in 2 of 2 passes."
    );
}

#[test]
fn what_disappeared_is_gone() {
    let (title, summary) = said(&gone());
    assert_eq!(title, "Disappeared: about 0.9 × 0.4 m");
    assert_eq!(
        summary,
        "Something about 0.9 × 0.4 m that 1 earlier pass saw is gone, since 06:12; free space seen by \
         agv-07 in 1 of 1 pass."
    );
}

#[test]
fn what_is_over_is_told_in_the_past_with_its_end() {
    let mut over = alert(ChangeKind::Appeared);
    over.evidence.until = Some(StampNs(SINCE_S * 1_000_000_000 + 30 * HOUR_NS));
    over.vehicles = ["a", "b", "c"]
        .map(|name| VehicleId::new(name).unwrap())
        .to_vec();
    let passes = over.passes.as_mut().unwrap();
    passes.since = counts(3, 2, 0);
    assert_eq!(
        said(&over).1,
        "Something about 0.9 × 0.4 m stood where 7 earlier passes saw free space, from 06:12 to \
         2026-11-21 12:12; seen by a, b and c in 2 of 5 passes."
    );
    let mut over = gone();
    over.evidence.until = Some(StampNs(SINCE_S * 1_000_000_000 + HOUR_NS));
    assert!(said(&over).1.contains("saw was gone, from 06:12 to 07:12;"));
}

#[test]
fn times_of_other_days_have_their_date() {
    let mut old = alert(ChangeKind::Appeared);
    old.evidence.last_seen = StampNs(SINCE_S * 1_000_000_000 + 24 * HOUR_NS);
    assert!(
        said(&old).1.contains(", since 2026-11-20 06:12;"),
        "{old:?}"
    );
}

#[test]
fn what_was_moved_says_how_far() {
    let mut moved = alert(ChangeKind::Appeared);
    let region = moved.evidence.region.iter();
    moved.evidence.counterpart = Some(Counterpart {
        kind: ChangeKind::Disappeared,
        region: region
            .map(|corner| corner + Vector2::new(0.0, 0.6))
            .collect(),
    });
    let (title, summary) = said(&moved);
    assert_eq!(title, "Moved: about 0.9 × 0.4 m");
    assert_eq!(
        summary,
        "Something about 0.9 × 0.4 m has moved by about 0.6 m, as a door or a pushed object does, since \
         06:12; seen by agv-07 in 2 of 2 passes."
    );
}

#[test]
fn without_passes_those_of_the_detector_count() {
    let mut old = alert(ChangeKind::Appeared);
    old.passes = None;
    old.vehicles.clear();
    assert_eq!(
        said(&old).1,
        "Something about 0.9 × 0.4 m stands where earlier passes saw free space, since 06:12; seen in 2 \
         passes."
    );
    old.vehicles = (0..4)
        .map(|k| VehicleId::new(format!("agv-{k}")).unwrap())
        .collect();
    assert!(said(&old).1.ends_with("seen by 4 vehicles in 2 passes."));
}

#[test]
fn closures_that_contradict_have_a_place() {
    let (title, summary) = said(&alert(ChangeKind::Residual));
    assert_eq!(title, "Closures contradict the map: about 0.9 × 0.4 m");
    assert_eq!(
        summary,
        "Loop closures contradict the map within about 0.9 × 0.4 m, since 06:12; reported by agv-07 in 2 \
         passes."
    );
}

#[test]
fn a_map_that_does_not_fit_says_along_what() {
    let mut mismatch = alert(ChangeKind::MapMismatch);
    let corners = [[0.0, 0.0], [12.3, 0.0], [12.3, 2.0], [0.0, 2.0]];
    mismatch.evidence.region = corners.map(Vector2::from).to_vec();
    mismatch.evidence.shift = Some(Vector2::new(0.3, 0.4));
    let (title, summary) = said(&mismatch);
    assert_eq!(title, "Map does not fit: about 12 m of trip monday");
    assert_eq!(
        summary,
        "The map does not fit what agv-07 observed along about 12 m of trip monday, since 06:12; moved by \
         0.50 m it would fit."
    );
    mismatch
        .evidence
        .trips
        .push(TripId::new("tuesday").unwrap());
    assert_eq!(said(&mismatch).0, "Map does not fit: about 12 m of 2 trips");
}

#[test]
fn a_suspected_vehicle_says_what_is_off() {
    let mut suspect = alert(ChangeKind::VehicleSuspect);
    suspect.evidence.region.clear();
    let (title, summary) = said(&suspect);
    assert_eq!(title, "Vehicle agv-07 is off");
    assert_eq!(
        summary,
        "Vehicle agv-07 is off since 06:12: its scans do not fit the map."
    );
    let at = Vector2::new(1.0, 2.0);
    let silenced = SilencedChange::new(ChangeKind::Appeared, &at, StampNs(0));
    suspect.evidence.suspect = Some(SuspectEvidence {
        faults: vec![VehicleFault::uncorrectable(None, "its lidar hangs loose")],
        silenced: vec![silenced],
    });
    let (title, summary) = said(&suspect);
    assert_eq!(title, "Vehicle agv-07 is off: its lidar hangs loose");
    assert_eq!(
        summary,
        "Vehicle agv-07 is off since 06:12: its lidar hangs loose; 1 change that only it saw is not raised."
    );
}
