-- Which versions of a map are for vehicles, who began each version, and how far it moved the map.

-- When the version was released, by whom and why; NULL for one that never was.
ALTER TABLE map_versions ADD COLUMN released_at_us INTEGER;
ALTER TABLE map_versions ADD COLUMN released_by TEXT;
ALTER TABLE map_versions ADD COLUMN release_note TEXT;
-- When a released version was withdrawn.
ALTER TABLE map_versions ADD COLUMN retired_at_us INTEGER
    CHECK (retired_at_us IS NULL OR released_at_us IS NOT NULL);
-- Who began the version and why. A version after the first whose cause_action is NULL began with the release
-- of the one before.
ALTER TABLE map_versions ADD COLUMN cause_by TEXT;
ALTER TABLE map_versions ADD COLUMN cause_note TEXT;
-- How far what began it moved nodes at most; NULL where an earlier program did not measure it.
ALTER TABLE map_versions ADD COLUMN max_displacement_m REAL
    CHECK (max_displacement_m >= 0 AND max_displacement_m < 9e999);

-- The same of the present version.
ALTER TABLE routes ADD COLUMN version_by TEXT;
ALTER TABLE routes ADD COLUMN version_note TEXT;
ALTER TABLE routes ADD COLUMN version_max_displacement_m REAL
    CHECK (version_max_displacement_m >= 0 AND version_max_displacement_m < 9e999);

-- Who began the versions that are there stands in the history of the alerts.
UPDATE map_versions SET (cause_by, cause_note) = (
    SELECT by_whom, note FROM alerts JOIN alert_history USING (alert_key)
    WHERE alerts.id = cause_alert_id AND at_us = map_versions.created_at_us
    ORDER BY position DESC LIMIT 1)
WHERE cause_alert_id IS NOT NULL;
UPDATE routes SET (version_by, version_note) = (
    SELECT by_whom, note FROM alerts JOIN alert_history USING (alert_key)
    WHERE alerts.id = version_alert_id AND at_us = version_created_at_us
    ORDER BY position DESC LIMIT 1)
WHERE version_alert_id IS NOT NULL;
