"""Rules of the gateway in C++ that the story does not come across. MAPSHIFT_GATEWAY_CPP is its program."""
from __future__ import annotations

import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any, Optional

from scripted import Reply, ScriptedService

LIDAR = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 10.0}
T0_NS = 1_764_000_000_000_000_000
HOUR_NS = 3_600_000_000_000


def scan(stamp_ns: int) -> dict[str, Any]:
    return {"stamp_ns": stamp_ns, "lidar": LIDAR, "ranges": [1.0, None]}


def odometry(stamp_ns: int, x: float) -> dict[str, Any]:
    return {"stamp_ns": stamp_ns, "x": x, "y": 0.0, "theta": 0.0}


@unittest.skipUnless("MAPSHIFT_GATEWAY_CPP" in os.environ, "MAPSHIFT_GATEWAY_CPP is not set")
class GatewayCppTest(unittest.TestCase):
    def setUp(self) -> None:
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.spool = Path(directory.name)

    def run_gateway(
        self, messages: list[dict[str, Any]], *replies: Reply, key: Optional[str] = None
    ) -> ScriptedService:
        """To its end, at which everything is uploaded."""
        service = ScriptedService(*replies)
        self.addCleanup(service.close)
        command = [os.environ["MAPSHIFT_GATEWAY_CPP"], service.url, "line", "agv", str(self.spool), "400", "5", "0.01"]
        lines = "".join(json.dumps(message) + "\n" for message in messages)
        environment = {**os.environ, **({"MAPSHIFT_KEY": key} if key else {})}
        subprocess.run(command, input=lines, text=True, check=True, timeout=30, stderr=subprocess.DEVNULL,
                       env=environment)
        return service

    def drive(self, scans: range) -> list[dict[str, Any]]:
        stamps = [(k, T0_NS + k * 100_000_000) for k in scans]
        pairs = [(odometry(at_ns - 10_000_000, 0.01 * k), scan(at_ns)) for k, at_ns in stamps]
        return [message for pair in pairs for message in pair]

    def write_batch(self, name: str, sequence: int, end: str) -> None:
        head = {"vehicle_id": "agv", "trip_id": "agv-t", "sequence": sequence, "lidar": LIDAR}
        stamp = f"2025-11-24T15:59:59.{sequence}00000000Z"
        line = {"stamp": stamp, "odometry": {"x": 0.0, "y": 0.0, "theta": 0.0}, "ranges": [1.0, None]}
        (self.spool / name).write_text(f"{json.dumps(head)}\n{json.dumps(line)}\n{end}")

    def test_a_trip_goes_on_after_a_line_cut_short(self) -> None:
        self.write_batch("last-stored", 3, "")
        self.write_batch("agv-t-000004.scans", 4, '{"stamp":"2025')
        service = self.run_gateway(self.drive(range(5)))
        self.assertEqual([name for name, _, _ in service.uploads], ["agv-t-000004", "agv-t-000005"])

    def test_after_a_damaged_batch_another_trip_begins(self) -> None:
        self.write_batch("last-stored", 3, "")
        self.write_batch("agv-t-000004.scans", 4, "damaged\n")
        (self.spool / "agv-t-000005.scans").write_bytes(b"")
        service = self.run_gateway(self.drive(range(5)), (400, {}, "{}"), (400, {}, "{}"))
        names = [name for name, _, _ in service.uploads]
        self.assertEqual(len(set(names)), 3)
        [other] = set(names) - {"agv-t-000004", "agv-t-000005"}
        self.assertFalse(other.startswith("agv-t-"))

    def test_a_clock_that_is_set_back_loses_hardly_a_scan(self) -> None:
        for odometry_first in (True, False):
            with self.subTest(odometry_first=odometry_first):
                messages = []
                for k in range(1_600):  # odometry comes ten times as often as scans
                    at_ns = T0_NS + k * 10_000_000 - (HOUR_NS if k > 800 else 0)  # as a scan waits
                    scans = [scan(at_ns)] if k % 10 == 0 else []
                    pose = [odometry(at_ns - 5_000_000, 0.001 * k)]
                    messages += pose + scans if odometry_first else scans + pose
                batches = self.run_gateway(messages).batches()
                self.assertEqual(len(batches), 2)
                self.assertGreaterEqual(sum(len(batch["scans"]) for batch in batches), 157)

    def test_odometry_that_comes_late_or_twice_is_ignored(self) -> None:
        late = [odometry(T0_NS + 390_000_000, 9.0), odometry(T0_NS + 200_000_000, 9.0)]
        [batch] = self.run_gateway(self.drive(range(5)) + late + self.drive(range(5, 10))).batches()
        self.assertEqual(len(batch["scans"]), 10)
        self.assertLess(max(scan["odometry"]["x"] for scan in batch["scans"]), 1.0)

    def test_a_key_may_have_a_line_feed_at_its_end(self) -> None:
        service = self.run_gateway(self.drive(range(5)), key="ms_1_2\n")
        self.assertEqual(service.uploads[0][2]["Authorization"], "Bearer ms_1_2")


if __name__ == "__main__":
    unittest.main()
