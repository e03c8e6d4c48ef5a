-- What a process leaves behind that was lost, and a clock that was put back.

-- Jobs that a process was lost with are tried once more, alone, and then given up. Earlier ends of
-- processes were counted for another rule.
UPDATE jobs SET orphaned = 0;
CREATE INDEX jobs_lost ON jobs (route_key, batch_key) WHERE orphaned > 0;

-- How many commits there were, one row: compared with a file beside the database when it is opened,
-- to know whether the write-ahead log was lost.
CREATE TABLE commits (
    only  INTEGER PRIMARY KEY CHECK (only = 1),
    count INTEGER NOT NULL CHECK (count >= 0)
) STRICT;
INSERT INTO commits VALUES (1, 0);

-- Since when it is held, if not since it was received: the clock was ahead then.
ALTER TABLE batches ADD COLUMN held_since_us INTEGER;

-- CRC-32 of what never changes of a row (`src/store/row_sums.rs`); NULL for rows from before: they are
-- not checked.
ALTER TABLE nodes ADD COLUMN checksum INTEGER;
ALTER TABLE edges ADD COLUMN checksum INTEGER;
