"""The node: laser scans and odometry in, batches to the service, /initialpose and /diagnostics out.

Its callbacks convert messages and hand them to the gateway, which uploads in threads of its own.
"""
from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path
from typing import Optional

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from mapshift_gateway import Gateway, Settings, is_finite
from mapshift_node.conversion import Lidar, StaticFrames, heading, nanoseconds, transform
from mapshift_node.localisation import Localisation, Localiser, Pose

DIAGNOSE_EVERY_S = 5.0
WAITS_LONG_S = 180.0
SIGMA_MIN = Pose(0.05, 0.05, 0.02)  # localisation on board must be free to search a little
LATCHED = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class MapshiftNode(Node):
    def __init__(self) -> None:
        super().__init__("mapshift_node")
        topics: list[str] = list(self.declare_parameter("scan_topics", ["/scan"]).value)
        self._base_frame: str = self.declare_parameter("base_frame", "base_link").value
        self._odom_frame: str = self.declare_parameter("odom_frame", "odom").value
        settings = Settings(
            url=self.declare_parameter("url", "http://127.0.0.1:8080").value,
            route=self.declare_parameter("route", "line-4").value,
            vehicle=self.declare_parameter("vehicle_id", "agv-07").value,
            spool=Path(self.declare_parameter("spool", "/var/lib/mapshift/spool").value),
            lidars=tuple(map(lidar_name, topics)) if len(topics) > 1 else (),
            scans_per_batch=self.declare_parameter("scans_per_batch", 60).value,
            seconds_per_batch=self.declare_parameter("seconds_per_batch", 10.0).value,
            spool_bytes_max=self.declare_parameter("spool_bytes_max", 2 << 30).value,
        )
        self._spool, self._has_several = settings.spool, len(topics) > 1
        self._frames, self._lidars = StaticFrames(), dict[str, Optional[Lidar]]()
        self._latest: Optional[tuple[Time, Pose]] = None
        self._localiser = self._make_localiser(settings)
        on_stored = self._localiser.on_stored if self._localiser else lambda batch_id, body: None
        self._gateway = Gateway(settings, self.get_logger().warning, on_stored)

        self.create_subscription(TFMessage, "/tf_static", self._on_tf_static, LATCHED)
        for topic in topics:
            self.create_subscription(LaserScan, topic, partial(self._on_scan, topic), qos_profile_sensor_data)
        if self.declare_parameter("odometry_from_tf", False).value:
            self.create_subscription(TFMessage, "/tf", self._on_tf, QoSProfile(depth=100))
        else:
            topic = self.declare_parameter("odometry_topic", "/odom").value
            self.create_subscription(Odometry, topic, self._on_odometry, qos_profile_sensor_data)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(DIAGNOSE_EVERY_S, self._diagnose)

    def close(self) -> None:
        if self._localiser:
            self._localiser.stop()
        self._gateway.close()

    def _make_localiser(self, settings: Settings) -> Optional[Localiser]:
        if not self.declare_parameter("publish_initial_pose", False).value:
            return None
        self._initial_pose = self.create_publisher(PoseWithCovarianceStamped, "/initialpose", 1)
        route_url = f"{settings.url.rstrip('/')}/v1/routes/{settings.route}"
        return Localiser(route_url, self._on_localised, self.get_logger().warning)

    def _on_tf_static(self, message: TFMessage) -> None:
        for stamped in message.transforms:
            parent_from_child = transform(stamped.transform.translation, stamped.transform.rotation)
            self._frames.add(stamped.header.frame_id, stamped.child_frame_id, parent_from_child)

    def _on_scan(self, topic: str, scan: LaserScan) -> None:
        lidar = self._lidar(topic, scan)
        if lidar:
            name = lidar_name(topic) if self._has_several else ""
            try:
                ranges = lidar.ranges(scan)
            except (ArithmeticError, ValueError) as error:  # angles that are not finite, or do not increase
                self.get_logger().warning(f"a scan of {topic} is left out: {error!r}")
                return
            self._gateway.on_scan(nanoseconds(scan.header.stamp), lidar.geometry, ranges, name)

    def _lidar(self, topic: str, scan: LaserScan) -> Optional[Lidar]:
        """Known from the first scan after its mount; None as long as there is none, or if it cannot be used."""
        if topic in self._lidars:
            return self._lidars[topic]
        mount = self._frames.between(self._base_frame, scan.header.frame_id)
        if mount is None:
            text = f"{topic} waits: /tf_static does not lead from {self._base_frame} to {scan.header.frame_id}"
            self.get_logger().warning(text, throttle_duration_sec=10.0)
            return None
        try:
            self._lidars[topic] = Lidar(scan, mount)
        except ValueError as error:
            self.get_logger().error(f"{topic} is not used: {error}")
            self._lidars[topic] = None
        return self._lidars[topic]

    def _on_odometry(self, message: Odometry) -> None:
        if message.child_frame_id and message.child_frame_id.lstrip("/") != self._base_frame:
            self.get_logger().error(
                f"the odometry is that of {message.child_frame_id}, mounts are those on {self._base_frame}: "
                "set base_frame", throttle_duration_sec=10.0)
        pose = message.pose.pose
        self._take_odometry(message.header.stamp, Pose(pose.position.x, pose.position.y, heading(pose.orientation)))

    def _on_tf(self, message: TFMessage) -> None:
        for stamped in message.transforms:
            frames = (stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/"))
            if frames == (self._odom_frame, self._base_frame):
                at = stamped.transform.translation
                self._take_odometry(stamped.header.stamp, Pose(at.x, at.y, heading(stamped.transform.rotation)))

    def _take_odometry(self, stamp: Time, odom_from_base: Pose) -> None:
        if is_finite(odom_from_base):
            self._latest = (stamp, odom_from_base)
        self._gateway.on_odometry(nanoseconds(stamp), *odom_from_base)

    def _on_localised(self, found: Localisation) -> None:
        """Where the vehicle is by now: it has gone on since the scans of the batch were taken."""
        if self._latest is None:
            return
        stamp, odom_from_base = self._latest
        at = found.map_from_odom.then(odom_from_base)
        message = PoseWithCovarianceStamped()
        message.header.stamp, message.header.frame_id = stamp, "map"
        pose = message.pose.pose
        pose.position.x, pose.position.y = at.x, at.y
        pose.orientation.z, pose.orientation.w = math.sin(at.theta / 2), math.cos(at.theta / 2)
        covariance = [0.0] * 36  # of x, y, z and the turns about them, row by row
        for place, sigma, least in zip((0, 7, 35), found.sigma, SIGMA_MIN):
            covariance[place] = max(sigma, least) ** 2
        message.pose.covariance = covariance
        self._initial_pose.publish(message)
        self.get_logger().info(f"the service has the vehicle at {at.x:.2f}, {at.y:.2f} m, {at.theta:.2f} rad")

    def _diagnose(self) -> None:
        waiting = list(self._spool.glob("*.scans"))
        waited_s = max(map(age_s, waiting), default=0.0)
        refused = len(list(self._spool.glob("refused/*.scans")))
        status = DiagnosticStatus()
        status.name, status.hardware_id = "mapshift: uploads", "mapshift_node"
        status.level, status.message = DiagnosticStatus.OK, "uploading"
        if refused:
            status.level = DiagnosticStatus.ERROR
            status.message = f"{refused} batches were refused: see {self._spool}/refused"
        elif waited_s > WAITS_LONG_S:
            status.level = DiagnosticStatus.WARN
            status.message = f"the oldest batch has waited for {waited_s / 60:.0f} minutes: see the log"
        status.values = [KeyValue(key="waiting", value=str(len(waiting))), KeyValue(key="refused", value=str(refused))]
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        message.status = [status]
        self._diagnostics.publish(message)


def age_s(batch: Path) -> float:
    try:
        return time.time() - batch.stat().st_mtime
    except FileNotFoundError:  # uploaded just now
        return 0.0


def lidar_name(topic: str) -> str:
    return topic.strip("/").replace("/", "_")


def main() -> None:
    rclpy.init()
    node = MapshiftNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
