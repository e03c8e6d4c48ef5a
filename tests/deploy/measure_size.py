"""How many bytes of disk a lidar's scans take: python3 tests/deploy/measure_size.py MAPSHIFT (needs numpy).

Drives a hall of 40 × 25 m with racks and columns in laps and uploads what a lidar sees, with 1 cm of noise,
rounded to millimetres. What the database holds is read after the first lap and after the last, so that
what is stored only once does not count. docs/reference/sizing.md has the results.
"""

import json
import math
import pathlib
import sqlite3
import subprocess
import sys
import tempfile
import time
import urllib.request

import numpy as np

MAPSHIFT, LAPS = sys.argv[1], 3
#        beams, Hz, m/s
KINDS = [(360, 5, 0.5), (360, 5, 1.0), (720, 10, 1.0), (720, 10, 1.5), (1440, 15, 1.0), (1440, 15, 1.5)]
RANGE_MAX = 25.0


def boxes(corners):
    for x, y, w, h in corners:
        a, b, c, d = (x, y), (x + w, y), (x + w, y + h), (x, y + h)
        yield from [(a, b), (b, c), (c, d), (d, a)]


def hall():
    generator = np.random.default_rng(7)
    racks = [(x, y, 6.0, 1.2) for x in (5, 14, 23, 32) for y in (5.5, 9.0, 14.0, 18.0)]
    clutter = [(*generator.uniform([0.5, 0.5], [39, 24]), *generator.uniform(0.2, 0.9, 2)) for _ in range(60)]
    clutter = [c for c in clutter if min(abs(c[1] - 3), abs(c[1] - 22), abs(c[0] - 3), abs(c[0] - 38.7)) > 1.6]
    return np.array(list(boxes([(0, 0, 40, 25), *racks, *clutter])))


def lap(step_m):
    """Poses along a rectangle with rounded corners, so many metres apart."""
    low, high, r = np.array([3.0, 3.0]), np.array([38.7, 22.0]), 1.5
    points = []
    for corner, start in [((high[0] - r, low[1] + r), -90), ((high[0] - r, high[1] - r), 0),
                          ((low[0] + r, high[1] - r), 90), ((low[0] + r, low[1] + r), 180)]:
        angles = np.radians(np.linspace(start, start + 90, 20))
        points += [(corner[0] + r * math.cos(a), corner[1] + r * math.sin(a)) for a in angles]
    points = np.array([*points, points[0]])
    way = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(0, way[-1], step_m)
    x, y = (np.interp(at, way, points[:, k]) for k in (0, 1))
    ahead = [np.interp((at + 0.2) % way[-1], way, points[:, k]) for k in (0, 1)]
    return np.stack([x, y, np.arctan2(ahead[1] - y, ahead[0] - x)], axis=1)


def ranges(walls, pose, beams, generator):
    angles = pose[2] - math.pi + np.arange(beams) * 2 * math.pi / beams
    d = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None, :]
    a, e = walls[None, :, 0] - pose[:2], walls[None, :, 1] - walls[None, :, 0]
    cross = d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a[..., 0] * e[..., 1] - a[..., 1] * e[..., 0]) / cross
        u = (a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0]) / cross
    t = np.where((t > 0) & (u >= 0) & (u <= 1), t, np.inf).min(axis=1)
    t = t + generator.normal(0, 0.01, beams)
    return [round(float(v), 3) if 0.05 < v < RANGE_MAX else None for v in t]


def batches(beams, hz, speed, laps):
    """A batch of 100 scans after the other, and after which of them a lap ends."""
    walls, generator = hall(), np.random.default_rng(1)
    poses = lap(speed / hz)
    scans, sequence = [], 0
    for number in range(laps * len(poses)):
        pose = poses[number % len(poses)] + generator.normal(0, [0.02, 0.02, 0.002])
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(1_795_000_000 + number / hz))
        scans.append({"stamp": f"{stamp}.{int(number % hz * 1000 / hz):03}Z", "ranges": ranges(walls, pose, beams, generator),
                      "odometry": dict(zip("x y theta".split(), (round(float(v), 4) for v in pose)))})
        ends_lap = (number + 1) % len(poses) == 0
        if len(scans) == 100 or ends_lap:
            yield sequence, ends_lap, {
                "vehicle_id": "agv-07", "trip_id": f"lap-{number // len(poses)}", "sequence": sequence, "scans": scans,
                "lidar": {"angle_min": -math.pi, "angle_increment": 2 * math.pi / beams, "range_min": 0.05, "range_max": RANGE_MAX}}
            scans, sequence = [], 0 if ends_lap else sequence + 1


def request(method, url, body=None):
    data = json.dumps(body).encode() if body is not None else None
    asked = urllib.request.Request(url, data=data, method=method, headers={"Content-Type": "application/json"})
    with urllib.request.urlopen(asked, timeout=120) as answer:
        return json.load(answer)


def held_bytes(data):
    """What the database holds: all of it, and the bodies of uploads."""
    database = sqlite3.connect(f"file:{data}/mapshift.db?mode=ro", uri=True)
    pages, free, size = (database.execute(f"PRAGMA {what}").fetchone()[0] for what in ("page_count", "freelist_count", "page_size"))
    bodies = database.execute("SELECT sum(length(body)) FROM batch_bodies").fetchone()[0]
    database.close()
    return (pages - free) * size, bodies


def measure(beams, hz, speed, data):
    service = subprocess.Popen([MAPSHIFT, "serve", "--log", "off", "--listen", "127.0.0.1:0", "--data", data], stdout=subprocess.PIPE, text=True)
    url = next(word for word in service.stdout.readline().replace(",", " ").split() if word.startswith("http"))
    try:
        route = f"{url}/v1/routes/hall"
        request("PUT", route, {})
        marks, scans = [], 0
        for sequence, ends_lap, batch in batches(beams, hz, speed, LAPS):
            request("PUT", f"{route}/batches/{batch['trip_id']}-{sequence}", batch)
            scans += len(batch["scans"])
            if ends_lap:
                while request("GET", route)["pending_batches"]:
                    time.sleep(0.2)
                marks.append((scans, *held_bytes(data)))
        counts = request("GET", route)["counts"]
    finally:
        service.terminate()
        service.wait(60)
    (first, all_first, bodies_first), (last, all_last, bodies_last) = marks[0], marks[-1]
    count = last - first
    per_scan, body = (all_last - all_first) / count, (bodies_last - bodies_first) / count
    hour_mb = 3600 * hz * per_scan / 1e6
    print(f"{beams} beams, {hz} Hz, {speed} m/s: {per_scan:.0f} bytes a scan, of that {body:.0f} of uploads; "
          f"{hour_mb:.0f} MB an hour; {counts['nodes']} nodes, {scans} scans, first lap {all_first / 1e6:.1f} MB", flush=True)


for kind in KINDS:
    with tempfile.TemporaryDirectory() as directory:
        measure(*kind, str(pathlib.Path(directory) / "data"))
