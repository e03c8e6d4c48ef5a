"""What a vehicle sees on its way through an empty rectangular room, and what it matched on board."""

import math

WIDTH_M, DEPTH_M = 8.0, 5.0
BEAMS = 120


def range_m(x: float, y: float, heading: float) -> float:
    """The distance to the wall that a beam hits."""
    across, along = math.cos(heading), math.sin(heading)
    walls = []
    if abs(across) > 1e-9:
        walls.append(((WIDTH_M if across > 0 else 0.0) - x) / across)
    if abs(along) > 1e-9:
        walls.append(((DEPTH_M if along > 0 else 0.0) - y) / along)
    return round(min(walls), 3)


def batch(sequence: int, scans: int = 8) -> dict[str, object]:
    """A batch of a drive along the room, 0.25 m from scan to scan."""
    step = 2 * math.pi / BEAMS

    def scan(k: int) -> dict[str, object]:
        x = 1.5 + 0.25 * k
        return {
            "stamp": f"2026-11-20T06:00:{k:02d}Z",
            "odometry": {"x": 0.25 * k, "y": 0.0, "theta": 0.0},
            "ranges": [range_m(x, 2.0, -math.pi + step * beam) for beam in range(BEAMS)],
        }

    return {
        "vehicle_id": "agv-1",
        "trip_id": "morning",
        "sequence": sequence,
        "lidar": {
            "angle_min": -math.pi,
            "angle_increment": step,
            "range_min": 0.05,
            "range_max": 20.0,
        },
        "scans": [scan(k) for k in range(sequence * scans, (sequence + 1) * scans)],
    }


def edges(node: int) -> dict[str, object]:
    """Two nodes of a vehicle that matches on board, tied to a node of the map."""
    information = [400.0, 0.0, 0.0, 400.0, 0.0, 2500.0]

    def edge(start: str, end: str) -> dict[str, object]:
        return {
            "from": start,
            "to": end,
            "measurement": {"x": 0.5, "y": 0.0, "theta": 0.0},
            "information": information,
            "kind": "odometry",
        }

    return {
        "vehicle_id": "agv-2",
        "nodes": [
            {"id": "a", "pose": {"x": 0.5, "y": 0.0, "theta": 0.0}},
            {"id": "b", "pose": {"x": 1.0, "y": 0.0, "theta": 0.0}},
        ],
        "edges": [edge(f"map:{node}", "a"), edge("a", "b")],
    }
