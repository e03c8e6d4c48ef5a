//! The pages that the `type` of a problem refers to, made from the table of problems.

use axum::Router;
use axum::body::Bytes;

use super::ApiState;
use super::documents::{HTML, STYLE, file};
use super::problem::ProblemKind;

const STYLE_SHEET: &str = include_str!("page/problems.css");

/// `/problems`, a page for each problem, and their style sheet.
pub(super) fn router() -> Router<ApiState> {
    let mut router = Router::new()
        .route("/problems", file(HTML, list().into()))
        .route(
            "/problems.css",
            file(STYLE, Bytes::from_static(STYLE_SHEET.as_bytes())),
        );
    for kind in ProblemKind::ALL {
        let path = format!("/problems/{}", kind.name());
        router = router.route(&path, file(HTML, page(*kind).into()));
    }
    router
}

fn list() -> String {
    let item = |kind: &ProblemKind| {
        format!(
            "<tr><td><a href=\"/problems/{name}\">{name}</a></td><td>{}</td><td>{}</td></tr>\n",
            kind.status().as_u16(),
            kind.title(),
            name = kind.name(),
        )
    };
    let items: String = ProblemKind::ALL.iter().map(item).collect();
    document(
        "Problems",
        &format!(
            "<h1>Problems</h1>\n<p>The errors that the service answers with: the <code>type</code> of the answer is \
             one of these.</p>\n<table>\n\
             <tr><th>type</th><th>status</th><th>title</th></tr>\n{items}</table>\n"
        ),
    )
}

fn page(kind: ProblemKind) -> String {
    let body = format!(
        "<p><a href=\"/problems\">All problems</a></p>\n<h1>{title}</h1>\n\
         <p>Type <code>/problems/{name}</code>, status {status}.</p>\n\
         <h2>What happened</h2>\n<p>{cause}</p>\n\
         <h2>What to do</h2>\n<p>{remedy}</p>\n\
         <h2>Does repeating help?</h2>\n<p>{repeating}</p>\n\
         <p class=\"note\">The answer itself has more: <code>detail</code> says what happened in this case, \
         <code>errors</code> where in the request, and <code>instance</code> is the request id under which the \
         service logs it.</p>\n",
        title = kind.title(),
        name = kind.name(),
        status = kind.status(),
        cause = with_code(kind.cause()),
        remedy = with_code(kind.remedy()),
        repeating = with_code(kind.repeating().text()),
    );
    document(kind.title(), &body)
}

fn document(title: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title} · mapshift</title>\n\
         <link rel=\"stylesheet\" href=\"/problems.css\">\n</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n"
    )
}

/// A text of the table as HTML: text between backticks becomes code.
fn with_code(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts
        .map(|(k, part)| match k % 2 {
            0 => part.to_owned(),
            _ => format!("<code>{part}</code>"),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_the_table_are_plain() {
        for kind in ProblemKind::ALL {
            for text in [kind.title(), kind.cause(), kind.remedy()] {
                assert!(!text.contains(['<', '>', '&']), "{}", kind.name());
                assert_eq!(text.matches('`').count() % 2, 0, "{}", kind.name());
            }
        }
        assert_eq!(with_code("send `A` now"), "send <code>A</code> now");
    }
}
