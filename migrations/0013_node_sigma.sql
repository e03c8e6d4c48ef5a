-- How uncertain the poses of nodes are.

-- Standard deviations of x and y (map frame, metres) and of theta (radians), relative to the first
-- node that the node hangs together with. All NULL where nothing tells them: of a node of which it is
-- not known where it is, and of one that was saved before they were kept, until its sub-graph is
-- solved again.
ALTER TABLE nodes ADD COLUMN sigma_x REAL CHECK (sigma_x >= 0 AND sigma_x < 9e999);
ALTER TABLE nodes ADD COLUMN sigma_y REAL CHECK (sigma_y >= 0 AND sigma_y < 9e999)
    CHECK ((sigma_y IS NULL) = (sigma_x IS NULL));
ALTER TABLE nodes ADD COLUMN sigma_theta REAL CHECK (sigma_theta >= 0 AND sigma_theta < 9e999)
    CHECK ((sigma_theta IS NULL) = (sigma_x IS NULL));
