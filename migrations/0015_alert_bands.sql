-- The height bands that show an alert: virtual scans of 3D lidars are layers, which are compared with
-- their like alone.

-- A JSON array of bands, ascending, each as [from, to], metres above the floor; empty if it is seen by
-- lidars that look along one plane.
ALTER TABLE alerts ADD COLUMN bands TEXT NOT NULL DEFAULT '[]' CHECK (json_valid(bands));
