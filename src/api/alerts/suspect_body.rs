//! What an alert says about the vehicle that it suspects.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::types::timestamp;
use crate::api::vehicles::field_of;
use crate::calibration::{Estimate, VehicleFault};
use crate::change::{SilencedChange, SuspectEvidence};
use crate::model::ChangeKind;

/// A suspected vehicle's faults, and the changes that they explain.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertSuspect)]
pub(super) struct SuspectBody {
    /// What has changed between trips, or cannot be corrected.
    faults: Vec<VehicleFaultBody>,
    /// Changes for which no alert is raised: only this vehicle observed them, after the fault began, and each is
    /// no farther from what was there before than the fault displaces the vehicle's observations.
    silenced: Vec<SilencedChangeBody>,
}

/// A fault of a vehicle.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehicleFault)]
struct VehicleFaultBody {
    /// The lidar whose scans show it; null for the vehicle's only one.
    #[schema(required)]
    lidar: Option<String>,
    /// The faulty quantity: the name of a field of the vehicle's `calibration`; null for a fault that none of
    /// them describes.
    #[schema(required)]
    quantity: Option<&'static str>,
    /// For a change, the value from the trips before; null otherwise.
    #[schema(required)]
    before: Option<FaultValueBody>,
    /// The value from the trips since; if they differ, their mean, with their standard deviation as `sigma`. Null
    /// if no quantity describes the fault.
    #[schema(required)]
    now: Option<FaultValueBody>,
    /// The fault in words.
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
    /// The kind of alert that it would have been.
    kind: ChangeKind,
    /// Its centre, map frame, metres.
    x: f64,
    /// Its centre, map frame, metres.
    y: f64,
    /// The first observation that shows it.
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
