//! What alerts are about, and their life.

use super::text_enum;

text_enum! {
    /// What kind of contradiction between the map and the world was found.
    ChangeKind {
        /// Something is where earlier observations saw free space.
        Appeared = "appeared",
        /// There is free space where earlier observations saw something.
        Disappeared = "disappeared",
        /// Closures contradict the map, without scans that say what changed.
        Residual = "residual",
        /// A segment of a trip does not fit the map: its scans differ, or expected closures are missing.
        MapMismatch = "map_mismatch",
        /// A vehicle's calibration has changed, or has an error that cannot be corrected.
        VehicleSuspect = "vehicle_suspect",
    }
}

impl ChangeKind {
    /// Whether a place is free that was occupied, or the reverse.
    pub fn is_of_state(self) -> bool {
        matches!(self, Self::Appeared | Self::Disappeared)
    }

    /// Whether it is about the world, so that a map can take it in: a vehicle that is off and a map that is
    /// wrong are no changes.
    pub fn is_of_world(self) -> bool {
        !matches!(self, Self::VehicleSuspect | Self::MapMismatch)
    }
}

text_enum! {
    /// How certain an alert is: one pass is a hint, two are evidence.
    Tier {
        /// One pass by one vehicle shows the new state so far.
        Tentative = "tentative",
        /// Two passes, or two vehicles, show the new state.
        Confirmed = "confirmed",
    }
}

text_enum! {
    /// Whether a pass by the place of a change was before it or since.
    PassSide {
        /// Before the first observation of the new state.
        Before = "before",
        /// With that observation, or later.
        Since = "since",
    }
}

text_enum! {
    /// Which observations a picture of a place shows.
    #[derive(Default)]
    ShownSide {
        /// Those from before the change.
        Before = "before",
        /// Those since.
        Since = "since",
        /// All, each side in its colour.
        #[default]
        Both = "both",
    }
}

text_enum! {
    /// What a pass saw at the place of a change.
    PassOutcome {
        /// The old state.
        OldState = "old_state",
        /// The new state.
        NewState = "new_state",
        /// Neither: the place was within reach but occluded, or the scans of the pass disagree.
        CouldNotSee = "could_not_see",
    }
}

text_enum! {
    /// How near a change is to the path that vehicles took before it.
    Clearance {
        /// Nearer than half the width of a vehicle: it blocks their path.
        Blocking = "blocking",
        /// Within a metre.
        Near = "near",
        /// Farther off.
        Clear = "clear",
    }
}

text_enum! {
    /// The status of an alert.
    AlertStatus {
        /// Raised; nobody has acknowledged it.
        Open = "open",
        /// Somebody works on it.
        Acknowledged = "acknowledged",
        /// The map shows the new state.
        Accepted = "accepted",
        /// The map is right as it is; what was dismissed is not raised again while it lasts.
        Dismissed = "dismissed",
        /// Later observations show the old state, or refute it.
        Resolved = "resolved",
    }
}

text_enum! {
    /// What can be done with an alert.
    AlertAction {
        /// Mark it as being worked on.
        Acknowledge = "acknowledge",
        /// Accept the change into the map.
        Accept = "accept",
        /// Keep the map, and do not raise the same thing again.
        Dismiss = "dismiss",
        /// Make it open again.
        Reopen = "reopen",
        /// Undo an acceptance.
        Undo = "undo",
    }
}

text_enum! {
    /// The outcome of one of several decisions.
    DecisionResult {
        /// It was carried out.
        Done = "done",
        /// The alert had that status already.
        AlreadyDone = "already_done",
        /// The alert has changed since it was read.
        Changed = "changed",
        /// The alert's status or kind does not allow it.
        NotAllowed = "not_allowed",
        /// There is no such alert.
        Unknown = "unknown",
        /// It could not be carried out now; the same may succeed later.
        Failed = "failed",
    }
}

text_enum! {
    /// Why an alert is dismissed.
    DismissReason {
        /// The change is temporary.
        Temporary = "temporary",
        /// People were standing there.
        People = "people",
        /// A lidar measured something that is not there.
        Sensor = "sensor",
        /// The map or the vehicle's pose is wrong there.
        WrongPlace = "wrong_place",
        /// Something else, as the note says.
        Other = "other",
    }
}

text_enum! {
    /// The verdict of another scan on a beam.
    BeamVerdict {
        /// The other scan has a surface where the beam ended.
        Agrees = "agrees",
        /// The other scan saw through the place where the beam ended.
        Contradicts = "contradicts",
        /// Something nearer hid the place from the other scan.
        Occluded = "occluded",
        /// The other scan has no beam there, or one without a return.
        Unseen = "unseen",
        /// The beam itself has no return: nothing to judge, and no evidence of free space (REP-117).
        NoReturn = "no_return",
    }
}
