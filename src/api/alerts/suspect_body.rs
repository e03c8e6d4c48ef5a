//! What an alert says of the vehicle that it suspects.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::types::timestamp;
use crate::api::vehicles::field_of;
use crate::calibration::{Estimate, VehicleFault};
use crate::change::{SilencedChange, SuspectEvidence};
use crate::model::ChangeKind;

/// What is off of a vehicle, and what that explains.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertSuspect)]
pub(super) struct SuspectBody {
    /// What has changed from trip to trip, or is off and cannot be corrected.
    faults: Vec<VehicleFaultBody>,
    /// Changes that no alert is raised for: only this vehicle saw them, since the fault, and each lies
    /// beside what was there no farther than the fault displaces what the vehicle sees.
    silenced: Vec<SilencedChangeBody>,
}

/// Something that is off of a vehicle.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehicleFault)]
struct VehicleFaultBody {
    /// The lidar whose scans say it; null for the vehicle's only one.
    #[schema(required)]
    lidar: Option<String>,
    /// What is off: the name of a field of the vehicle's `calibration`; null for a fault that none of
    /// them tells.
    #[schema(required)]
    quantity: Option<&'static str>,
    /// What the trips before said, of a change; null otherwise.
    #[schema(required)]
    before: Option<FaultValueBody>,
    /// What the trips since say; where they differ from trip to trip their mean, and as `sigma` their
    /// standard deviation. Null where no quantity tells it.
    #[schema(required)]
    now: Option<FaultValueBody>,
    /// The same for people.
    text: String,
}

/// A value in the unit of its field in the vehicle's `calibration`.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehicleFaultValue)]
struct FaultValueBody {
    /// The value.
    value: f64,
    /// Its standard error.
    sigma: f64,
}

/// A change that a vehicle's fault explains.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SilencedChange)]
struct SilencedChangeBody {
    /// What it would have been.
    kind: ChangeKind,
    /// Its centre, map frame, metres.
    x: f64,
    /// Its centre, map frame, metres.
    y: f64,
    /// The first look that shows it.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
}

impl From<SuspectEvidence> for SuspectBody {
    fn from(evidence: SuspectEvidence) -> Self {
        let (faults, silenced) = (evidence.faults.into_iter(), evidence.silenced.into_iter());
        Self {
            faults: faults.map(VehicleFaultBody::from).collect(),
            silenced: silenced.map(SilencedChangeBody::from).collect(),
        }
    }
}

impl From<VehicleFault> for VehicleFaultBody {
    fn from(fault: VehicleFault) -> Self {
        Self {
            lidar: fault.lidar.map(|lidar| lidar.to_string()),
            quantity: fault.quantity.map(field_of),
            before: fault.before.map(FaultValueBody::from),
            now: fault.now.map(FaultValueBody::from),
            text: fault.text,
        }
    }
}

impl From<Estimate> for FaultValueBody {
    fn from(Estimate { value, sigma }: Estimate) -> Self {
        Self { value, sigma }
    }
}

impl From<SilencedChange> for SilencedChangeBody {
    fn from(change: SilencedChange) -> Self {
        let [x, y] = change.at_m;
        Self {
            kind: change.kind,
            x,
            y,
            since: timestamp(change.since),
        }
    }
}
