//! Random secrets that somebody holds, of which only a digest is kept.

use std::fmt;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};

use crate::ids::KeyId;

/// The prefix of every key, by which scanners of source code find keys that were committed.
const PREFIX: &str = "ms_";

/// 32 random bytes.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret([u8; 32]);

impl Secret {
    /// A new one.
    ///
    /// # Errors
    /// If the system has no randomness.
    pub fn random() -> Result<Self, getrandom::Error> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes)?;
        Ok(Self(bytes))
    }

    /// As its holder has it: 43 characters of base64url.
    pub fn text(&self) -> String {
        URL_SAFE_NO_PAD.encode(self.0)
    }

    /// The secret of a text; `None` if it is none.
    pub fn of_text(text: &str) -> Option<Self> {
        let bytes = URL_SAFE_NO_PAD.decode(text).ok()?;
        bytes.try_into().ok().map(Self)
    }

    /// What is kept of it.
    pub(super) fn digest(&self) -> [u8; 32] {
        Sha256::digest(self.0).into()
    }

    /// Whether a digest is its own; takes the same time whichever bytes differ.
    pub(super) fn has_digest(&self, digest: &[u8]) -> bool {
        let own = self.digest();
        let differing = own.iter().zip(digest).fold(0, |all, (a, b)| all | (a ^ b));
        own.len() == digest.len() && differing == 0
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

/// A key as its holder sends it: `ms_`, its id without hyphens, `_`, and its secret.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeyText {
    /// Which key it is.
    pub id: KeyId,
    /// What shows that somebody holds it.
    pub secret: Secret,
}

/// A text that is no key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a key has the form ms_…_…, as it was shown when it was made")]
pub struct NoKey;

impl KeyText {
    /// The text, to be shown to its holder once.
    pub fn text(&self) -> String {
        format!("{PREFIX}{}_{}", self.id.0.simple(), self.secret.text())
    }
}

impl FromStr for KeyText {
    type Err = NoKey;

    fn from_str(text: &str) -> Result<Self, NoKey> {
        let parts = text
            .strip_prefix(PREFIX)
            .and_then(|rest| rest.split_once('_'));
        let (id, secret) = parts.ok_or(NoKey)?;
        Ok(Self {
            id: id.parse().map_err(|_| NoKey)?,
            secret: Secret::of_text(secret).ok_or(NoKey)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_comes_back_from_its_text() {
        let key = KeyText {
            id: KeyId(uuid::Uuid::from_u128(7)),
            secret: Secret([0xfb; 32]),
        };
        let text = key.text();
        assert!(text.starts_with("ms_00000000000000000000000000000007_"));
        assert_eq!(text.parse(), Ok(key));
        for bad in [
            "",
            "ms_",
            "ms_7_x",
            &text[1..],
            &text[..text.len() - 1],
            &format!("{text}A"),
        ] {
            assert_eq!(bad.parse::<KeyText>(), Err(NoKey), "{bad}");
        }
    }

    #[test]
    fn secrets_differ_and_are_not_printed() {
        let (one, other) = (Secret::random().unwrap(), Secret::random().unwrap());
        assert_ne!(one, other);
        assert!(one.has_digest(&one.digest()));
        assert!(!one.has_digest(&other.digest()) && !one.has_digest(&[]));
        assert!(!format!("{one:?}").contains(&one.text()));
    }
}
