//! The map as the service offers it to ROS's `map_server`: a YAML description and a PGM.

use anyhow::{Context, bail};

use crate::geometry::Vector2;
use crate::ingest::ExportedGrid;

/// Reads the two files.
///
/// # Errors
/// If they are not what the service writes.
pub(super) fn grid(yaml: &[u8], pgm: &[u8]) -> anyhow::Result<ExportedGrid> {
    let yaml = std::str::from_utf8(yaml).context("the map's description is not text")?;
    let value = |key: &str| {
        let line = yaml.lines().find_map(|line| line.strip_prefix(key));
        line.with_context(|| format!("the map's description has no {key}"))
    };
    let resolution_m: f64 = value("resolution: ")?.parse()?;
    let [x, y, _]: [f64; 3] = serde_json::from_str(value("origin: ")?)?;
    let (width, height, pixels) = picture(pgm).context("the map's picture is no PGM")?;
    let row_bytes = (width as usize).max(1);
    // The first row of the picture is the topmost.
    let rows = pixels.chunks(row_bytes).rev();
    let cells: Result<Vec<i8>, _> = rows.flatten().map(|grey| occupancy(*grey)).collect();
    Ok(ExportedGrid {
        resolution_m,
        origin: Vector2::new(x, y),
        width,
        height,
        cells: cells?,
    })
}

/// Width, height and pixels of a binary PGM with a byte for each.
fn picture(pgm: &[u8]) -> Option<(u32, u32, &[u8])> {
    let mut rest = pgm;
    let mut words = [""; 4];
    for word in &mut words {
        let end = rest.iter().position(u8::is_ascii_whitespace)?;
        let (head, tail) = rest.split_at_checked(end)?;
        *word = std::str::from_utf8(head).ok()?;
        rest = tail.get(1..)?;
    }
    let [magic, width, height, white] = words;
    let (width, height): (u32, u32) = (width.parse().ok()?, height.parse().ok()?);
    let pixels = u64::from(width) * u64::from(height);
    (magic == "P5" && white == "255" && rest.len() as u64 == pixels)
        .then_some((width, height, rest))
}

fn occupancy(grey: u8) -> anyhow::Result<i8> {
    Ok(match grey {
        0 => 100,
        254 => 0,
        205 => -1,
        grey => bail!("the map's picture has a grey {grey}, which stands for nothing"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const YAML: &str =
        "image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.5, 2.0, 0.0]\n";

    #[test]
    fn the_lowest_row_comes_first() {
        let pgm = b"P5\n3 2\n255\n\x00\xfe\xcd\xfe\xfe\x00";
        let grid = grid(YAML.as_bytes(), pgm).unwrap();
        assert_eq!((grid.width, grid.height), (3, 2));
        assert_eq!(grid.cells, [0, 0, 100, 100, 0, -1]);
        assert_eq!((grid.origin.x, grid.origin.y), (-1.5, 2.0));
    }

    #[test]
    fn what_the_service_does_not_write_is_refused() {
        let read = |pgm: &[u8]| grid(YAML.as_bytes(), pgm).is_ok();
        assert!(read(b"P5\n1 1\n255\n\xcd"));
        for wrong in [
            &b"P5\n1 1\n255\n"[..],
            b"P5\n2 1\n255\n\xcd",
            b"P5\n1 1\n255\n\x07",
            b"P2\n1 1\n255\n\xcd",
            b"P5\n1",
        ] {
            assert!(!read(wrong));
        }
        assert!(grid(b"origin: [0, 0, 0]", b"P5\n1 1\n255\n\xcd").is_err());
    }
}
