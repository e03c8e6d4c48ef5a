-- What others are notified of: changes that a decision is about, uploads that are kept out, vehicles that
-- become suspect, operations that end. And secrets that are replaced while both are valid.

-- Whether what a decision is about has changed with the event (status, kind, tier, region), or the alert
-- has gained evidence or was handled otherwise. Of events before this it is not known: they count.
ALTER TABLE alert_events ADD COLUMN is_decision INTEGER NOT NULL DEFAULT 1
    CHECK (is_decision IN (0, 1));

-- What an event is about that is about no alert: the route, NULL for an operation of several routes, and
-- the name of the batch or the vehicle, or the id of the operation. Both NULL for alerts and tests.
ALTER TABLE webhook_deliveries ADD COLUMN route_key INTEGER REFERENCES routes ON DELETE CASCADE;
ALTER TABLE webhook_deliveries ADD COLUMN subject TEXT
    CHECK (subject IS NULL OR alert_key IS NULL);
CREATE INDEX webhook_deliveries_by_route ON webhook_deliveries (route_key)
    WHERE route_key IS NOT NULL;

-- The secret before the present one, and until when calls are signed with both. Both NULL if there is none.
ALTER TABLE webhooks ADD COLUMN previous_secret BLOB CHECK (length(previous_secret) = 32);
ALTER TABLE webhooks ADD COLUMN previous_secret_until_us INTEGER
    CHECK ((previous_secret_until_us IS NULL) = (previous_secret IS NULL));

-- The VehicleState that a vehicle had when that was last determined: what becoming suspect is measured
-- against. A vehicle without a row has always been trusted.
CREATE TABLE vehicle_states (
    route_key  INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    vehicle_id TEXT    NOT NULL,
    state      TEXT    NOT NULL,
    PRIMARY KEY (route_key, vehicle_id)
) STRICT, WITHOUT ROWID;

INSERT INTO vehicle_states (route_key, vehicle_id, state)
SELECT route_key, vehicle_id, 'quarantined' FROM vehicle_quarantines;
INSERT OR IGNORE INTO vehicle_states (route_key, vehicle_id, state)
SELECT route_key, value, 'suspect' FROM alerts, json_each(alerts.vehicles)
WHERE kind = 'vehicle_suspect' AND status IN ('open', 'acknowledged');
-- Three of a vehicle's newest ten batches were kept out.
INSERT OR IGNORE INTO vehicle_states (route_key, vehicle_id, state)
SELECT route_key, vehicle_id, 'suspect' FROM (
    SELECT route_key, vehicle_id, status,
        row_number() OVER (PARTITION BY route_key, vehicle_id ORDER BY batch_key DESC) AS newness
    FROM batches WHERE status IN ('merged', 'unanchored', 'quarantined')
) WHERE newness <= 10 AND status = 'quarantined' GROUP BY route_key, vehicle_id HAVING count(*) >= 3;
