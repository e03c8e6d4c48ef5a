//! The OpenAPI schemas of the enumerations in [`model`](crate::model): the values come from its tables, the
//! descriptions are here.

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

/// The schema of a text that is one of a list.
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
    DismissReason as "DismissReasonName": "Why an alert is dismissed: `temporary`, the change will not last; `people` were standing there; `sensor`, a lidar measured wrongly; `wrong_place`, the map or the vehicle's pose is wrong there; `other`, see the note.";
    AlertAction as "AlertActionName": "An action on an alert: the last part of a path.";
    AlertStatus as "AlertStatusName": "Whether an alert awaits a decision, and what was decided.";
    AuditAction as "AuditActionName": "The change that was made.";
    BatchKind as "BatchKindName": "What a batch contains.";
    BatchStatus as "BatchStatusName": "How far a batch has been processed.";
    BeamVerdict as "BeamVerdictName": "How one scan judges a beam of another.";
    ChangeKind as "AlertKindName": "What changed.";
    Clearance as "AlertBlockingName": "How near a change is to the path that vehicles took before it: `blocking`, nearer than 0.4 m, half the width of a vehicle; `near`, within 1 m; `clear`, farther away.";
    DeliveryFailure as "DeliveryFailureName": "Why an attempt got no answer.";
    DeliveryStatus as "DeliveryStatusName": "The status of a delivery.";
    Detector as "DetectorName": "The rule that decides whether something changed.";
    EdgeKind as "EdgeKindName": "How an edge was measured.";
    EdgeStatus as "EdgeStatusName": "Whether an edge takes part in the optimisation.";
    DecisionResult as "DecisionResult": "The outcome of a decision: `done`; `already_done`, the alert already had that status; `changed`, it does not have the ETag in `if_match`; `not_allowed` for its status or kind; `unknown`, there is no such alert; `failed`, the same may succeed later.";
    OperationKind as "OperationKindName": "What an operation does: a `removal` removes uploads from a route, `decisions` concern several alerts.";
    OperationStatus as "OperationStatusName": "The status of an operation.";
    MapLayer as "MapLayerName": "Which state of the world a map shows: what people have `accepted`, without changes that await a decision or were dismissed, or everything `observed`.";
    PassOutcome as "PassOutcomeName": "What a pass observed at the place of a change: the `old_state`, the `new_state`, or neither (`could_not_see`: the place was within reach, but hidden, or its scans disagree).";
    PassSide as "PassSideName": "Whether a pass was `before` the first observation of the new state, or `since`.";
    RecordingFormat as "RecordingFormatName": "The format of a recording: `mcap` (a ROS 2 bag, or Foxglove's JSON messages) or `carmen` (a CARMEN log).";
    ResidualMeasurement as "MeasurementName": "Which residuals of loop closures.";
    ResidualVerdict as "VerdictName": "The verdict of the paper's rule on a loop closure.";
    ShownSide as "ShownSideName": "Which observations to show: those from `before` the change, those `since`, or `both`.";
    Role as "RoleName": "What the holder of a key may do: `vehicle` uploads, and reads its own uploads; `viewer` reads; `maintainer` also decides about alerts and manages routes and vehicles; `admin` also manages keys and webhooks and deletes routes.";
    Stage as "RouteStage": "Whether a route's reference map is still being built.";
    Tier as "AlertTierName": "How well an alert is supported: `tentative`, one pass has shown the new state so far; `confirmed`, two passes or two vehicles have.";
    VersionAction as "MapVersionAction": "What began a version: a change was accepted, an acceptance was undone, or the previous version was released.";
    VersionState as "MapVersionState": "The state of a version: the `draft` grows with every batch; a `released` one is for vehicles; a `retired` one no longer is, or ended without a release. Only the draft changes.";
    ZonePurpose as "ZonePurposeName": "The effect of a zone on the alerts in it: `mute`, they are recorded and shown, but not sent, and do not count among the open ones.";
    VehicleState as "VehicleState": "Whether a vehicle's uploads are trusted: `trusted`, there is no reason to doubt them; `suspect`, an undecided alert of kind `vehicle_suspect` names it, or three of its newest ten batches were kept out of the map; `quarantined`, somebody keeps its uploads out of the map.";
    WebhookEvent as "DeliveryEventName": "What happened, or `webhook.test`.";
    WebhookTopic as "WebhookEventName": "What a webhook can subscribe to: `alert.raised` and `alert.updated`; `batch.quarantined`, an upload was kept out of the map; `vehicle.suspect`, a vehicle has become suspect or quarantined; `operation.finished`, whether it succeeded or failed.";
}
