//! The layers that admit requests: those meant for this service, from senders with the necessary role.

use std::collections::HashMap;
use std::str::FromStr;
use std::sync::Arc;

use axum::body::HttpBody;
use axum::extract::{MatchedPath, RawPathParams, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde_json::Value;

use super::authenticate::{authenticate, unauthenticated};
use super::identity::Identity;
use super::operations::{About, Needs, needs_of};
use crate::api::extract::raw_path;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::{ApiState, alerts, operation, webhooks};
use crate::ids::RouteId;

/// The role that each operation needs, by path and method.
pub(in crate::api) struct Rules(HashMap<String, HashMap<String, (Needs, About)>>);

impl Rules {
    /// The rules of the operations of an OpenAPI document.
    pub(in crate::api) fn of(document: &Value) -> Self {
        let paths = document["paths"].as_object().into_iter().flatten();
        let needs = |(method, operation): (&String, &Value)| {
            let needs = needs_of(operation["operationId"].as_str()?)?;
            Some((method.to_ascii_uppercase(), needs))
        };
        let methods = |item: &Value| {
            let operations = item.as_object().into_iter().flatten();
            operations.filter_map(needs).collect()
        };
        Self(
            paths
                .map(|(path, item)| (path.clone(), methods(item)))
                .collect(),
        )
    }

    fn needs(&self, parts: &Parts) -> Option<(Needs, About)> {
        let path = parts.extensions.get::<MatchedPath>()?;
        // HEAD is answered like GET.
        let method = match parts.method {
            Method::HEAD => &Method::GET,
            ref method => method,
        };
        self.0.get(path.as_str())?.get(method.as_str()).copied()
    }
}

/// Refuses requests for another host, and changes requested by pages of other sites. Probes may use any name, because
/// they change nothing.
pub(in crate::api) async fn check_origin(
    State(state): State<ApiState>,
    request: Request,
    next: Next,
) -> Response {
    let is_probe = ["/livez", "/readyz"].contains(&request.uri().path());
    let checked = match is_probe {
        true => Ok(()),
        false => check_host(&state, &request).and_then(|()| match is_safe(request.method()) {
            true => Ok(()),
            false => check_page(&state, request.headers(), false),
        }),
    };
    match checked {
        Ok(()) => next.run(request).await,
        Err(problem) => refuse(problem, &request),
    }
}

/// Admits a request to an operation if its sender may use it, and adds the sender's identity.
pub(in crate::api) async fn admit(
    State((state, rules)): State<(ApiState, Arc<Rules>)>,
    request: Request,
    next: Next,
) -> Response {
    let (mut parts, body) = request.into_parts();
    let admitted = admitted(&state, &rules, &mut parts).await;
    let mut request = Request::from_parts(parts, body);
    match admitted {
        Ok(identity) => {
            request.extensions_mut().insert(identity);
            next.run(request).await
        }
        Err(problem) => refuse(problem, &request),
    }
}

async fn admitted(state: &ApiState, rules: &Rules, parts: &mut Parts) -> Result<Identity, Problem> {
    let found = rules.needs(parts);
    if let Some((Needs::Nothing, _)) = found {
        return Ok(Identity::nobody());
    }
    let sender = authenticate(state, parts).await?;
    if sender.by_cookie && !is_safe(&parts.method) {
        check_page(state, &parts.headers, true)?;
    }
    let identity = sender.identity;
    if state.is_open() {
        return Ok(identity);
    }
    let Some((needs, about)) = found else {
        let detail = "this operation has no rule, so nobody may use it";
        return Err(Problem::new(ProblemKind::Forbidden, detail));
    };
    check_role(&identity, needs)?;
    if let Some(routes) = &identity.routes
        && needs != Needs::Identity
    {
        check_sees(state, &identity, routes, about, parts).await?;
    }
    Ok(identity)
}

fn check_role(identity: &Identity, needs: Needs) -> Result<(), Problem> {
    if needs.allows(identity.role) {
        return Ok(());
    }
    let roles = needs.roles().unwrap_or("any role");
    let Some(name) = identity.name() else {
        let detail = format!(
            "send Authorization: Bearer with a key whose role is {roles}, or sign in to the console"
        );
        return Err(unauthenticated(&detail));
    };
    let has = identity.role.map_or("none", |role| role.name());
    let detail = format!("this needs the role {roles}; {name} has {has}");
    Err(Problem::new(ProblemKind::Forbidden, detail))
}

/// Refuses what belongs to other routes, as if it did not exist.
async fn check_sees(
    state: &ApiState,
    identity: &Identity,
    routes: &[RouteId],
    about: About,
    parts: &mut Parts,
) -> Result<(), Problem> {
    let params = raw_path(parts, state).await?;
    let route = match about {
        About::Several => return Ok(()),
        About::Service => {
            let names: Vec<&str> = routes.iter().map(RouteId::as_str).collect();
            let names = names.join(", ");
            let detail = format!("this concerns all routes, and the key is limited to {names}");
            return Err(Problem::new(ProblemKind::Forbidden, detail));
        }
        About::Route => param(&params, "route"),
        // A malformed id is left for the handler to refuse.
        About::Alert => match param(&params, "alert") {
            Some(id) => Some(alerts::known_alert(state, id).await?.route_id),
            None => return Ok(()),
        },
        About::Webhook => match param(&params, "webhook") {
            Some(id) => webhooks::known_webhook(state, id).await?.route_id,
            None => return Ok(()),
        },
        About::Operation => {
            let Some(id) = param(&params, "operation") else {
                return Ok(());
            };
            let known = operation::known_operation(state, id).await?;
            return match known.is_within(|route| identity.sees(route)) {
                true => Ok(()),
                false => Err(operation::unknown_operation()),
            };
        }
    };
    if route.is_some_and(|route| identity.sees(&route)) {
        return Ok(());
    }
    Err(match about {
        About::Alert => alerts::unknown_alert(),
        About::Webhook => webhooks::unknown_webhook(),
        About::Route | About::Operation | About::Several | About::Service => {
            Problem::unknown_route()
        }
    })
}

fn param<T: FromStr>(params: &RawPathParams, wanted: &str) -> Option<T> {
    let (_, text) = params.iter().find(|(name, _)| *name == wanted)?;
    text.parse().ok()
}

fn is_safe(method: &Method) -> bool {
    [Method::GET, Method::HEAD].contains(method)
}

/// The host that a request is for: in its target, or in the header `Host`.
fn host(request: &Request) -> Option<&str> {
    let in_target = request
        .uri()
        .authority()
        .map(|authority| authority.as_str());
    in_target.or_else(|| text(request.headers(), header::HOST))
}

fn check_host(state: &ApiState, request: &Request) -> Result<(), Problem> {
    let hosts = request.headers().get_all(header::HOST).iter().count();
    // Browsers always send one; a request without it does not come from a page.
    if hosts == 0 && request.uri().authority().is_none() {
        return Ok(());
    }
    if hosts <= 1 && host(request).is_some_and(|host| state.hosts.is_own(host)) {
        return Ok(());
    }
    let detail = "the service does not have the name in Host: use the address that it listens on, or \
                  start it with --public-url and the name that people use";
    Err(Problem::new(ProblemKind::ForeignHost, detail))
}

/// Checks that a change is requested by a page of the service, or not by a page at all. If the sender is identified by
/// a cookie (`must_say`), the browser must name the page.
fn check_page(state: &ApiState, headers: &HeaderMap, must_say: bool) -> Result<(), Problem> {
    let host = text(headers, header::HOST).unwrap_or_default();
    let fetch_site = text(headers, header::HeaderName::from_static("sec-fetch-site"));
    let is_own = match headers.contains_key(header::ORIGIN) {
        true => {
            let origin = text(headers, header::ORIGIN).unwrap_or_default();
            state.hosts.is_own_origin(origin, host)
        }
        false => match fetch_site {
            Some(site) => ["same-origin", "none"].contains(&site),
            None => !must_say,
        },
    };
    if is_own {
        return Ok(());
    }
    let detail = "changes are taken from the service's own pages alone: send the Origin that the service \
                  is reached by, or a key in Authorization and no Origin";
    Err(Problem::new(ProblemKind::ForeignOrigin, detail))
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// The answer with a problem; closes the connection if a body was not read.
fn refuse(problem: Problem, request: &Request) -> Response {
    match request.body().is_end_stream() {
        true => problem.into_response(),
        false => problem.closing().into_response(),
    }
}
