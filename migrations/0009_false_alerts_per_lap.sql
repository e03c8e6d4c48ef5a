-- `false_alarm_rate` has another meaning: false alerts per lap, no longer the share of unchanged
-- closures that a test of residuals may flag. A rate of the old kind says nothing about the new
-- one, so that every route gets the default; the service says at its start how many did.

ALTER TABLE routes DROP COLUMN false_alarm_rate;
-- How many false alerts are accepted in a lap: in as much driven way as the route's reference is
-- long.
ALTER TABLE routes ADD COLUMN false_alarm_rate REAL NOT NULL DEFAULT 0.01
    CHECK (false_alarm_rate > 0 AND false_alarm_rate <= 1);
