//! The OpenAPI schemas of the enumerations in [`model`](crate::model): their values come from its
//! tables, and the descriptions for people stand here.

use std::borrow::Cow;

use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::model::{
    AlertAction, AlertEventKind, AlertStatus, AuditAction, BatchKind, BatchStatus, BeamVerdict,
    ChangeKind, DeliveryFailure, DeliveryStatus, Detector, DismissReason, EdgeKind, EdgeStatus,
    MapLayer, OperationStatus, ResidualMeasurement, ResidualVerdict, Stage, TextEnum, Tier,
    VersionAction, VersionState, WebhookEvent,
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
    AlertEventKind as "WebhookEventName": "What a webhook can tell of.";
    AlertStatus as "AlertStatusName": "What became of an alert.";
    AuditAction as "AuditActionName": "What was done.";
    BatchKind as "BatchKindName": "What a batch holds.";
    BatchStatus as "BatchStatusName": "Where a batch is on its way.";
    BeamVerdict as "BeamVerdictName": "What one scan says of a point of another.";
    ChangeKind as "AlertKindName": "What changed.";
    DeliveryFailure as "DeliveryFailureName": "Why an attempt had no answer.";
    DeliveryStatus as "DeliveryStatusName": "How far a delivery has come.";
    Detector as "DetectorName": "Which rule decides that something changed.";
    EdgeKind as "EdgeKindName": "What made an edge.";
    EdgeStatus as "EdgeStatusName": "Whether an edge is optimised.";
    OperationStatus as "OperationStatusName": "How far an operation has come.";
    MapLayer as "MapLayerName": "What of the world a map shows: what people have `accepted`, without changes that wait for a decision or were dismissed, or everything `observed`.";
    ResidualMeasurement as "MeasurementName": "Which residuals of the closures.";
    ResidualVerdict as "VerdictName": "What the paper's rule says about a closure.";
    Stage as "RouteStage": "How far a route's reference map has come.";
    Tier as "AlertTierName": "How far an alert is to be believed.";
    VersionAction as "MapVersionAction": "What begins a version: a change was accepted, that was undone, or the version before was released.";
    VersionState as "MapVersionState": "Where a version is in its life: the `draft` grows with every batch; a `released` one is for vehicles; a `retired` one is not any more, or ended without a release. Only the draft changes.";
    WebhookEvent as "DeliveryEventName": "What a delivery tells of.";
}
