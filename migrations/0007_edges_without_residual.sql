-- The residual of an edge follows from the poses of its nodes: kept with the edge, every solve
-- wrote all edges of a block anew.
ALTER TABLE edges DROP COLUMN residual;
