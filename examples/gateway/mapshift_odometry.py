"""Where a vehicle's odometry says that it was. Python 3.10 or newer, standard library only."""
from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, Optional

AGE_MAX_NS = 200_000_000  # a scan without odometry after it takes what is no older than this
STEP_NS = 1_000_000_000  # time that goes back by more is that of another clock; by less, a message came late or twice
GAP_MAX_S = 30.0
SPEED_MAX_M_PER_S = 5.0
TURN_MAX_RAD_PER_S = 4.0


class Odometry(NamedTuple):  # the pose of the base in the odometry frame
    stamp_ns: int
    x: float
    y: float
    theta: float

    def continues(self, before: Odometry) -> bool:
        """Whether both can be of one odometry frame."""
        elapsed_s = (self.stamp_ns - before.stamp_ns) * 1e-9
        moved_m = math.hypot(self.x - before.x, self.y - before.y)
        turned_rad = abs(math.remainder(self.theta - before.theta, math.tau))
        possible = moved_m < 0.5 + SPEED_MAX_M_PER_S * elapsed_s and turned_rad < 0.5 + TURN_MAX_RAD_PER_S * elapsed_s
        return possible and 0 <= elapsed_s <= GAP_MAX_S

    def towards(self, after: Odometry, stamp_ns: int) -> Odometry:
        part = (stamp_ns - self.stamp_ns) / (after.stamp_ns - self.stamp_ns)
        x, y = self.x + part * (after.x - self.x), self.y + part * (after.y - self.y)
        return Odometry(stamp_ns, x, y, self.theta + part * math.remainder(after.theta - self.theta, math.tau))


def is_step_back(newest_ns: int, stamp_ns: int) -> bool:
    """Whether the clock was set back, or a simulation or a recording begins again."""
    return stamp_ns < newest_ns - STEP_NS


class RecentOdometry:
    def __init__(self) -> None:
        self._poses: deque[Odometry] = deque(maxlen=500)

    def add(self, odometry: Odometry) -> None:
        if is_step_back(self.newest_ns(), odometry.stamp_ns):
            self.clear()
        if not self._poses or odometry.stamp_ns > self.newest_ns():
            self._poses.append(odometry)

    def clear(self) -> None:
        self._poses.clear()

    def newest_ns(self) -> int:
        return self._poses[-1].stamp_ns if self._poses else 0

    def at(self, stamp_ns: int) -> Optional[Odometry]:
        """Interpolated, else what came shortly before."""
        before = next((pose for pose in reversed(self._poses) if pose.stamp_ns <= stamp_ns), None)
        after = next((pose for pose in self._poses if pose.stamp_ns > stamp_ns), None)
        if before and after and after.continues(before):
            return before.towards(after, stamp_ns)
        if before and stamp_ns - before.stamp_ns <= AGE_MAX_NS:
            return before._replace(stamp_ns=stamp_ns)
        return None
