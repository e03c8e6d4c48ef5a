-- Enumerations in columns are open: no CHECK lists their texts any more, so that a new kind or state
-- needs no table rebuilt. The program has the one list of each (src/model), writes nothing else, and
-- calls a text that it does not know corrupt. What else was checked still is, but for one rule: an
-- event that tells of no alert need not be a test.
--
-- Lists go by rebuilding their tables, here once for all of them. Foreign keys must not be enforced
-- meanwhile: dropping an old table would delete every row that refers to it. Whoever applies this turns
-- them off before, because that has no effect inside a transaction; else the guard refuses.
--
-- jobs.state keeps its list: it is no enumeration of the program, which tells the two states apart by
-- the lease.

CREATE TEMP TABLE refuse (what TEXT CHECK (what IS NULL));
INSERT INTO refuse SELECT 'foreign keys are enforced' FROM pragma_foreign_keys WHERE foreign_keys <> 0;

-- One map and one pose graph each.
CREATE TABLE routes_new (
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
    -- Which rule decides that something changed: a Detector.
    detector         TEXT    NOT NULL,
    -- How many false alerts are accepted in a lap: in as much driven way as the route's reference is
    -- long.
    false_alarm_rate REAL    NOT NULL CHECK (false_alarm_rate > 0 AND false_alarm_rate <= 1),
    -- How long a batch waits for its predecessor, seconds.
    hold_s           INTEGER NOT NULL CHECK (hold_s BETWEEN 0 AND 4294967295),
    -- How far the reference map has come: a Stage.
    stage            TEXT    NOT NULL,
    -- Raised by every accepted change.
    map_version      INTEGER NOT NULL CHECK (map_version >= 1),
    epoch            INTEGER NOT NULL CHECK (epoch >= 1),
    -- How the present version of the map began; NULL for the first, which began with the route.
    version_created_at_us INTEGER,
    version_alert_id TEXT,
    -- An AlertAction.
    version_action   TEXT,
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
    -- Alerts that wait for a decision.
    open_alerts      INTEGER NOT NULL DEFAULT 0 CHECK (open_alerts >= 0),
    created_at_us    INTEGER NOT NULL,
    updated_at_us    INTEGER NOT NULL,
    CHECK ((geo_latitude IS NULL) = (geo_longitude IS NULL)
       AND (geo_latitude IS NULL) = (geo_heading IS NULL))
) STRICT;

INSERT INTO routes_new
    (route_key, id, display_name, geo_latitude, geo_longitude, geo_heading, detector,
     false_alarm_rate, hold_s, stage, map_version, epoch, version_created_at_us, version_alert_id,
     version_action, revision, next_node_id, next_edge_id, batches, scans, vehicles, nodes, edges,
     loop_closures, subgraphs, open_alerts, created_at_us, updated_at_us)
    SELECT route_key, id, display_name, geo_latitude, geo_longitude, geo_heading, detector,
     false_alarm_rate, hold_s, stage, map_version, epoch, version_created_at_us, version_alert_id,
     version_action, revision, next_node_id, next_edge_id, batches, scans, vehicles, nodes, edges,
     loop_closures, subgraphs, open_alerts, created_at_us, updated_at_us FROM routes;

-- Every upload that was acknowledged. A row is never deleted while its route lives: the key of
-- idempotency (route, id) does not expire.
CREATE TABLE batches_new (
    -- The order of arrival.
    batch_key       INTEGER PRIMARY KEY AUTOINCREMENT,
    route_key       INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Chosen by the client.
    id              TEXT    NOT NULL CHECK (length(id) BETWEEN 1 AND 64),
    -- Who sent it: the trip's vehicle, else the batch is quarantined.
    vehicle_id      TEXT    NOT NULL CHECK (length(vehicle_id) BETWEEN 1 AND 64),
    trip_id         TEXT    NOT NULL,
    -- What it holds: a BatchKind.
    kind            TEXT    NOT NULL DEFAULT 'scans',
    -- 0, 1, 2 … within the trip, of edges in the order of arrival; below 2^53, so that every JSON
    -- reader holds it.
    sequence        INTEGER NOT NULL CHECK (sequence BETWEEN 0 AND 9007199254740991),
    -- A BatchStatus. One that is queued has a job that nobody works on, one that is processing a job
    -- that a worker holds; no other has a job, until one that is unanchored is tried again.
    status          TEXT    NOT NULL,
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
    -- Whether its body is still there: a service can be told to delete bodies of merged batches.
    body_kept       INTEGER NOT NULL DEFAULT 1 CHECK (body_kept IN (0, 1)),
    received_at_us  INTEGER NOT NULL,
    processed_at_us INTEGER,
    UNIQUE (route_key, id),
    FOREIGN KEY (route_key, trip_id) REFERENCES trips ON DELETE CASCADE
) STRICT;

