-- Who changed what, when, and from where: a row for each change that people make, or the service on its
-- own, written in the transaction of the change. Rows are neither changed nor deleted, and outlive
-- what they tell of.
CREATE TABLE audit (
    -- In the order of commits; never used again.
    audit_key INTEGER PRIMARY KEY AUTOINCREMENT,
    at_us     INTEGER NOT NULL,
    -- 'local' for requests, until there are people with keys; 'system' for the service itself.
    actor     TEXT    NOT NULL,
    -- The client's address, of IPv6 its network of 64 bits; NULL for the service itself.
    address   TEXT,
    -- An AuditAction.
    action    TEXT    NOT NULL,
    -- The route's name; NULL for what is about all routes. No foreign key: the row outlives the route.
    route_id  TEXT,
    -- What was changed: the name of a route, a batch or a vehicle, the id of an alert, a webhook, an operation.
    subject   TEXT    NOT NULL,
    -- What was there before and after, as JSON without secrets; NULL where there is no such thing.
    before    TEXT    CHECK (json_valid(before)),
    after     TEXT    CHECK (json_valid(after)),
    CHECK ((actor = 'system') = (address IS NULL))
) STRICT;

-- Lists are read in the order of time.
CREATE INDEX audit_by_time   ON audit (at_us);
CREATE INDEX audit_by_route  ON audit (route_id, at_us);
CREATE INDEX audit_by_action ON audit (action, at_us);
