//! The table of what each operation needs. An operation that is not in it is refused.

use crate::model::Role;

/// Who may use an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Needs {
    /// Anybody may use it, without authentication and under any host name. For probes.
    Nothing,
    /// Anybody may use it; the answer depends on who they are.
    Identity,
    /// Vehicles, for their own uploads, and maintainers: viewers only read.
    Upload,
    /// Vehicles, for their own uploads and their poses in the map, and viewers.
    OwnUpload,
    /// Holders of this role or a higher one.
    Role(Role),
}

/// What an operation concerns, for keys that are limited to routes: everything else does not exist for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum About {
    /// The route in the path.
    Route,
    /// The route of the alert in the path.
    Alert,
    /// The route of the webhook in the path.
    Webhook,
    /// The route of the operation in the path.
    Operation,
    /// Several routes: the handler leaves out those that the key does not cover.
    Several,
    /// The service as a whole: refused to such keys, unless anybody may use it.
    Service,
}

use About::{Alert, Operation, Route, Service, Several, Webhook};
use Needs::{Identity, Nothing, OwnUpload, Upload};

const VIEWER: Needs = Needs::Role(Role::Viewer);
const MAINTAINER: Needs = Needs::Role(Role::Maintainer);
const ADMIN: Needs = Needs::Role(Role::Admin);

/// Operations by their ids in the OpenAPI document.
pub(super) const OPERATIONS: &[(&str, Needs, About)] = &[
    ("livez", Nothing, Service),
    ("readyz", Nothing, Service),
    ("metrics", VIEWER, Service),
    ("get_session", Identity, Service),
    ("sign_in", Identity, Service),
    ("sign_out", Identity, Service),
    ("list_keys", ADMIN, Service),
    ("create_key", ADMIN, Service),
    ("get_key", ADMIN, Service),
    ("revoke_key", ADMIN, Service),
    ("list_audit", MAINTAINER, Several),
    ("export_audit", MAINTAINER, Several),
    ("list_routes", VIEWER, Several),
    ("get_route", VIEWER, Route),
    ("put_route", MAINTAINER, Route),
    ("delete_route", ADMIN, Route),
    ("put_batch", Upload, Route),
    ("put_recording", Upload, Route),
    ("put_edge_batch", Upload, Route),
    ("get_batch", OwnUpload, Route),
    ("list_batches", OwnUpload, Route),
    ("retry_batch", MAINTAINER, Route),
    ("post_removal", MAINTAINER, Route),
    ("get_operation", VIEWER, Operation),
    ("list_vehicles", VIEWER, Route),
    ("get_vehicle", VIEWER, Route),
    ("quarantine_vehicle", MAINTAINER, Route),
    ("release_vehicle", MAINTAINER, Route),
    ("get_graph", VIEWER, Route),
    ("get_graph_g2o", VIEWER, Route),
    ("list_nodes", VIEWER, Route),
    ("get_node", OwnUpload, Route),
    ("get_node_scan", VIEWER, Route),
    ("list_edges", VIEWER, Route),
    ("get_edge", VIEWER, Route),
    ("list_subgraphs", VIEWER, Route),
    ("get_trajectory", OwnUpload, Route),
    ("get_trajectory_tum", VIEWER, Route),
    ("get_residuals", VIEWER, Route),
    ("get_map_png", VIEWER, Route),
    ("get_map_pgm", VIEWER, Route),
    ("get_map_yaml", VIEWER, Route),
    ("list_versions", VIEWER, Route),
    ("get_version", VIEWER, Route),
    ("get_vda5050", VIEWER, Route),
    ("release_version", MAINTAINER, Route),
    ("retire_version", MAINTAINER, Route),
    ("get_tiles", VIEWER, Route),
    ("get_tile", VIEWER, Route),
    ("get_trajectory_layer", VIEWER, Route),
    ("get_residual_layer", VIEWER, Route),
    ("get_keyframe_layer", VIEWER, Route),
    ("list_trips", VIEWER, Route),
    ("get_version_diff", VIEWER, Route),
    ("get_version_diff_png", VIEWER, Route),
    ("get_version_png", VIEWER, Route),
    ("get_version_pgm", VIEWER, Route),
    ("get_version_yaml", VIEWER, Route),
    ("list_alerts", VIEWER, Several),
    ("list_alerts_geojson", VIEWER, Several),
    ("stream_alerts", VIEWER, Several),
    ("get_alert", VIEWER, Alert),
    ("get_evidence", VIEWER, Alert),
    ("get_evidence_svg", VIEWER, Alert),
    ("list_alert_passes", VIEWER, Alert),
    ("get_observations", VIEWER, Alert),
    ("get_observations_svg", VIEWER, Alert),
    ("acknowledge_alert", MAINTAINER, Alert),
    ("accept_alert", MAINTAINER, Alert),
    ("dismiss_alert", MAINTAINER, Alert),
    ("reopen_alert", MAINTAINER, Alert),
    ("undo_alert", MAINTAINER, Alert),
    ("decide_alerts", MAINTAINER, Several),
    ("preview_alert", VIEWER, Alert),
    ("assign_alert", MAINTAINER, Alert),
    ("comment_on_alert", MAINTAINER, Alert),
    ("list_alert_comments", VIEWER, Alert),
    ("list_zones", VIEWER, Route),
    ("create_zone", MAINTAINER, Route),
    ("get_zone", VIEWER, Route),
    ("put_zone", MAINTAINER, Route),
    ("delete_zone", MAINTAINER, Route),
    ("get_report", VIEWER, Several),
    ("list_webhooks", MAINTAINER, Several),
    ("get_webhook", MAINTAINER, Webhook),
    ("list_deliveries", MAINTAINER, Webhook),
    ("register_webhook", ADMIN, Service),
    ("change_webhook", ADMIN, Webhook),
    ("delete_webhook", ADMIN, Webhook),
    ("rotate_webhook_secret", ADMIN, Webhook),
    ("test_webhook", ADMIN, Webhook),
];