INSERT INTO batches_new
    (batch_key, route_key, id, vehicle_id, trip_id, kind, sequence, status, reason, flags, scans,
     nodes_added, loop_closures, nodes_at_try, body_sha256, body_bytes, body_kept, received_at_us,
     processed_at_us)
    SELECT batch_key, route_key, id, vehicle_id, trip_id, kind, sequence, status, reason, flags, scans,
     nodes_added, loop_closures, nodes_at_try, body_sha256, body_bytes, body_kept, received_at_us,
     processed_at_us FROM batches;

-- Measured motions between two nodes of one route.
CREATE TABLE edges_new (
    route_key   INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Unique within the route, never used again.
    edge_id     INTEGER NOT NULL CHECK (edge_id >= 0),
    from_node   INTEGER NOT NULL,
    to_node     INTEGER NOT NULL CHECK (to_node <> from_node),
    -- What made it: an EdgeKind.
    kind        TEXT    NOT NULL,
    -- Whether it is optimised: an EdgeStatus.
    status      TEXT    NOT NULL,
    -- The upload it came with.
    batch_key   INTEGER NOT NULL REFERENCES batches ON DELETE CASCADE,
    -- from_from_to, as optimised.
    x           REAL    NOT NULL CHECK (abs(x) < 9e999),
    y           REAL    NOT NULL CHECK (abs(y) < 9e999),
    theta       REAL    NOT NULL CHECK (abs(theta) < 3.1415927),
    -- Upper triangle of its information in the order (x, y, theta).
    info_xx     REAL    NOT NULL CHECK (info_xx >= 0 AND info_xx < 9e999),
    info_xy     REAL    NOT NULL CHECK (abs(info_xy) < 9e999),
    info_xt     REAL    NOT NULL CHECK (abs(info_xt) < 9e999),
    info_yy     REAL    NOT NULL CHECK (info_yy >= 0 AND info_yy < 9e999),
    info_yt     REAL    NOT NULL CHECK (abs(info_yt) < 9e999),
    info_tt     REAL    NOT NULL CHECK (info_tt >= 0 AND info_tt < 9e999),
    -- What a loop closure added to the optimum F when it was inserted; NULL for odometry.
    delta_f     REAL    CHECK (abs(delta_f) < 9e999),
    -- The block of the graph it lies in; NULL for bridges.
    subgraph_id INTEGER,
    PRIMARY KEY (route_key, edge_id),
    FOREIGN KEY (route_key, from_node) REFERENCES nodes ON DELETE CASCADE,
    FOREIGN KEY (route_key, to_node) REFERENCES nodes ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

INSERT INTO edges_new
    (route_key, edge_id, from_node, to_node, kind, status, batch_key, x, y, theta, info_xx, info_xy,
     info_xt, info_yy, info_yt, info_tt, delta_f, subgraph_id)
    SELECT route_key, edge_id, from_node, to_node, kind, status, batch_key, x, y, theta, info_xx,
     info_xy, info_xt, info_yy, info_yt, info_tt, delta_f, subgraph_id FROM edges;

-- One for each place where the world contradicts the map.
CREATE TABLE alerts_new (
    alert_key     INTEGER PRIMARY KEY AUTOINCREMENT,
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- UUID of version 7 in its usual text: sorts by when the alert was raised.
    id            TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    -- Raised by every change: the fence of people who edit.
    revision      INTEGER NOT NULL CHECK (revision >= 1),
    -- What changed: a ChangeKind.
    kind          TEXT    NOT NULL,
    -- Where it is in its life: an AlertStatus.
    status        TEXT    NOT NULL,
    -- How far it is to be believed: a Tier. What was raised before there were tiers is confirmed.
    tier          TEXT    NOT NULL DEFAULT 'confirmed',
    -- The revision with which it was first confirmed: what a webhook that is sent confirmed alerts
    -- alone knows as the raising. NULL while it never was.
    confirmed_revision INTEGER CHECK (confirmed_revision BETWEEN 1 AND revision),
    -- Probability that it is true.
    confidence    REAL    NOT NULL CHECK (confidence BETWEEN 0 AND 1),
    -- Its centre in the map frame and the standard deviation of that, metres.
    x             REAL    NOT NULL CHECK (abs(x) < 9e999),
    y             REAL    NOT NULL CHECK (abs(y) < 9e999),
    sigma_m       REAL    NOT NULL CHECK (sigma_m >= 0 AND sigma_m < 9e999),
    -- A simple polygon round it, map frame, metres: x and y of each corner, 8 bytes each,
    -- little-endian IEEE 754 (decimal text would not come back to the bit).
    region        BLOB    NOT NULL CHECK (length(region) % 16 = 0),
    -- The other side of the same event, as of a door: its kind and its region. Both NULL if there is
    -- none.
    counterpart_kind   TEXT,
    counterpart_region BLOB CHECK (length(counterpart_region) % 16 = 0),
    -- The vector by which what the pass observed there would have to be moved to lie on the map, map
    -- frame, metres. Both NULL if no shift explains the alert.
    shift_x       REAL    CHECK (abs(shift_x) < 9e999),
    shift_y       REAL    CHECK (abs(shift_y) < 9e999),
    -- A JSON array of the height bands that show it, ascending, each as [from, to], metres above the
    -- floor; empty if it is seen by lidars that look along one plane.
    bands         TEXT    NOT NULL DEFAULT '[]' CHECK (json_valid(bands)),
    -- What is off of a suspected vehicle, and the changes that this silences, as JSON; NULL for all
    -- other alerts.
    suspect       TEXT    CHECK (json_valid(suspect)),
    -- JSON arrays: the closures and nodes that tell it (numbers), trips and vehicles (names).
    edges         TEXT    NOT NULL CHECK (json_valid(edges)),
    nodes         TEXT    NOT NULL CHECK (json_valid(nodes)),
    trips         TEXT    NOT NULL CHECK (json_valid(trips)),
    vehicles      TEXT    NOT NULL CHECK (json_valid(vehicles)),
    -- Scans and passes that show the new state.
    views         INTEGER NOT NULL CHECK (views >= 0),
    laps          INTEGER NOT NULL CHECK (laps >= 0),
    -- Stamps of observations, nanoseconds since the Unix epoch: the first that ever showed it, the
    -- first and last of its present episode, the first that showed the old state again.
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
    CHECK ((counterpart_region IS NULL) = (counterpart_kind IS NULL)),
    CHECK ((shift_y IS NULL) = (shift_x IS NULL)),
    CHECK ((residual_edge IS NULL) = (residual_delta_f IS NULL)
       AND (residual_edge IS NULL) = (residual_p_value IS NULL)
       AND (residual_edge IS NULL) = (residual_seed_rule IS NULL))
) STRICT;

INSERT INTO alerts_new
    (alert_key, route_key, id, revision, kind, status, tier, confirmed_revision, confidence, x, y,
     sigma_m, region, counterpart_kind, counterpart_region, shift_x, shift_y, bands, suspect, edges,
     nodes, trips, vehicles, views, laps, first_seen_ns, since_ns, last_seen_ns, until_ns,
     residual_edge, residual_delta_f, residual_threshold, residual_ratio, residual_p_value,
     residual_seed_rule, map_version, related, raised_at_us, updated_at_us)
    SELECT alert_key, route_key, id, revision, kind, status, tier, confirmed_revision, confidence, x, y,
     sigma_m, region, counterpart_kind, counterpart_region, shift_x, shift_y, bands, suspect, edges,
     nodes, trips, vehicles, views, laps, first_seen_ns, since_ns, last_seen_ns, until_ns,
     residual_edge, residual_delta_f, residual_threshold, residual_ratio, residual_p_value,
     residual_seed_rule, map_version, related, raised_at_us, updated_at_us FROM alerts;

-- Every status that an alert had; rows are only added.
CREATE TABLE alert_history_new (
    alert_key INTEGER NOT NULL REFERENCES alerts ON DELETE CASCADE,
    -- 0, 1, 2 …
    position  INTEGER NOT NULL CHECK (position >= 0),
    -- The status from then on: an AlertStatus.
    status    TEXT    NOT NULL,
    at_us     INTEGER NOT NULL,
    -- Who did it: a name, or 'system'.
    by_whom   TEXT    NOT NULL,
    note      TEXT,
    PRIMARY KEY (alert_key, position)
) STRICT, WITHOUT ROWID;

INSERT INTO alert_history_new (alert_key, position, status, at_us, by_whom, note)
    SELECT alert_key, position, status, at_us, by_whom, note FROM alert_history;

-- The versions of a map that others have followed. A row never changes.
CREATE TABLE map_versions_new (
    route_key        INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    version          INTEGER NOT NULL CHECK (version >= 1),
    epoch            INTEGER NOT NULL CHECK (epoch >= 1),
    -- When the version began, and when another followed it.
    created_at_us    INTEGER NOT NULL,
    superseded_at_us INTEGER NOT NULL,
    -- The decision that began it, an AlertAction; NULL for the first version.
    cause_alert_id   TEXT,
    cause_action     TEXT,
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

INSERT INTO map_versions_new
    (route_key, version, epoch, created_at_us, superseded_at_us, cause_alert_id, cause_action, png,
     pgm, pgm_bytes, pgm_sha256, yaml)
    SELECT route_key, version, epoch, created_at_us, superseded_at_us, cause_alert_id, cause_action, png,
     pgm, pgm_bytes, pgm_sha256, yaml FROM map_versions;

-- One for each event and each webhook that is told of it, written with the event itself. An update
-- that waits is deleted when its receiver has taken the same alert as new as that, or newer; and
-- when an attempt for the same alert has failed, while a newer update waits.
CREATE TABLE webhook_deliveries_new (
    -- In the order of commits; never used again.
    delivery_key    INTEGER PRIMARY KEY AUTOINCREMENT,
    webhook_key     INTEGER NOT NULL REFERENCES webhooks ON DELETE CASCADE,
    -- The same for every attempt: what a receiver knows a repetition by.
    id              TEXT    NOT NULL UNIQUE,
    -- A WebhookEvent. A test is sent on demand and tried once.
    event           TEXT    NOT NULL,
    -- What it tells of: an entry of alert_events and its alert; NULL for a test.
    event_sequence  INTEGER,
    alert_key       INTEGER REFERENCES alerts ON DELETE CASCADE,
    -- Of the alert after the event: whoever was told of this one or a later needs it no more.
    alert_revision  INTEGER CHECK (alert_revision >= 1),
    -- When that happened.
    at_us           INTEGER NOT NULL,
    -- A DeliveryStatus. While it is pending an attempt follows at next_attempt_at_us, as long as the
    -- webhook is active.
    status          TEXT    NOT NULL,
    -- Attempts so far, and when the last of them ended.
    attempts        INTEGER NOT NULL CHECK (attempts >= 0),
    attempted_at_us INTEGER,
    next_attempt_at_us INTEGER,
    -- How the last attempt ended: the status of an answer, or why there was none, a DeliveryFailure.
    answer_status   INTEGER CHECK (answer_status BETWEEN 100 AND 999),
    failure         TEXT,
    CHECK ((alert_key IS NULL) = (event_sequence IS NULL)),
    CHECK ((alert_key IS NULL) = (alert_revision IS NULL)),
    CHECK ((status = 'pending') = (next_attempt_at_us IS NOT NULL)),
    CHECK ((attempts = 0) = (attempted_at_us IS NULL)),
    CHECK (answer_status IS NULL OR failure IS NULL)
) STRICT;

INSERT INTO webhook_deliveries_new
    (delivery_key, webhook_key, id, event, event_sequence, alert_key, alert_revision, at_us, status,
     attempts, attempted_at_us, next_attempt_at_us, answer_status, failure)
    SELECT delivery_key, webhook_key, id, event, event_sequence, alert_key, alert_revision, at_us, status,
     attempts, attempted_at_us, next_attempt_at_us, answer_status, failure FROM webhook_deliveries;

-- Keys of rows that are gone are never used again, also in the new tables.
DELETE FROM sqlite_sequence WHERE name LIKE '%\_new' ESCAPE '\';
INSERT INTO sqlite_sequence (name, seq) SELECT name || '_new', seq FROM sqlite_sequence
    WHERE name IN ('routes', 'batches', 'alerts', 'webhook_deliveries');

DROP TABLE routes;
DROP TABLE batches;
DROP TABLE edges;
DROP TABLE alerts;
DROP TABLE alert_history;
DROP TABLE map_versions;
DROP TABLE webhook_deliveries;

ALTER TABLE routes_new RENAME TO routes;
ALTER TABLE batches_new RENAME TO batches;
ALTER TABLE edges_new RENAME TO edges;
ALTER TABLE alerts_new RENAME TO alerts;
ALTER TABLE alert_history_new RENAME TO alert_history;
ALTER TABLE map_versions_new RENAME TO map_versions;
ALTER TABLE webhook_deliveries_new RENAME TO webhook_deliveries;

CREATE INDEX batches_by_arrival ON batches (route_key, batch_key);
CREATE INDEX batches_by_vehicle ON batches (route_key, vehicle_id);
CREATE INDEX batches_by_status  ON batches (route_key, status);
CREATE INDEX batches_by_trip    ON batches (route_key, trip_id, sequence);
CREATE INDEX batches_held       ON batches (route_key, trip_id, sequence)
    WHERE status = 'held';
CREATE INDEX batches_unanchored ON batches (route_key, trip_id, sequence)
    WHERE status = 'unanchored';
-- A job of edges takes along what the vehicle has sent and what could not be tied to the map yet.
CREATE INDEX batches_unanchored_edges ON batches (route_key, vehicle_id, batch_key)
    WHERE status = 'unanchored' AND kind = 'edges';
-- Whose bodies are deleted next.
CREATE INDEX batches_with_bodies ON batches (processed_at_us)
    WHERE status = 'merged' AND body_kept = 1;

CREATE INDEX edges_by_from     ON edges (route_key, from_node);
CREATE INDEX edges_by_to       ON edges (route_key, to_node);
CREATE INDEX edges_by_batch    ON edges (batch_key);
CREATE INDEX edges_by_subgraph ON edges (route_key, subgraph_id) WHERE status = 'active';

CREATE INDEX alerts_by_route ON alerts (route_key, id);
CREATE INDEX alerts_pending  ON alerts (route_key) WHERE status IN ('open', 'acknowledged');

-- What is sent next to a webhook.
CREATE INDEX webhook_deliveries_pending
    ON webhook_deliveries (webhook_key, next_attempt_at_us, delivery_key) WHERE status = 'pending';
CREATE INDEX webhook_deliveries_by_webhook ON webhook_deliveries (webhook_key, delivery_key);
CREATE INDEX webhook_deliveries_by_alert ON webhook_deliveries (alert_key);
-- What is deleted next.
CREATE INDEX webhook_deliveries_by_time ON webhook_deliveries (at_us);

INSERT INTO refuse SELECT 'a row refers to none: ' || "table" FROM pragma_foreign_key_check LIMIT 1;
DROP TABLE refuse;
