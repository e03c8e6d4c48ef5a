//! Uploads.

use super::text_enum;

text_enum! {
    /// What a batch holds.
    BatchKind {
        /// Scans, a part of a trip.
        Scans = "scans",
        /// Nodes and edges.
        Edges = "edges",
    }
}

text_enum! {
    /// The format of a recording.
    RecordingFormat {
        /// MCAP: a ROS 2 bag, or Foxglove's JSON messages.
        Mcap = "mcap",
        /// A CARMEN log.
        Carmen = "carmen",
    }
}

text_enum! {
    /// The status of a batch.
    BatchStatus {
        /// Stored; a worker will take it.
        Queued = "queued",
        /// A worker processes it.
        Processing = "processing",
        /// Waits for its predecessor.
        Held = "held",
        /// In the map.
        Merged = "merged",
        /// Its trip could not be localised in the map; tried again when the map or the trip grows.
        Unanchored = "unanchored",
        /// Processing failed for good; the reason says why.
        Quarantined = "quarantined",
        /// Removed from the map by somebody.
        Removed = "removed",
    }
}

impl BatchStatus {
    /// Whether it is still to be processed.
    pub fn is_pending(self) -> bool {
        matches!(self, Self::Queued | Self::Processing | Self::Held)
    }
}

text_enum! {
    /// What was noticed about a batch without refusing it. Readers take texts that are not
    /// listed here as well.
    BatchFlag {
        /// Stamps lie far in the future, or the vehicle's clock is hours behind.
        ClockSkew = "clock_skew",
        /// Scans without any return.
        EmptyScans = "empty_scans",
        /// Earlier batches of its trip are missing.
        Gap = "gap",
        /// Stamps lie far in the past.
        Late = "late",
        /// It led to a misplaced segment of the map being moved.
        MapMended = "map_mended",
        /// At its end the vehicle was not localised.
        NotLocalised = "not_localised",
        /// The odometry is faster than any vehicle.
        WildOdometry = "wild_odometry",
        /// Readings of `range_max` or longer, which count as no return.
        AboveRangeMax = "above_range_max",
        /// Readings below `range_min`, which are invalid.
        BelowRangeMin = "below_range_min",
        /// Scans were taken clockwise; their beams were put into counter-clockwise order.
        ClockwiseScans = "clockwise_scans",
        /// Stamps before 2000, of a simulation or of a clock that was never set.
        SimulatedTime = "simulated_time",
    }
}
