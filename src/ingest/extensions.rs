//! What a sender adds to an upload for its own use: any JSON object, kept as it was sent.

use serde::Deserialize;
use serde_json::value::RawValue;

use super::body_error::{BatchProblem, Checked, refuse};
use super::json::depth;

/// Most bytes of an upload's extensions.
pub const EXTENSIONS_BYTES_MAX: usize = 16 * 1024;
/// They nest no deeper than this, the object itself counted.
pub const EXTENSIONS_DEPTH_MAX: usize = 8;

/// Extensions as they were sent: any JSON.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
pub(super) struct Extensions(Box<RawValue>);

impl Extensions {
    /// The object's text.
    ///
    /// # Errors
    /// [`BatchProblem`] at `/extensions` if it is no object, too long or too deep.
    pub fn checked(self) -> Checked<String> {
        let text = self.0.get();
        let wrong = |problem, detail| refuse(problem, "/extensions", detail);
        if !text.starts_with('{') {
            let detail = "extensions are an object: {\"firmware\": \"4.2\"}".to_owned();
            return wrong(BatchProblem::InvalidField, detail);
        }
        if text.len() > EXTENSIONS_BYTES_MAX {
            let detail = format!(
                "extensions have at most {EXTENSIONS_BYTES_MAX} bytes, these have {}",
                text.len()
            );
            return wrong(BatchProblem::OutOfRange, detail);
        }
        if depth(text.as_bytes()) > EXTENSIONS_DEPTH_MAX {
            let detail = format!("extensions nest no deeper than {EXTENSIONS_DEPTH_MAX}");
            return wrong(BatchProblem::InvalidField, detail);
        }
        Ok(text.to_owned())
    }
}
