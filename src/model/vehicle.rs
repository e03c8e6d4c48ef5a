//! Whether what a vehicle sends is believed.

use super::text_enum;

text_enum! {
    /// Whether what a vehicle sends is believed.
    VehicleState {
        /// Nothing speaks against it.
        Trusted = "trusted",
        /// An undecided alert of kind `vehicle_suspect` names it, or several of its newest batches were
        /// kept out of the map.
        Suspect = "suspect",
        /// Somebody keeps its uploads out of the map.
        Quarantined = "quarantined",
    }
}
