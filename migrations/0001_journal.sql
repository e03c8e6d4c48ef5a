-- Routes, the durable journal of uploads, and the queue of jobs.
--
-- Conventions of every table: STRICT; times are microseconds since the Unix epoch, UTC (`_us`);
-- flags are 0 or 1; a REAL is finite (`abs(v) < 9e999`: SQLite stores infinities, and turns NaN
-- into NULL, which NOT NULL refuses). A migration that was released is never edited.

-- One map and one pose graph each.
CREATE TABLE routes (
    -- Never used again, so that a route put anew after its deletion shares nothing with the old.
    route_key        INTEGER PRIMARY KEY AUTOINCREMENT,
    -- Chosen by the client.
    id               TEXT    NOT NULL UNIQUE CHECK (length(id) BETWEEN 1 AND 64),
    display_name     TEXT,
    -- Where the map frame lies on the Earth (WGS 84, degrees): all three or none.
    geo_latitude     REAL    CHECK (geo_latitude BETWEEN -90 AND 90),
    geo_longitude    REAL    CHECK (geo_longitude BETWEEN -180 AND 180),
    -- Of the x axis, clockwise from north.
    geo_heading      REAL    CHECK (geo_heading BETWEEN 0 AND 360),
    -- Which rule decides that something changed.
    detector         TEXT    NOT NULL CHECK (detector IN (
        'fused',     -- robust estimates make the map, all-points residuals are watched
        'seed'       -- all-points estimates are optimised with the identity as information
    )),
    -- Share of unchanged closures that the residual test may call contradictory.
    false_alarm_rate REAL    NOT NULL CHECK (false_alarm_rate > 0 AND false_alarm_rate < 1),
    -- How long a batch waits for its predecessor, seconds.
    hold_s           INTEGER NOT NULL CHECK (hold_s BETWEEN 0 AND 4294967295),
    stage            TEXT    NOT NULL CHECK (stage IN (
        'mapping',   -- the reference is still being built
        'monitoring' -- new laps are judged against the reference
    )),
    -- Raised by every accepted change.
    map_version      INTEGER NOT NULL CHECK (map_version >= 1),
    epoch            INTEGER NOT NULL CHECK (epoch >= 1),
    -- Raised by every result that is applied: the fence of optimistic work.
    revision         INTEGER NOT NULL CHECK (revision >= 0),
    -- High-water marks: an id is never used again, not even after its row is gone.
    next_node_id     INTEGER NOT NULL CHECK (next_node_id >= 0),
    next_edge_id     INTEGER NOT NULL CHECK (next_edge_id >= 0),
    -- Counters, kept in the transactions that change what they count.
    batches          INTEGER NOT NULL DEFAULT 0 CHECK (batches >= 0),
    scans            INTEGER NOT NULL DEFAULT 0 CHECK (scans >= 0),
    vehicles         INTEGER NOT NULL DEFAULT 0 CHECK (vehicles >= 0),
    nodes            INTEGER NOT NULL DEFAULT 0 CHECK (nodes >= 0),
    edges            INTEGER NOT NULL DEFAULT 0 CHECK (edges >= 0),
    loop_closures    INTEGER NOT NULL DEFAULT 0 CHECK (loop_closures >= 0),
    -- Distinct blocks among the active edges.
    subgraphs        INTEGER NOT NULL DEFAULT 0 CHECK (subgraphs >= 0),
    created_at_us    INTEGER NOT NULL,
    updated_at_us    INTEGER NOT NULL,
    CHECK ((geo_latitude IS NULL) = (geo_longitude IS NULL)
       AND (geo_latitude IS NULL) = (geo_heading IS NULL))
) STRICT;

-- One drive of one vehicle; made by its first batch to arrive.
CREATE TABLE trips (
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    trip_id       TEXT    NOT NULL CHECK (length(trip_id) BETWEEN 1 AND 64),
    -- A trip belongs to the vehicle that named it first.
    vehicle_id    TEXT    NOT NULL CHECK (length(vehicle_id) BETWEEN 1 AND 64),
    -- The sequence that is due: lower ones have ended or were given up.
    next_sequence INTEGER NOT NULL CHECK (next_sequence >= 0),
    PRIMARY KEY (route_key, trip_id)
) STRICT, WITHOUT ROWID;

