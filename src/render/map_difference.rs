//! How two maps of the same route differ, cell by cell, and a picture of it.

use super::{CELLS_MAX, DifferingCells, MapImageError, MapRaster};

/// The colour of a cell in [`PALETTE`], by its occupancy before and now: unknown, free, occupied.
const COLOUR_OF: [[u8; 3]; 3] = [[0, 7, 5], [8, 1, 3], [6, 4, 2]];
/// Grey where nothing differs. Vermilion for what is new and blue for what is gone, as in the picture of a
/// place: colour-blind people can distinguish them. Pale where the cell is unknown in one of the maps.
const PALETTE: [[u8; 3]; 9] = [
    [222, 222, 222],
    [255, 255, 255],
    [74, 79, 87],
    [213, 94, 0],
    [0, 114, 178],
    [239, 182, 142],
    [156, 195, 222],
    [253, 238, 227],
    [227, 239, 247],
];

/// How two maps differ.
#[derive(Debug, Clone, PartialEq)]
pub struct MapDifference {
    resolution_m: f64,
    width: usize,
    /// By the place in [`PALETTE`], the row of the highest y first.
    pixels: Vec<u8>,
    cells: DifferingCells,
    bounds_m: Option<[f64; 4]>,
}

impl MapDifference {
    /// Compares two maps over the area of both; outside a map everything is unknown. Cells are as large as the
    /// larger ones of the two, doubled until the picture has at most [`CELLS_MAX`].
    pub fn between(before: &MapRaster<'_>, after: &MapRaster<'_>) -> Self {
        let mut resolution_m = before.resolution_m().max(after.resolution_m());
        let mut frame = frame_of([before, after], resolution_m);
        while frame.width() * frame.height() > CELLS_MAX as i64 {
            resolution_m *= 2.0;
            frame = frame_of([before, after], resolution_m);
        }
        let mut difference = Self {
            resolution_m,
            width: frame.width() as usize,
            pixels: Vec::with_capacity((frame.width() * frame.height()) as usize),
            cells: DifferingCells::default(),
            bounds_m: None,
        };
        let [doublings_before, doublings_after] =
            [before, after].map(|map| map.doublings_to(resolution_m));
        let mut differing: Option<Frame> = None;
        for row in (frame.rows[0]..frame.rows[1]).rev() {
            for column in frame.columns[0]..frame.columns[1] {
                let then = before.occupancy_at(column, row, doublings_before);
                let now = after.occupancy_at(column, row, doublings_after);
                let colour = COLOUR_OF[then as usize][now as usize];
                difference.pixels.push(colour);
                if then != now {
                    difference.cells.count(then, now);
                    let cell = Frame::of_cell(column, row);
                    differing = Some(differing.map_or(cell, |frame| frame.with(cell)));
                }
            }
        }
        difference.bounds_m = differing.map(|frame| frame.bounds_m(resolution_m));
        difference
    }

    /// Edge of a cell, metres.
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// How many cells differ.
    pub fn cells(&self) -> DifferingCells {
        self.cells
    }

    /// Lowest x and y, highest x and y of the cells that differ, metres, map frame; `None` if none does.
    pub fn bounds_m(&self) -> Option<[f64; 4]> {
        self.bounds_m
    }

    /// The picture as an indexed PNG, one pixel a cell, y upwards.
    ///
    /// # Errors
    /// [`MapImageError`].
    pub fn to_png(&self) -> Result<Vec<u8>, MapImageError> {
        let (width, height) = (self.width, self.pixels.len() / self.width);
        let too_large = |_| MapImageError::TooLarge { width, height };
        let columns = u32::try_from(width).map_err(too_large)?;
        let rows = u32::try_from(height).map_err(too_large)?;
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, columns, rows);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Four);
        encoder.set_palette(PALETTE.as_flattened());
        let mut writer = encoder.write_header()?;
        let rows = self.pixels.chunks(width);
        let packed: Vec<u8> = rows.flat_map(|row| row.chunks(2).map(packed)).collect();
        writer.write_image_data(&packed)?;
        writer.finish()?;
        Ok(bytes)
    }
}

/// One or two pixels in a byte.
fn packed(pixels: &[u8]) -> u8 {
    let second = pixels.get(1).copied().unwrap_or_default();
    pixels[0] << 4 | second
}

/// Columns and rows of cells, each from the first to the one after the last.
#[derive(Debug, Clone, Copy)]
struct Frame {
    columns: [i64; 2],
    rows: [i64; 2],
}

