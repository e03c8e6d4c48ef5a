//! Tiles of a map's picture, as viewers of large maps ask for them.
//!
//! A tile has 256 × 256 pixels. Tile (0, 0) of every zoom lies right of the map's origin and below it: x grows
//! with the map's x, y against the map's y. At zoom 8 a pixel is 5 cm, at each lower one twice that of the one
//! above. A pixel of several cells shows an occupied one before a free one before an unknown one, so that
//! walls stay visible.

use std::ops::Range;

use super::{MAP_RESOLUTION_M, MapImageError, Occupancy};

/// Pixels along the edge of a tile.
pub const TILE_PIXELS: usize = 256;
/// The zoom at which a pixel is a cell of [`MAP_RESOLUTION_M`].
pub const ZOOM_MAX: u8 = 8;

/// Palette of a tile: unknown, free, occupied; by the rank that a pixel shows the highest of.
const PALETTE: [u8; 9] = [255, 255, 255, 255, 255, 255, 0, 0, 0];
/// Opacity of the palette's colours: unknown is transparent.
const OPACITY: [u8; 3] = [0, 255, 255];

/// Cells of a map in the form that its PGM and YAML have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapRaster<'a> {
    /// Grey values, the row of the highest y first.
    pixels: &'a [u8],
    width: usize,
    height: usize,
    resolution_m: f64,
    /// Cells from the map's origin to the lowest cell, along x and y.
    first_column: i64,
    first_row: i64,
}

impl<'a> MapRaster<'a> {
    /// Reads what [`to_pgm`](super::to_pgm) and [`to_yaml`](super::to_yaml) have written; `None` for anything
    /// else.
    pub fn read(pgm: &'a [u8], yaml: &str) -> Option<Self> {
        let rest = pgm.strip_prefix(b"P5\n")?;
        let (size, rest) = split_line(rest)?;
        let (_, pixels) = split_line(rest)?;
        let (width, height) = size.split_once(' ')?;
        let (width, height): (usize, usize) = (width.parse().ok()?, height.parse().ok()?);
        let field = |name| {
            let mut lines = yaml.lines();
            lines.find_map(|line| line.strip_prefix(name))
        };
        let resolution_m: f64 = field("resolution: ")?.parse().ok()?;
        let mut origin = field("origin: [")?.split(", ");
        let mut cells = || -> Option<i64> {
            let metres: f64 = origin.next()?.parse().ok()?;
            Some((metres / resolution_m).round() as i64)
        };
        let (first_column, first_row) = (cells()?, cells()?);
        let whole = pixels.len() == width * height && resolution_m > 0.0;
        whole.then_some(Self {
            pixels,
            width,
            height,
            resolution_m,
            first_column,
            first_row,
        })
    }

    /// Edge of a cell, metres.
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// Lowest x and y, highest x and y, metres.
    pub fn bounds_m(&self) -> [f64; 4] {
        let metres = |cells: i64| cells as f64 * self.resolution_m;
        let (width, height) = (self.width as i64, self.height as i64);
        [
            metres(self.first_column),
            metres(self.first_row),
            metres(self.first_column + width),
            metres(self.first_row + height),
        ]
    }

    /// The lowest zoom at which no cell shares its pixel with another: higher ones show no more.
    pub fn zoom(&self) -> u8 {
        self.native_zoom().clamp(0, i32::from(ZOOM_MAX)) as u8
    }

