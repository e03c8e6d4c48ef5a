-- Trips that were found, while they were driven, to have a clock that is behind: what they observed says
-- nothing about changes.
CREATE TABLE clock_faults (
    route_key    INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    trip_id      TEXT    NOT NULL,
    vehicle_id   TEXT    NOT NULL,
    -- How much later than they are stamped the trip's batches arrive, nanoseconds.
    behind_ns    INTEGER NOT NULL CHECK (behind_ns > 0),
    -- Stamp of the trip's first scan, of the newest one when it was found, and the scans between them.
    since_ns     INTEGER NOT NULL,
    last_seen_ns INTEGER NOT NULL,
    scans        INTEGER NOT NULL,
    -- Stamp of the first scan of the vehicle's next trip that arrived as it was driven. NULL while there is none.
    until_ns     INTEGER,
    PRIMARY KEY (route_key, trip_id)
) STRICT, WITHOUT ROWID;
