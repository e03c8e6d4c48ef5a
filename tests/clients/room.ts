// What a vehicle sees on its way through an empty rectangular room, and what it matched on board. The types of
// each generated client check it where it is sent.

const WIDTH_M = 8;
const DEPTH_M = 5;
const BEAMS = 120;

/** The distance to the wall that a beam hits. */
function rangeM(x: number, y: number, heading: number): number {
  const [across, along] = [Math.cos(heading), Math.sin(heading)];
  const walls: number[] = [];
  if (Math.abs(across) > 1e-9) walls.push(((across > 0 ? WIDTH_M : 0) - x) / across);
  if (Math.abs(along) > 1e-9) walls.push(((along > 0 ? DEPTH_M : 0) - y) / along);
  return Number(Math.min(...walls).toFixed(3));
}

/** A batch of a drive along the room, 0.25 m from scan to scan. */
export function batch(sequence: number, scans = 8) {
  const step = (2 * Math.PI) / BEAMS;
  const scan = (k: number) => ({
    stamp: `2026-11-20T06:00:${String(k).padStart(2, "0")}Z`,
    odometry: { x: 0.25 * k, y: 0, theta: 0 },
    ranges: Array.from({ length: BEAMS }, (_, beam) => rangeM(1.5 + 0.25 * k, 2, -Math.PI + step * beam)),
  });
  return {
    vehicle_id: "agv-1",
    trip_id: "morning",
    sequence,
    lidar: { angle_min: -Math.PI, angle_increment: step, range_min: 0.05, range_max: 20 },
    scans: Array.from({ length: scans }, (_, k) => scan(sequence * scans + k)),
  };
}

/** Two nodes of a vehicle that matches on board, tied to a node of the map. */
export function edges(node: number) {
  const edge = (from: string, to: string) => ({
    from,
    to,
    measurement: { x: 0.5, y: 0, theta: 0 },
    information: [400, 0, 0, 400, 0, 2500] as [number, number, number, number, number, number],
    kind: "odometry" as const,
  });
  return {
    vehicle_id: "agv-2",
    nodes: [
      { id: "a", pose: { x: 0.5, y: 0, theta: 0 } },
      { id: "b", pose: { x: 1, y: 0, theta: 0 } },
    ],
    edges: [edge(`map:${node}`, "a"), edge("a", "b")],
  };
}