/// The cells of two maps.
fn frame_of(maps: [&MapRaster<'_>; 2], resolution_m: f64) -> Frame {
    let [before, after] = maps.map(|map| {
        let bounds = map.bounds_m().map(|metres| metres / resolution_m);
        // Cells of the map's own size end on whole numbers, but for rounding.
        let first = |cells: f64| (cells + 1e-6).floor() as i64;
        let end = |cells: f64| (cells - 1e-6).ceil() as i64;
        Frame {
            columns: [first(bounds[0]), end(bounds[2])],
            rows: [first(bounds[1]), end(bounds[3])],
        }
    });
    before.with(after)
}

impl Frame {
    fn of_cell(column: i64, row: i64) -> Self {
        Self {
            columns: [column, column + 1],
            rows: [row, row + 1],
        }
    }

    fn with(self, other: Self) -> Self {
        let joined = |a: [i64; 2], b: [i64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self {
            columns: joined(self.columns, other.columns),
            rows: joined(self.rows, other.rows),
        }
    }

    fn width(&self) -> i64 {
        self.columns[1] - self.columns[0]
    }

    fn height(&self) -> i64 {
        self.rows[1] - self.rows[0]
    }

    fn bounds_m(&self, resolution_m: f64) -> [f64; 4] {
        let [x, y] = [self.columns, self.rows];
        // Without the noise of a product such as 3 × 0.05.
        [x[0], y[0], x[1], y[1]].map(|cells| (cells as f64 * resolution_m * 1e6).round() / 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const U: u8 = 205;
    const F: u8 = 254;
    const O: u8 = 0;

    fn files(first: [f64; 2], resolution_m: f64, rows: &[&[u8]]) -> (Vec<u8>, String) {
        let mut pgm = format!("P5\n{} {}\n255\n", rows[0].len(), rows.len()).into_bytes();
        pgm.extend(rows.concat());
        let yaml = format!(
            "resolution: {resolution_m}\norigin: [{:.6}, {:.6}, 0.0]\n",
            first[0], first[1]
        );
        (pgm, yaml)
    }

    fn between(before: &(Vec<u8>, String), after: &(Vec<u8>, String)) -> MapDifference {
        let before = MapRaster::read(&before.0, &before.1).unwrap();
        let after = MapRaster::read(&after.0, &after.1).unwrap();
        MapDifference::between(&before, &after)
    }

    #[test]
    fn every_kind_of_change_is_counted_once_where_it_is() {
        let before = files([-0.05, 0.1], 0.05, &[&[F, O, F], &[O, U, U]]);
        let after = files([-0.05, 0.1], 0.05, &[&[O, F, F], &[U, O, U]]);
        let found = between(&before, &after);
        let each = DifferingCells {
            to_occupied: 1,
            to_free: 1,
            to_unknown: 1,
            from_unknown: 1,
        };
        assert_eq!(found.cells(), each);
        assert_eq!(found.bounds_m(), Some([-0.05, 0.1, 0.05, 0.2]));
        assert_eq!(found.pixels, [3, 4, 1, 6, 5, 0]);
        let same = between(&before, &before);
        assert_eq!(same.cells(), DifferingCells::default());
        assert_eq!(same.bounds_m(), None);
        assert_eq!(same.pixels, [1, 2, 1, 2, 0, 0]);
    }

    #[test]
    fn maps_of_other_extents_and_cells_are_compared_where_either_is() {
        let before = files([0.0, 0.0], 0.05, &[&[F, F], &[O, F]]);
        let wider = files([-0.1, 0.0], 0.1, &[&[F, O, O]]);
        let found = between(&before, &wider);
        assert_eq!(found.resolution_m(), 0.1);
        // The four small cells are an occupied one.
        assert_eq!(found.pixels, [7, 2, 5]);
        assert_eq!(found.cells().from_unknown, 2);
        let back = between(&wider, &before);
        assert_eq!((back.cells().to_unknown, back.pixels[1]), (2, 2));
    }

    #[test]
    fn the_picture_has_the_colours_of_its_cells() {
        let before = files([0.0, 0.0], 0.05, &[&[F, O, F]]);
        let after = files([0.0, 0.0], 0.05, &[&[O, F, F]]);
        let png = between(&before, &after).to_png().unwrap();
        let mut decoder = png::Decoder::new(std::io::Cursor::new(png));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut read = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut read).unwrap();
        assert_eq!((info.width, info.height), (3, 1));
        assert_eq!(read, [[213, 94, 0], [0, 114, 178], [255; 3]].as_flattened());
    }
}
