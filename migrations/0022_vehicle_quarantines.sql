-- Vehicles of which somebody wants nothing more in the map, until they are released.
CREATE TABLE vehicle_quarantines (
    route_key  INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    vehicle_id TEXT    NOT NULL,
    since_us   INTEGER NOT NULL,
    -- Why, for people.
    note       TEXT,
    PRIMARY KEY (route_key, vehicle_id)
) STRICT, WITHOUT ROWID;
