-- Alerts, what was decided about them, and the versions of a route's map.

-- One for each place where the world contradicts the map.
CREATE TABLE alerts (
    alert_key     INTEGER PRIMARY KEY AUTOINCREMENT,
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- UUID of version 7 in its usual text: sorts by when the alert was raised.
    id            TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    -- Raised by every change: the fence of people who edit.
    revision      INTEGER NOT NULL CHECK (revision >= 1),
    kind          TEXT    NOT NULL CHECK (kind IN (
        'appeared',       -- something stands where free space was
        'disappeared',    -- free space where something stood
        'residual',       -- closures contradict the map; scans do not say what changed
        'map_mismatch',   -- the map does not fit the place
        'vehicle_suspect' -- one vehicle disagrees everywhere
    )),
    status        TEXT    NOT NULL CHECK (status IN (
        'open',         -- nobody has looked at it
        'acknowledged', -- somebody has taken it up
        'accepted',     -- the map shows the new state
        'dismissed',    -- the map is right; never raised again
        'resolved'      -- later looks show the old state, or refute it
    )),
    -- Probability that it is true.
    confidence    REAL    NOT NULL CHECK (confidence BETWEEN 0 AND 1),
    -- Its centre in the map frame and the standard deviation of that, metres.
    x             REAL    NOT NULL CHECK (abs(x) < 9e999),
    y             REAL    NOT NULL CHECK (abs(y) < 9e999),
    sigma_m       REAL    NOT NULL CHECK (sigma_m >= 0 AND sigma_m < 9e999),
    -- A simple polygon round it, map frame, metres: x and y of each corner, 8 bytes each,
    -- little-endian IEEE 754 (decimal text would not come back to the bit).
    region        BLOB    NOT NULL CHECK (length(region) % 16 = 0),
    -- JSON arrays: the closures and nodes that tell it (numbers), trips and vehicles (names).
    edges         TEXT    NOT NULL CHECK (json_valid(edges)),
    nodes         TEXT    NOT NULL CHECK (json_valid(nodes)),
    trips         TEXT    NOT NULL CHECK (json_valid(trips)),
    vehicles      TEXT    NOT NULL CHECK (json_valid(vehicles)),
    -- Scans and passes that show the new state.
    views         INTEGER NOT NULL CHECK (views >= 0),
    laps          INTEGER NOT NULL CHECK (laps >= 0),
    -- Stamps of looks, nanoseconds since the Unix epoch: the first that ever showed it, the first
    -- and last of its present episode, the first that showed the old state again.
    first_seen_ns INTEGER NOT NULL,
    since_ns      INTEGER NOT NULL,
    last_seen_ns  INTEGER NOT NULL,
    until_ns      INTEGER,
    -- What the paper's rule says of its strongest closure; all NULL without a closure. Threshold
    -- and ratio are NULL while the series warms up.
    residual_edge      INTEGER,
    residual_delta_f   REAL CHECK (abs(residual_delta_f) < 9e999),
    residual_threshold REAL CHECK (residual_threshold >= 0 AND residual_threshold < 9e999),
    residual_ratio     REAL CHECK (residual_ratio >= 0 AND residual_ratio < 9e999),
    residual_p_value   REAL CHECK (residual_p_value BETWEEN 0 AND 1),
    residual_seed_rule INTEGER CHECK (residual_seed_rule IN (0, 1)),
    -- The version of the map that it contradicts.
    map_version   INTEGER NOT NULL CHECK (map_version >= 1),
    -- Ids of alerts that tell of the same place: a JSON array.
    related       TEXT    NOT NULL CHECK (json_valid(related)),
    raised_at_us  INTEGER NOT NULL,
    updated_at_us INTEGER NOT NULL,
    CHECK ((residual_edge IS NULL) = (residual_delta_f IS NULL)
       AND (residual_edge IS NULL) = (residual_p_value IS NULL)
       AND (residual_edge IS NULL) = (residual_seed_rule IS NULL))
) STRICT;

CREATE INDEX alerts_by_route ON alerts (route_key, id);
CREATE INDEX alerts_pending  ON alerts (route_key) WHERE status IN ('open', 'acknowledged');

