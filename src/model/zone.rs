//! What zones are for.

use super::text_enum;

text_enum! {
    /// What a zone does with the alerts in it.
    ZonePurpose {
        /// They are recorded and shown, but not sent, and nobody is asked to decide about them.
        Mute = "mute",
    }
}
