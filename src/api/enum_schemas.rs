//! The OpenAPI schemas of the enumerations in [`model`](crate::model): their values come from its
//! tables, and the descriptions for people stand here.

use std::borrow::Cow;

use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::model::{
    AlertAction, AlertStatus, AuditAction, BatchKind, BatchStatus, BeamVerdict, ChangeKind,
    Clearance, DecisionResult, DeliveryFailure, DeliveryStatus, Detector, DismissReason, EdgeKind,
    EdgeStatus, MapLayer, OperationKind, OperationStatus, PassOutcome, PassSide, RecordingFormat,
    ResidualMeasurement, ResidualVerdict, Role, ShownSide, Stage, TextEnum, Tier, VehicleState,
    VersionAction, VersionState, WebhookEvent, WebhookTopic, ZonePurpose,
};

/// The schema of one text of a list.
pub(super) fn one_of(
    texts: impl IntoIterator<Item = &'static str>,
    description: &str,
) -> RefOr<Schema> {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(texts))
        .description(Some(description))
        .into()
}

macro_rules! enum_schemas {
    ($($type:ident as $name:literal: $description:literal;)+) => { $(
        impl PartialSchema for $type {
            fn schema() -> RefOr<Schema> {
                one_of(Self::TABLE.iter().map(|(_, text)| *text), $description)
            }
        }

        impl ToSchema for $type {
            fn name() -> Cow<'static, str> {
                Cow::Borrowed($name)
            }
        }
    )+ };
}

enum_schemas! {
    DismissReason as "DismissReasonName": "Why an alert is dismissed: `temporary`, what is there will be gone again; `people` were standing there; `sensor`, a lidar saw what is not so; `wrong_place`, the map or the vehicle's pose is off there; `other`, as the note says.";
    AlertAction as "AlertActionName": "What can be done with an alert: the last part of a path.";
    AlertStatus as "AlertStatusName": "What became of an alert.";
    AuditAction as "AuditActionName": "What was done.";
    BatchKind as "BatchKindName": "What a batch holds.";
    BatchStatus as "BatchStatusName": "Where a batch is on its way.";
    BeamVerdict as "BeamVerdictName": "What one scan says of a point of another.";
    ChangeKind as "AlertKindName": "What changed.";
    Clearance as "AlertBlockingName": "How near a change is to the way that vehicles took before it: `blocking`, nearer than 0.4 m, half the width of a vehicle; `near`, within 1 m; `clear`, farther off.";
    DeliveryFailure as "DeliveryFailureName": "Why an attempt had no answer.";
    DeliveryStatus as "DeliveryStatusName": "How far a delivery has come.";
    Detector as "DetectorName": "Which rule decides that something changed.";
    EdgeKind as "EdgeKindName": "What made an edge.";
    EdgeStatus as "EdgeStatusName": "Whether an edge is optimised.";
    DecisionResult as "DecisionResult": "What became of a decision: `done`; `already_done`, the alert had that status; `changed`, it is not as `if_match` says; `not_allowed` for its status or kind; `unknown`, there is no such alert; `failed`, the same may succeed later.";
    OperationKind as "OperationKindName": "What an operation does: a `removal` takes uploads out of a route, `decisions` are about several alerts.";
    OperationStatus as "OperationStatusName": "How far an operation has come.";
    MapLayer as "MapLayerName": "What of the world a map shows: what people have `accepted`, without changes that wait for a decision or were dismissed, or everything `observed`.";
    PassOutcome as "PassOutcomeName": "What a pass saw at the place of a change: the `old_state`, the `new_state`, or neither (`could_not_see`: it was within reach, but the place was hidden, or its scans disagree).";
    PassSide as "PassSideName": "Whether a pass was `before` the first observation of the new state, or `since`.";
    RecordingFormat as "RecordingFormatName": "How a recording of a drive is written: `mcap` (a ROS 2 bag, or Foxglove's JSON messages) or `carmen` (a CARMEN log).";
    ResidualMeasurement as "MeasurementName": "Which residuals of the closures.";
    ResidualVerdict as "VerdictName": "What the paper's rule says about a closure.";
    ShownSide as "ShownSideName": "Whose observations to show: those from `before` the change, those `since`, or `both`.";
    Role as "RoleName": "What somebody may do: `vehicle` uploads and reads what became of it; `viewer` reads; `maintainer` also decides about alerts and keeps routes and vehicles; `admin` also makes keys and webhooks and deletes routes.";
    Stage as "RouteStage": "How far a route's reference map has come.";
    Tier as "AlertTierName": "How far an alert is to be believed.";
    VersionAction as "MapVersionAction": "What begins a version: a change was accepted, that was undone, or the version before was released.";
    VersionState as "MapVersionState": "Where a version is in its life: the `draft` grows with every batch; a `released` one is for vehicles; a `retired` one is not any more, or ended without a release. Only the draft changes.";
    ZonePurpose as "ZonePurposeName": "What a zone does with the alerts in it: `mute`, they are recorded and shown, but not sent, and do not count among the open ones.";
    VehicleState as "VehicleState": "Whether what a vehicle sends is believed: `trusted`, nothing speaks against it; `suspect`, an undecided alert of kind `vehicle_suspect` names it, or three of its newest ten batches were kept out of the map; `quarantined`, somebody keeps its uploads out of the map.";
    WebhookEvent as "DeliveryEventName": "What happened, or `webhook.test`.";
    WebhookTopic as "WebhookEventName": "What a webhook can subscribe to: `alert.raised` and `alert.updated`; `batch.quarantined`, an upload was kept out of the map; `vehicle.suspect`, a vehicle has become suspect or quarantined; `operation.finished`, whether it succeeded or failed.";
}