    /// A tile as an indexed PNG, unknown transparent, free white, occupied black. One outside the map is
    /// transparent.
    ///
    /// # Errors
    /// [`MapImageError`].
    pub fn tile(&self, zoom: u8, x: i32, y: i32) -> Result<Vec<u8>, MapImageError> {
        let size = TILE_PIXELS as u32;
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size, size);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Two);
        encoder.set_palette(PALETTE.as_slice());
        encoder.set_trns(OPACITY.as_slice());
        let mut writer = encoder.write_header()?;
        let ranks = self.ranks(zoom, x, y);
        let packed = ranks.chunks_exact(4);
        let packed = packed.map(|four| four.iter().fold(0, |byte, rank| byte << 2 | rank));
        writer.write_image_data(&packed.collect::<Vec<u8>>())?;
        writer.finish()?;
        Ok(bytes)
    }

    /// What the pixels of a tile show, row by row from above: 0 unknown, 1 free, 2 occupied.
    fn ranks(&self, zoom: u8, x: i32, y: i32) -> Vec<u8> {
        let mut ranks = vec![0; TILE_PIXELS * TILE_PIXELS];
        let scale = Scale(i32::from(zoom) - self.native_zoom());
        // Rows are counted downwards from the map's origin, as those of tiles are.
        let first_row = -(self.first_row + self.height as i64);
        let rows = scale.cells_of(y, first_row, self.height);
        let columns = scale.cells_of(x, self.first_column, self.width);
        for row in rows {
            let of_row = &self.pixels[row * self.width..][..self.width];
            let lines = scale.pixels_of(first_row + row as i64, y);
            for column in columns.clone() {
                let rank = occupancy_of(of_row[column]) as u8;
                if rank == 0 {
                    continue;
                }
                let across = scale.pixels_of(self.first_column + column as i64, x);
                for line in lines.clone() {
                    for pixel in &mut ranks[line * TILE_PIXELS..][across.clone()] {
                        *pixel = rank.max(*pixel);
                    }
                }
            }
        }
        ranks
    }

    /// How often the map's cell edge must be doubled to give this one, metres.
    pub(super) fn doublings_to(&self, resolution_m: f64) -> u32 {
        let doublings = (resolution_m / self.resolution_m).log2().round();
        (doublings as u32).min(30)
    }

    /// The occupancy of a cell whose edge is the map's doubled `doublings` times, counted from the map's
    /// origin: occupied if any of the map's cells in it is, else free if any is.
    pub(super) fn occupancy_at(&self, column: i64, row: i64, doublings: u32) -> Occupancy {
        let within = |cell: i64, first: i64, cells: usize| {
            let index = |cell: i64| (cell - first).clamp(0, cells as i64) as usize;
            index(cell << doublings)..index((cell + 1) << doublings)
        };
        let columns = within(column, self.first_column, self.width);
        let rows = within(row, self.first_row, self.height);
        let greys = rows.flat_map(|row| {
            let of_row = &self.pixels[(self.height - 1 - row) * self.width..];
            &of_row[columns.clone()]
        });
        let occupancies = greys.map(|grey| occupancy_of(*grey));
        occupancies.max().unwrap_or(Occupancy::Unknown)
    }

    /// The zoom at which a cell is a pixel; below 0 for a map of very coarse cells.
    fn native_zoom(&self) -> i32 {
        let doublings = (self.resolution_m / MAP_RESOLUTION_M).log2().round();
        // Maps as large as that are none; their bits must not be shifted out all the same.
        i32::from(ZOOM_MAX) - (doublings as i32).clamp(0, 30)
    }
}

/// By how many doublings cells are larger than the pixels of a zoom; below 0 they are smaller.
#[derive(Clone, Copy)]
struct Scale(i32);

impl Scale {
    /// Which of a map's cells along one axis lie in a tile, the first of them this many from the origin.
    fn cells_of(self, tile: i32, first_cell: i64, cells: usize) -> Range<usize> {
        let pixels = TILE_PIXELS as i64;
        let first = i64::from(tile) * pixels;
        let (from, to) = match self.0 {
            up @ 0.. => (first >> up, ((first + pixels - 1) >> up) + 1),
            down => (first << -down, (first + pixels) << -down),
        };
        let within = |cell: i64| (cell - first_cell).clamp(0, cells as i64) as usize;
        within(from)..within(to)
    }

    /// The pixels of a tile along one axis that a cell of it covers, or has a part of.
    fn pixels_of(self, cell: i64, tile: i32) -> Range<usize> {
        let first = i64::from(tile) * TILE_PIXELS as i64;
        let (from, to) = match self.0 {
            up @ 0.. => (cell << up, (cell + 1) << up),
            down => (cell >> -down, (cell >> -down) + 1),
        };
        let within = |pixel: i64| (pixel - first).clamp(0, TILE_PIXELS as i64) as usize;
        within(from)..within(to)
    }
}

/// What a grey value of a PGM stands for.
fn occupancy_of(grey: u8) -> Occupancy {
    match grey {
        0 => Occupancy::Occupied,
        254.. => Occupancy::Free,
        _ => Occupancy::Unknown,
    }
}

