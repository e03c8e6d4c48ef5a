-- What a removal has removed already, as its result, while the map is made anew without it; else NULL.
ALTER TABLE operations ADD COLUMN removed TEXT CHECK (json_valid(removed));
-- How often it has begun to make it anew: a process may be lost meanwhile.
ALTER TABLE operations ADD COLUMN rebuilds_begun INTEGER NOT NULL DEFAULT 0 CHECK (rebuilds_begun >= 0);
