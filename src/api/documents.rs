//! The OpenAPI document, its browser, and the maintainers' page.

use axum::Router;
use axum::body::Bytes;
use axum::http::{HeaderValue, header};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use utoipa_swagger_ui::{Config, SwaggerUi};

use super::ApiState;
use super::extract::NoQuery;

const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The browser of the vendored Swagger UI sets styles and draws its icons inline.
const DOCS_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// A file of the console: its path, its media type, its text.
macro_rules! console {
    ($path:literal, $media_type:ident, $name:literal) => {
        ($path, $media_type, include_str!(concat!("page/", $name)))
    };
}

/// The maintainers' console, but `/words.js`.
pub(super) const CONSOLE: [(&str, &str, &str); 15] = [
    console!("/", HTML, "index.html"),
    console!("/console.css", STYLE, "console.css"),
    console!("/app.js", SCRIPT, "app.js"),
    console!("/decide.js", SCRIPT, "decide.js"),
    console!("/dom.js", SCRIPT, "dom.js"),
    console!("/evidence.js", SCRIPT, "evidence.js"),
    console!("/format.js", SCRIPT, "format.js"),
    console!("/http.js", SCRIPT, "http.js"),
    console!("/inbox.js", SCRIPT, "inbox.js"),
    console!("/live.js", SCRIPT, "live.js"),
    console!("/map.js", SCRIPT, "map.js"),
    console!("/panel.js", SCRIPT, "panel.js"),
    console!("/route.js", SCRIPT, "route.js"),
    console!("/state.js", SCRIPT, "state.js"),
    console!("/texts.js", SCRIPT, "texts.js"),
];

/// `/openapi.json`, `/docs` and the console, whose words for enumerations are those of the model.
pub(super) fn router(openapi: Bytes, words: Bytes) -> Router<ApiState> {
    let docs = SwaggerUi::new("/docs").config(Config::new(["/openapi.json"]));
    let docs = Router::from(docs).layer(from_fn(|request, next: Next| async move {
        with_policy(next.run(request).await, DOCS_POLICY)
    }));
    let document =
        move |_: NoQuery| async move { ([(header::CONTENT_TYPE, "application/json")], openapi) };
    let mut router = Router::new()
        .route("/openapi.json", get(document))
        .route("/words.js", get(move || file(SCRIPT, words)));
    for (path, media_type, text) in CONSOLE {
        router = router.route(path, get(move || file(media_type, text)));
    }
    router.merge(docs)
}

async fn file(media_type: &'static str, text: impl IntoResponse) -> Response {
    let headers = [
        (header::CONTENT_TYPE, media_type),
        (header::CACHE_CONTROL, "no-cache"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    with_policy((headers, text).into_response(), PAGE_POLICY)
}

fn with_policy(mut response: Response, policy: &'static str) -> Response {
    let policy = HeaderValue::from_static(policy);
    response
        .headers_mut()
        .insert(header::CONTENT_SECURITY_POLICY, policy);
    response
}
