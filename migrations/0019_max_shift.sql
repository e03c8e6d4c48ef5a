-- How far a batch may move what others have mapped, metres.
ALTER TABLE routes ADD COLUMN max_shift_m REAL NOT NULL DEFAULT 0.02 CHECK (max_shift_m > 0.0);
