-- What was noticed about the readings of a batch, and what its sender added for its own use.

-- Readings of range_max or longer, and readings below range_min; NULL for edges, and for batches that came
-- in before these were counted.
ALTER TABLE batches ADD COLUMN above_range_max INTEGER CHECK (above_range_max >= 0);
ALTER TABLE batches ADD COLUMN below_range_min INTEGER CHECK (below_range_min >= 0);
-- A JSON object as it was sent, kept also when the body is deleted; NULL if there was none, or if it was
-- erased.
ALTER TABLE batches ADD COLUMN extensions TEXT CHECK (extensions IS NULL OR json_valid(extensions));
