//! What differs between versions of a map.

use serde_json::{Value, json};

use crate::changed_hall::{self, APPEARED};
use crate::client::Request;
use crate::service::Service;

const VERSIONS: &str = "/v1/routes/hall/versions";

async fn decide(service: &Service, action: &str) {
    let post = Request::new("POST", format!("/v1/alerts/{APPEARED}/{action}"));
    let answer = service.send(post.header("if-match", "*")).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
}

async fn json_of(service: &Service, path: &str) -> Value {
    let answer = service.get(&format!("{VERSIONS}/{path}")).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

/// Width, height, and the colours of a picture, row by row.
fn picture(png: &[u8]) -> (usize, usize, Vec<[u8; 3]>) {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(png));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut read = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut read).unwrap();
    let colours = read.chunks_exact(3).map(|rgb| rgb.try_into().unwrap());
    (info.width as usize, info.height as usize, colours.collect())
}

#[tokio::test]
async fn an_acceptance_and_its_undo_differ_in_the_same_cells() {
    let service = changed_hall::start().await;
    decide(&service, "accept").await;
    let accepted = json_of(&service, "2/diff").await;
    assert_eq!(
        (&accepted["from"], &accepted["to"], &accepted["alerts"]),
        (&json!(1), &json!(2), &json!([APPEARED]))
    );
    assert_eq!(accepted["resolution_m"], 0.05);
    let cells = |diff: &Value| {
        let cells = diff["cells"].as_object().unwrap();
        let count = cells.values().map(|count| count.as_u64().unwrap());
        (cells["to_occupied"].as_u64().unwrap(), count.sum::<u64>())
    };
    let (occupied, all) = cells(&accepted);
    assert!(occupied > 0, "{accepted}");
    let bbox: [f64; 4] = serde_json::from_value(accepted["bbox"].clone()).unwrap();
    // Round the box, and what it hides.
    assert!(bbox[0] > 0.0 && bbox[0] < 1.6 && bbox[2] > 1.5, "{bbox:?}");

    let png = service.get(&format!("{VERSIONS}/2/diff.png")).await;
    assert_eq!(png.header("content-type"), Some("image/png"));
    let (_, _, colours) = picture(&png.body);
    let count = |colour| colours.iter().filter(|c| **c == colour).count() as u64;
    assert_eq!(count([213, 94, 0]), occupied);
    let greys = [[222; 3], [255; 3], [74, 79, 87]].map(count);
    assert!(greys.iter().all(|count| *count > 0), "{greys:?}");
    assert_eq!(colours.len() as u64, all + greys.iter().sum::<u64>());

    decide(&service, "undo").await;
    let undone = json_of(&service, "3/diff").await;
    assert_eq!(cells(&undone).1, all);
    assert_eq!(
        (
            &undone["cells"]["to_free"],
            &undone["bbox"],
            &undone["alerts"]
        ),
        (&json!(occupied), &accepted["bbox"], &json!([APPEARED]))
    );
    let none = json_of(&service, "3/diff?from=1").await;
    let nothing = json!({"to_occupied": 0, "to_free": 0, "to_unknown": 0, "from_unknown": 0});
    assert_eq!((&none["cells"], &none["bbox"]), (&nothing, &Value::Null));
    assert_eq!(none["alerts"], json!([APPEARED]));
    let back = json_of(&service, "1/diff?from=2").await;
    assert_eq!(back["cells"], undone["cells"]);
    service.stop().await;
}

#[tokio::test]
async fn pictures_of_ended_versions_are_cached_for_ever() {
    let service = changed_hall::start().await;
    decide(&service, "accept").await;
    let png = format!("{VERSIONS}/2/diff.png");
    let caching = async |path: &str| {
        let answer = service.get(path).await;
        let header = |name| answer.header(name).unwrap().to_owned();
        (header("cache-control"), header("etag"))
    };
    let (draft, tag) = caching(&png).await;
    assert_eq!(draft, "no-cache");
    let again = Request::new("GET", &*png).header("if-none-match", &tag);
    assert_eq!(service.send(again).await.status, 304);
    let release = Request::new("POST", format!("{VERSIONS}/2/release"));
    assert_eq!(service.send(release).await.status, 200);
    let (ended, next) = caching(&png).await;
    assert!(ended.contains("immutable"), "{ended}");
    assert_ne!(next, tag);
    service.stop().await;
}

#[tokio::test]
async fn missing_versions_are_not_compared() {
    let service = changed_hall::start().await;
    for (path, status, problem, says) in [
        ("9/diff", 404, "not-found", ""),
        ("1/diff", 400, "invalid-parameter", "before version 1"),
        ("1/diff?from=7", 400, "invalid-parameter", "no version 7"),
        (
            "1/diff.png?from=0",
            400,
            "invalid-parameter",
            "no version 0",
        ),
        ("1/diff?from=one", 400, "invalid-parameter", ""),
        ("one/diff", 400, "invalid-field", ""),
    ] {
        let answer = service.get(&format!("{VERSIONS}/{path}")).await;
        let found = (answer.status, answer.problem());
        assert_eq!(found, (status, problem.to_owned()), "{path}");
        let detail = answer.json()["detail"].as_str().unwrap().to_owned();
        assert!(detail.contains(says), "{detail}");
    }
    let empty = service.get("/v1/routes/yard/versions/1/diff?from=1").await;
    assert_eq!(empty.status, 404);
    service.stop().await;
}
