-- What a decision about an alert is bound to: a revision that driving does not raise.
--
-- Counts changes of status, tier, and of the region beyond a tolerance. Alerts that are there begin with
-- their revision, so that decisions about what was read before still fit.
ALTER TABLE alerts ADD COLUMN decision_revision INTEGER NOT NULL DEFAULT 1
    CHECK (decision_revision BETWEEN 1 AND revision);
-- The region as it was with that revision, as `region` is kept.
ALTER TABLE alerts ADD COLUMN decision_region BLOB NOT NULL DEFAULT x''
    CHECK (length(decision_region) % 16 = 0);
UPDATE alerts SET decision_revision = revision, decision_region = region;

-- Why an alert was dismissed: a DismissReason; NULL where nobody says, and of every other status.
ALTER TABLE alert_history ADD COLUMN reason TEXT CHECK (reason IS NULL OR status = 'dismissed');
