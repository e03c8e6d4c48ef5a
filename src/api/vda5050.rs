//! A released version of a map as VDA 5050 actions.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::parameters::{RouteParam, VersionParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::VersionUseProblems;
use super::types::hex;
use super::versions::known_version;
use crate::ids::RouteId;
use crate::model::VersionState;

/// Which edition of VDA 5050.
#[derive(Debug, Clone, Copy, Default, Deserialize, ToSchema)]
#[schema(as = Vda5050Edition)]
enum Edition {
    #[default]
    #[serde(rename = "2.1")]
    V2_1,
    #[serde(rename = "3.0")]
    V3_0,
}

/// Which edition to use.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EditionQuery {
    /// Edition of VDA 5050; `2.1` by default.
    #[param(nullable = false, inline)]
    vda5050: Option<Edition>,
}

/// The parts of an `instantActions` message that do not depend on the vehicle; the sender adds `headerId`,
/// `timestamp`, `manufacturer` and `serialNumber`.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Vda5050InstantActions)]
pub(super) struct InstantActionsBody {
    /// Edition of VDA 5050 of the message.
    version: &'static str,
    /// `downloadMap`, then `enableMap`, to be sent once the vehicle has reported the download as `FINISHED`.
    actions: Vec<ActionBody>,
}

/// An action of VDA 5050.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Vda5050Action)]
#[serde(rename_all = "camelCase")]
struct ActionBody {
    /// `downloadMap` or `enableMap`.
    action_type: &'static str,
    /// The same for the same version of a route's map; replace it to send an action to a vehicle again.
    action_id: String,
    /// `NONE`: neither action stops the vehicle; edition 3.0 allows nothing else for instant actions.
    blocking_type: &'static str,
    /// `mapId` and `mapVersion`; for a download also `mapDownloadLink` and `mapHash`, the SHA-256 of the PGM.
    action_parameters: Vec<ParameterBody>,
}

/// A parameter of an action.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Vda5050ActionParameter)]
struct ParameterBody {
    /// Its name.
    key: &'static str,
    /// Its value.
    value: String,
}

/// Read the VDA 5050 actions that download and enable a version.
///
/// Only for a released version. `mapId` is the name of the route, `mapVersion` the number of the version. The
/// link begins with the service's public URL or, if none is set, with `http://` and the host that this request
/// was sent to.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/vda5050", tag = "map",
    params(RouteParam, VersionParam, EditionQuery),
    responses((status = 200, description = "The actions", body = InstantActionsBody), VersionUseProblems)
)]
pub(super) async fn get_vda5050(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    ApiQuery(query): ApiQuery<EditionQuery>,
    headers: HeaderMap,
) -> Result<Json<InstantActionsBody>, Problem> {
    let record = known_version(&state, &route_id, version).await?;
    let sha256 = record
        .sha256
        .filter(|_| record.state() == VersionState::Released);
    let sha256 = sha256.ok_or_else(|| {
        let name = record.state().name();
        let detail = format!("version {version} is {name}: vehicles get only released versions");
        Problem::new(ProblemKind::VersionState, detail)
    })?;
    let origin = origin(&state, &headers)?;
    let link = format!("{origin}/v1/routes/{route_id}/versions/{version}/map.pgm");
    let map = || {
        let (id, version) = (route_id.to_string(), version.to_string());
        vec![parameter("mapId", id), parameter("mapVersion", version)]
    };
    let mut download = map();
    download.push(parameter("mapDownloadLink", link));
    download.push(parameter("mapHash", hex(&sha256)));
    let action = |action_type, action_parameters| ActionBody {
        action_type,
        action_id: format!("{action_type}-{route_id}-{version}"),
        blocking_type: "NONE",
        action_parameters,
    };
    Ok(Json(InstantActionsBody {
        version: match query.vda5050.unwrap_or_default() {
            Edition::V2_1 => "2.1.0",
            Edition::V3_0 => "3.0.0",
        },
        actions: vec![action("downloadMap", download), action("enableMap", map())],
    }))
}

/// Scheme and host under which vehicles reach the service.
fn origin(state: &ApiState, request: &HeaderMap) -> Result<String, Problem> {
    if let Some(origin) = state.hosts.public_origin() {
        return Ok(origin.to_owned());
    }
    let host = request.get(header::HOST);
    let host = host.and_then(|host| host.to_str().ok()).ok_or_else(|| {
        let detail =
            "send the header Host, from which the link is made, or set the service's public URL";
        Problem::new(ProblemKind::BadRequest, detail)
    })?;
    Ok(format!("http://{host}"))
}

fn parameter(key: &'static str, value: String) -> ParameterBody {
    ParameterBody { key, value }
}
