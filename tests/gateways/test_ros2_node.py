"""The ROS 2 node with recorded messages, over stand-ins for rclpy and the message classes (stand_ins/)."""
from __future__ import annotations

import math
import os
import tempfile
import time
import unittest
from pathlib import Path
from typing import Any, Optional
from unittest import mock

import rclpy.node
import room
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from mapshift_node.conversion import INVALID, Lidar, StaticFrames, Transform, transform, upload_range
from mapshift_node.localisation import Localisation, Localiser, Pose
from mapshift_node.node import MapshiftNode
from scripted import ScriptedService
from story import Service
from test_gateway import until

UPSIDE_DOWN = Quaternion(1.0, 0.0, 0.0, 0.0)
LEVEL = transform(Vector3(), Quaternion())


def time_of(stamp_ns: int) -> Time:
    return Time(stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000)


def turned(theta: float) -> Quaternion:
    return Quaternion(0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))


def scan_message(message: dict[str, Any], frame: str = "laser") -> LaserScan:
    """As a driver publishes it: no return is infinite."""
    lidar = message["lidar"]
    ranges = [math.inf if r is None else r for r in message["ranges"]]
    scan = LaserScan(angle_min=lidar["angle_min"], angle_increment=lidar["angle_increment"], ranges=ranges,
                     range_min=lidar["range_min"], range_max=lidar["range_max"])
    scan.header.stamp, scan.header.frame_id = time_of(message["stamp_ns"]), frame
    return scan


def odometry_message(message: dict[str, Any]) -> Odometry:
    odometry = Odometry(child_frame_id="base_link")
    odometry.header.stamp = time_of(message["stamp_ns"])
    odometry.pose.pose.position.x, odometry.pose.pose.position.y = message["x"], message["y"]
    odometry.pose.pose.orientation = turned(message["theta"])
    return odometry


def frame_message(
    parent: str, child: str, x: float, rotation: Optional[Quaternion] = None, stamp_ns: int = 0
) -> TFMessage:
    stamped = TransformStamped(child_frame_id=child)
    stamped.header.frame_id, stamped.header.stamp = parent, time_of(stamp_ns)
    stamped.transform.translation.x = x
    stamped.transform.rotation = rotation or Quaternion()
    return TFMessage([stamped])


class ConversionTest(unittest.TestCase):
    def test_ranges_are_what_rep_117_says(self) -> None:
        pairs = [(math.inf, None), (8.1, None), (8.0, 8.0), (1.23456, 1.235), (0.1, 0.1), (0.05, INVALID),
                 (0.0, INVALID), (-0.003, INVALID), (-math.inf, INVALID), (math.nan, INVALID)]
        for measured, sent in pairs:
            self.assertEqual(upload_range(measured, 0.1, 8.0), sent, measured)

    def test_what_was_not_measured_is_below_range_min_even_if_that_is_0(self) -> None:
        lidar = Lidar(LaserScan(angle_increment=0.1, range_max=8.0, ranges=[math.nan]), LEVEL)
        self.assertGreater(lidar.geometry["range_min"], INVALID)

    def test_mounts_are_found_through_the_static_frames(self) -> None:
        frames = StaticFrames()
        frames.add("base_footprint", "base_link", transform(Vector3(0.0, 0.0, 0.1), Quaternion()))
        frames.add("base_link", "/tower", transform(Vector3(0.2, 0.0, 0.0), turned(math.pi / 2)))
        frames.add("tower", "laser", transform(Vector3(0.1, 0.0, 0.0), Quaternion()))
        mount = frames.between("base_footprint", "laser")
        assert mount
        self.assertAlmostEqual(mount.translation[0], 0.2)
        self.assertAlmostEqual(mount.translation[1], 0.1)
        back = frames.between("laser", "base_footprint")
        assert back
        self.assertAlmostEqual(back.then(mount).translation[1], 0.0)
        self.assertIsNone(frames.between("base_footprint", "camera"))

    def directions(self, first: LaserScan, mount: Transform) -> list[tuple[float, Optional[float]]]:
        """Where each range lies as seen from the base, by what is uploaded."""
        lidar = Lidar(first, mount)
        stated = lidar.geometry
        self.assertGreater(stated["angle_increment"], 0)
        turns = [stated["mount"]["theta"] + stated["angle_min"] + k * stated["angle_increment"] for k in range(3)]
        return sorted((round(turn, 6), r) for turn, r in zip(turns, lidar.ranges(first)))

    def test_beams_point_where_they_did(self) -> None:
        forward = LaserScan(angle_min=-0.1, angle_increment=0.3, range_max=8.0, ranges=[1.0, 2.0, 3.0])
        backward = LaserScan(angle_min=0.5, angle_increment=-0.3, range_max=8.0, ranges=[3.0, 2.0, 1.0])
        upright, hanging = transform(Vector3(), turned(0.4)), transform(Vector3(), UPSIDE_DOWN)
        self.assertEqual(self.directions(forward, upright), [(0.3, 1.0), (0.6, 2.0), (0.9, 3.0)])
        self.assertEqual(self.directions(backward, upright), [(0.3, 1.0), (0.6, 2.0), (0.9, 3.0)])
        self.assertEqual(self.directions(forward, hanging), [(-0.5, 3.0), (-0.2, 2.0), (0.1, 1.0)])
        self.assertEqual(self.directions(backward, hanging), [(-0.5, 3.0), (-0.2, 2.0), (0.1, 1.0)])
        with self.assertRaises(ValueError):
            Lidar(forward, transform(Vector3(), Quaternion(0.0, 0.5, 0.0, 0.866)))

    def test_a_driver_with_a_beam_more_or_less_keeps_its_geometry(self) -> None:
        first = LaserScan(angle_increment=0.1, range_max=8.0, ranges=[1.0, 2.0, 3.0, 4.0], scan_time=0.1)
        lidar = Lidar(first, LEVEL)
        shorter = LaserScan(angle_increment=0.1, range_max=8.0, ranges=[1.0, 2.0, 3.0], scan_time=0.11)
        wider = LaserScan(angle_increment=0.15, range_max=8.0, ranges=[1.0, 2.5, 4.0])
        self.assertEqual(lidar.ranges(shorter), [1.0, 2.0, 3.0, INVALID])
        self.assertEqual(lidar.ranges(wider), [1.0, 2.5, 2.5, 4.0])
        self.assertEqual(lidar.geometry["scan_time"], 0.1)


