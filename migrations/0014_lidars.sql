-- Several lidars of one vehicle: which of them took a scan, and what trips say of each.

-- The name that the vehicle gives the lidar that took the keyframe; NULL for its only one.
ALTER TABLE node_scans ADD COLUMN lidar TEXT CHECK (length(lidar) BETWEEN 1 AND 64);

-- The lidar beside that of the keyframe; NULL for a scan of the keyframe's.
ALTER TABLE intermediate_scans ADD COLUMN companion TEXT CHECK (length(companion) BETWEEN 1 AND 64);
-- Whether its points count as the keyframe's: it was taken at about the same time.
ALTER TABLE intermediate_scans ADD COLUMN lends INTEGER NOT NULL DEFAULT 0
    CHECK (lends IN (0, 1) AND (lends = 0 OR companion IS NOT NULL));

-- What a trip says of each lidar of its vehicle: as before, one row for each.
CREATE TABLE lidar_calibrations (
    route_key      INTEGER NOT NULL,
    trip_id        TEXT    NOT NULL,
    -- As the vehicle names it; empty for its only one.
    lidar          TEXT    NOT NULL CHECK (length(lidar) <= 64),
    -- The trip's; repeated here so that a vehicle's trips are found at once.
    vehicle_id     TEXT    NOT NULL CHECK (length(vehicle_id) BETWEEN 1 AND 64),
    -- When the newest scan that it rests on was taken: nanoseconds since the Unix epoch, UTC.
    stamp_ns       INTEGER NOT NULL,
    -- Scans that it rests on.
    scans          INTEGER NOT NULL CHECK (scans > 0),
    -- Estimates with their standard errors, as JSON; always as differences to what was stated.
    calibration    TEXT    NOT NULL CHECK (json_valid(calibration)),
    -- The same of the mount beside the lidar that takes the trip's keyframes; NULL for that one.
    beside_primary TEXT    CHECK (json_valid(beside_primary)),
    PRIMARY KEY (route_key, trip_id, lidar),
    FOREIGN KEY (route_key, trip_id) REFERENCES trips ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

INSERT INTO lidar_calibrations
    (route_key, trip_id, lidar, vehicle_id, stamp_ns, scans, calibration)
    SELECT route_key, trip_id, '', vehicle_id, stamp_ns, scans, calibration FROM trip_calibrations;

DROP TABLE trip_calibrations;

CREATE INDEX lidar_calibrations_by_vehicle
    ON lidar_calibrations (route_key, vehicle_id, lidar, stamp_ns);
