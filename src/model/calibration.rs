//! What can be wrong with a vehicle in every scan and every motion alike.

use super::text_enum;

text_enum! {
    /// A systematic error of a vehicle. Its value is how far the truth is from what was stated: 0 for a
    /// vehicle that is as it says.
    Quantity {
        /// Turn of the lidar against its stated mount, radians, counter-clockwise.
        MountYaw = "mount_yaw",
        /// How far the lidar sits ahead of its stated mount, metres, base frame.
        MountX = "mount_x",
        /// How far the lidar sits to the left of its stated mount, metres, base frame.
        MountY = "mount_y",
        /// Share by which ways are longer than the wheels say: metres of the scans for each metre of
        /// the wheels, less one. See [`Quantity::RangeScale`].
        WayScale = "way_scale",
        /// Share by which turns are larger than the wheels say (a wrong track width).
        TurnScale = "turn_scale",
        /// Turn that each metre driven ahead adds and the wheels do not show (wheels of unequal size),
        /// radians a metre.
        TurnPerMetre = "turn_per_metre",
        /// How long after the odometry of the same stamp scans show a motion, seconds.
        ClockOffset = "clock_offset",
        /// Share by which the beams are farther apart than stated, about the middle of the fan.
        BeamSpacing = "beam_spacing",
        /// Share by which distances are longer than the ranges say.
        ///
        /// A vehicle alone cannot tell it: ways by its scans grow with its ranges, and what is compared
        /// with the wheels is the product of both. It needs a map that another vehicle has made.
        RangeScale = "range_scale",
    }
}
