-- What the trips of vehicles say of their systematic errors: mount, wheels, clock, beams.

-- One row for each trip that has driven enough to say something; the newest of a vehicle are read
-- together.
CREATE TABLE trip_calibrations (
    route_key     INTEGER NOT NULL,
    trip_id       TEXT    NOT NULL,
    -- The trip's; repeated here so that a vehicle's trips are found at once.
    vehicle_id    TEXT    NOT NULL CHECK (length(vehicle_id) BETWEEN 1 AND 64),
    -- When the newest scan that it rests on was taken: nanoseconds since the Unix epoch, UTC.
    stamp_ns      INTEGER NOT NULL,
    -- Scans that it rests on.
    scans         INTEGER NOT NULL CHECK (scans > 0),
    -- Estimates with their standard errors, as JSON; always as differences to what was stated.
    calibration   TEXT    NOT NULL CHECK (json_valid(calibration)),
    PRIMARY KEY (route_key, trip_id),
    FOREIGN KEY (route_key, trip_id) REFERENCES trips ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE INDEX trip_calibrations_by_vehicle ON trip_calibrations (route_key, vehicle_id, stamp_ns);
