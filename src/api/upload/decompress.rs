//! Decompression that stops at decompression bombs.

use std::io::Read;

use flate2::bufread::GzDecoder;

use super::Encoding;
use crate::api::problem::{Problem, ProblemKind};

/// Real scans shrink to a third at best, bombs to a thousandth.
const RATIO_MAX: usize = 20;
/// Bodies up to this size may have any ratio, bytes.
const RATIO_FREE_BYTES: usize = 1 << 20;
/// By how much a body may exceed the ratio while it is read: a bomb is refused beyond that, without being decompressed
/// to its limit.
const AHEAD_BYTES_MAX: usize = 4 << 20;
/// The largest window that a zstd frame may ask for, as a power of two.
const WINDOW_LOG_MAX: u32 = 24;
const CHUNK_BYTES: usize = 64 << 10;

/// The most bytes that `wire_len` bytes may decompress to.
pub(super) fn most(wire_len: usize, bytes_max: usize) -> usize {
    let by_ratio = wire_len.saturating_mul(RATIO_MAX).max(RATIO_FREE_BYTES);
    by_ratio.min(bytes_max)
}

/// The body as it was before compression.
///
/// # Errors
/// 413 if it is longer than `bytes_max`, or than both 20 times the compressed size and 1 MiB, or if any part of it
/// exceeds 20 times the compressed bytes read so far by more than 4 MiB; 400 if it is damaged or followed by further
/// bytes.
pub(in crate::api) fn decompress(
    wire: Vec<u8>,
    encoding: Encoding,
    bytes_max: usize,
) -> Result<Vec<u8>, Problem> {
    match encoding {
        Encoding::Identity => Ok(wire),
        Encoding::Gzip => {
            let mut decoder = GzDecoder::new(wire.as_slice());
            let left = |decoder: &GzDecoder<&[u8]>| decoder.get_ref().len();
            let body = read_bounded(&mut decoder, left, wire.len(), bytes_max)?;
            check_end(decoder.into_inner())?;
            Ok(body)
        }
        Encoding::Zstd => {
            let decoder = zstd::stream::read::Decoder::with_buffer(wire.as_slice());
            let mut decoder = decoder.map_err(Problem::internal)?.single_frame();
            decoder
                .window_log_max(WINDOW_LOG_MAX)
                .map_err(Problem::internal)?;
            let left = |decoder: &zstd::Decoder<'_, &[u8]>| decoder.get_ref().len();
            let body = read_bounded(&mut decoder, left, wire.len(), bytes_max)?;
            check_end(decoder.finish())?;
            Ok(body)
        }
    }
}

/// Reads to the end; `left` is the number of compressed bytes that the reader has not taken yet.
fn read_bounded<R: Read>(
    reader: &mut R,
    left: impl Fn(&R) -> usize,
    wire_len: usize,
    bytes_max: usize,
) -> Result<Vec<u8>, Problem> {
    let most = most(wire_len, bytes_max);
    let mut body = Vec::new();
    let mut chunk = vec![0; CHUNK_BYTES];
    loop {
        let count = match reader.read(&mut chunk) {
            Ok(0) => return Ok(body),
            Ok(count) => count,
            Err(error) => {
                let detail = format!("the body does not decompress: {error}");
                return Err(Problem::new(ProblemKind::BadEncoding, detail));
            }
        };
        let taken = wire_len.saturating_sub(left(reader));
        let so_far = taken
            .saturating_mul(RATIO_MAX)
            .saturating_add(AHEAD_BYTES_MAX);
        if body.len() + count > most.min(so_far) {
            let detail = format!(
                "the body is too long after decompression: it may have at most {bytes_max} bytes and {RATIO_MAX} times the compressed size, which no part of it may exceed by more than {AHEAD_BYTES_MAX} bytes"
            );
            return Err(Problem::new(ProblemKind::TooLarge, detail));
        }
        body.extend_from_slice(&chunk[..count]);
    }
}

