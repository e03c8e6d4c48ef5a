-- Scans between keyframes: they show what stands where, and never enter the graph.

-- One row for each scan that was taken after a keyframe and before the next one of its trip.
CREATE TABLE intermediate_scans (
    route_key   INTEGER NOT NULL,
    -- The keyframe that it follows: the scan moves rigidly with it.
    node_id     INTEGER NOT NULL,
    -- Its place among those of the keyframe, in the order of time: 0, 1, 2 …
    place       INTEGER NOT NULL CHECK (place >= 0),
    -- When the scan was taken: nanoseconds since the Unix epoch, UTC.
    stamp_ns    INTEGER NOT NULL,
    -- keyframe_from_base: pose of the base in the frame of the keyframe's base.
    x           REAL    NOT NULL CHECK (abs(x) < 9e999),
    y           REAL    NOT NULL CHECK (abs(y) < 9e999),
    theta       REAL    NOT NULL CHECK (abs(theta) < 3.1415927),
    -- odom_from_base, as the vehicle sent it.
    odom_x      REAL    NOT NULL CHECK (abs(odom_x) < 9e999),
    odom_y      REAL    NOT NULL CHECK (abs(odom_y) < 9e999),
    odom_theta  REAL    NOT NULL CHECK (abs(odom_theta) < 3.1415927),
    -- Of the compact form.
    scan_sha256 BLOB    CHECK (length(scan_sha256) = 32),
    -- The compact form of the scan; NULL where it would repeat the scan before. The last column:
    -- whoever reads the poses alone does not read it.
    scan        BLOB,
    PRIMARY KEY (route_key, node_id, place),
    FOREIGN KEY (route_key, node_id) REFERENCES nodes ON DELETE CASCADE,
    CHECK ((scan IS NULL) = (scan_sha256 IS NULL))
) STRICT;