/// A line of a PGM's head, and what follows it.
fn split_line(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let line = std::str::from_utf8(&bytes[..end]).ok()?;
    Some((line, &bytes[end + 1..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GREYS: [u8; 3] = [205, 254, 0];

    /// A map of random cells, the lowest of them at a column and row, and its files.
    fn files(
        size: (usize, usize),
        first: (i64, i64),
        doublings: i32,
        seed: u64,
    ) -> (Vec<u8>, String) {
        let (width, height) = size;
        let resolution_m = MAP_RESOLUTION_M * 2_f64.powi(doublings);
        let mut pgm = format!("P5\n{width} {height}\n255\n").into_bytes();
        let mut state = seed | 1;
        for _ in 0..width * height {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            pgm.push(GREYS[(state >> 60) as usize % 3]);
        }
        let metres = |cells: i64| cells as f64 * resolution_m;
        let (x, y) = (metres(first.0), metres(first.1));
        let yaml =
            format!("image: map.pgm\nresolution: {resolution_m}\norigin: [{x:.6}, {y:.6}, 0.0]\n");
        (pgm, yaml)
    }

    impl MapRaster<'_> {
        /// What is known of a cell, counted from the map's origin.
        fn at(&self, column: i64, row: i64) -> u8 {
            let (column, row) = (column - self.first_column, row - self.first_row);
            let inside = |k: i64, size: usize| (0..size as i64).contains(&k);
            if !inside(column, self.width) || !inside(row, self.height) {
                return 0;
            }
            let from_above = self.height - 1 - row as usize;
            occupancy_of(self.pixels[from_above * self.width + column as usize]) as u8
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// A pixel shows the highest rank among the cells that it has a part of, found by its corners in metres.
        #[test]
        fn a_pixel_shows_the_most_of_its_cells(
            size in (1_usize..70, 1_usize..70), first in (-90_i64..40, -90_i64..40),
            doublings in 0..3_i32, zoom in 4_u8..=8, tile in (-2..2_i32, -2..2_i32), seed: u64,
        ) {
            let (pgm, yaml) = files(size, first, doublings, seed);
            let raster = MapRaster::read(&pgm, &yaml).unwrap();
            let ranks = raster.ranks(zoom, tile.0, tile.1);
            let pixel_m = MAP_RESOLUTION_M * 2_f64.powi(8 - i32::from(zoom));
            let cell_m = raster.resolution_m();
            let cells = |from_m: f64| {
                let first = (from_m / cell_m + 1e-6).floor() as i64;
                first..=((from_m + pixel_m) / cell_m - 1e-6).floor() as i64
            };
            for (k, rank) in ranks.iter().enumerate() {
                let across = i64::from(tile.0) * 256 + (k % 256) as i64;
                let down = i64::from(tile.1) * 256 + (k / 256) as i64;
                let columns = cells(across as f64 * pixel_m);
                let rows = cells(-(down + 1) as f64 * pixel_m);
                let shown = rows.flat_map(|row| columns.clone().map(move |column| (column, row)));
                let most = shown.map(|(column, row)| raster.at(column, row)).max();
                prop_assert_eq!(Some(*rank), most, "pixel {} of {:?}", k, raster.bounds_m());
            }
        }
    }

    #[test]
    fn a_tile_is_a_png_with_unknown_transparent() {
        let (pgm, yaml) = files((40, 30), (-10, -20), 0, 7);
        let raster = MapRaster::read(&pgm, &yaml).unwrap();
        let tile = raster.tile(8, 0, 0).unwrap();
        let mut decoder = png::Decoder::new(std::io::Cursor::new(tile));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut read = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut read).unwrap();
        assert_eq!((info.width, info.height), (256, 256));
        assert_eq!(info.color_type, png::ColorType::Rgba);
        let ranks = raster.ranks(8, 0, 0);
        assert!((0..3).all(|rank| ranks.contains(&rank)));
        for (rgba, rank) in read.chunks_exact(4).zip(ranks) {
            let expected = [[255, 255, 255, 0], [255; 4], [0, 0, 0, 255]];
            assert_eq!(rgba, expected[usize::from(rank)]);
        }
        let nothing = raster.tile(8, i32::MAX, i32::MIN).unwrap();
        assert_eq!(nothing, raster.tile(0, 90, 90).unwrap());
        assert!(nothing.len() < 300, "{}", nothing.len());
    }

    #[test]
    fn the_extent_and_the_zoom_are_those_of_the_cells() {
        let (pgm, yaml) = files((40, 30), (-10, -20), 2, 7);
        let raster = MapRaster::read(&pgm, &yaml).unwrap();
        let bounds_m = raster.bounds_m().map(|v| (v * 1e6).round() / 1e6);
        assert_eq!(bounds_m, [-2.0, -4.0, 6.0, 2.0]);
        assert_eq!((raster.resolution_m(), raster.zoom()), (0.2, 6));
        for (pgm, yaml) in [
            (&b"P5\n2 2\n255\n123"[..], &*yaml),
            (&pgm, "resolution: 0.05\n"),
        ] {
            assert_eq!(MapRaster::read(pgm, yaml), None);
        }
    }
}
