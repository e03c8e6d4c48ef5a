//! The compact form of a scan: postcard of the ticks' differences, compressed with zstd.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{BEAMS_MAX, BandView, HeightBand, LaserScan, Lidar, LidarError, ScanError};
use crate::geometry::Pose2;

const COMPRESSION_LEVEL: i32 = 3;
const DECODED_BYTES_MAX: usize = 128 + BEAMS_MAX * 4;

#[derive(Serialize, Deserialize)]
struct Record {
    angle_min_rad: f64,
    angle_increment_rad: f64,
    range_min_m: f64,
    range_max_m: f64,
    mount: [f64; 3],
    range_sigma_m: f64,
    /// Each beam's ticks minus the beam's before it.
    tick_steps: Vec<i32>,
}

/// What follows the record of a lidar with a height band, and of no other.
#[derive(Serialize, Deserialize)]
struct BandRecord {
    from_m: f64,
    to_m: f64,
    clear_from_m: f64,
    clear_to_m: f64,
}

/// Why bytes are not a scan.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    /// Not zstd, or longer than any scan.
    #[error("the scan's bytes do not decompress")]
    Compression(#[from] std::io::Error),
    /// Not the record.
    #[error("the scan's record does not decode")]
    Record(#[from] postcard::Error),
    /// A tick outside `u16`.
    #[error("beam {0} is out of range")]
    Tick(usize),
    /// Refused geometry.
    #[error(transparent)]
    Lidar(#[from] LidarError),
    /// Refused sweep.
    #[error(transparent)]
    Scan(#[from] ScanError),
}

/// The scan's bytes; [`decode_scan`] gives back an equal scan.
///
/// # Errors
/// [`CodecError`] if the compressor fails.
pub fn encode_scan(scan: &LaserScan) -> Result<Vec<u8>, CodecError> {
    let lidar = scan.lidar();
    let mut last = 0;
    let steps = scan.ticks().iter().map(|&tick| {
        let tick = i32::from(tick);
        let step = tick - last;
        last = tick;
        step
    });
    let record = Record {
        angle_min_rad: lidar.angle_min_rad,
        angle_increment_rad: lidar.angle_increment_rad,
        range_min_m: lidar.range_min_m,
        range_max_m: lidar.range_max_m,
        mount: [lidar.mount.x, lidar.mount.y, lidar.mount.theta],
        range_sigma_m: lidar.range_sigma_m,
        tick_steps: steps.collect(),
    };
    let mut plain = postcard::to_stdvec(&record)?;
    if let Some(view) = &lidar.band {
        let band = BandRecord {
            from_m: view.band.from_m,
            to_m: view.band.to_m,
            clear_from_m: view.clear_from_m,
            clear_to_m: view.clear_to_m,
        };
        plain = postcard::to_extend(&band, plain)?;
    }
    Ok(zstd::bulk::compress(&plain, COMPRESSION_LEVEL)?)
}

/// The scan that [`encode_scan`] wrote.
///
/// # Errors
/// [`CodecError`] for any other bytes.
pub fn decode_scan(bytes: &[u8]) -> Result<LaserScan, CodecError> {
    let plain = zstd::bulk::decompress(bytes, DECODED_BYTES_MAX)?;
    let (record, rest): (Record, &[u8]) = postcard::take_from_bytes(&plain)?;
    let band: Option<BandRecord> = match rest.is_empty() {
        true => None,
        false => Some(postcard::from_bytes(rest)?),
    };
    let lidar = Lidar {
        angle_min_rad: record.angle_min_rad,
        angle_increment_rad: record.angle_increment_rad,
        range_min_m: record.range_min_m,
        range_max_m: record.range_max_m,
        mount: Pose2::new(record.mount[0], record.mount[1], record.mount[2]),
        range_sigma_m: record.range_sigma_m,
        band: band.map(|band| BandView {
            band: HeightBand {
                from_m: band.from_m,
                to_m: band.to_m,
            },
            clear_from_m: band.clear_from_m,
            clear_to_m: band.clear_to_m,
        }),
    }
    .validated()?;
    let mut last = 0i32;
    let mut ticks = Vec::with_capacity(record.tick_steps.len());
    for (beam, step) in record.tick_steps.iter().enumerate() {
        last = last.checked_add(*step).ok_or(CodecError::Tick(beam))?;
        ticks.push(u16::try_from(last).map_err(|_| CodecError::Tick(beam))?);
    }
    Ok(LaserScan::from_ticks(Arc::new(lidar), ticks)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Reading;
    use proptest::prelude::*;

    fn any_range() -> impl Strategy<Value = Option<f64>> {
        prop_oneof![
            Just(None),
            (-1.0..500.0_f64).prop_map(Some),
            (0.05..0.15_f64).prop_map(Some),
            proptest::sample::select(vec![
                f64::NAN,
                f64::INFINITY,
                f64::NEG_INFINITY,
                0.0,
                -0.0,
                0.1,
            ])
            .prop_map(Some),
        ]
    }

    fn any_band() -> impl Strategy<Value = BandView> {
        let ends = (0.0..1.0_f64, 0.1..1.0_f64, 0.0..3.0_f64, 0.1..9.0_f64);
        ends.prop_map(|(from_m, height_m, clear_from_m, clear_m)| BandView {
            band: HeightBand::new(from_m, from_m + height_m).unwrap(),
            clear_from_m,
            clear_to_m: clear_from_m + clear_m,
        })
    }

    proptest! {
        #[test]
        fn round_trip(
            ticks in proptest::collection::vec(any::<u16>(), 1..400),
            range_max_m in 1.0..500.0_f64,
            band in proptest::option::of(any_band()),
        ) {
            let lidar = Lidar {
                angle_min_rad: -1.5,
                angle_increment_rad: 0.01,
                range_min_m: 0.0,
                range_max_m,
                mount: Pose2::new(0.2, -0.1, 0.3),
                range_sigma_m: 0.02,
                band,
            };
            let scan = LaserScan::from_ticks(Arc::new(lidar), ticks).unwrap();
            prop_assert_eq!(decode_scan(&encode_scan(&scan).unwrap()).unwrap(), scan);
        }

        /// Whatever a driver sends for a beam, what it says is the same afterwards.
        #[test]
        fn what_each_beam_says_survives(
            ranges in proptest::collection::vec(any_range(), 1..400),
            range_max_m in 1.0..500.0_f64,
        ) {
            let lidar = Lidar {
                angle_min_rad: -1.5,
                angle_increment_rad: 0.01,
                range_min_m: 0.1,
                range_max_m,
                mount: Pose2::IDENTITY,
                range_sigma_m: 0.02,
                band: None,
            };
            let scan = LaserScan::new(Arc::new(lidar), ranges.clone()).unwrap();
            let decoded = decode_scan(&encode_scan(&scan).unwrap()).unwrap();
            prop_assert_eq!(&decoded, &scan);
            for (beam, sent) in ranges.iter().enumerate() {
                let half_tick_m = 0.5 * decoded.lidar().tick_m() + 1e-9;
                let is_right = match (decoded.reading(beam), *sent) {
                    (Reading::Invalid, Some(r)) => r.is_nan() || r < 0.1,
                    (Reading::NoReturn, sent) => sent.is_none_or(|r| r >= range_max_m),
                    (Reading::Range(read_m), Some(r)) => (read_m - r).abs() <= half_tick_m,
                    _ => false,
                };
                prop_assert!(is_right, "{:?} of {:?}", decoded.reading(beam), sent);
            }
        }

        #[test]
        fn foreign_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            prop_assert!(decode_scan(&bytes).is_err());
        }
    }
}
