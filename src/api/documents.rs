//! The OpenAPI document, its browser, and the maintainers' console.

use axum::Router;
use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};
use utoipa_swagger_ui::{Config, SwaggerUi};

use super::ApiState;
use super::extract::NoQuery;

const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The vendored Swagger UI sets styles and draws its icons inline.
const DOCS_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

pub(super) const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
pub(super) const STYLE: &str = "text/css; charset=utf-8";

/// A file of the console: its path, its media type, its text.
macro_rules! console {
    ($path:literal, $media_type:ident, $name:literal) => {
        ($path, $media_type, include_str!(concat!("page/", $name)))
    };
}

/// The files of the maintainers' console, except `/words.js`.
pub(super) const CONSOLE: [(&str, &str, &str); 45] = [
    console!("/", HTML, "index.html"),
    console!("/console.css", STYLE, "console.css"),
    console!("/views.css", STYLE, "views.css"),
    console!("/address.js", SCRIPT, "address.js"),
    console!("/alert_facts.js", SCRIPT, "alert_facts.js"),
    console!("/app.js", SCRIPT, "app.js"),
    console!("/audit.js", SCRIPT, "audit.js"),
    console!("/batches.js", SCRIPT, "batches.js"),
    console!("/decide.js", SCRIPT, "decide.js"),
    console!("/dialog.js", SCRIPT, "dialog.js"),
    console!("/discussion.js", SCRIPT, "discussion.js"),
    console!("/dom.js", SCRIPT, "dom.js"),
    console!("/evidence.js", SCRIPT, "evidence.js"),
    console!("/filters.js", SCRIPT, "filters.js"),
    console!("/format.js", SCRIPT, "format.js"),
    console!("/http.js", SCRIPT, "http.js"),
    console!("/inbox.js", SCRIPT, "inbox.js"),
    console!("/keys.js", SCRIPT, "keys.js"),
    console!("/live.js", SCRIPT, "live.js"),
    console!("/map.js", SCRIPT, "map.js"),
    console!("/map_colours.js", SCRIPT, "map_colours.js"),
    console!("/map_input.js", SCRIPT, "map_input.js"),
    console!("/map_layers.js", SCRIPT, "map_layers.js"),
    console!("/map_lines.js", SCRIPT, "map_lines.js"),
    console!("/map_marks.js", SCRIPT, "map_marks.js"),
    console!("/map_overlay.js", SCRIPT, "map_overlay.js"),
    console!("/map_scan.js", SCRIPT, "map_scan.js"),
    console!("/map_tiles.js", SCRIPT, "map_tiles.js"),
    console!("/map_view.js", SCRIPT, "map_view.js"),
    console!("/palette.js", SCRIPT, "palette.js"),
    console!("/panel.js", SCRIPT, "panel.js"),
    console!("/passes.js", SCRIPT, "passes.js"),
    console!("/questions.js", SCRIPT, "questions.js"),
    console!("/report.js", SCRIPT, "report.js"),
    console!("/residuals.js", SCRIPT, "residuals.js"),
    console!("/route.js", SCRIPT, "route.js"),
    console!("/settings.js", SCRIPT, "settings.js"),
    console!("/several.js", SCRIPT, "several.js"),
    console!("/shown.js", SCRIPT, "shown.js"),
    console!("/sign_in.js", SCRIPT, "sign_in.js"),
    console!("/state.js", SCRIPT, "state.js"),
    console!("/texts.js", SCRIPT, "texts.js"),
    console!("/vehicles.js", SCRIPT, "vehicles.js"),
    console!("/versions.js", SCRIPT, "versions.js"),
    console!("/zones.js", SCRIPT, "zones.js"),
];

/// `/openapi.json`, `/docs` and the console; its words for enumerations are `words`.
pub(super) fn router(openapi: Bytes, words: Bytes) -> Router<ApiState> {
    let docs = SwaggerUi::new("/docs").config(Config::new(["/openapi.json"]));
    let docs = Router::from(docs).layer(from_fn(|request, next: Next| async move {
        with_policy(next.run(request).await, DOCS_POLICY)
    }));
    let document =
        move |_: NoQuery| async move { ([(header::CONTENT_TYPE, "application/json")], openapi) };
    let mut router = Router::new()
        .route("/openapi.json", get(document))
        .route("/words.js", file(SCRIPT, words));
    for (path, media_type, text) in CONSOLE {
        router = router.route(path, file(media_type, Bytes::from_static(text.as_bytes())));
    }
    router.merge(docs)
}

/// Serves a text with an ETag, which a browser uses to keep its copy.
pub(super) fn file(media_type: &'static str, text: Bytes) -> MethodRouter<ApiState> {
    let tag = format!("W/\"{}\"", STANDARD.encode(Sha256::digest(&text)));
    get(move |request: HeaderMap| async move {
        let known = request.get(header::IF_NONE_MATCH);
        let is_known = known.is_some_and(|known| known.as_bytes() == tag.as_bytes());
        let headers = [
            (header::CONTENT_TYPE, media_type.to_owned()),
            (header::CACHE_CONTROL, "no-cache".to_owned()),
            (header::REFERRER_POLICY, "no-referrer".to_owned()),
            (header::ETAG, tag),
        ];
        let response = if is_known {
            (StatusCode::NOT_MODIFIED, headers).into_response()
        } else {
            (headers, text).into_response()
        };
        with_policy(response, PAGE_POLICY)
    })
}

fn with_policy(mut response: Response, policy: &'static str) -> Response {
    let policy = HeaderValue::from_static(policy);
    response
        .headers_mut()
        .insert(header::CONTENT_SECURITY_POLICY, policy);
    response
}
