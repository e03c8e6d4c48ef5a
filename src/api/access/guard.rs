//! The layers that requests pass: whether they are meant for this service, and whether whoever sends
//! them may.

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

/// What every operation needs, by path and method.
pub(in crate::api) struct Rules(HashMap<String, HashMap<String, (Needs, About)>>);

impl Rules {
    /// Of the operations of an OpenAPI document.
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
        // A HEAD is answered as the GET is.
        let method = match parts.method {
            Method::HEAD => &Method::GET,
            ref method => method,
        };
        self.0.get(path.as_str())?.get(method.as_str()).copied()
    }
}

/// Refuses requests that are meant for another host, and changes that another page asks for. Probes ask
/// by whatever name they know, and change nothing.
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

/// Lets a request to an operation pass if whoever sends it may, and states who that is.
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
    let shown = authenticate(state, parts).await?;
    if shown.by_cookie && !is_safe(&parts.method) {
        check_page(state, &parts.headers, true)?;
    }
    let identity = shown.identity;
    if state.is_open() {
        return Ok(identity);
    }
    let Some((needs, about)) = found else {
        let detail = "nobody may use this operation: it has no rule";
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
            "send Authorization: Bearer with a key whose role is {roles}, or sign in on the page"
        );
        return Err(unauthenticated(&detail));
    };
    let has = identity.role.map_or("none", |role| role.name());
    let detail = format!("this needs the role {roles}; {name} has {has}");
    Err(Problem::new(ProblemKind::Forbidden, detail))
}

/// Refuses what belongs to other routes than theirs, in the words of what is not there.
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
            let detail = format!("this is about all routes, and the key is limited to {names}");
            return Err(Problem::new(ProblemKind::Forbidden, detail));
        }
        About::Route => param(&params, "route"),
        // An id that is none is the handler's to refuse; it finds nothing.
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

/// The host that a request is meant for: it stands in its target, or in its header.
fn host(request: &Request) -> Option<&str> {
    let in_target = request
        .uri()
        .authority()
        .map(|authority| authority.as_str());
    in_target.or_else(|| text(request.headers(), header::HOST))
}

fn check_host(state: &ApiState, request: &Request) -> Result<(), Problem> {
    let hosts = request.headers().get_all(header::HOST).iter().count();
    // Browsers send one always; what sends none is no page.
    if hosts == 0 && request.uri().authority().is_none() {
        return Ok(());
    }
    if hosts <= 1 && host(request).is_some_and(|host| state.hosts.is_own(host)) {
        return Ok(());
    }
    let detail = "the service is not known by this Host: ask for it by the address that it listens on, \
                  or start it with --public-url and the name that people use";
    Err(Problem::new(ProblemKind::ForeignHost, detail))
}

/// Whether a change is asked for by a page of the service, or by what is no page. Where a browser adds
/// what shows the identity, it has to say which page it was.
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

/// The connection is closed where a body was not read.
fn refuse(problem: Problem, request: &Request) -> Response {
    match request.body().is_end_stream() {
        true => problem.into_response(),
        false => problem.closing().into_response(),
    }
}
