-- What is corrected of a vehicle while it drives a trip, and what alerts against vehicles rest on.

-- A JSON array of the corrections in force for the trip, decided when its first scans enter the map and
-- never changed: NULL until then, and for trips of edges.
ALTER TABLE trips ADD COLUMN corrections TEXT CHECK (json_valid(corrections));

-- Trips that began before there were corrections go on without.
UPDATE trips SET corrections = '[]' WHERE EXISTS (
    SELECT 1 FROM batches WHERE batches.route_key = trips.route_key
    AND batches.trip_id = trips.trip_id AND batches.kind = 'scans'
    AND batches.status IN ('merged', 'unanchored'));

-- What is off of a suspected vehicle, and the changes that this silences, as JSON; NULL for all other
-- alerts.
ALTER TABLE alerts ADD COLUMN suspect TEXT CHECK (json_valid(suspect));