fn check_end(rest: &[u8]) -> Result<(), Problem> {
    if rest.is_empty() {
        return Ok(());
    }
    let detail = format!("{} bytes follow the compressed body", rest.len());
    Err(Problem::new(ProblemKind::BadEncoding, detail))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;

    const MAX: usize = 4 << 20;

    fn gzip(plain: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        encoder.write_all(plain).unwrap();
        encoder.finish().unwrap()
    }

    fn pack(plain: &[u8], encoding: Encoding) -> Vec<u8> {
        match encoding {
            Encoding::Identity => plain.to_vec(),
            Encoding::Gzip => gzip(plain),
            Encoding::Zstd => zstd::bulk::compress(plain, 3).unwrap(),
        }
    }

    fn refused(wire: Vec<u8>, encoding: Encoding) -> ProblemKind {
        decompress(wire, encoding, MAX).unwrap_err().kind()
    }

    #[test]
    fn bombs_are_refused_by_ratio_and_by_size() {
        for encoding in [Encoding::Gzip, Encoding::Zstd] {
            let bomb = pack(&vec![0; 2 << 20], encoding);
            assert_eq!(refused(bomb, encoding), ProblemKind::TooLarge);
            let small = pack(&vec![0; 1 << 20], encoding);
            assert_eq!(decompress(small, encoding, MAX).unwrap().len(), 1 << 20);
            let noise: Vec<u8> = (0_u32..5 << 18)
                .flat_map(|k| k.wrapping_mul(2_654_435_761).to_le_bytes())
                .collect();
            assert_eq!(
                refused(pack(&noise, encoding), encoding),
                ProblemKind::TooLarge
            );
        }
    }

    #[test]
    fn a_bomb_is_refused_where_it_runs_ahead_of_the_ratio() {
        let noise: Vec<u8> = (0_u32..1 << 18)
            .flat_map(|k| k.wrapping_mul(2_654_435_761).rotate_left(k).to_le_bytes())
            .collect();
        let ahead = |mebibytes: usize| [vec![0; mebibytes << 20], noise.clone()].concat();
        for encoding in [Encoding::Gzip, Encoding::Zstd] {
            let wire = pack(&ahead(8), encoding);
            assert!(most(wire.len(), 16 << 20) > 9 << 20, "{}", wire.len());
            let problem = decompress(wire, encoding, 16 << 20).unwrap_err();
            assert_eq!(problem.kind(), ProblemKind::TooLarge);
            let wire = pack(&ahead(3), encoding);
            assert_eq!(decompress(wire, encoding, 16 << 20).unwrap(), ahead(3));
        }
    }

    #[test]
    fn broken_and_trailing_bytes_are_refused() {
        for encoding in [Encoding::Gzip, Encoding::Zstd] {
            let good = pack(b"{\"vehicle_id\": \"agv-07\"}", encoding);
            assert_eq!(
                refused(good[..good.len() - 1].to_vec(), encoding),
                ProblemKind::BadEncoding
            );
            let twice = [good.clone(), good.clone()].concat();
            assert_eq!(refused(twice, encoding), ProblemKind::BadEncoding);
            let more = [good, vec![0]].concat();
            assert_eq!(refused(more, encoding), ProblemKind::BadEncoding);
        }
        assert_eq!(
            refused(b"{}".to_vec(), Encoding::Gzip),
            ProblemKind::BadEncoding
        );
        assert_eq!(
            refused(Vec::new(), Encoding::Zstd),
            ProblemKind::BadEncoding
        );
    }

    proptest! {
        #[test]
        fn what_was_packed_comes_out(plain in proptest::collection::vec(any::<u8>(), 0..5_000)) {
            for encoding in [Encoding::Identity, Encoding::Gzip, Encoding::Zstd] {
                prop_assert_eq!(&decompress(pack(&plain, encoding), encoding, MAX).unwrap(), &plain);
            }
        }

        #[test]
        fn foreign_bytes_never_panic(wire in proptest::collection::vec(any::<u8>(), 0..500)) {
            for encoding in [Encoding::Gzip, Encoding::Zstd] {
                if let Err(problem) = decompress(wire.clone(), encoding, MAX) {
                    prop_assert_eq!(problem.kind().status().is_client_error(), true);
                }
            }
        }
    }
}
