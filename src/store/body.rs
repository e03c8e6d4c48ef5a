//! Bodies at rest: compressed, with a checksum of what was sent.

use sha2::{Digest, Sha256};

use super::error::StoreError;

const COMPRESSION_LEVEL: i32 = 3;

/// The SHA-256 of some bytes.
pub(super) type Checksum = [u8; 32];

/// The SHA-256 of some bytes.
pub(super) fn checksum(bytes: &[u8]) -> Checksum {
    Sha256::digest(bytes).into()
}

/// A body as it is stored.
pub(super) struct SealedBody {
    /// Of the body as it was sent.
    pub(super) sha256: Checksum,
    /// Length of the body as it was sent.
    pub(super) bytes: i64,
    /// zstd.
    pub(super) compressed: Vec<u8>,
}

impl SealedBody {
    /// Compresses a body; milliseconds of work for a large one.
    pub(super) fn seal(body: &[u8]) -> Result<Self, StoreError> {
        let compressed =
            zstd::bulk::compress(body, COMPRESSION_LEVEL).map_err(StoreError::Compression)?;
        Ok(Self {
            sha256: checksum(body),
            bytes: i64::try_from(body.len()).unwrap_or(i64::MAX),
            compressed,
        })
    }
}

/// The body as it was sent, if it still has its checksum.
pub(super) fn unseal(compressed: &[u8], bytes: i64, sha256: &[u8]) -> Option<Vec<u8>> {
    let body = zstd::bulk::decompress(compressed, usize::try_from(bytes).ok()?).ok()?;
    (checksum(&body) == *sha256).then_some(body)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flipped_bit_is_found() {
        let body: Vec<u8> = (0..400_u32).map(|k| (k * k % 251) as u8).collect();
        let sealed = SealedBody::seal(&body).unwrap();
        let unsealed = unseal(&sealed.compressed, sealed.bytes, &sealed.sha256);
        assert_eq!(unsealed.as_deref(), Some(body.as_slice()));
        for bit in 0..sealed.compressed.len() * 8 {
            let mut flipped = sealed.compressed.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let read = unseal(&flipped, sealed.bytes, &sealed.sha256);
            // A bit that the decoder ignores may flip: what was sent must come out, or nothing.
            assert!(read.is_none_or(|read| read == body), "bit {bit}");
        }
    }

    #[test]
    fn an_empty_body_is_a_body() {
        let sealed = SealedBody::seal(&[]).unwrap();
        assert_eq!(unseal(&sealed.compressed, 0, &sealed.sha256), Some(vec![]));
    }
}