class LocaliserTest(unittest.TestCase):
    def test_stamps_that_the_service_has_moved_are_those_of_the_batch(self) -> None:
        scans = [{"stamp": f"1970-01-01T00:00:0{k}.5Z", "odometry": Pose(k, 0.0, 0.0)._asdict()} for k in range(4)]
        batch = {"trip_id": "t", "scans": scans}
        keyframes = [{"stamp": f"2026-11-24T12:00:0{k}Z", "node_id": str(k), "pose": Pose(k + 7.0, 0.0, 0.0)._asdict()}
                     for k in (0, 2, 5)]
        answers: dict[str, Any] = {"batches/t-0": {"status": "merged"}, "nodes/2": {"sigma": None}}
        poses = iter([[], keyframes])  # at first there is none
        found: list[Localisation] = []
        log: list[str] = []
        localiser = Localiser("http://127.0.0.1:9", found.append, log.append, poll_s=0.01)
        self.addCleanup(localiser.stop)
        localiser._trip = "t"
        with mock.patch.object(localiser, "_get", lambda path: answers.get(path) or {"poses": next(poses)}):
            localiser._localise("t-0", batch)
        self.assertEqual([localisation.map_from_odom for localisation in found], [Pose(7.0, 0.0, 0.0)])
        self.assertEqual(["IndexError" in line for line in log], [True])


