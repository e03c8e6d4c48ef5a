//! An alert in a title and in one sentence: the same in lists, webhook messages and the console.

use jiff::Timestamp;
use jiff::tz::TimeZone;

use super::size::Size;
use crate::api::types::timestamp;
use crate::api::words::kind_words;
use crate::change::{Counterpart, Finding, JudgedPasses, PassCounts, centroid};
use crate::ids::StampNs;
use crate::model::ChangeKind;
use crate::store::AlertRecord;

/// Lengths of this and more are written without decimals, metres.
const LONG_M: f64 = 10.0;
/// Most vehicles that are named; more are counted.
const NAMED_MAX: usize = 3;

/// What happened and its size, in a few words.
pub(super) fn title(alert: &AlertRecord, size: Option<Size>) -> String {
    let finding = &alert.evidence;
    let head = match finding.kind {
        ChangeKind::VehicleSuspect => return suspect_title(alert),
        ChangeKind::MapMismatch => return mismatch_title(finding, size),
        _ if finding.counterpart.is_some() => "Moved",
        ChangeKind::Appeared => "Appeared",
        ChangeKind::Disappeared => "Disappeared",
        kind => kind_words(kind),
    };
    match size {
        Some(size) => format!("{head}: about {}", area(size)),
        None => head.to_owned(),
    }
}

/// What happened, how it differs from what was known, since when, and which vehicles observed it, in one
/// sentence. Times are UTC, with their date if it differs from that of the last observation.
pub(super) fn summary(alert: &AlertRecord, size: Option<Size>) -> String {
    let finding = &alert.evidence;
    let about = size.map_or_else(String::new, |size| format!(" about {}", area(size)));
    let when = when(finding);
    let passes = alert.passes.as_ref();
    match (finding.kind, &finding.counterpart) {
        (ChangeKind::VehicleSuspect, _) => suspect_summary(alert, &when),
        (ChangeKind::MapMismatch, _) => mismatch_summary(alert, size, &when),
        (ChangeKind::Residual, _) => format!(
            "Loop closures contradict the map within{about}, {when}; reported by {} in {}.",
            vehicles(alert),
            times(finding.laps, "pass", "passes"),
        ),
        (_, Some(other)) => format!(
            "Something{about} {} moved by about {} m, as a door or a pushed object does, {when}; seen {}.",
            if finding.until.is_none() {
                "has"
            } else {
                "had"
            },
            metres(moved_m(finding, other)),
            witnesses(alert, passes),
        ),
        (ChangeKind::Appeared, None) => format!(
            "Something{about} {} where {} saw free space, {when}; seen {}.",
            if finding.until.is_none() {
                "stands"
            } else {
                "stood"
            },
            earlier(passes.map(|passes| passes.before.saw_free)),
            witnesses(alert, passes),
        ),
        (ChangeKind::Disappeared, None) => format!(
            "Something{about} that {} saw {} gone, {when}; free space seen {}.",
            earlier(passes.map(|passes| passes.before.saw_occupied)),
            if finding.until.is_none() { "is" } else { "was" },
            witnesses(alert, passes),
        ),
    }
}

fn suspect_title(alert: &AlertRecord) -> String {
    let suspect = alert.evidence.suspect.as_ref();
    let fault = suspect.and_then(|suspect| suspect.faults.first());
    let fault = fault.map_or_else(String::new, |fault| format!(": {}", fault.text));
    format!("{} off{fault}", suspected(alert))
}

fn suspect_summary(alert: &AlertRecord, when: &str) -> String {
    let suspect = alert.evidence.suspect.as_ref();
    let faults = suspect.iter().flat_map(|suspect| &suspect.faults);
    let faults: Vec<&str> = faults.map(|fault| fault.text.as_str()).collect();
    let faults = match faults.is_empty() {
        true => "its scans do not fit the map".to_owned(),
        false => faults.join("; "),
    };
    let silenced = match suspect.map_or(0, |suspect| suspect.silenced.len()) {
        0 => String::new(),
        1 => "; 1 change that only it saw is not raised".to_owned(),
        count => format!("; {count} changes that only it saw are not raised"),
    };
    format!("{} off {when}: {faults}{silenced}.", suspected(alert))
}

