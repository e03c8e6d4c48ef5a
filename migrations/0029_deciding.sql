-- Deciding: operations that decide about several alerts, zones that mute alerts, and what people keep
-- beside an alert.

-- Operations of several kinds, which may be about several routes. Nothing refers to this table.
CREATE TABLE operations_of_kinds (
    -- The order in which they are carried out.
    operation_key INTEGER PRIMARY KEY AUTOINCREMENT,
    -- UUID of version 7 in its usual text.
    id            TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    -- An OperationKind.
    kind          TEXT    NOT NULL,
    -- NULL where alerts of several routes are decided about.
    route_key     INTEGER REFERENCES routes ON DELETE CASCADE,
    -- What is to be done, as JSON, by kind.
    request       TEXT    NOT NULL CHECK (json_valid(request)),
    -- An OperationStatus.
    status        TEXT    NOT NULL,
    -- What was done, as JSON, by kind; NULL until it is.
    result        TEXT    CHECK (json_valid(result)),
    -- Why it failed, for people.
    reason        TEXT,
    asked_at_us   INTEGER NOT NULL,
    ended_at_us   INTEGER,
    CHECK (ended_at_us IS NOT NULL OR (result IS NULL AND reason IS NULL))
) STRICT;
INSERT INTO operations_of_kinds (operation_key, id, kind, route_key, request, status, result, reason,
    asked_at_us, ended_at_us)
SELECT operation_key, id, 'removal', route_key, request, status, result, reason, asked_at_us, ended_at_us
FROM operations;
DROP TABLE operations;
ALTER TABLE operations_of_kinds RENAME TO operations;
CREATE INDEX operations_by_route ON operations (route_key);
CREATE INDEX operations_waiting  ON operations (operation_key) WHERE ended_at_us IS NULL;

-- Parts of a route's map where alerts are treated otherwise. What is detected does not depend on them.
CREATE TABLE zones (
    zone_key      INTEGER PRIMARY KEY AUTOINCREMENT,
    -- UUID of version 7 in its usual text: sorts by when the zone was made.
    id            TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Raised by every edit: the fence of people who edit.
    revision      INTEGER NOT NULL CHECK (revision >= 1),
    -- A simple polygon, map frame, metres, as `region` of alerts is kept.
    polygon       BLOB    NOT NULL CHECK (length(polygon) >= 48 AND length(polygon) % 16 = 0),
    -- A ZonePurpose.
    purpose       TEXT    NOT NULL,
    -- A JSON array of the ChangeKinds that it is about; NULL for all.
    kinds         TEXT    CHECK (json_array_length(kinds) >= 1),
    -- When it ends by itself; NULL if it does not.
    until_us      INTEGER,
    -- When it did; NULL while it is in effect.
    ended_at_us   INTEGER CHECK (ended_at_us IS NULL OR until_us IS NOT NULL),
    note          TEXT,
    created_at_us INTEGER NOT NULL,
    -- Who made it, as they say.
    created_by    TEXT    NOT NULL,
    updated_at_us INTEGER NOT NULL
) STRICT;
CREATE INDEX zones_by_route ON zones (route_key, id);
CREATE INDEX zones_ending   ON zones (until_us) WHERE until_us IS NOT NULL AND ended_at_us IS NULL;

-- What people and zones add to an alert without changing what it says; an alert without a row has
-- nothing of it.
CREATE TABLE alert_handling (
    alert_key     INTEGER PRIMARY KEY REFERENCES alerts ON DELETE CASCADE,
    -- Changes of this row that streams were sent: they are counted on top of the alert's revision.
    changes       INTEGER NOT NULL DEFAULT 0 CHECK (changes >= 0),
    -- Who sees to it.
    assignee      TEXT,
    -- How many rows `alert_comments` has of it.
    comments      INTEGER NOT NULL DEFAULT 0 CHECK (comments >= 0),
    -- While a zone mutes it: until when, 9223372036854775807 for as long as the zone is there; else NULL.
    muted_until_us INTEGER,
    -- The first revision of the alert that webhooks were not sent because it was muted; NULL if none.
    withheld_from INTEGER CHECK (withheld_from >= 1)
) STRICT;

CREATE TABLE alert_comments (
    comment_key INTEGER PRIMARY KEY AUTOINCREMENT,
    alert_key   INTEGER NOT NULL REFERENCES alerts ON DELETE CASCADE,
    at_us       INTEGER NOT NULL,
    -- Who wrote it, as they say.
    by_whom     TEXT    NOT NULL,
    text        TEXT    NOT NULL CHECK (text <> '')
) STRICT;
CREATE INDEX alert_comments_by_alert ON alert_comments (alert_key, comment_key);

-- What was decided in a time.
CREATE INDEX alert_history_by_time ON alert_history (at_us);
-- What was raised in a time.
CREATE INDEX alerts_by_raising ON alerts (raised_at_us);