class NodeTest(unittest.TestCase):
    def setUp(self) -> None:
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.scratch = Path(directory.name)

    def node(self, url: str, **parameters: Any) -> MapshiftNode:
        rclpy.node.overrides = {"url": url, "route": "ros", "spool": str(self.scratch / "spool"), "scans_per_batch": 10,
                                **parameters}
        node = MapshiftNode()
        self.addCleanup(node.close)
        return node

    def give(self, node: MapshiftNode, topic: str, message: Any) -> None:
        kind, callback, _ = node.subscribed[topic]
        self.assertIsInstance(message, kind)
        callback(message)

    def scripted(self) -> ScriptedService:
        service = ScriptedService()
        self.addCleanup(service.close)
        return service

    def drive(self, node: MapshiftNode, scans: int, begun_ns: int = room.START_NS) -> None:
        for message in room.messages(scans, scans):
            message["stamp_ns"] += begun_ns - room.START_NS
            if "ranges" in message:
                self.give(node, "/scan", scan_message(message))
            else:
                self.give(node, "/odom", odometry_message(message))

    def test_quality_of_service_is_that_of_sensors_and_static_frames(self) -> None:
        node = self.node(self.scripted().url)
        self.assertEqual(node.subscribed["/scan"][2].reliability, ReliabilityPolicy.BEST_EFFORT)
        self.assertEqual(node.subscribed["/odom"][2].reliability, ReliabilityPolicy.BEST_EFFORT)
        self.assertEqual(node.subscribed["/tf_static"][2].durability, DurabilityPolicy.TRANSIENT_LOCAL)
        self.assertNotIn("/initialpose", node.publishers)

    def test_scans_wait_for_the_mount(self) -> None:
        service = self.scripted()
        node = self.node(service.url)
        self.drive(node, 3)
        self.assertTrue(any("/tf_static does not lead" in line for line in node.get_logger().lines))
        self.give(node, "/tf_static", frame_message("base_link", "laser", 0.1))
        self.drive(node, 11)
        until(lambda: len(service.uploads) == 1)
        [batch] = service.batches()
        self.assertEqual(batch["lidar"]["mount"], {"x": 0.1, "y": 0.0, "theta": 0.0})
        self.assertEqual([len(batch["scans"]), len(batch["scans"][0]["ranges"])], [10, room.BEAMS])

    def test_odometry_from_tf_and_two_lidars(self) -> None:
        service = self.scripted()
        node = self.node(service.url, odometry_from_tf=True, scan_topics=["/front/scan", "/rear/scan"])
        self.give(node, "/tf_static", frame_message("base_link", "front_laser", 0.3))
        self.give(node, "/tf_static", frame_message("base_link", "rear_laser", -0.3, turned(math.pi)))
        for message in room.messages(12, 12):
            if "ranges" in message:
                self.give(node, "/rear/scan", scan_message(message, "rear_laser"))
                self.give(node, "/front/scan", scan_message(message, "front_laser"))
            else:
                frames = frame_message("odom", "base_link", message["x"], turned(message["theta"]), message["stamp_ns"])
                self.give(node, "/tf", frames)
        until(lambda: len(service.uploads) > 0)
        batch = service.batches()[0]
        self.assertEqual([lidar["id"] for lidar in batch["lidars"]], ["front_scan", "rear_scan"])
        self.assertEqual([lidar["mount"]["x"] for lidar in batch["lidars"]], [0.3, -0.3])

    def test_refused_batches_are_in_the_diagnostics(self) -> None:
        service = self.scripted()
        service.replies = [(422, {}, "{}")]
        node = self.node(service.url)
        self.give(node, "/tf_static", frame_message("base_link", "laser", 0.1))
        self.drive(node, 11)
        until(lambda: any((self.scratch / "spool" / "refused").glob("*.scans")))
        node.timers[0]()
        [message] = node.publishers["/diagnostics"].published
        self.assertEqual(message.status[0].level, b"\x02")

    def test_a_batch_that_waits_for_long_is_in_the_diagnostics(self) -> None:
        node = self.node("http://127.0.0.1:9")
        waiting = self.scratch / "spool" / "a.scans"
        for age_s, level in [(0.0, b"\x00"), (600.0, b"\x01")]:
            waiting.write_text("{}\n")
            os.utime(waiting, (time.time() - age_s,) * 2)
            node.timers[0]()
            self.assertEqual(node.publishers["/diagnostics"].published[-1].status[0].level, level)

    def test_messages_that_are_not_finite_do_not_end_the_node(self) -> None:
        service = self.scripted()
        node = self.node(service.url, scan_topics=["/scan", "/broken"])
        self.give(node, "/tf_static", frame_message("base_link", "laser", 0.1))
        first = next(message for message in room.messages(1, 1) if "ranges" in message)
        endless = scan_message(first)
        endless.range_max = math.inf
        self.give(node, "/broken", endless)
        self.assertTrue(any("/broken is not used" in line for line in node.get_logger().lines))
        self.drive(node, 1)
        self.give(node, "/odom", odometry_message({"stamp_ns": room.START_NS, "x": math.nan, "y": 0.0, "theta": 0.0}))
        crooked = scan_message(first)
        crooked.angle_min = math.nan
        self.give(node, "/scan", crooked)
        self.assertTrue(any("a scan of /scan is left out" in line for line in node.get_logger().lines))
        self.drive(node, 15)
        until(lambda: len(service.uploads) == 1)

    @unittest.skipUnless("MAPSHIFT_BINARY" in os.environ, "MAPSHIFT_BINARY is not set")
    def test_the_service_says_where_the_vehicle_is(self) -> None:
        for clock, begun_ns in [("real", room.START_NS), ("simulated", 5_000_000_000)]:
            with self.subTest(clock=clock):
                self.check_where_the_vehicle_is(clock, begun_ns)

    def check_where_the_vehicle_is(self, clock: str, begun_ns: int) -> None:
        service = Service(os.environ["MAPSHIFT_BINARY"], self.scratch / f"data-{clock}")
        self.addCleanup(service.stop)
        service.call("ros", {})
        spool = str(self.scratch / f"spool-{clock}")
        node = self.node(f"http://127.0.0.1:{service.port}", publish_initial_pose=True, spool=spool)
        self.give(node, "/tf_static", frame_message("base_link", "laser", 0.1))
        scans = 25
        self.drive(node, scans, begun_ns)
        until(lambda: bool(node.publishers["/initialpose"].published))
        [message] = node.publishers["/initialpose"].published
        # The first trip of a route defines the map: it begins where the trip did, at the first scan.
        truth = room.in_odometry(room.true_pose(0), room.true_pose(scans - 1 + 0.3))
        self.assertEqual(message.header.frame_id, "map")
        pose = message.pose.pose
        self.assertLess(math.hypot(pose.position.x - truth[0], pose.position.y - truth[1]), 0.1)
        heading = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
        self.assertLess(abs(math.remainder(heading - truth[2], math.tau)), 0.05)
        self.assertGreaterEqual(message.pose.covariance[0], 0.05**2 - 1e-12)


if __name__ == "__main__":
    unittest.main()
