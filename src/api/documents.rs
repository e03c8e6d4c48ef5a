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

const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The browser of the vendored Swagger UI sets styles and draws its icons inline.
const DOCS_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// `/openapi.json`, `/docs` and `/`, whose words for enumerations are those of the model.
pub(super) fn router(openapi: Bytes, words: Bytes) -> Router<ApiState> {
    let docs = SwaggerUi::new("/docs").config(Config::new(["/openapi.json"]));
    let docs = Router::from(docs).layer(from_fn(|request, next: Next| async move {
        with_policy(next.run(request).await, DOCS_POLICY)
    }));
    let document =
        move |_: NoQuery| async move { ([(header::CONTENT_TYPE, "application/json")], openapi) };
    Router::new()
        .route("/openapi.json", get(document))
        .route(
            "/",
            get(|| file("text/html; charset=utf-8", include_str!("page/index.html"))),
        )
        .route(
            "/page.js",
            get(|| {
                file(
                    "text/javascript; charset=utf-8",
                    include_str!("page/page.js"),
                )
            }),
        )
        .route(
            "/alerts.js",
            get(|| {
                file(
                    "text/javascript; charset=utf-8",
                    include_str!("page/alerts.js"),
                )
            }),
        )
        .route(
            "/words.js",
            get(move || file("text/javascript; charset=utf-8", words)),
        )
        .route(
            "/page.css",
            get(|| file("text/css; charset=utf-8", include_str!("page/page.css"))),
        )
        .merge(docs)
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
