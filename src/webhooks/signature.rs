//! Signatures as Standard Webhooks has them (<https://www.standardwebhooks.com>, version 1).

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use jiff::Timestamp;
use sha2::Sha256;

use crate::store::{NextDelivery, WebhookSecret};

/// What a secret's text begins with.
const SECRET_PREFIX: &str = "whsec_";
/// The symmetric kind of signature.
const SIGNATURE_PREFIX: &str = "v1,";

/// A new secret from the system's source of randomness.
///
/// # Errors
/// If the system has none.
pub fn generate_secret() -> Result<WebhookSecret, getrandom::Error> {
    let mut key = [0; 32];
    getrandom::fill(&mut key)?;
    Ok(WebhookSecret(key))
}

/// A secret as its holder receives it: `whsec_` and the key in base64.
pub fn secret_text(secret: &WebhookSecret) -> String {
    format!("{SECRET_PREFIX}{}", STANDARD.encode(secret.0))
}

/// The value of `webhook-signature`: a signature with the secret and, while the one before is valid as well,
/// one with that, separated by a space.
pub(super) fn signatures(next: &NextDelivery, now: Timestamp, body: &str) -> String {
    let previous = next.previous_secret.as_ref();
    let previous = previous.filter(|(_, until)| now < *until);
    let secrets = [&next.secret]
        .into_iter()
        .chain(previous.map(|(secret, _)| secret));
    let signatures = secrets.map(|secret| signature(secret, &next.id, now.as_second(), body));
    signatures.collect::<Vec<_>>().join(" ")
}

/// `v1,` and the HMAC-SHA256 of `id.timestamp.body` in base64.
fn signature(secret: &WebhookSecret, id: &str, timestamp_s: i64, body: &str) -> String {
    let mut mac = keyed(secret);
    mac.update(format!("{id}.{timestamp_s}.").as_bytes());
    mac.update(body.as_bytes());
    let code = mac.finalize().into_bytes();
    format!("{SIGNATURE_PREFIX}{}", STANDARD.encode(code))
}

/// A key as long as this needs no hashing, and no length can be wrong.
fn keyed(secret: &WebhookSecret) -> Hmac<Sha256> {
    let mut block = [0; 64];
    block[..secret.0.len()].copy_from_slice(&secret.0);
    Hmac::new(&block.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computed with Python: `hmac.new(bytes(range(32)), b"msg_0001.1795154409." + body, "sha256")`.
    #[test]
    fn a_signature_is_the_one_that_others_compute() {
        let secret = WebhookSecret(std::array::from_fn(|k| k as u8));
        assert_eq!(
            secret_text(&secret),
            "whsec_AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8="
        );
        assert_eq!(
            signature(
                &secret,
                "msg_0001",
                1_795_154_409,
                r#"{"type":"alert.raised"}"#
            ),
            "v1,Wca+HubgWG90acgyHFAaj/r+OMbXJ48ibPLwHJ4/wbk="
        );
    }

    #[test]
    fn everything_that_is_signed_counts() {
        let secret = WebhookSecret([7; 32]);
        let signed = signature(&secret, "msg_1", 5, "body");
        assert_ne!(signed, signature(&secret, "msg_2", 5, "body"));
        assert_ne!(signed, signature(&secret, "msg_1", 6, "body"));
        assert_ne!(signed, signature(&secret, "msg_1", 5, "body "));
        assert_ne!(
            signed,
            signature(&WebhookSecret([8; 32]), "msg_1", 5, "body")
        );
    }

    #[test]
    fn secrets_are_never_the_same_and_never_printed() {
        let (one, other) = (generate_secret().unwrap(), generate_secret().unwrap());
        assert_ne!(one.0, other.0);
        assert!(!format!("{one:?}").contains(&one.0[0].to_string()));
    }
}
