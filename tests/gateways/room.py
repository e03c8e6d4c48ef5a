"""A vehicle with a lidar in a simulated room: the messages that its gateway gets, and where it was."""
from __future__ import annotations

import math
import time
from typing import Any, Iterator, Optional

BEAMS = 180
RANGE_MIN_M, RANGE_MAX_M = 0.1, 8.0
GEOMETRY = {"angle_min": -math.pi, "angle_increment": math.tau / BEAMS, "range_min": RANGE_MIN_M,
            "range_max": RANGE_MAX_M, "mount": {"x": 0.1, "y": 0.0, "theta": 0.0}}
START_NS = 1_764_000_000_000_000_000
SCAN_EVERY_NS = 200_000_000
LAP_SCANS = 120
Pose = tuple[float, float, float]
Segment = tuple[float, float, float, float]


def box(x0: float, y0: float, x1: float, y1: float) -> list[Segment]:
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


# No turn of it fits itself, so that a trip is localised in it without a doubt.
WALLS: list[Segment] = [
    (0, 0, 10, 0), (10, 0, 10, 5), (10, 5, 7.5, 5), (7.5, 5, 7.5, 7), (7.5, 7, 0, 6), (0, 6, 0, 0),
    *box(4.2, 2.6, 5.0, 3.6), *box(9.2, 0.6, 9.7, 1.4), *box(0.4, 4.6, 0.9, 5.4),
]


def true_pose(k: float) -> Pose:
    """Of the base in the room at the k-th scan: round a box in the middle."""
    a = math.tau * k / LAP_SCANS - 2.0
    x, y = 4.6 + 2.9 * math.cos(a), 3.0 + 1.7 * math.sin(a)
    return x, y, math.atan2(1.7 * math.cos(a), -2.9 * math.sin(a))


def in_odometry(first: Pose, pose: Pose) -> Pose:
    """The same in a frame that begins at `first`, measured half a per cent too long."""
    dx, dy = 1.005 * (pose[0] - first[0]), 1.005 * (pose[1] - first[1])
    c, s = math.cos(first[2]), math.sin(first[2])
    return c * dx + s * dy, c * dy - s * dx, math.remainder(pose[2] - first[2], math.tau)


def distance(x: float, y: float, direction: float) -> Optional[float]:
    """Of the nearest wall, None beyond the range of the lidar."""
    dx, dy = math.cos(direction), math.sin(direction)
    nearest = math.inf
    for x0, y0, x1, y1 in WALLS:
        ex, ey = x1 - x0, y1 - y0
        cross = dx * ey - dy * ex
        if abs(cross) > 1e-12:
            along = ((x0 - x) * ey - (y0 - y) * ex) / cross
            share = ((x0 - x) * dy - (y0 - y) * dx) / cross
            if 0 <= share <= 1 and 0 < along < nearest:
                nearest = along
    return round(nearest, 3) if nearest < RANGE_MAX_M else None


def ranges_from(pose: Pose) -> list[Optional[float]]:
    x, y, theta = pose
    x, y = x + 0.1 * math.cos(theta), y + 0.1 * math.sin(theta)
    return [distance(x, y, theta - math.pi + k * math.tau / BEAMS) for k in range(BEAMS)]


def messages(scans: int, trip_at: int) -> Iterator[dict[str, Any]]:
    """Odometry between the scans, so that it is to be interpolated; from `trip_at` on in a new frame."""
    for k in range(scans):
        first = true_pose(0 if k < trip_at else trip_at)
        yield odometry_message(first, k - 0.2)
        yield {"stamp_ns": stamp_ns(k), "lidar": GEOMETRY, "ranges": ranges_from(true_pose(k))}
        yield odometry_message(first, k + 0.3)


def stamp_ns(k: float) -> int:
    return START_NS + int(k * SCAN_EVERY_NS)


def stamp_text(stamp_ns: int) -> str:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{nanoseconds:09}Z"


def odometry_message(first: Pose, k: float) -> dict[str, Any]:
    x, y, theta = in_odometry(first, true_pose(k))
    return {"stamp_ns": stamp_ns(k), "x": x, "y": y, "theta": theta}
