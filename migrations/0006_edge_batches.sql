-- Uploads of edges alone: vehicles that match scans on board, or have other sensors.
--
-- Their nodes have no row in node_scans, their loop closures none in closures.

ALTER TABLE batches ADD COLUMN kind TEXT NOT NULL DEFAULT 'scans' CHECK (kind IN (
    'scans', -- a part of a drive, to be matched here
    'edges'  -- nodes and edges; sequence is the order of arrival within the trip
));
-- A job of edges takes along what the vehicle has sent and what could not be tied to the map yet.
CREATE INDEX batches_unanchored_edges ON batches (route_key, vehicle_id, batch_key)
    WHERE status = 'unanchored' AND kind = 'edges';

-- What the vehicle calls the node: unique among the nodes of its uploads of edges. NULL for nodes
-- that were made here.
ALTER TABLE nodes ADD COLUMN client_id TEXT CHECK (length(client_id) BETWEEN 1 AND 64);
CREATE INDEX nodes_by_client_id ON nodes (route_key, client_id) WHERE client_id IS NOT NULL;

-- What a loop closure added to the optimum F when it was inserted; NULL for odometry. It moves here
-- from closures, which is about matched scans.
ALTER TABLE edges ADD COLUMN delta_f REAL CHECK (abs(delta_f) < 9e999);
UPDATE edges SET delta_f = closures.delta_f FROM closures
WHERE closures.route_key = edges.route_key AND closures.edge_id = edges.edge_id;
ALTER TABLE closures DROP COLUMN delta_f;
