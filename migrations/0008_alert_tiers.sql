-- How far alerts are to be believed, and which webhooks are sent those that are not certain yet.

-- 'tentative' while one pass shows the new state, 'confirmed' once two passes or two vehicles do.
-- What was raised before there were tiers counts as confirmed. The program knows the names: a list
-- of them here would have the table rebuilt for a new one.
ALTER TABLE alerts ADD COLUMN tier TEXT NOT NULL DEFAULT 'confirmed';
-- The revision with which it was first confirmed: what a webhook that is sent confirmed alerts
-- alone knows as the raising. NULL while it never was.
ALTER TABLE alerts ADD COLUMN confirmed_revision INTEGER
    CHECK (confirmed_revision BETWEEN 1 AND revision);
UPDATE alerts SET confirmed_revision = 1;
-- The other side of the same event, as of a door: its kind, as in `kind`, and its region, as in
-- `region`. Both NULL if there is none.
ALTER TABLE alerts ADD COLUMN counterpart_kind TEXT;
ALTER TABLE alerts ADD COLUMN counterpart_region BLOB
    CHECK (length(counterpart_region) % 16 = 0)
    CHECK ((counterpart_region IS NULL) = (counterpart_kind IS NULL));

-- Whether the webhook is sent alerts also while they are tentative.
ALTER TABLE webhooks ADD COLUMN include_tentative INTEGER NOT NULL DEFAULT 0
    CHECK (include_tentative IN (0, 1));
