//! What keeps answers short: ETags of lists, and gzip.

use std::io::Read;

use crate::access::operations;
use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::service::Service;

async fn get(service: &Service, path: &str, header: (&str, &str)) -> Answer {
    let request = Request::new("GET", path).header(header.0, header.1);
    service.send(request).await
}

#[tokio::test]
async fn a_client_with_a_valid_copy_of_a_list_gets_304() {
    let service = changed_hall::start().await;
    for path in [
        "/v1/routes",
        "/v1/alerts?status=open",
        "/v1/routes/hall/versions",
        "/v1/routes/hall/vehicles",
        "/v1/routes/hall/batches",
    ] {
        let list = service.get(path).await;
        let tag = list.header("etag").unwrap();
        assert!(tag.starts_with("W/\""), "{path}: {tag}");
        assert_eq!(list.header("cache-control"), Some("no-cache"), "{path}");
        let again = get(&service, path, ("if-none-match", tag)).await;
        assert_eq!((again.status, again.body.len()), (304, 0), "{path}");
        assert_eq!(again.header("etag"), Some(tag));
    }
    let open = service.get("/v1/alerts?status=open").await;
    let dismiss = Request::new("POST", format!("/v1/alerts/{APPEARED}/dismiss"));
    assert_eq!(
        service.send(dismiss.header("if-match", "*")).await.status,
        200
    );
    let tag = open.header("etag").unwrap();
    let changed = get(&service, "/v1/alerts?status=open", ("if-none-match", tag)).await;
    assert_eq!(changed.status, 200);
    // The rest of an alert changes under the tag of its decision.
    let alert = service.get(&format!("/v1/alerts/{APPEARED}")).await;
    let tag = alert.header("etag").unwrap();
    let path = format!("/v1/alerts/{APPEARED}");
    assert_eq!(
        get(&service, &path, ("if-none-match", tag)).await.status,
        200
    );
    service.stop().await;
}

#[tokio::test]
async fn text_is_compressed_for_clients_that_accept_gzip() {
    let service = changed_hall::start().await;
    for path in ["/v1/alerts", "/v1/routes/hall/graph"] {
        let plain = service.get(path).await;
        assert_eq!(plain.header("content-encoding"), None, "{path}");
        assert_eq!(plain.header("vary"), Some("accept-encoding"), "{path}");
        let short = get(&service, path, ("accept-encoding", "br, gzip")).await;
        assert_eq!(short.header("content-encoding"), Some("gzip"), "{path}");
        let mut read = Vec::new();
        let mut decoder = flate2::read::GzDecoder::new(&*short.body);
        decoder.read_to_end(&mut read).unwrap();
        assert!(read == plain.body, "{path}");
        assert!(short.body.len() < plain.body.len(), "{path}");
    }
    for path in ["/v1/routes/hall/map.png", "/livez", "/v1/routes/nowhere"] {
        let answer = get(&service, path, ("accept-encoding", "gzip")).await;
        assert_eq!(answer.header("content-encoding"), None, "{path}");
    }
    service.stop().await;
}

#[tokio::test]
async fn the_document_states_which_answers_have_an_etag() {
    let service = changed_hall::start().await;
    let release = Request::new("POST", "/v1/routes/hall/versions/1/release");
    assert_eq!(service.send(release).await.status, 200);
    let document = mapshift::api::openapi_document().unwrap();
    let mut named = 0;
    for (id, _, template) in operations().into_iter().filter(|(_, get, _)| *get == "GET") {
        let documented = &document["paths"][&template]["get"]["responses"];
        let is_json = documented["200"]["content"]
            .get("application/json")
            .is_some();
        let mut path = template;
        for (parameter, name) in [
            ("{route}", "hall"),
            ("{batch}", "b-0"),
            ("{vehicle}", "agv-07"),
            ("{trip}", "trip-1"),
            ("{node}", "1"),
            ("{edge}", "3"),
            ("{version}", "1"),
            ("{alert}", APPEARED),
        ] {
            path = path.replace(parameter, name);
        }
        match id.as_str() {
            "get_version_diff" => path.push_str("?from=1"),
            // Else it ends now.
            "get_report" => path.push_str("?since=2026-11-20T06:00:00Z&until=2026-11-20T14:00:00Z"),
            _ => {}
        }
        if !is_json || path.contains('{') {
            continue;
        }
        let answer = service.get(&path).await;
        assert_eq!(answer.status, 200, "{id}: {}", answer.text());
        let tag = answer.header("etag");
        let is_documented = !documented["200"]["headers"]["ETag"].is_null();
        assert_eq!(tag.is_some(), is_documented, "{id}");
        let Some(tag) = tag else { continue };
        let again = get(&service, &path, ("if-none-match", tag)).await;
        let may_be = !documented["304"].is_null();
        assert_eq!(again.status, if may_be { 304 } else { 200 }, "{id}");
        named += usize::from(may_be);
    }
    assert!(named > 25, "{named}");
    service.stop().await;
}
