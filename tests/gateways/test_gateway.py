"""Rules of the gateway that the story does not come across."""
from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import tempfile
import time
import unittest
from pathlib import Path
from typing import Callable
from unittest import mock

from mapshift_gateway import Gateway, Settings
from mapshift_odometry import Odometry, RecentOdometry
from mapshift_spool import Spool
from scripted import Reply, ScriptedService

LIDAR = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 10.0}
T0_NS = 1_764_000_000_000_000_000
REFUSED: Reply = (422, {}, '{"type":"/problems/scan-geometry","detail":"did you send degrees?"}')


def until(is_so: Callable[[], bool]) -> None:
    for _ in range(500):
        if is_so():
            return
        time.sleep(0.01)
    raise AssertionError("it does not come about")


class GatewayTest(unittest.TestCase):
    def setUp(self) -> None:
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.spool = Path(directory.name)
        self.log: list[str] = []

    def serve(self, *replies: Reply) -> ScriptedService:
        service = ScriptedService(*replies)
        self.addCleanup(service.close)
        return service

    def gateway(self, url: str, **settings: object) -> Gateway:
        made = Settings(url, "line", "agv", self.spool, first_wait_s=0.01, **settings)  # type: ignore[arg-type]
        gateway = Gateway(made, self.log.append)
        self.addCleanup(gateway.close)
        return gateway

    def drive(self, gateway: Gateway, scans: range, x: float = 0.0) -> None:
        for k in scans:
            gateway.on_scan(T0_NS + k * 100_000_000, LIDAR, [1.0, None])
            gateway.on_odometry(T0_NS + k * 100_000_000 + 50_000_000, x + 0.01 * k + 0.005, 0.0, 0.0)

    def left(self) -> list[str]:
        return sorted(str(file.relative_to(self.spool)) for file in self.spool.rglob("*") if file.is_file())

    def test_odometry_is_interpolated_or_shortly_before(self) -> None:
        recent = RecentOdometry()
        recent.add(Odometry(0, 0.0, 0.0, 3.1))
        recent.add(Odometry(100, 0.2, 0.0, -3.1))
        middle = recent.at(50)
        assert middle
        self.assertAlmostEqual(middle.x, 0.1)
        self.assertAlmostEqual(abs(middle.theta), 3.1416, places=3)
        self.assertEqual(recent.at(100 + 199_000_000), Odometry(100 + 199_000_000, 0.2, 0.0, -3.1))
        self.assertIsNone(recent.at(100 + 201_000_000))
        self.assertIsNone(recent.at(-1))

    def test_odometry_that_comes_late_or_twice_is_ignored(self) -> None:
        recent = RecentOdometry()
        for stamp_ns, x in [(0, 0.0), (1_000_000_000, 1.0), (1_000_000_000, 9.0), (500_000_000, 9.0)]:
            recent.add(Odometry(stamp_ns, x, 0.0, 0.0))
        self.assertEqual(recent.at(250_000_000), Odometry(250_000_000, 0.25, 0.0, 0.0))
        recent.add(Odometry(2_000_000_000, 2.0, 0.0, 0.0))
        recent.add(Odometry(900_000_000, 0.0, 0.0, 0.0))
        self.assertIsNone(recent.at(800_000_000))

    def test_the_same_bytes_are_sent_again_with_digest_and_key(self) -> None:
        busy: Reply = (503, {"Retry-After": "0"}, "")
        service = self.serve(busy, (408, {}, ""), (429, {}, ""), (302, {"Location": "/"}, ""), (507, {}, ""))
        with mock.patch.dict(os.environ, MAPSHIFT_KEY="ms_1_2"):
            gateway = self.gateway(service.url, scans_per_batch=3)
            self.drive(gateway, range(5))
            until(lambda: len(service.uploads) == 6)
        self.assertEqual(len({(name, wire) for name, wire, _ in service.uploads}), 1)
        _, wire, headers = service.uploads[0]
        digest = base64.b64encode(hashlib.sha256(wire).digest()).decode()
        self.assertEqual(headers["Content-Digest"], f"sha-256=:{digest}:")
        self.assertEqual(headers["Authorization"], "Bearer ms_1_2")
        until(lambda: "last-stored" in self.left())

    def test_a_key_may_have_a_line_feed_at_its_end(self) -> None:
        service = self.serve()
        with mock.patch.dict(os.environ, MAPSHIFT_KEY="ms_1_2\n"):
            self.drive(self.gateway(service.url, scans_per_batch=3), range(5))
            until(lambda: len(service.uploads) == 1)
        self.assertEqual(service.uploads[0][2]["Authorization"], "Bearer ms_1_2")

    def test_uploads_go_on_after_an_error_of_any_kind(self) -> None:
        service = self.serve()
        with mock.patch("mapshift_uploader.put", side_effect=[TypeError("of no kind that is known")]):
            self.drive(self.gateway(service.url, scans_per_batch=3), range(5))
            until(lambda: any("TypeError" in line for line in self.log))
        until(lambda: len(service.uploads) == 1)

    def test_a_damaged_file_is_refused_and_not_in_the_way(self) -> None:
        (self.spool / "a.scans").write_bytes(b"")
        service = self.serve((400, {}, "{}"))
        self.gateway(service.url)
        until(lambda: "refused/a.scans" in self.left())

    def test_retry_after_is_waited_for(self) -> None:
        service = self.serve((503, {"Retry-After": "1"}, ""))
        self.drive(self.gateway(service.url, scans_per_batch=3), range(5))
        until(lambda: any("again in 1." in line for line in self.log))

    def test_a_refused_batch_is_kept_with_the_problem_and_not_repeated(self) -> None:
        service = self.serve(REFUSED)
        gateway = self.gateway(service.url, scans_per_batch=3)
        self.drive(gateway, range(7))
        until(lambda: len(service.uploads) == 2)
        gateway.close()
        names = [name for name, _, _ in service.uploads]
        self.assertEqual(len(set(names)), 2)
        self.assertIn(f"refused/{names[0]}.scans", self.left())
        self.assertEqual((self.spool / "refused" / f"{names[0]}.problem.json").read_text(), REFUSED[2])

    def test_after_a_refusal_the_sequence_goes_on(self) -> None:
        service = self.serve(REFUSED)
        self.drive(first := self.gateway(service.url, scans_per_batch=3), range(7))
        until(lambda: len(service.uploads) == 2)
        first.close()
        second = self.gateway(service.url, scans_per_batch=3)
        self.drive(second, range(7, 14))
        second.close()
        until(lambda: not list(self.spool.glob("*.scans")) or not second._uploader._thread.is_alive())
        third = self.gateway(service.url)
        until(lambda: not list(self.spool.glob("*.scans")))
        third.close()
        batches = service.batches()
        self.assertEqual([batch["sequence"] for batch in batches], list(range(len(batches))))
        self.assertEqual(len({batch["trip_id"] for batch in batches}), 1)

    def test_a_jump_of_the_odometry_begins_a_trip(self) -> None:
        service = self.serve()
        gateway = self.gateway(service.url)
        self.drive(gateway, range(5))
        self.drive(gateway, range(5, 10), x=-7.0)
        gateway.complete_batch()
        until(lambda: len(service.uploads) == 2)
        batches = service.batches()
        self.assertEqual(len({batch["trip_id"] for batch in batches}), 2)
        self.assertEqual({batch["sequence"] for batch in batches}, {0})

    def test_a_full_spool_forgets_refused_batches_and_then_keeps_no_more(self) -> None:
        (self.spool / "refused").mkdir()
        (self.spool / "refused" / "old.scans").write_bytes(b"x" * 3_000)
        gateway = self.gateway("http://127.0.0.1:9", scans_per_batch=10, spool_bytes_max=2_000)
        self.drive(gateway, range(60))
        gateway.complete_batch()
        until(lambda: not list(self.spool.glob("*.open")))
        kept = [file for file in self.left() if file.endswith(".scans")]
        self.assertEqual([file[-12:] for file in kept], [f"{k:06}.scans" for k in range(len(kept))])
        self.assertTrue(0 < len(kept) < 6)
        self.assertFalse((self.spool / "refused" / "old.scans").exists())
        self.assertEqual(sum("spool is full" in line for line in self.log), 1)

    def test_a_line_cut_short_is_not_uploaded(self) -> None:
        head = b'{"vehicle_id":"agv","trip_id":"t","sequence":0,"lidar":{}}\n'
        (self.spool / "t-000000.open").write_bytes(head + b'{"stamp":"a"}\n{"stamp":"b"')
        (self.spool / "t-000001.open").write_bytes(head)
        service = self.serve()
        self.gateway(service.url)
        until(lambda: len(service.uploads) == 1)
        self.assertEqual(service.batches()[0]["scans"], [{"stamp": "a"}])
        until(lambda: self.left() == ["last-stored"])

    def test_after_a_damaged_batch_another_trip_begins(self) -> None:
        pose = {"x": 0.0, "y": 0.0, "theta": 0.0}
        scan = {"stamp": "2025-11-24T16:00:00.0Z", "odometry": pose, "ranges": [1.0, None]}
        head = {"vehicle_id": "agv", "trip_id": "agv-t", "sequence": 0, "lidar": LIDAR}
        (self.spool / "last-stored").write_text(f"{json.dumps(head)}\n{json.dumps(scan)}\n")
        damaged = self.spool / "agv-t-000001.scans"
        damaged.write_bytes(b"\0" * 100)
        gateway = self.gateway("http://127.0.0.1:9", scans_per_batch=3)
        self.drive(gateway, range(5))
        until(lambda: len(list(self.spool.glob("*.scans"))) == 2)
        self.assertEqual(damaged.read_bytes(), b"\0" * 100)
        [other] = set(self.spool.glob("*.scans")) - {damaged}
        self.assertTrue(other.name.endswith("-000000.scans"))
        self.assertFalse(other.name.startswith("agv-t-"))

    def test_a_batch_does_not_take_the_place_of_another(self) -> None:
        spool = Spool(self.spool, 1_000_000, self.log.append)
        self.addCleanup(spool.close)
        for taken in ("a.scans", "b.open", "refused/c.scans"):
            (self.spool / taken).write_text("kept")
            self.assertFalse(spool.begin(Path(taken).stem, {}))
            self.assertEqual((self.spool / taken).read_text(), "kept")
        self.assertTrue(spool.begin("d", {}))

    def test_a_batch_without_a_head_is_not_begun(self) -> None:
        spool = Spool(self.spool, 1_000_000, self.log.append)
        self.addCleanup(spool.close)
        with self.assertRaises(ValueError):
            spool.begin("a", {"range_max": math.inf})
        self.assertFalse(spool.is_open())
        self.assertEqual(self.left(), [])

    def test_what_is_not_finite_is_left_out(self) -> None:
        service = self.serve()
        gateway = self.gateway(service.url)
        gateway.on_odometry(T0_NS - 50_000_000, math.nan, 0.0, 0.0)
        gateway.on_scan(T0_NS - 40_000_000, {**LIDAR, "mount": {"x": math.inf}}, [1.0, None])
        gateway.on_scan(T0_NS - 30_000_000, LIDAR, [1.0, math.nan])
        self.assertEqual(sum("finite" in line for line in self.log), 3)
        self.drive(gateway, range(5))
        gateway.complete_batch()
        until(lambda: len(service.uploads) == 1)
        self.assertEqual(len(service.batches()[0]["scans"]), 4)  # all but the first, which has no odometry before it

    def test_a_clock_that_is_set_back_loses_hardly_a_scan(self) -> None:
        for lidars in [("",), ("front", "rear")]:
            for odometry_first in (True, False):
                with self.subTest(lidars=lidars, odometry_first=odometry_first):
                    self.spool = self.spool / "fresh"
                    self.check_clock_set_back(lidars, odometry_first)

    def check_clock_set_back(self, lidars: tuple[str, ...], odometry_first: bool) -> None:
        service = self.serve()
        gateway = self.gateway(service.url, lidars=lidars if len(lidars) > 1 else (), scans_per_batch=400)
        for k in range(160):
            at_ns = T0_NS + k * 100_000_000 - (3_600_000_000_000 if k >= 80 else 0)
            if odometry_first:
                gateway.on_odometry(at_ns - 10_000_000, 0.01 * k, 0.0, 0.0)
            for name in lidars:
                gateway.on_scan(at_ns, LIDAR, [1.0, None], name)
            if not odometry_first:
                gateway.on_odometry(at_ns - 10_000_000, 0.01 * k, 0.0, 0.0)
        gateway.complete_batch()
        until(lambda: not any(file.endswith((".open", ".scans")) for file in self.left()))
        batches = service.batches()
        self.assertEqual(len({batch["trip_id"] for batch in batches}), 2)
        self.assertGreaterEqual(sum(len(batch["scans"]) for batch in batches), 157 * len(lidars), self.log)

    def test_scans_of_several_lidars_are_put_in_order(self) -> None:
        service = self.serve()
        gateway = self.gateway(service.url, lidars=("front", "rear"))
        for k in range(20):
            at_ns = T0_NS + k * 100_000_000
            gateway.on_odometry(at_ns - 20_000_000, 0.01 * k, 0.0, 0.0)
            gateway.on_scan(at_ns, LIDAR, [1.0], "front")
            gateway.on_scan(at_ns - 10_000_000, LIDAR, [1.0], "rear")
        gateway.complete_batch()
        until(lambda: len(service.uploads) == 1)
        [batch] = service.batches()
        self.assertEqual([lidar["id"] for lidar in batch["lidars"]], ["front", "rear"])
        stamps = [scan["stamp"] for scan in batch["scans"]]
        self.assertEqual(stamps, sorted(stamps))
        self.assertEqual([scan["lidar"] for scan in batch["scans"][:3]], ["front", "rear", "front"])
        self.assertEqual(len(stamps), 39)  # all but a scan before the first one of the front lidar


if __name__ == "__main__":
    unittest.main()
