-- What passes by the place of a change saw of it, and how near to the vehicles' way it is.

-- A JSON object: counts of passes by outcome before the change and since, and a list of passes, the
-- oldest first. NULL for other kinds of alerts, and for alerts that have not changed since this column
-- exists.
ALTER TABLE alerts ADD COLUMN passes TEXT CHECK (json_valid(passes));
-- A Clearance: whether the region lies on, near or off the way that vehicles took before the change. NULL
-- as `passes`, and where nobody had driven before.
ALTER TABLE alerts ADD COLUMN clearance TEXT;
