-- What is taken from the stamps of a trip whose clock is ahead, nanoseconds; decided with the
-- corrections, when the trip begins.
ALTER TABLE trips ADD COLUMN clock_ahead_ns INTEGER NOT NULL DEFAULT 0;
