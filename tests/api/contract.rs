//! What holds for every operation of the document: the order of checks, links of lists, pages of problems.

use mapshift::api::openapi_document;
use mapshift::api::problem::ProblemKind;
use serde_json::Value;

use crate::client::Request;
use crate::service::Service;

fn operations() -> Vec<(&'static str, String, Value)> {
    let document = openapi_document().unwrap();
    let mut operations = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let method = match method.as_str() {
                "get" => "GET",
                "put" => "PUT",
                "post" => "POST",
                "patch" => "PATCH",
                "delete" => "DELETE",
                other => panic!("{other}"),
            };
            operations.push((method, path.clone(), operation.clone()));
        }
    }
    operations
}

/// A path with something in place of each parameter.
fn filled(path: &str, route: &str) -> String {
    let part = |part: &str| match part {
        "{route}" => route.to_owned(),
        part if part.starts_with('{') => "1".to_owned(),
        part => part.to_owned(),
    };
    path.split('/').map(part).collect::<Vec<_>>().join("/")
}

#[tokio::test]
async fn an_unknown_route_is_reported_before_any_other_problem() {
    let service = Service::start().await;
    let mut asked = 0;
    for (method, path, _) in operations() {
        if !path.contains("{route}") || (method, path.as_str()) == ("PUT", "/v1/routes/{route}") {
            continue;
        }
        let spoilt = Request::new(method, filled(&path, "nowhere") + "?nonsense=%01&limit=0")
            .header("content-type", "text/plain")
            .header("content-encoding", "br");
        let spoilt = match method {
            "GET" => spoilt,
            _ => spoilt.body("{"),
        };
        let answer = service.send(spoilt).await;
        assert_eq!(answer.problem(), "unknown-route", "{method} {path}");
        assert_eq!(answer.status, 404, "{method} {path}");
        asked += 1;
    }
    assert!(asked > 30, "{asked}");
    service.stop().await;
}

/// Follows the links of a list to its end and returns how many items came, each once.
async fn followed(service: &Service, path: &str, items: &str) -> usize {
    let mut seen: Vec<String> = Vec::new();
    let mut path = path.to_owned();
    loop {
        let answer = service.get(&path).await;
        assert_eq!(answer.status, 200, "{path}");
        let body = answer.json();
        let part = body[items].as_array().unwrap();
        seen.extend(part.iter().map(Value::to_string));
        let Some(cursor) = body["next_cursor"].as_str() else {
            assert_eq!(answer.header("link"), None, "{path}");
            break;
        };
        let link = answer.header("link").unwrap();
        let next = link.strip_prefix('<').unwrap();
        let next = next.strip_suffix(">; rel=\"next\"").unwrap();
        assert!(next.ends_with(&format!("cursor={cursor}")), "{link}");
        path = next.to_owned();
    }
    let count = seen.len();
    seen.sort();
    seen.dedup();
    assert_eq!(seen.len(), count, "{path}");
    count
}

#[tokio::test]
async fn links_lead_through_a_list_and_keep_the_query() {
    let service = Service::start_with_map().await;
    service.put_route("yard").await;
    for (path, count) in [
        ("/v1/routes?limit=1", 2),
        ("/v1/routes/hall/nodes?limit=2", 3),
        ("/v1/routes/hall/edges?limit=1&kind=odometry", 2),
        ("/v1/routes/hall/edges?kind=odometry&cursor=31&limit=1", 1),
        ("/v1/audit?limit=1&route_id=yard", 1),
    ] {
        assert_eq!(followed(&service, path, "items").await, count, "{path}");
    }
    service.stop().await;
}

#[test]
fn every_list_declares_its_link() {
    let mut lists = 0;
    for (method, path, operation) in operations() {
        let parameters = operation["parameters"].as_array();
        let mut parameters = parameters.into_iter().flatten();
        let takes_cursor = parameters.any(|parameter| parameter["name"] == "cursor");
        let link = operation["responses"]["200"]["headers"].get("Link");
        assert_eq!(link.is_some(), takes_cursor, "{method} {path}");
        lists += usize::from(takes_cursor);
    }
    assert!(lists >= 16, "{lists}");
}

#[tokio::test]
async fn the_type_of_every_problem_is_the_path_of_its_page() {
    let service = Service::start().await;
    let list = service.get("/problems").await;
    for kind in ProblemKind::ALL {
        let path = format!("/problems/{}", kind.name());
        let page = service.get(&path).await;
        assert_eq!(page.status, 200, "{path}");
        assert_eq!(
            page.header("content-type"),
            Some("text/html; charset=utf-8")
        );
        assert!(page.text().contains(kind.title()), "{path}");
        assert!(list.text().contains(&format!("href=\"{path}\"")), "{path}");
    }
    let missing = service.get("/v1/routes/nowhere").await.json();
    let page = service.get(missing["type"].as_str().unwrap()).await;
    assert!(page.text().contains("There is no such route"));
    let none = service.get("/problems/none").await;
    assert_eq!((none.status, none.problem().as_str()), (404, "not-found"));
    service.stop().await;
}

#[tokio::test]
async fn every_path_answers_head_and_options() {
    let service = Service::start_with_map().await;
    for (path, allowed) in [
        ("/v1/routes", "GET,HEAD"),
        ("/v1/routes/hall/graph", "GET,HEAD"),
        ("/problems", "GET,HEAD"),
        ("/livez", "GET,HEAD"),
    ] {
        let head = service.send(Request::new("HEAD", path)).await;
        assert_eq!((head.status, head.body.len()), (200, 0), "{path}");
        let options = service.send(Request::new("OPTIONS", path)).await;
        assert_eq!((options.status, options.body.len()), (204, 0), "{path}");
        assert_eq!(options.header("allow"), Some(allowed), "{path}");
    }
    let route = service
        .send(Request::new("OPTIONS", "/v1/routes/hall"))
        .await;
    let allowed = route.header("allow").unwrap();
    assert!(
        ["PUT", "DELETE", "GET"].iter().all(|m| allowed.contains(m)),
        "{allowed}"
    );
    let listed = Request::new("HEAD", "/v1/routes/hall/nodes?limit=1");
    assert!(service.send(listed).await.header("link").is_some());
    service.stop().await;
}
