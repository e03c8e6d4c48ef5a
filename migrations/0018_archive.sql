-- What reads of an old route need to know of the nodes and edges that have left the active graph,
-- without reading them all.

-- Sums over what has left, one row for each sub-graph. An edge has left once one of its nodes has.
CREATE TABLE archive_sums (
    route_key     INTEGER NOT NULL REFERENCES routes ON DELETE CASCADE,
    -- The sub-graph it was in when it left; -1 for what was in none.
    subgraph_id   INTEGER NOT NULL,
    nodes         INTEGER NOT NULL DEFAULT 0,
    -- Edges whose status is 'active', and the loop closures among them.
    edges         INTEGER NOT NULL DEFAULT 0,
    loop_closures INTEGER NOT NULL DEFAULT 0,
    -- e^T Omega e of those edges when they left.
    total         REAL    NOT NULL DEFAULT 0,
    -- Edges of any status that are in the residual series, and the increases of F that they caused.
    closures      INTEGER NOT NULL DEFAULT 0,
    delta_f       REAL    NOT NULL DEFAULT 0,
    -- Those of them between scans, and the residuals of their all-points estimates.
    scan_closures INTEGER NOT NULL DEFAULT 0,
    all_points    REAL    NOT NULL DEFAULT 0,
    PRIMARY KEY (route_key, subgraph_id)
) STRICT, WITHOUT ROWID;

-- The few edges that are not optimised.
CREATE INDEX edges_by_status ON edges (route_key, status, edge_id) WHERE status <> 'active';
