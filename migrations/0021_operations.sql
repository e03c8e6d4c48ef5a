-- Long work that somebody asked for, and what came of it.
CREATE TABLE operations (
    -- The order in which they are carried out.
    operation_key INTEGER PRIMARY KEY AUTOINCREMENT,
    -- UUID of version 7 in its usual text.
    id            TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- What is to be removed, as JSON.
    request       TEXT    NOT NULL CHECK (json_valid(request)),
    -- An OperationStatus.
    status        TEXT    NOT NULL,
    -- What was removed, as JSON; NULL until it is.
    result        TEXT    CHECK (json_valid(result)),
    -- Why it failed, for people.
    reason        TEXT,
    asked_at_us   INTEGER NOT NULL,
    ended_at_us   INTEGER,
    CHECK (ended_at_us IS NOT NULL OR (result IS NULL AND reason IS NULL))
) STRICT;

CREATE INDEX operations_by_route ON operations (route_key);
CREATE INDEX operations_waiting  ON operations (operation_key) WHERE ended_at_us IS NULL;
