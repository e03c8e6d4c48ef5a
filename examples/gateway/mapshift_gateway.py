"""A vehicle's gateway to mapshift: copy this directory, and call `on_odometry` and `on_scan` from your callbacks.

docs/how-to/write-a-gateway.md has the rules. Python 3.10 or newer, standard library only.
"""
from __future__ import annotations

import calendar
import math
import secrets
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, NamedTuple, Optional, Sequence

from mapshift_odometry import Odometry, RecentOdometry, is_step_back
from mapshift_spool import Spool
from mapshift_uploader import Uploader

WAIT_NS = 300_000_000  # so long a scan waits for odometry after it, and for earlier ones of other lidars
PAUSE_S = 10.0
Ranges = Sequence[Optional[float]]  # metres; None is no return


@dataclass(frozen=True)
class Settings:
    url: str  # of the service; its key is in the environment, MAPSHIFT_KEY
    route: str
    vehicle: str  # at most 32 characters, so that the ids of batches fit into 64
    spool: Path
    lidars: tuple[str, ...] = ()  # names, if there are several: the first takes the keyframes
    scans_per_batch: int = 60
    seconds_per_batch: float = 10.0
    spool_bytes_max: int = 2 << 30
    timeout_s: float = 60.0
    first_wait_s: float = 1.0  # doubled by each failure, up to 300 s


class Scan(NamedTuple):
    stamp_ns: int
    lidar: str  # its name; "" for the only one
    geometry: dict[str, Any]  # the fields of `lidar` in an upload
    ranges: Ranges


