-- Who may do what: keys of vehicles, machines and people, and the sessions that people begin with them.
CREATE TABLE keys (
    -- In the order in which they were made; never used again.
    key_key         INTEGER PRIMARY KEY AUTOINCREMENT,
    -- UUID of version 7: the part of a key that is no secret.
    id              TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    -- Whose it is: a person or a machine. Several keys may have one name, so that they can be rotated.
    name            TEXT    NOT NULL CHECK (length(name) BETWEEN 1 AND 100),
    -- A Role.
    role            TEXT    NOT NULL,
    -- The one vehicle that it uploads for; NULL for any, and for other roles than 'vehicle'.
    vehicle_id      TEXT,
    -- The names of the routes that it is limited to, a JSON array; NULL for all. Not foreign keys: a name
    -- may be given before its route is made.
    routes          TEXT    CHECK (json_array_length(routes) >= 1),
    -- SHA-256 of its 32 secret bytes. They are random, so that no salt and no slow digest is needed.
    secret_sha256   BLOB    NOT NULL CHECK (length(secret_sha256) = 32),
    created_at_us   INTEGER NOT NULL,
    -- The name of who made it.
    created_by      TEXT    NOT NULL,
    -- Noted every few minutes at most; NULL before the first use.
    last_used_at_us INTEGER,
    -- From then on it is no key; NULL for never.
    expires_at_us   INTEGER,
    -- Since when it is no key. Rows stay: a service that has had a key is never open again.
    revoked_at_us   INTEGER
) STRICT;

-- Deleted when they end, or when another one begins after that.
CREATE TABLE sessions (
    session_key     INTEGER PRIMARY KEY AUTOINCREMENT,
    -- SHA-256 of the 32 random bytes in the cookie.
    id_sha256       BLOB    NOT NULL UNIQUE CHECK (length(id_sha256) = 32),
    -- The key that it was begun with, and ends with.
    key_key         INTEGER NOT NULL REFERENCES keys ON DELETE CASCADE,
    created_at_us   INTEGER NOT NULL,
    -- Noted every few minutes at most.
    last_used_at_us INTEGER NOT NULL
) STRICT;

CREATE INDEX sessions_by_key ON sessions (key_key);

-- The id of the key that a change was made with; NULL without a key. `actor` has its name.
ALTER TABLE audit ADD COLUMN key_id TEXT;
