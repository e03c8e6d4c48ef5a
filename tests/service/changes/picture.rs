//! A map's picture, asked about a place.

use mapshift::geometry::Vector2;

use super::reported::ROUTE;
use crate::client::Client;

/// What `map_server` would read.
pub struct Picture {
    pub pgm: Vec<u8>,
    pixels: usize,
    width: usize,
    height: usize,
    resolution_m: f64,
    origin: Vector2<f64>,
}

/// How many cells are in which state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cells {
    pub occupied: usize,
    pub free: usize,
    pub unknown: usize,
}

impl Picture {
    pub async fn of(client: &Client) -> Self {
        let pgm = client.bytes(&format!("/v1/routes/{ROUTE}/map.pgm")).await;
        let yaml = client.text(&format!("/v1/routes/{ROUTE}/map.yaml")).await;
        Self::read(pgm, &yaml)
    }

    fn read(pgm: Vec<u8>, yaml: &str) -> Self {
        let lines = pgm.split(|byte| *byte == b'\n').take(3);
        let head: Vec<&str> = lines
            .map(|line| std::str::from_utf8(line).unwrap())
            .collect();
        assert_eq!((head[0], head[2]), ("P5", "255"));
        let size: Vec<usize> = head[1].split(' ').map(|n| n.parse().unwrap()).collect();
        let pixels = head.iter().map(|line| line.len() + 1).sum();
        assert_eq!(pgm.len(), pixels + size[0] * size[1]);
        let value = |name: &str| {
            let line = yaml.lines().find_map(|line| line.strip_prefix(name));
            line.unwrap().trim_matches(|c| " []".contains(c)).to_owned()
        };
        let origin = value("origin:");
        let origin: Vec<f64> = origin.split(", ").map(|n| n.parse().unwrap()).collect();
        Self {
            pgm,
            pixels,
            width: size[0],
            height: size[1],
            resolution_m: value("resolution:").parse().unwrap(),
            origin: Vector2::new(origin[0], origin[1]),
        }
    }

    /// The cells whose centres are wanted.
    pub fn cells(&self, is_wanted: impl Fn(&Vector2<f64>) -> bool) -> Cells {
        let mut cells = Cells::default();
        for row in 0..self.height {
            for column in 0..self.width {
                let up = self.height - 1 - row;
                let centre = Vector2::new(column as f64 + 0.5, up as f64 + 0.5);
                if !is_wanted(&(self.origin + centre * self.resolution_m)) {
                    continue;
                }
                match self.pgm[self.pixels + row * self.width + column] {
                    0 => cells.occupied += 1,
                    254 => cells.free += 1,
                    _ => cells.unknown += 1,
                }
            }
        }
        cells
    }
}