/// The suspected vehicle or vehicles, and the verb.
fn suspected(alert: &AlertRecord) -> String {
    match alert.vehicles.as_slice() {
        [] => "A vehicle is".to_owned(),
        [vehicle] => format!("Vehicle {vehicle} is"),
        _ => format!("Vehicles {} are", vehicles(alert)),
    }
}

fn mismatch_title(finding: &Finding, size: Option<Size>) -> String {
    let along = size.map_or_else(String::new, |size| {
        format!(": about {} m", metres(size.length))
    });
    let of_trip = trips(finding).map_or_else(String::new, |trips| format!(" of {trips}"));
    format!("Map does not fit{along}{of_trip}")
}

fn mismatch_summary(alert: &AlertRecord, size: Option<Size>, when: &str) -> String {
    let finding = &alert.evidence;
    let along = size.map_or_else(String::new, |size| {
        format!(" along about {} m", metres(size.length))
    });
    let of_trip = trips(finding).map_or_else(String::new, |trips| format!(" of {trips}"));
    let shift = finding.shift.map_or_else(String::new, |shift| {
        format!("; moved by {:.2} m it would fit", shift.norm())
    });
    format!(
        "The map does not fit what {} observed{along}{of_trip}, {when}{shift}.",
        vehicles(alert)
    )
}

fn trips(finding: &Finding) -> Option<String> {
    match finding.trips.as_slice() {
        [] => None,
        [trip] => Some(format!("trip {trip}")),
        trips => Some(format!("{} trips", trips.len())),
    }
}

/// The vehicles that observed the new state, and in how many of the passes since that could see the place.
fn witnesses(alert: &AlertRecord, passes: Option<&JudgedPasses>) -> String {
    let finding = &alert.evidence;
    let by = match alert.vehicles.is_empty() {
        true => String::new(),
        false => format!("by {} ", vehicles(alert)),
    };
    let Some(PassCounts {
        saw_free,
        saw_occupied,
        ..
    }) = passes.map(|passes| passes.since)
    else {
        return format!("{by}in {}", times(finding.laps, "pass", "passes"));
    };
    let seen = match finding.kind {
        ChangeKind::Appeared => saw_occupied,
        _ => saw_free,
    };
    let able = (saw_free + saw_occupied) as usize;
    format!("{by}in {seen} of {}", times(able, "pass", "passes"))
}

fn earlier(passes: Option<u32>) -> String {
    match passes {
        None | Some(0) => "earlier passes".to_owned(),
        Some(count) => times(count as usize, "earlier pass", "earlier passes"),
    }
}

fn vehicles(alert: &AlertRecord) -> String {
    let names: Vec<String> = alert.vehicles.iter().map(ToString::to_string).collect();
    match names.as_slice() {
        [] => "a vehicle".to_owned(),
        [name] => name.clone(),
        [names @ .., last] if names.len() < NAMED_MAX => format!("{} and {last}", names.join(", ")),
        names => format!("{} vehicles", names.len()),
    }
}

/// How far a moved object is from its old place, metres.
fn moved_m(finding: &Finding, other: &Counterpart) -> f64 {
    (finding.location - centroid(&other.region)).norm()
}

/// Since when, and until when if it has ended.
fn when(finding: &Finding) -> String {
    let day = day_of(timestamp(finding.last_seen));
    let time = |stamp: StampNs| {
        let at = timestamp(stamp);
        let format = if day_of(at) == day {
            "%H:%M"
        } else {
            "%F %H:%M"
        };
        at.strftime(format).to_string()
    };
    match finding.until {
        None => format!("since {}", time(finding.since)),
        Some(until) => format!("from {} to {}", time(finding.since), time(until)),
    }
}

fn day_of(at: Timestamp) -> jiff::civil::Date {
    at.to_zoned(TimeZone::UTC).date()
}

fn times(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

fn area(size: Size) -> String {
    format!("{} × {} m", metres(size.length), metres(size.width))
}

/// A length to 10 cm, about the accuracy to which it is known.
fn metres(length_m: f64) -> String {
    match length_m < LONG_M {
        true => format!("{:.1}", length_m.max(0.1)),
        false => format!("{length_m:.0}"),
    }
}

#[cfg(test)]
mod tests;
