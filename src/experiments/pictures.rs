//! Pictures of a place: before, since, and both.

use super::placed::PlacedScan;
use crate::geometry::Vector2;
use crate::ids::StampNs;

/// Side of the window that each panel shows, metres.
const WINDOW_M: f64 = 6.0;
/// Side of a panel, pixels.
const PANEL: usize = 360;
/// White between panels, pixels.
const GAP: usize = 8;
const WIDTH: usize = 3 * PANEL + 2 * GAP;

const WHITE: [u8; 3] = [255, 255, 255];
const FRAME: [u8; 3] = [200, 200, 200];
const BEFORE: [u8; 3] = [30, 60, 220];
const SINCE: [u8; 3] = [225, 30, 30];
const STOOD: [u8; 3] = [120, 120, 120];
const OUTLINE: [u8; 3] = [190, 0, 190];

/// A picture of one place.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Its file's name without the ending.
    pub name: String,
    /// PNG.
    pub png: Vec<u8>,
}

/// Draws the hits of scans before a moment (blue), since it (red) and of both, 6 m round a place,
/// with outlines and where the scans stood (grey); x to the right, y upwards.
///
/// # Errors
/// If it cannot be encoded.
pub(super) fn draw(
    name: String,
    scans: &[PlacedScan<'_>],
    middle: &Vector2<f64>,
    moment: StampNs,
    outlines: &[&[Vector2<f64>]],
) -> anyhow::Result<Picture> {
    let mut canvas = Canvas::new(*middle);
    for placed in scans {
        let is_before = placed.scan.stamp < moment;
        let (panel, colour) = if is_before { (0, BEFORE) } else { (1, SINCE) };
        let stood = placed.map_from_lidar.translation();
        if (stood - middle).norm() > WINDOW_M + placed.lidar.range_max_m {
            continue;
        }
        for hit in placed.hits() {
            canvas.dot(panel, &hit, colour);
            canvas.dot(2, &hit, colour);
        }
        canvas.dot(panel, &stood, STOOD);
    }
    for panel in 0..3 {
        for outline in outlines {
            canvas.outline(panel, outline);
        }
    }
    let png = canvas.encode()?;
    Ok(Picture { name, png })
}

struct Canvas {
    middle: Vector2<f64>,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    fn new(middle: Vector2<f64>) -> Self {
        let mut pixels = vec![WHITE; WIDTH * PANEL];
        for row in 0..PANEL {
            for column in 0..WIDTH {
                let within = column % (PANEL + GAP);
                let is_edge = [0, PANEL - 1].contains(&within) || [0, PANEL - 1].contains(&row);
                if is_edge && within < PANEL {
                    pixels[row * WIDTH + column] = FRAME;
                }
            }
        }
        Self { middle, pixels }
    }

    /// Two by two pixels.
    fn dot(&mut self, panel: usize, point: &Vector2<f64>, colour: [u8; 3]) {
        let from_corner = point - self.middle + Vector2::new(0.5, 0.5) * WINDOW_M;
        let pixel = |v: f64| (v / WINDOW_M * PANEL as f64).floor();
        let (column, row) = (pixel(from_corner.x), pixel(WINDOW_M - from_corner.y));
        let inside = 0.0..(PANEL - 1) as f64;
        if inside.contains(&column) && inside.contains(&row) {
            let (column, row) = (panel * (PANEL + GAP) + column as usize, row as usize);
            for place in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                self.pixels[(row + place.0) * WIDTH + column + place.1] = colour;
            }
        }
    }

    fn outline(&mut self, panel: usize, corners: &[Vector2<f64>]) {
        let step_m = WINDOW_M / PANEL as f64;
        for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let steps = ((to - from).norm() / step_m).ceil().clamp(1.0, 10_000.0) as usize;
            for k in 0..steps {
                let point = from + (to - from) * (k as f64 / steps as f64);
                self.dot(panel, &point, OUTLINE);
            }
        }
    }

    fn encode(&self) -> anyhow::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let (width, height) = (u32::try_from(WIDTH)?, u32::try_from(PANEL)?);
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::baselines::testing::{posed, room};
    use super::super::placed::placed_scans;
    use super::*;

    #[test]
    fn a_picture_has_three_panels() {
        let recordings = room(20, None);
        let poses = posed(&recordings);
        let scans = placed_scans(&recordings, &poses);
        let moment = recordings[0].scans[10].stamp;
        let corners = [(2.0, 1.0), (2.5, 1.0), (2.5, 1.5)].map(|(x, y)| Vector2::new(x, y));
        let picture = draw("here".into(), &scans, &corners[0], moment, &[&corners]).unwrap();
        let decoder = png::Decoder::new(std::io::Cursor::new(picture.png));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        let (pixels, _) = bytes.as_chunks::<3>();
        let has = |panel: usize, colour: [u8; 3]| {
            let columns = panel * (PANEL + GAP)..panel * (PANEL + GAP) + PANEL;
            let mut of_panel = pixels
                .iter()
                .enumerate()
                .filter(|(k, _)| columns.contains(&(k % WIDTH)));
            of_panel.any(|(_, pixel)| *pixel == colour)
        };
        assert!(has(0, BEFORE) && !has(0, SINCE) && has(0, OUTLINE) && has(0, STOOD));
        assert!(has(1, SINCE) && !has(1, BEFORE) && has(2, OUTLINE));
        assert!(has(2, SINCE) || has(2, BEFORE));
    }
}