-- Every status that an alert had; rows are only added.
CREATE TABLE alert_history (
    alert_key INTEGER NOT NULL REFERENCES alerts ON DELETE CASCADE,
    -- 0, 1, 2 …
    position  INTEGER NOT NULL CHECK (position >= 0),
    -- The status from then on.
    status    TEXT    NOT NULL CHECK (status IN
        ('open', 'acknowledged', 'accepted', 'dismissed', 'resolved')),
    at_us     INTEGER NOT NULL,
    -- Who did it: a name, or 'system'.
    by_whom   TEXT    NOT NULL,
    note      TEXT,
    PRIMARY KEY (alert_key, position)
) STRICT, WITHOUT ROWID;

-- Which uploads an alert rests on.
CREATE TABLE alert_batches (
    batch_key INTEGER NOT NULL REFERENCES batches ON DELETE CASCADE,
    alert_key INTEGER NOT NULL REFERENCES alerts ON DELETE CASCADE,
    PRIMARY KEY (batch_key, alert_key)
) STRICT, WITHOUT ROWID;

CREATE INDEX alert_batches_by_alert ON alert_batches (alert_key);

-- What happened to alerts, written with the change that it tells of: what event streams read.
CREATE TABLE alert_events (
    -- The id of the event: never used again, in the order of commits.
    sequence  INTEGER PRIMARY KEY AUTOINCREMENT,
    alert_key INTEGER NOT NULL REFERENCES alerts ON DELETE CASCADE,
    -- Of the alert after the change; 1 is the raising.
    revision  INTEGER NOT NULL CHECK (revision >= 1),
    at_us     INTEGER NOT NULL
) STRICT;

CREATE INDEX alert_events_by_alert ON alert_events (alert_key);

-- Changes of the world that the map has taken in.
CREATE TABLE accepted_changes (
    alert_key     INTEGER PRIMARY KEY REFERENCES alerts ON DELETE CASCADE,
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Where, as the alert had it.
    region        BLOB    NOT NULL CHECK (length(region) % 16 = 0),
    -- Looks before this stamp say nothing about the region any more: nanoseconds since the epoch.
    since_ns      INTEGER NOT NULL,
    -- The version of the map that began with it.
    map_version   INTEGER NOT NULL CHECK (map_version >= 2),
    -- Nodes that show the place: a JSON array of numbers …
    nodes         TEXT    NOT NULL CHECK (json_valid(nodes)),
    -- … and the first edge since: earlier closures of these nodes have left the baseline.
    first_edge_id INTEGER NOT NULL,
    -- What an undo restores, compressed with zstd; its length and checksum before that.
    undo          BLOB    NOT NULL,
    undo_bytes    INTEGER NOT NULL CHECK (undo_bytes >= 0),
    undo_sha256   BLOB    NOT NULL CHECK (length(undo_sha256) = 32)
) STRICT;

CREATE INDEX accepted_changes_by_route ON accepted_changes (route_key);

-- The versions of a map that others have followed. A row never changes.
CREATE TABLE map_versions (
    route_key        INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    version          INTEGER NOT NULL CHECK (version >= 1),
    epoch            INTEGER NOT NULL CHECK (epoch >= 1),
    -- When the version began, and when another followed it.
    created_at_us    INTEGER NOT NULL,
    superseded_at_us INTEGER NOT NULL,
    -- The decision that began it; NULL for the first version.
    cause_alert_id   TEXT,
    cause_action     TEXT    CHECK (cause_action IN ('accept', 'undo')),
    -- The map as it was when another version followed: PNG, PGM (compressed with zstd), YAML.
    png              BLOB    NOT NULL,
    pgm              BLOB    NOT NULL,
    pgm_bytes        INTEGER NOT NULL CHECK (pgm_bytes >= 0),
    -- Of the PGM.
    pgm_sha256       BLOB    NOT NULL CHECK (length(pgm_sha256) = 32),
    yaml             TEXT    NOT NULL,
    PRIMARY KEY (route_key, version),
    CHECK ((cause_alert_id IS NULL) = (cause_action IS NULL))
) STRICT, WITHOUT ROWID;

-- Alerts that wait for a decision, kept in the transactions that change them.
ALTER TABLE routes ADD COLUMN open_alerts INTEGER NOT NULL DEFAULT 0 CHECK (open_alerts >= 0);
-- How the present version of the map began; NULL for the first, which began with the route.
ALTER TABLE routes ADD COLUMN version_created_at_us INTEGER;
ALTER TABLE routes ADD COLUMN version_alert_id TEXT;
ALTER TABLE routes ADD COLUMN version_action TEXT CHECK (version_action IN ('accept', 'undo'));