-- Every upload that was acknowledged. A row is never deleted while its route lives: the key of
-- idempotency (route, id) does not expire.
CREATE TABLE batches (
    -- The order of arrival.
    batch_key       INTEGER PRIMARY KEY AUTOINCREMENT,
    route_key       INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Chosen by the client.
    id              TEXT    NOT NULL CHECK (length(id) BETWEEN 1 AND 64),
    -- Who sent it: the trip's vehicle, else the batch is quarantined.
    vehicle_id      TEXT    NOT NULL CHECK (length(vehicle_id) BETWEEN 1 AND 64),
    trip_id         TEXT    NOT NULL,
    -- 0, 1, 2 … within the trip; below 2^53, so that every JSON reader holds it.
    sequence        INTEGER NOT NULL CHECK (sequence BETWEEN 0 AND 9007199254740991),
    status          TEXT    NOT NULL CHECK (status IN (
        'queued',     -- it has a job that nobody works on
        'processing', -- it has a job that a worker holds
        'held',       -- waits for its predecessor; no job
        'merged',     -- in the map; no job
        'unanchored', -- its trip could not be placed in the map; a job when map or trip grow
        'quarantined' -- given up; the reason says why; no job
    )),
    -- Why it is there, for people.
    reason          TEXT,
    -- What was noticed: a JSON array of texts.
    flags           TEXT    NOT NULL CHECK (json_valid(flags)),
    scans           INTEGER NOT NULL CHECK (scans >= 0),
    nodes_added     INTEGER NOT NULL DEFAULT 0 CHECK (nodes_added >= 0),
    loop_closures   INTEGER NOT NULL DEFAULT 0 CHECK (loop_closures >= 0),
    -- How many nodes the route had when it was last found unanchored.
    nodes_at_try    INTEGER CHECK (nodes_at_try >= 0),
    -- Of the decompressed body; outlives the body.
    body_sha256     BLOB    NOT NULL CHECK (length(body_sha256) = 32),
    body_bytes      INTEGER NOT NULL CHECK (body_bytes >= 0),
    received_at_us  INTEGER NOT NULL,
    processed_at_us INTEGER,
    UNIQUE (route_key, id),
    FOREIGN KEY (route_key, trip_id) REFERENCES trips ON DELETE CASCADE
) STRICT;

CREATE INDEX batches_by_arrival ON batches (route_key, batch_key);
CREATE INDEX batches_by_vehicle ON batches (route_key, vehicle_id);
CREATE INDEX batches_by_status  ON batches (route_key, status);
CREATE INDEX batches_by_trip    ON batches (route_key, trip_id, sequence);
CREATE INDEX batches_held       ON batches (route_key, trip_id, sequence)
    WHERE status = 'held';
CREATE INDEX batches_unanchored ON batches (route_key, trip_id, sequence)
    WHERE status = 'unanchored';

-- The uploads' bodies, apart from their rows so that lists do not drag them along.
CREATE TABLE batch_bodies (
    batch_key INTEGER PRIMARY KEY REFERENCES batches ON DELETE CASCADE,
    -- The body as it was sent (decompressed), compressed with zstd.
    body      BLOB NOT NULL
) STRICT;

-- Work to be done: one job for each batch that is queued or processing, gone when the batch ends.
CREATE TABLE jobs (
    -- Never used again: a late result of an earlier job finds nothing.
    job_id           INTEGER PRIMARY KEY AUTOINCREMENT,
    -- Jobs are taken in the order of arrival of their batches.
    batch_key        INTEGER NOT NULL UNIQUE REFERENCES batches ON DELETE CASCADE,
    -- The batch's, repeated here so that claiming reads this table alone.
    route_key        INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    trip_id          TEXT    NOT NULL,
    sequence         INTEGER NOT NULL,
    state            TEXT    NOT NULL CHECK (state IN (
        'queued', -- nobody works on it
        'running' -- a worker holds it until the lease expires
    )),
    -- Raised by every claim: a result of another generation is refused.
    generation       INTEGER NOT NULL DEFAULT 0 CHECK (generation >= 0),
    -- How often it was claimed.
    attempts         INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    orphaned         INTEGER NOT NULL DEFAULT 0 CHECK (orphaned >= 0), -- claims that ended with the process
    -- Not before this time.
    run_after_us     INTEGER NOT NULL DEFAULT 0,
    lease_expires_us INTEGER,
    CHECK ((state = 'running') = (lease_expires_us IS NOT NULL))
) STRICT;

CREATE INDEX jobs_by_trip ON jobs (route_key, trip_id, sequence);
CREATE INDEX jobs_running ON jobs (route_key, lease_expires_us) WHERE state = 'running';
