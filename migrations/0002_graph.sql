-- Pose graphs. Poses are metres and radians, angles in (-pi, pi].

-- Poses of the base when a scan was taken. Vehicle and trip are the batch's.
CREATE TABLE nodes (
    route_key   INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Unique within the route, never used again.
    node_id     INTEGER NOT NULL CHECK (node_id >= 0),
    -- The upload it came with.
    batch_key   INTEGER NOT NULL REFERENCES batches ON DELETE CASCADE,
    -- When the scan was taken: nanoseconds since the Unix epoch, UTC.
    stamp_ns    INTEGER NOT NULL,
    -- map_from_base.
    x           REAL    NOT NULL CHECK (abs(x) < 9e999),
    y           REAL    NOT NULL CHECK (abs(y) < 9e999),
    theta       REAL    NOT NULL CHECK (abs(theta) < 3.1415927),
    -- odom_from_base, as the vehicle sent it.
    odom_x      REAL    NOT NULL CHECK (abs(odom_x) < 9e999),
    odom_y      REAL    NOT NULL CHECK (abs(odom_y) < 9e999),
    odom_theta  REAL    NOT NULL CHECK (abs(odom_theta) < 3.1415927),
    -- Whether later laps are tied to it.
    drift_m     REAL    NOT NULL CHECK (drift_m >= 0 AND drift_m < 9e999), -- way driven since last tied to the map
    reference   INTEGER NOT NULL CHECK (reference IN (0, 1)),
    -- Whether it takes part in the optimisation.
    active      INTEGER NOT NULL CHECK (active IN (0, 1)),
    -- The block of the graph it lies in; NULL outside every block with a loop closure.
    subgraph_id INTEGER,
    PRIMARY KEY (route_key, node_id)
) STRICT, WITHOUT ROWID;

CREATE INDEX nodes_by_batch ON nodes (batch_key);

-- The nodes' scans, apart from the nodes so that lists do not drag them along.
CREATE TABLE node_scans (
    route_key   INTEGER NOT NULL,
    node_id     INTEGER NOT NULL,
    -- The compact form of the scan.
    scan        BLOB    NOT NULL,
    -- Of the compact form.
    scan_sha256 BLOB    NOT NULL CHECK (length(scan_sha256) = 32),
    PRIMARY KEY (route_key, node_id),
    FOREIGN KEY (route_key, node_id) REFERENCES nodes ON DELETE CASCADE
) STRICT;

-- Measured motions between two nodes of one route.
CREATE TABLE edges (
    route_key   INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- Unique within the route, never used again.
    edge_id     INTEGER NOT NULL CHECK (edge_id >= 0),
    from_node   INTEGER NOT NULL,
    to_node     INTEGER NOT NULL CHECK (to_node <> from_node),
    kind        TEXT    NOT NULL CHECK (kind IN (
        'odometry',    -- two keyframes of one drive, one after the other
        'loop_closure' -- a place seen again
    )),
    status      TEXT    NOT NULL CHECK (status IN (
        'active',     -- it is optimised
        'retired',    -- it contradicts an accepted change; kept for the record
        'quarantined' -- it contradicts the rest beyond belief; kept for the record
    )),
    -- The upload it came with.
    batch_key   INTEGER NOT NULL REFERENCES batches ON DELETE CASCADE,
    -- from_from_to, as optimised.
    x           REAL    NOT NULL CHECK (abs(x) < 9e999),
    y           REAL    NOT NULL CHECK (abs(y) < 9e999),
    theta       REAL    NOT NULL CHECK (abs(theta) < 3.1415927),
    -- Upper triangle of its information in the order (x, y, theta).
    info_xx     REAL    NOT NULL CHECK (info_xx >= 0 AND info_xx < 9e999),
    info_xy     REAL    NOT NULL CHECK (abs(info_xy) < 9e999),
    info_xt     REAL    NOT NULL CHECK (abs(info_xt) < 9e999),
    info_yy     REAL    NOT NULL CHECK (info_yy >= 0 AND info_yy < 9e999),
    info_yt     REAL    NOT NULL CHECK (abs(info_yt) < 9e999),
    info_tt     REAL    NOT NULL CHECK (info_tt >= 0 AND info_tt < 9e999),
    -- e^T Omega e at the current poses.
    residual    REAL    NOT NULL CHECK (abs(residual) < 9e999),
    -- The block of the graph it lies in; NULL for bridges.
    subgraph_id INTEGER,
    PRIMARY KEY (route_key, edge_id),
    FOREIGN KEY (route_key, from_node) REFERENCES nodes ON DELETE CASCADE,
    FOREIGN KEY (route_key, to_node) REFERENCES nodes ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE INDEX edges_by_from     ON edges (route_key, from_node);
CREATE INDEX edges_by_to       ON edges (route_key, to_node);
CREATE INDEX edges_by_batch    ON edges (batch_key);
CREATE INDEX edges_by_subgraph ON edges (route_key, subgraph_id) WHERE status = 'active';

-- What two matched scans say beside the estimate that is optimised: one row for each loop
-- closure between scans.
CREATE TABLE closures (
    route_key           INTEGER NOT NULL,
    edge_id             INTEGER NOT NULL,
    -- The all-points estimate of from_from_to.
    x                   REAL    NOT NULL CHECK (abs(x) < 9e999),
    y                   REAL    NOT NULL CHECK (abs(y) < 9e999),
    theta               REAL    NOT NULL CHECK (abs(theta) < 3.1415927),
    -- Upper triangle of its information in the order (x, y, theta).
    info_xx             REAL    NOT NULL CHECK (info_xx >= 0 AND info_xx < 9e999),
    info_xy             REAL    NOT NULL CHECK (abs(info_xy) < 9e999),
    info_xt             REAL    NOT NULL CHECK (abs(info_xt) < 9e999),
    info_yy             REAL    NOT NULL CHECK (info_yy >= 0 AND info_yy < 9e999),
    info_yt             REAL    NOT NULL CHECK (abs(info_yt) < 9e999),
    info_tt             REAL    NOT NULL CHECK (info_tt >= 0 AND info_tt < 9e999),
    -- Share of the points with a counterpart.
    overlap             REAL    NOT NULL CHECK (overlap BETWEEN 0 AND 1),
    -- Share of the counterparts that agree.
    inlier_share        REAL    NOT NULL CHECK (inlier_share BETWEEN 0 AND 1),
    -- Root mean square distance of the agreeing points, metres.
    rmse_m              REAL    NOT NULL CHECK (rmse_m >= 0 AND rmse_m < 9e999),
    -- What the closure added to the optimum F when it was inserted.
    delta_f             REAL    NOT NULL CHECK (abs(delta_f) < 9e999),
    -- e^T Omega e of the all-points estimate at the optimum when it was inserted.
    all_points_residual REAL    NOT NULL CHECK (abs(all_points_residual) < 9e999),
    PRIMARY KEY (route_key, edge_id),
    FOREIGN KEY (route_key, edge_id) REFERENCES edges ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
