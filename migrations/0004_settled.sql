-- Nodes that have left the active graph, and how long bodies of uploads are kept.
--
-- A node that is not `active` has left: its drive is long over, and it is no reference. Its pose,
-- its scan and its edges are kept as they were. An edge is in the active graph if both its ends
-- are.

-- The node's place in its trip: 0, 1, 2 …
ALTER TABLE nodes ADD COLUMN trip_order INTEGER NOT NULL DEFAULT 0 CHECK (trip_order >= 0);
UPDATE nodes SET trip_order = numbered.place FROM (
    SELECT nodes.route_key, node_id,
        row_number() OVER (PARTITION BY nodes.route_key, trip_id ORDER BY node_id) - 1 AS place
    FROM nodes JOIN batches USING (batch_key)
) AS numbered
WHERE numbered.route_key = nodes.route_key AND numbered.node_id = nodes.node_id;

-- What a worker loads, however many nodes have left.
CREATE INDEX nodes_active ON nodes (route_key, node_id) WHERE active = 1;

-- Whether its body is still there: a service can be told to delete bodies of merged batches.
ALTER TABLE batches ADD COLUMN body_kept INTEGER NOT NULL DEFAULT 1 CHECK (body_kept IN (0, 1));
-- Whose bodies are deleted next.
CREATE INDEX batches_with_bodies ON batches (processed_at_us)
    WHERE status = 'merged' AND body_kept = 1;
