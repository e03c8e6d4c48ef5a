-- The shift that explains what a pass contradicts: the map is wrong there, not the world.

-- The vector by which what the pass observed there would have to be moved to lie on the map, in the
-- map's frame, metres. Both NULL if no shift explains the alert.
ALTER TABLE alerts ADD COLUMN shift_x REAL CHECK (abs(shift_x) < 9e999);
ALTER TABLE alerts ADD COLUMN shift_y REAL CHECK (abs(shift_y) < 9e999)
    CHECK ((shift_y IS NULL) = (shift_x IS NULL));
