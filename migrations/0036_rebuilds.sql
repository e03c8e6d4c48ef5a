-- What a removal has removed already, as its result, while the map is made anew without it; else NULL.
ALTER TABLE operations ADD COLUMN removed TEXT CHECK (json_valid(removed));