class Gateway:
    """The callbacks may come from any thread; they wait neither for the network nor for a sync."""

    def __init__(self, settings: Settings, log: Callable[[str], None] = print,
                 on_stored: Callable[[str, bytes], None] = lambda batch_id, body: None) -> None:
        self._settings, self._log, self._lock = settings, log, threading.RLock()
        self._odometry = RecentOdometry()
        self._waiting: list[Scan] = []
        self._shapes: dict[str, tuple[dict[str, Any], int]] = {}  # geometry and number of beams, by lidar
        self._stamps: dict[str, int] = {}  # of the last scan that was written, by lidar
        self._given: dict[str, int] = {}  # of the newest scan that was given, by lidar
        self._scans, self._begun_s, self._paused_until_s = 0, 0.0, 0.0
        self._trip, self._sequence, self._last = "", 0, Odometry(0, 0.0, 0.0, 0.0)
        self._spool = Spool(settings.spool, settings.spool_bytes_max, log)
        try:
            self._resume()
        except (OSError, LookupError, TypeError, ValueError) as error:  # damaged by a power cut
            log(f"the last batch cannot be read, another trip begins: {error!r}")
        batches = f"{settings.url.rstrip('/')}/v1/routes/{settings.route}/batches"
        self._uploader = Uploader(batches, settings.spool, settings.timeout_s, settings.first_wait_s, log, on_stored)

    def _resume(self) -> None:
        if last := self._spool.last():
            head, scan = last
            self._last = Odometry(stamp_of(scan["stamp"]), **scan["odometry"])
            self._stamps[scan.get("lidar", "")] = self._last.stamp_ns
            self._trip, self._sequence = head["trip_id"], head["sequence"] + 1

    def on_odometry(self, stamp_ns: int, x: float, y: float, theta: float) -> None:
        with self._lock:
            if not is_finite([x, y, theta]):
                return self._log(f"the odometry of {stamp_ns * 1e-9:.3f} s is left out: it is not finite")
            if is_step_back(self._odometry.newest_ns(), stamp_ns):
                self._begin_anew(stamp_ns)
            self._odometry.add(Odometry(stamp_ns, x, y, theta))
            self._take_waiting()
            if time.monotonic() - self._begun_s > self._settings.seconds_per_batch:
                self._spool.end()

    def on_scan(self, stamp_ns: int, geometry: dict[str, Any], ranges: Ranges, lidar: str = "") -> None:
        with self._lock:
            if not is_finite([geometry, ranges]):
                return self._log(f"the scan of {stamp_ns * 1e-9:.3f} s is left out: its numbers are not all finite")
            if is_step_back(self._given.get(lidar, 0), stamp_ns):
                self._begin_anew(stamp_ns)
            self._given[lidar] = max(stamp_ns, self._given.get(lidar, 0))
            self._waiting.append(Scan(stamp_ns, lidar, geometry, ranges))
            self._take_waiting()

    def complete_batch(self) -> None:
        """Hands on what has been collected, as at the end of a drive."""
        with self._lock:
            self._take_waiting(everything=True)
            self._spool.end()

    def close(self) -> None:
        """Ends the threads; what is not stored stays in the spool, and the next start goes on with it."""
        self.complete_batch()
        self._spool.close()
        self._uploader.stop()

    def _begin_anew(self, stamp_ns: int) -> None:
        """Time went back: what waits is of the time before, and what comes is not compared with that."""
        self._take_waiting(everything=True)
        self._end_trip("time went back: a new trip begins")
        if is_step_back(self._odometry.newest_ns(), stamp_ns):
            self._odometry.clear()
        self._stamps.clear()
        self._given.clear()
        self._last = Odometry(0, 0.0, 0.0, 0.0)

    def _take_waiting(self, everything: bool = False) -> None:
        newest_ns = max((scan.stamp_ns for scan in self._waiting), default=0)
        ready_ns = newest_ns if everything else newest_ns - WAIT_NS
        if not self._settings.lidars:  # those of several lidars wait in any case, to be put in order
            ready_ns = max(ready_ns, self._odometry.newest_ns())
        ready = sorted((scan for scan in self._waiting if scan.stamp_ns <= ready_ns), key=lambda scan: scan.stamp_ns)
        self._waiting = [scan for scan in self._waiting if scan.stamp_ns > ready_ns]
        for scan in ready:
            odometry = self._odometry.at(scan.stamp_ns)
            late = scan.stamp_ns < self._last.stamp_ns < scan.stamp_ns + 1_000_000_000
            if not odometry or late or self._stamps.get(scan.lidar) == scan.stamp_ns:
                why = "there is no odometry" if not odometry else "it came too late, or twice"
                self._log(f"the scan of {scan.stamp_ns * 1e-9:.3f} s is left out: {why}")
                continue
            try:
                self._collect(scan, odometry)
            except OSError as error:
                self._pause(f"the spool cannot be written: {error!r}")

    def _collect(self, scan: Scan, odometry: Odometry) -> None:
        if self._trip and not odometry.continues(self._last):
            self._end_trip("the odometry frame is another: a new trip begins")
        shape = (scan.geometry, len(scan.ranges))
        if self._shapes.get(scan.lidar) != shape:
            self._spool.end()
            self._shapes[scan.lidar] = shape
        if not self._spool.is_open() and not self._begin_batch(scan.lidar):
            return
        seconds, nanoseconds = divmod(scan.stamp_ns, 1_000_000_000)
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{nanoseconds:09}Z"
        named = {"lidar": scan.lidar} if scan.lidar else {}
        pose = {"x": odometry.x, "y": odometry.y, "theta": odometry.theta}
        self._spool.write({"stamp": stamp, **named, "odometry": pose, "ranges": scan.ranges})
        self._last, self._stamps[scan.lidar], self._scans = odometry, scan.stamp_ns, self._scans + 1
        if self._scans >= self._settings.scans_per_batch:
            self._spool.end()

    def _begin_batch(self, lidar: str) -> bool:
        names = self._settings.lidars
        if time.monotonic() < self._paused_until_s:
            return False
        if not self._trip and names and lidar != names[0]:
            return False  # a trip begins with a scan of the lidar that takes its keyframes
        if not self._trip:
            begun = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
            self._trip, self._sequence = f"{self._settings.vehicle}-{begun}-{secrets.token_hex(2)}", 0
        several = [{"id": name, **self._shapes[name][0]} for name in names if name in self._shapes]
        lidars = {"lidars": several} if names else {"lidar": self._shapes[""][0]}
        head = {"vehicle_id": self._settings.vehicle, "trip_id": self._trip, "sequence": self._sequence, **lidars}
        if not self._spool.begin(f"{self._trip}-{self._sequence:06}", head):
            self._pause("the spool is full, or has a batch of that name")
            return False
        self._sequence, self._scans, self._begun_s = self._sequence + 1, 0, time.monotonic()
        return True

    def _pause(self, why: str) -> None:
        """Ends the trip, so that what is kept of it has no gap; another begins when scans can be kept again."""
        self._end_trip(f"{why}: scans of the next {PAUSE_S:.0f} s are left out")
        self._paused_until_s = time.monotonic() + PAUSE_S

    def _end_trip(self, why: str) -> None:
        self._log(why)
        self._spool.end()
        self._trip = ""


def is_finite(value: Any) -> bool:
    """Whether JSON can state it: it has neither NaN nor infinity."""
    if isinstance(value, dict):
        return all(map(is_finite, value.values()))
    if isinstance(value, (list, tuple)):
        return all(map(is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def stamp_of(text: str) -> int:
    """Nanoseconds of a time as uploads and the service write it."""
    seconds, _, fraction = text.rstrip("Z").partition(".")
    return calendar.timegm(time.strptime(seconds, "%Y-%m-%dT%H:%M:%S")) * 1_000_000_000 + int(f"{fraction:0<9}")
