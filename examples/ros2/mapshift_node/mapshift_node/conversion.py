"""From ROS messages to what the gateway takes. Nothing of ROS is imported, so that it can be tested anywhere."""
from __future__ import annotations

import math
from typing import Any, NamedTuple, Optional, Protocol, Sequence

from mapshift_gateway import is_finite

INVALID = 0.0  # below every range_min: the service takes it as not measured
RANGE_MIN_M = 0.01  # stated if a driver says 0, so that INVALID is below it
LEVEL_COS = math.cos(math.radians(5.0))  # a lidar that is tilted further does not scan a horizontal plane
SWEEP_MAX_S = 2.0


class Stamp(Protocol):
    sec: int
    nanosec: int


class LaserScan(Protocol):  # sensor_msgs/LaserScan
    angle_min: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float

    @property
    def ranges(self) -> Sequence[float]: ...


class Quaternion(Protocol):
    x: float
    y: float
    z: float
    w: float


class Transform(NamedTuple):
    """A rotation, as the rows of its matrix, and a translation."""

    rotation: tuple[tuple[float, float, float], ...]
    translation: tuple[float, float, float]

    def then(self, other: Transform) -> Transform:
        columns = list(zip(*other.rotation))
        rotation = tuple(tuple(dot(row, column) for column in columns) for row in self.rotation)
        moved = [dot(row, other.translation) + t for row, t in zip(self.rotation, self.translation)]
        return Transform(rotation, (moved[0], moved[1], moved[2]))  # type: ignore[arg-type]


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b))


def nanoseconds(stamp: Stamp) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def heading(q: Quaternion) -> float:
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def transform(translation: Any, q: Quaternion) -> Transform:
    x, y, z, w = q.x, q.y, q.z, q.w
    rotation = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return Transform(rotation, (translation.x, translation.y, translation.z))


class StaticFrames:
    """What /tf_static says."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Transform]] = {}

    def add(self, parent: str, child: str, parent_from_child: Transform) -> None:
        self._parents[child.lstrip("/")] = (parent.lstrip("/"), parent_from_child)

    def between(self, base: str, frame: str) -> Optional[Transform]:
        """`base_from_frame`, if both are known to hang together."""
        base_path, frame_path = self._to_root(base.lstrip("/")), self._to_root(frame.lstrip("/"))
        for ancestor, frame_transform in frame_path.items():
            if ancestor in base_path:
                return inverse(base_path[ancestor]).then(frame_transform)
        return None

    def _to_root(self, frame: str) -> dict[str, Transform]:
        """A frame and its ancestors, nearest first, with `ancestor_from_frame`."""
        path = {frame: Transform(((1, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0))}
        while frame in self._parents and self._parents[frame][0] not in path:
            parent, step = self._parents[frame]
            path[parent] = step.then(path[frame])
            frame = parent
        return path


def inverse(t: Transform) -> Transform:
    rotation = tuple(zip(*t.rotation))
    moved = [-dot(row, t.translation) for row in rotation]
    return Transform(rotation, (moved[0], moved[1], moved[2]))


def upload_range(range_m: float, range_min_m: float, range_max_m: float) -> Optional[float]:
    """A range as REP 117 means it: inf is no return; -inf, NaN and what is too near were not measured."""
    if math.isnan(range_m) or range_m < range_min_m:
        return INVALID
    return None if range_m > range_max_m else round(range_m, 3)


class Lidar:
    """A lidar as its first scan states it.

    Drivers measure their times anew for each scan, and some have a beam more or less in each turn; an upload states one
    geometry for all scans. So that of the first scan stays, and other beams are put where theirs are.
    """

    def __init__(self, first: LaserScan, base_from_lidar: Transform) -> None:
        level = base_from_lidar.rotation[2][2]
        if abs(level) < LEVEL_COS:
            raise ValueError("the lidar is tilted: its scans are no horizontal plane")
        self._upside_down = level < 0
        self._angle_min, self._increment, self._beams = first.angle_min, first.angle_increment, len(first.ranges)
        self._range_min, self._range_max = max(first.range_min, RANGE_MIN_M), first.range_max
        forward = math.atan2(base_from_lidar.rotation[1][0], base_from_lidar.rotation[0][0])
        x, y, _ = base_from_lidar.translation
        self.geometry: dict[str, Any] = {
            **self._angles(), **self._times(first), "range_min": self._range_min, "range_max": self._range_max,
            "mount": {"x": x, "y": y, "theta": forward},
        }
        if not is_finite(self.geometry):
            raise ValueError(f"its geometry is not finite: {self.geometry}")

    def ranges(self, scan: LaserScan) -> list[Optional[float]]:
        placed = scan.ranges if self._is_alike(scan) else [self._nearest(scan, beam) for beam in range(self._beams)]
        ranges = [upload_range(float(r), self._range_min, self._range_max) for r in placed]
        return ranges[::-1] if self._is_reversed() else ranges

    def _is_reversed(self) -> bool:
        """Whether beams are sent in the other order, so that they turn counter-clockwise as seen from above."""
        return self._upside_down != (self._increment < 0)

    def _angles(self) -> dict[str, float]:
        sign = -1.0 if self._upside_down else 1.0
        first, last = sign * self._angle_min, sign * (self._angle_min + (self._beams - 1) * self._increment)
        return {"angle_min": last if self._is_reversed() else first, "angle_increment": abs(self._increment)}

    def _times(self, first: LaserScan) -> dict[str, float]:
        """Left out if beams are reversed: the service takes the first beam for the earliest."""
        if self._is_reversed():
            return {}
        if 0 < first.time_increment * self._beams <= SWEEP_MAX_S:
            return {"time_increment": first.time_increment}
        return {"scan_time": first.scan_time} if 0 < first.scan_time <= SWEEP_MAX_S else {}

    def _is_alike(self, scan: LaserScan) -> bool:
        half_beam = 0.5 * abs(self._increment)
        last = self._angle_min + (self._beams - 1) * self._increment
        its_last = scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment
        near = abs(scan.angle_min - self._angle_min) < half_beam and abs(its_last - last) < half_beam
        return near and len(scan.ranges) == self._beams

    def _nearest(self, scan: LaserScan, beam: int) -> float:
        angle = self._angle_min + beam * self._increment
        index = round((angle - scan.angle_min) / scan.angle_increment)
        return scan.ranges[index] if 0 <= index < len(scan.ranges) else math.nan
