//! The map in tiles.

use serde_json::{Value, json};

use crate::changed_hall;
use crate::client::Request;
use crate::service::Service;

const TILES: &str = "/v1/routes/hall/map/tiles";

/// Grey values of a PGM in rows from above, and where its lowest cell lies, in cells from the origin.
struct Map {
    rows: Vec<Vec<u8>>,
    first: [i64; 2],
}

async fn map(service: &Service, path: &str) -> Map {
    let pgm = service
        .get(&format!("/v1/routes/hall/{path}.pgm"))
        .await
        .body;
    let yaml = service
        .get(&format!("/v1/routes/hall/{path}.yaml"))
        .await
        .text();
    let head: Vec<_> = pgm.splitn(4, |byte| *byte == b'\n').collect();
    let size = std::str::from_utf8(head[1]).unwrap();
    let width: usize = size.split(' ').next().unwrap().parse().unwrap();
    let origin = yaml
        .lines()
        .find_map(|line| line.strip_prefix("origin: ["))
        .unwrap();
    let mut cells = origin
        .split(", ")
        .map(|metres| (metres.parse::<f64>().unwrap() / 0.05).round() as i64);
    Map {
        rows: head[3].chunks_exact(width).map(<[u8]>::to_vec).collect(),
        first: [cells.next().unwrap(), cells.next().unwrap()],
    }
}

impl Map {
    /// The colour of a pixel of zoom 8, counted from the map's origin to the right and downwards.
    fn colour(&self, across: i64, down: i64) -> [u8; 4] {
        let above = self.first[1] + self.rows.len() as i64;
        let row = usize::try_from(down + above)
            .ok()
            .and_then(|row| self.rows.get(row));
        let column = usize::try_from(across - self.first[0]).ok();
        match row.and_then(|row| row.get(column?)) {
            Some(0) => [0, 0, 0, 255],
            Some(254) => [255; 4],
            _ => [255, 255, 255, 0],
        }
    }
}

fn pixels(png: &[u8]) -> Vec<[u8; 4]> {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(png));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut read = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut read).unwrap();
    assert_eq!((info.width, info.height), (256, 256));
    let pixels = read.chunks_exact(4).map(|rgba| rgba.try_into().unwrap());
    pixels.collect()
}

#[tokio::test]
async fn a_tile_shows_its_part_of_the_map() {
    let service = changed_hall::start().await;
    for (query, path) in [("", "map"), ("?version=1", "versions/1/map")] {
        let map = map(&service, path).await;
        let mut occupied = 0;
        for (x, y) in [(0, 0), (-1, 0), (0, -1), (-1, -1)] {
            let tile = service.get(&format!("{TILES}/8/{x}/{y}.png{query}")).await;
            assert_eq!(
                (tile.status, tile.header("content-type")),
                (200, Some("image/png"))
            );
            for (k, colour) in pixels(&tile.body).into_iter().enumerate() {
                let (across, down) = (x * 256 + k as i64 % 256, y * 256 + k as i64 / 256);
                assert_eq!(colour, map.colour(across, down), "{across}, {down}");
                occupied += usize::from(colour == [0, 0, 0, 255]);
            }
        }
        let black = map.rows.iter().flatten().filter(|grey| **grey == 0).count();
        assert!(occupied == black && black > 50, "{occupied} of {black}");
    }
    let outside = service.get(&format!("{TILES}/3/70/-9.png")).await;
    assert!(pixels(&outside.body).iter().all(|rgba| rgba[3] == 0));
    service.stop().await;
}

#[tokio::test]
async fn tiles_state_their_extent_and_are_cached_while_valid() {
    let service = changed_hall::start().await;
    let about = service.get(&format!("{TILES}.json")).await;
    let tag = about.header("etag").unwrap().to_owned();
    let answered = about.json();
    assert_eq!(
        answered,
        json!({
            "version": 1, "layer": "accepted", "tile_size": 256, "min_zoom": 0, "max_zoom": 8,
            "tiles": "/v1/routes/hall/map/tiles/{z}/{x}/{y}.png?version=1", "resolution_m": 0.05,
            "bounds": answered["bounds"], "tag": tag,
        })
    );
    let bounds: Vec<f64> = serde_json::from_value(answered["bounds"].clone()).unwrap();
    assert!(bounds[0] < -4.0 && bounds[1] < -3.0 && bounds[2] > 4.0 && bounds[3] > 3.0);

    let tile = format!("{TILES}/8/0/0.png");
    let draft = service.get(&tile).await;
    assert_eq!(draft.header("cache-control"), Some("no-cache"));
    assert_eq!(draft.header("etag"), Some(&*tag));
    let again = Request::new("GET", &*tile).header("if-none-match", &tag);
    assert_eq!(service.send(again).await.status, 304);
    let observed = service.get(&format!("{tile}?layer=observed")).await;
    assert_ne!(observed.header("etag"), Some(&*tag));

    let release = Request::new("POST", "/v1/routes/hall/versions/1/release");
    assert_eq!(service.send(release).await.status, 200);
    let released = service.get(&format!("{tile}?version=1")).await;
    assert_eq!(released.body, draft.body);
    let caching = released.header("cache-control").unwrap();
    assert!(caching.contains("immutable"), "{caching}");
    let newest = service.get(&format!("{TILES}.json")).await.json();
    assert_eq!(newest["version"], 1);
    let observed = service
        .get(&format!("{TILES}.json?layer=observed"))
        .await
        .json();
    assert_eq!(
        (&observed["version"], &observed["layer"]),
        (&json!(2), &json!("observed"))
    );
    let tiles = observed["tiles"].as_str().unwrap();
    assert!(tiles.ends_with("?version=2&layer=observed"), "{tiles}");
    let of_draft = tiles
        .replace("{z}", "8")
        .replace("{x}", "0")
        .replace("{y}", "0");
    assert_eq!(service.get(&of_draft).await.status, 200);
    service.stop().await;
}

#[tokio::test]
async fn impossible_tiles_are_refused() {
    let service = changed_hall::start().await;
    let release = Request::new("POST", "/v1/routes/hall/versions/1/release");
    assert_eq!(service.send(release).await.status, 200);
    for (path, status, problem) in [
        ("8/0/0", 400, "invalid-field"),
        ("8/0/a.png", 400, "invalid-field"),
        ("8/0/0.jpg", 400, "invalid-field"),
        ("9/0/0.png", 400, "invalid-field"),
        ("-1/0/0.png", 400, "invalid-field"),
        ("8/0/9999999999.png", 400, "invalid-field"),
        ("8/0/0.png?version=9", 404, "not-found"),
        ("8/0/0.png?version=one", 400, "invalid-parameter"),
        (
            "8/0/0.png?version=1&layer=observed",
            400,
            "invalid-parameter",
        ),
        ("8/0/0.png?layer=all", 400, "invalid-parameter"),
    ] {
        let answer = service.get(&format!("{TILES}/{path}")).await;
        let answered = (answer.status, answer.problem());
        assert_eq!(answered, (status, problem.to_owned()), "{path}");
    }
    let empty = service.get("/v1/routes/yard/map/tiles/8/0/0.png").await;
    assert_eq!(
        (empty.status, empty.json()["errors"].clone()),
        (404, Value::Array(Vec::new()))
    );
    service.stop().await;
}
