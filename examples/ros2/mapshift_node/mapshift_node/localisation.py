"""Where the service has a trip: by its map and its own matching, not by this vehicle's. Nothing of ROS is imported."""
from __future__ import annotations

import json
import math
import os
import threading
import urllib.error
import urllib.request
from typing import Any, Callable, NamedTuple

from mapshift_gateway import stamp_of

POLL_S = 2.0
TRIES = 300  # a trip that is not localised after ten minutes is given up


class Pose(NamedTuple):
    x: float
    y: float
    theta: float

    def then(self, other: Pose) -> Pose:
        c, s = math.cos(self.theta), math.sin(self.theta)
        x, y = self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y
        return Pose(x, y, math.remainder(self.theta + other.theta, math.tau))

    def inverse(self) -> Pose:
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose(-c * self.x - s * self.y, s * self.x - c * self.y, -self.theta)


class Localisation(NamedTuple):
    map_from_odom: Pose
    sigma: Pose  # of map_from_base, one standard deviation


class Localiser:
    """Waits, in a thread, until the first batch of a trip is in the map, and says once where it is."""

    def __init__(self, route_url: str, on_localised: Callable[[Localisation], None], log: Callable[[str], None],
                 poll_s: float = POLL_S) -> None:
        """`route_url` is …/v1/routes/{route}."""
        self._route_url, self._on_localised, self._log, self._poll_s = route_url, on_localised, log, poll_s
        self._trip = ""
        self._stop = threading.Event()

    def on_stored(self, batch_id: str, body: bytes) -> None:
        """For the gateway: called after each upload."""
        head = body[: body.index(b',"scans":')]
        batch = json.loads(head + b"}")
        if batch["sequence"] == 0:
            self._trip = batch["trip_id"]
            threading.Thread(target=self._localise, args=(batch_id, json.loads(body)), daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _localise(self, batch_id: str, batch: dict[str, Any]) -> None:
        for _ in range(TRIES):
            if self._stop.wait(self._poll_s) or self._trip != batch["trip_id"]:
                return
            try:
                status = self._get(f"batches/{batch_id}")["status"]
                if status == "merged":
                    return self._on_localised(self._of_trip(batch))
                if status in ("quarantined", "removed"):
                    return self._log(f"{batch_id} is {status}: its trip is not localised by it")
            except urllib.error.HTTPError as error:
                if 400 <= error.code < 500 and error.code not in (408, 429):
                    return self._log(f"the trip cannot be asked for: {error.code} {error.read().decode()}")
            except (OSError, ValueError, LookupError) as error:
                self._log(f"the trip cannot be asked for, again in {self._poll_s} s: {error!r}")
        self._log(f"{batch['trip_id']} is not localised: it is no longer asked for")

    def _of_trip(self, batch: dict[str, Any]) -> Localisation:
        """By the last keyframe of the trip's first batch: its pose in the map, and in the odometry frame.

        The service moves the stamps of a clock that it does not believe, as that of a simulation, all by as much: the
        first keyframe is the first scan, and times since then are compared.
        """
        scans, keyframes = batch["scans"], self._get(f"trajectories/{batch['trip_id']}")["poses"]
        moved_ns = stamp_of(keyframes[0]["stamp"]) - stamp_of(scans[0]["stamp"])
        odometry = {stamp_of(scan["stamp"]) + moved_ns: Pose(**scan["odometry"]) for scan in scans}
        keyframe = [pose for pose in keyframes if stamp_of(pose["stamp"]) in odometry][-1]
        sigma = self._get(f"nodes/{keyframe['node_id']}")["sigma"]
        odom_from_base = odometry[stamp_of(keyframe["stamp"])]
        map_from_odom = Pose(**keyframe["pose"]).then(odom_from_base.inverse())
        return Localisation(map_from_odom, Pose(**sigma) if sigma else Pose(0.0, 0.0, 0.0))

    def _get(self, path: str) -> Any:
        key = os.environ.get("MAPSHIFT_KEY", "").strip()
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        request = urllib.request.Request(f"{self._route_url}/{path}", headers=headers)
        with urllib.request.urlopen(request, timeout=10) as answer:
            return json.load(answer)
