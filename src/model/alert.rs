//! What alerts are about, and their life.

use super::text_enum;

text_enum! {
    /// What kind of contradiction between the map and the world was found.
    ChangeKind {
        /// Something stands where earlier looks saw free space.
        Appeared = "appeared",
        /// Free space is seen where earlier looks saw something.
        Disappeared = "disappeared",
        /// Closures contradict the map, without scans that say what changed.
        Residual = "residual",
        /// So much differs, or so many closures are missing, that the map does not fit the place.
        MapMismatch = "map_mismatch",
        /// A vehicle has changed, or is off in a way that cannot be corrected.
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
    /// How far an alert is to be believed: one pass is a hint, two are evidence.
    Tier {
        /// One pass by one vehicle shows the new state so far: shown, not sent.
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
    /// Whose observations a picture of a place shows.
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
        /// What was there before.
        OldState = "old_state",
        /// What is new.
        NewState = "new_state",
        /// Neither: the place was within reach, but hidden, or the scans of the pass disagree.
        CouldNotSee = "could_not_see",
    }
}

text_enum! {
    /// How near a change is to the way that vehicles took before it.
    Clearance {
        /// Nearer than half the width of a vehicle: it stands in their way.
        Blocking = "blocking",
        /// Within a metre.
        Near = "near",
        /// Farther off.
        Clear = "clear",
    }
}

text_enum! {
    /// Where an alert is in its life.
    AlertStatus {
        /// Raised; nobody has looked at it.
        Open = "open",
        /// Somebody has taken it up.
        Acknowledged = "acknowledged",
        /// The map shows the new state.
        Accepted = "accepted",
        /// The map is right as it is; what was dismissed is not raised again while it lasts.
        Dismissed = "dismissed",
        /// Later looks show the old state, or refute it.
        Resolved = "resolved",
    }
}

text_enum! {
    /// What somebody may do with an alert.
    AlertAction {
        /// Take it up.
        Acknowledge = "acknowledge",
        /// Take the change into the map.
        Accept = "accept",
        /// Keep the map, and do not raise the same thing again.
        Dismiss = "dismiss",
        /// Put it back among the open ones.
        Reopen = "reopen",
        /// Take an acceptance back.
        Undo = "undo",
    }
}

text_enum! {
    /// What became of one of several decisions.
    DecisionResult {
        /// It was carried out.
        Done = "done",
        /// The alert had that status already.
        AlreadyDone = "already_done",
        /// The alert is not as it was when it was decided about.
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
        /// What is there will be gone again.
        Temporary = "temporary",
        /// People were standing there.
        People = "people",
        /// A lidar saw what is not so.
        Sensor = "sensor",
        /// The map or the vehicle's pose is off there.
        WrongPlace = "wrong_place",
        /// Something else, as the note says.
        Other = "other",
    }
}

text_enum! {
    /// What another scan says of a beam.
    BeamVerdict {
        /// The other scan has a surface where the beam ended.
        Agrees = "agrees",
        /// The other scan saw through the place where the beam ended.
        Contradicts = "contradicts",
        /// Something nearer hid the place from the other scan.
        Occluded = "occluded",
        /// The other scan did not look there, or its beam has no return.
        Unseen = "unseen",
        /// The beam itself has no return: nothing to judge, and no evidence of free space (REP-117).
        NoReturn = "no_return",
    }
}
