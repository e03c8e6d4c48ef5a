-- Everything that shaped a route's map, in the order in which it did: from it the map can be made anew.
CREATE TABLE inputs (
    -- In the order of commits; never used again.
    input_key INTEGER PRIMARY KEY AUTOINCREMENT,
    route_key INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- The time that whatever came of it bears.
    at_us     INTEGER NOT NULL,
    -- An Input, as JSON.
    input     TEXT    NOT NULL CHECK (json_valid(input))
) STRICT;

CREATE INDEX inputs_by_route ON inputs (route_key, input_key);

-- Of routes that have seen batches already the beginning is not known.
INSERT INTO inputs (route_key, at_us, input)
    SELECT route_key, created_at_us, json_object('settings', json_object('detector', detector,
        'false_alarm_rate', false_alarm_rate, 'hold_s', hold_s, 'max_shift_m', max_shift_m))
    FROM routes WHERE batches = 0;