/// What an operation needs; `None` for one that is not in the table.
pub(super) fn needs_of(operation_id: &str) -> Option<(Needs, About)> {
    let mut table = OPERATIONS.iter();
    let found = table.find(|(id, ..)| *id == operation_id);
    found.map(|(_, needs, about)| (*needs, *about))
}

impl Needs {
    /// Whether a sender with this role may use the operation.
    pub(super) fn allows(self, role: Option<Role>) -> bool {
        match (self, role) {
            (Self::Nothing | Self::Identity, _) => true,
            (_, None) => false,
            (Self::Upload, Some(role)) => role != Role::Viewer,
            (Self::OwnUpload, Some(_)) => true,
            (Self::Role(least), Some(role)) => role >= least,
        }
    }

    /// The sufficient roles in words; `None` if no role is needed.
    pub(super) fn roles(self) -> Option<&'static str> {
        match self {
            Self::Nothing | Self::Identity => None,
            Self::Upload => Some("vehicle, maintainer or admin"),
            Self::OwnUpload => Some("vehicle, viewer, maintainer or admin"),
            Self::Role(Role::Vehicle) => Some("vehicle"),
            Self::Role(Role::Viewer) => Some("viewer, maintainer or admin"),
            Self::Role(Role::Maintainer) => Some("maintainer or admin"),
            Self::Role(Role::Admin) => Some("admin"),
        }
    }

    /// The lowest sufficient role; `None` if no role is needed.
    pub(super) fn least_role(self) -> Option<Role> {
        match self {
            Self::Nothing | Self::Identity => None,
            Self::Upload | Self::OwnUpload => Some(Role::Vehicle),
            Self::Role(role) => Some(role),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::api::openapi_document;

    /// The parameter of the path that names what an operation concerns.
    fn parameter(about: About) -> Option<&'static str> {
        match about {
            Route => Some("{route}"),
            Alert => Some("{alert}"),
            Webhook => Some("{webhook}"),
            Operation => Some("{operation}"),
            Several | Service => None,
        }
    }

    #[test]
    fn every_operation_is_in_the_table_once_and_concerns_what_its_path_names() {
        let document = openapi_document().unwrap();
        let mut documented = BTreeSet::new();
        for (path, item) in document["paths"].as_object().unwrap() {
            for operation in item.as_object().unwrap().values() {
                let id = operation["operationId"].as_str().unwrap();
                let found = needs_of(id);
                let (_, about) = found.unwrap_or_else(|| panic!("{id} is not in the table"));
                match parameter(about) {
                    Some(named) => assert!(path.contains(named), "{id}"),
                    None => assert!(!path.contains('{') || path.contains("{key}"), "{id}"),
                }
                assert!(documented.insert(id.to_owned()), "{id}");
            }
        }
        let listed: BTreeSet<String> = OPERATIONS.iter().map(|(id, ..)| (*id).to_owned()).collect();
        assert_eq!(listed, documented);
        assert_eq!(
            OPERATIONS.len(),
            documented.len(),
            "an operation is in the table twice"
        );
    }

    #[test]
    fn viewers_may_not_upload() {
        assert!(Upload.allows(Some(Role::Vehicle)) && Upload.allows(Some(Role::Maintainer)));
        assert!(!Upload.allows(Some(Role::Viewer)) && !Upload.allows(None));
        assert!(!MAINTAINER.allows(Some(Role::Viewer)) && MAINTAINER.allows(Some(Role::Admin)));
    }
}
