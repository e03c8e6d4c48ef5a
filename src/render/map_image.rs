//! Pictures of a map: PNG for people, PGM and YAML for ROS's `map_server`.

use super::{Occupancy, OccupancyGrid};

/// Why a picture could not be made.
#[derive(Debug, thiserror::Error)]
pub enum MapImageError {
    /// The picture has more columns or rows than the format can name.
    #[error("a picture of {width} × {height} pixels is too large")]
    TooLarge {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The encoder refused.
    #[error("the PNG encoder failed")]
    Png(#[from] png::EncodingError),
}

/// 8-bit grey values of the three states.
struct Palette {
    unknown: u8,
    free: u8,
    occupied: u8,
}

const FOR_PEOPLE: Palette = Palette {
    unknown: 222,
    free: 255,
    occupied: 16,
};

/// What `map_server` reads back as unknown, free and occupied in its `trinary` mode.
const FOR_MAP_SERVER: Palette = Palette {
    unknown: 205,
    free: 254,
    occupied: 0,
};

/// The grid as an 8-bit grey PNG: free white, occupied black, unknown light grey; one pixel a
/// cell, y upwards.
///
/// # Errors
/// [`MapImageError`]; not for grids of [`OccupancyGrid::from_scans`].
pub fn to_png(grid: &OccupancyGrid) -> Result<Vec<u8>, MapImageError> {
    let (width, height) = (grid.width(), grid.height());
    let too_large = |_| MapImageError::TooLarge { width, height };
    let columns = u32::try_from(width).map_err(too_large)?;
    let rows = u32::try_from(height).map_err(too_large)?;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, columns, rows);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels(grid, &FOR_PEOPLE))?;
    writer.finish()?;
    Ok(bytes)
}

/// The grid as a binary PGM (P5) with `map_server`'s grey values: 0 occupied, 254 free, 205
/// unknown; row 0 on top.
pub fn to_pgm(grid: &OccupancyGrid) -> Vec<u8> {
    let mut bytes = format!("P5\n{} {}\n255\n", grid.width(), grid.height()).into_bytes();
    bytes.extend(pixels(grid, &FOR_MAP_SERVER));
    bytes
}

/// The YAML file that goes with [`to_pgm`]; `image` is the picture's file name or path, relative
/// to the YAML file.
///
/// Loaders make an occupancy of a grey value v, (255 − v)/255: 0.19608 of the 205 that is unknown,
/// which must be neither below `free_thresh` nor above `occupied_thresh`.
pub fn to_yaml(grid: &OccupancyGrid, image: &str) -> String {
    let origin = grid.origin();
    format!(
        "image: {image}\n\
         mode: trinary\n\
         resolution: {}\n\
         origin: [{:.6}, {:.6}, 0.0]\n\
         negate: 0\n\
         occupied_thresh: 0.65\n\
         free_thresh: 0.196\n",
        grid.resolution_m(),
        origin.x,
        origin.y,
    )
}

fn pixels(grid: &OccupancyGrid, palette: &Palette) -> Vec<u8> {
    let mut pixels = Vec::with_capacity(grid.width() * grid.height());
    for row in (0..grid.height()).rev() {
        pixels.extend(
            (0..grid.width()).map(|column| match grid.occupancy(column, row) {
                Occupancy::Unknown => palette.unknown,
                Occupancy::Free => palette.free,
                Occupancy::Occupied => palette.occupied,
            }),
        );
    }
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose2, Vector2};
    use crate::scan::{LaserScan, Lidar};
    use std::sync::Arc;

    /// One beam along +y, 1 m long, from (0.025, 0.025).
    fn one_beam() -> OccupancyGrid {
        let lidar = Arc::new(Lidar {
            angle_min_rad: std::f64::consts::FRAC_PI_2,
            angle_increment_rad: 0.1,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        });
        let scan = LaserScan::new(lidar, [Some(1.0)]).unwrap();
        OccupancyGrid::from_scans([(Pose2::new(0.025, 0.025, 0.0), &scan)], 0.05)
    }

    fn pixel_of(grid: &OccupancyGrid, pixels: &[u8], x: f64, y: f64) -> u8 {
        let (column, row) = grid.cell_at(&Vector2::new(x, y)).unwrap();
        pixels[(grid.height() - 1 - row) * grid.width() + column]
    }

    #[test]
    fn pgm_has_the_header_and_values_of_map_server() {
        let grid = one_beam();
        let pgm = to_pgm(&grid);
        let header = b"P5\n17 37\n255\n";
        assert_eq!(&pgm[..header.len()], header);
        let pixels = &pgm[header.len()..];
        assert_eq!(pixels.len(), 17 * 37);
        assert_eq!(pixel_of(&grid, pixels, 0.025, 1.025), 0);
        assert_eq!(pixel_of(&grid, pixels, 0.025, 0.525), 254);
        assert_eq!(pixel_of(&grid, pixels, 0.325, 0.525), 205);
        // Row 0 is on top: the return lies above the beam's start.
        let first = |value| pixels.iter().position(|&p| p == value).unwrap();
        assert!(first(0) < first(254));
    }

    #[test]
    fn png_reads_back_as_it_was_written() {
        let grid = one_beam();
        let bytes = to_png(&grid).unwrap();
        assert_eq!(bytes, to_png(&grid).unwrap());
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        let mut read = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut read).unwrap();
        assert_eq!((info.width, info.height), (17, 37));
        assert_eq!(info.color_type, png::ColorType::Grayscale);
        assert_eq!(read, pixels(&grid, &FOR_PEOPLE));
        assert_eq!(pixel_of(&grid, &read, 0.025, 1.025), 16);
    }

    #[test]
    fn yaml_has_the_keys_of_map_server() {
        let expected = "image: hall.pgm\nmode: trinary\nresolution: 0.05\n\
                        origin: [-0.400000, -0.400000, 0.0]\nnegate: 0\n\
                        occupied_thresh: 0.65\nfree_thresh: 0.196\n";
        assert_eq!(to_yaml(&one_beam(), "hall.pgm"), expected);
    }

    #[test]
    fn loaders_read_each_cell_as_it_is() {
        let grid = one_beam();
        let yaml = to_yaml(&grid, "hall.pgm");
        let threshold = |key: &str| -> f64 {
            let line = yaml.lines().find(|line| line.starts_with(key)).unwrap();
            line[key.len()..].trim().parse().unwrap()
        };
        let (occupied, free) = (threshold("occupied_thresh:"), threshold("free_thresh:"));
        let loaded = |grey: u8| match (255.0 - f64::from(grey)) / 255.0 {
            occupancy if occupancy > occupied => Occupancy::Occupied,
            occupancy if occupancy < free => Occupancy::Free,
            _ => Occupancy::Unknown,
        };
        let greys = pixels(&grid, &FOR_MAP_SERVER);
        let mut of_each = [0; 3];
        for (k, grey) in greys.iter().enumerate() {
            let (column, row) = (k % grid.width(), grid.height() - 1 - k / grid.width());
            let truly = grid.occupancy(column, row);
            assert_eq!(loaded(*grey), truly, "{column}, {row}");
            of_each[truly as usize] += 1;
        }
        assert!(of_each.iter().all(|count| *count > 0), "{of_each:?}");
    }
}
