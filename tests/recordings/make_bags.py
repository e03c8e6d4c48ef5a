"""Writes the recordings that the tests read, with libraries that share nothing with the service.

    pip install rosbags mcap lz4 zstandard numpy
    python make_bags.py

Each recording is a drive through a small room with what a public robot records: the topics, types and
frames of a TurtleBot 3, of a TurtleBot 4, of a vehicle with two lidars, and Foxglove's JSON messages. Beside
each stands the batch that says the same in the service's own JSON, with poses that are computed here.
"""

import datetime
import json
import math
import shutil
from pathlib import Path

import numpy
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START_S = 1_790_000_000
# Corners of the room, counter-clockwise, and a pillar in it.
ROOM = [(-3.0, -2.5), (4.5, -2.5), (4.5, 3.0), (1.0, 3.0), (1.0, 3.8), (-3.0, 3.8)]
PILLAR = [(2.0, 1.0), (2.5, 1.0), (2.5, 1.6), (2.0, 1.6)]
WALLS = [list(zip(ring, ring[1:] + ring[:1])) for ring in (ROOM, PILLAR)]
WALLS = [wall for ring in WALLS for wall in ring]
SCANS = 30
SCAN_HZ = 5.0
ODOMETRY_HZ = 10.0


def compose(a, b):
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return (a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], wrap(a[2] + b[2]))


def wrap(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


def true_pose(t):
    """Where the base is: a slow arc that turns past a half turn."""
    turn = 2.4 + 0.25 * t
    return (0.8 * math.cos(turn), 0.8 * math.sin(turn), wrap(turn + math.pi / 2))


def ray(x, y, heading):
    """The range to the nearest wall, rounded to 0.1 mm."""
    dx, dy = math.cos(heading), math.sin(heading)
    best = math.inf
    for (ax, ay), (bx, by) in WALLS:
        ex, ey = bx - ax, by - ay
        across = dx * ey - dy * ex
        if abs(across) < 1e-12:
            continue
        along = ((ax - x) * ey - (ay - y) * ex) / across
        at = ((ax - x) * dy - (ay - y) * dx) / across
        if along > 0 and 0 <= at <= 1:
            best = min(best, along)
    return round(best, 4)


class Lidar:
    """A lidar whose mount is (x, y, yaw); one upside down has its beams the other way round."""

    def __init__(self, mount, beams, angle_min, increment, range_max, upside_down=False):
        self.mount, self.beams = mount, beams
        self.angle_min, self.increment = numpy.float32(angle_min), numpy.float32(increment)
        self.range_min, self.range_max = 0.12, range_max
        self.sign = -1.0 if upside_down else 1.0

    def angles(self):
        return [float(self.angle_min) + k * float(self.increment) for k in range(self.beams)]

    def ranges(self, t, number):
        """As the driver publishes them: with zeros, infinities and values beyond the limits."""
        x, y, yaw = compose(true_pose(t), self.mount)
        ranges = [ray(x, y, yaw + self.sign * angle) for angle in self.angles()]
        ranges[(3 * number) % self.beams] = math.inf
        ranges[(3 * number + 1) % self.beams] = 0.0
        ranges[(3 * number + 2) % self.beams] = math.nan
        return [r if r <= self.range_max or r == math.inf else self.range_max + 1.0 for r in ranges]

    def sent(self, ranges):
        """As the service takes them, counter-clockwise: null for no return, 0 for invalid."""
        sent = [None if r > self.range_max else (r if r >= self.range_min else 0.0) for r in ranges]
        return sent if self.sign * float(self.increment) > 0 else sent[::-1]

    def json(self, times=None):
        first, step = float(self.angle_min) * self.sign, float(self.increment) * self.sign
        if step < 0:
            first, step = first + (self.beams - 1) * step, -step
        lidar = {"angle_min": first, "angle_increment": step, "range_min": self.range_min,
                 "range_max": self.range_max,
                 "mount": dict(zip(("x", "y", "theta"), self.mount)), "range_sigma": 0.01}
        return lidar | (times or {})


def stamps():
    """Scans are not taken when odometry is: their poses lie between its samples."""
    scans = [k / SCAN_HZ + 0.013 for k in range(SCANS)]
    odometry = [k / ODOMETRY_HZ for k in range(int(SCANS / SCAN_HZ * ODOMETRY_HZ) + 2)]
    return scans, odometry


def interpolated(t, odometry):
    """The pose between two samples of the odometry, the short way round."""
    after = next(k for k, at in enumerate(odometry) if at >= t)
    t0, t1 = odometry[after - 1], odometry[after]
    a, b, share = true_pose(t0), true_pose(t1), (t - t0) / (t1 - t0)
    turn = wrap(b[2] - a[2])
    return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), wrap(a[2] + share * turn))


def nanoseconds(t):
    return START_S * 1_000_000_000 + round(t * 1e9)


def rfc3339(t):
    ns = nanoseconds(t)
    day = datetime.datetime.fromtimestamp(ns // 1_000_000_000, datetime.timezone.utc)
    return day.strftime("%Y-%m-%dT%H:%M:%S") + f".{ns % 1_000_000_000:09d}Z"


def time_of(t):
    ns = nanoseconds(t)
    return T["builtin_interfaces/msg/Time"](sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def header(t, frame):
    return T["std_msgs/msg/Header"](stamp=time_of(t), frame_id=frame)


def quaternion(yaw, upside_down=False):
    make = T["geometry_msgs/msg/Quaternion"]
    if upside_down:  # yaw after half a turn about x
        return make(x=math.cos(yaw / 2), y=math.sin(yaw / 2), z=0.0, w=0.0)
    return make(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def transform(t, parent, child, x, y, z, rotation):
    make = T["geometry_msgs/msg/Transform"]
    vector = T["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)
    return T["geometry_msgs/msg/TransformStamped"](
        header=header(t, parent), child_frame_id=child,
        transform=make(translation=vector, rotation=rotation))


def transforms(*list_of):
    return T["tf2_msgs/msg/TFMessage"](transforms=list(list_of))


def odometry_message(t, child):
    x, y, yaw = true_pose(t)
    pose = T["geometry_msgs/msg/Pose"](
        position=T["geometry_msgs/msg/Point"](x=x, y=y, z=0.0), orientation=quaternion(yaw))
    zero = T["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    twist = T["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    covariance = numpy.zeros(36)
    return T["nav_msgs/msg/Odometry"](
        header=header(t, "odom"), child_frame_id=child,
        pose=T["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
        twist=T["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance))


def scan_message(t, frame, lidar, ranges, time_increment=0.0, scan_time=0.0):
    return T["sensor_msgs/msg/LaserScan"](
        header=header(t, frame), angle_min=lidar.angle_min,
        angle_max=numpy.float32(lidar.angles()[-1]), angle_increment=lidar.increment,
        time_increment=time_increment, scan_time=scan_time, range_min=lidar.range_min,
        range_max=lidar.range_max, ranges=numpy.array(ranges, dtype=numpy.float32),
        intensities=numpy.zeros(0, dtype=numpy.float32))


def odometry_transform(t, child):
    x, y, yaw = true_pose(t)
    return transforms(transform(t, "odom", child, x, y, 0.0, quaternion(yaw)))


def write_expected(name, lidars, scans):
    body = {"vehicle_id": "agv-07", "trip_id": name, "sequence": 0} | lidars | {"scans": scans}
    (HERE / f"{name}.json").write_text(json.dumps(body, separators=(",", ":")) + "\n")


def scan_json(t, odometry, lidar, ranges, name=None):
    pose = dict(zip(("x", "y", "theta"), interpolated(t, odometry)))
    scan = {"stamp": rfc3339(t), "odometry": pose, "ranges": lidar.sent(ranges)}
    return scan if name is None else {"lidar": name} | scan


def write_bag(name, messages, zstd):
    """`messages`: (time of recording, topic, type, message)."""
    folder = HERE / "bag" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(exist_ok=True)
    bag = BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if zstd:
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag:
        connections = {}
        for t, topic, kind, message in sorted(messages, key=lambda m: m[0]):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(connections[topic], nanoseconds(t), STORE.serialize_cdr(message, kind))
    shutil.copy(folder / f"{name}.mcap", HERE / f"{name}.mcap")
    shutil.rmtree(HERE / "bag")


SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TF, TEXT = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"


def turtlebot3():
    lidar = Lidar((-0.032, 0.0, 0.0), 120, 0.0, 2 * math.pi / 120, 3.5)
    scans, odometry = stamps()
    level = quaternion(0.0)
    static = transforms(
        transform(0.0, "base_footprint", "base_link", 0.0, 0.0, 0.01, level),
        transform(0.0, "base_link", "base_scan", -0.032, 0.0, 0.172, level))
    messages = [(0.0, "/tf_static", TF, static)]
    for t in odometry:
        messages.append((t, "/odom", ODOMETRY, odometry_message(t, "base_footprint")))
        messages.append((t, "/tf", TF, odometry_transform(t, "base_footprint")))
    expected = []
    for number, t in enumerate(scans):
        ranges = lidar.ranges(t, number)
        messages.append((t + 0.03, "/scan", SCAN, scan_message(t, "base_scan", lidar, ranges)))
        expected.append(scan_json(t, odometry, lidar, ranges))
    # Before the odometry begins, and of another topic.
    messages.append((-0.4, "/scan", SCAN, scan_message(-0.5, "base_scan", lidar, lidar.ranges(0.0, 0))))
    messages.append((1.0, "/rosout", TEXT, T[TEXT](data="not asked for")))
    write_bag("turtlebot3", messages, zstd=False)
    write_expected("turtlebot3", {"lidar": lidar.json()}, expected)


def turtlebot4():
    """Its lidar is turned by a quarter turn; it states how long a sweep takes."""
    lidar = Lidar((-0.04, 0.0, 1.570796), 120, -math.pi, 2 * math.pi / 120, 12.0)
    scans, odometry = stamps()
    level = quaternion(0.0)
    static = transforms(
        transform(0.0, "base_link", "shell_link", 0.0, 0.0, 0.0942, level),
        transform(0.0, "shell_link", "rplidar_link", -0.04, 0.0, 0.0987, quaternion(1.570796)))
    messages = [(0.0, "/tf_static", TF, static)]
    for t in odometry:
        messages.append((t, "/odom", ODOMETRY, odometry_message(t, "base_link")))
        messages.append((t, "/tf", TF, odometry_transform(t, "base_link")))
    expected = []
    for number, t in enumerate(scans):
        ranges = lidar.ranges(t, number)
        scan = scan_message(t, "rplidar_link", lidar, ranges, time_increment=0.0008, scan_time=0.1)
        messages.append((t + 0.11, "/scan", SCAN, scan))
        expected.append(scan_json(t, odometry, lidar, ranges))
    write_bag("turtlebot4", messages, zstd=True)
    times = {"time_increment": 0.0008, "scan_time": 0.1}
    write_expected("turtlebot4", {"lidar": lidar.json(times)}, expected)


def amr():
    """Two lidars at opposite corners, the rear one upside down; odometry as transforms alone; lz4."""
    front = Lidar((0.4, 0.3, 0.785398), 90, -2.3, 4.6 / 89, 10.0)
    rear = Lidar((-0.4, -0.3, -2.356194), 90, -2.3, 4.6 / 89, 10.0, upside_down=True)
    scans, odometry = stamps()
    scans = scans[:20]
    static = transforms(
        transform(0.0, "amr1/base_link", "amr1/front_laser", 0.4, 0.3, 0.2, quaternion(0.785398)),
        transform(0.0, "amr1/base_link", "amr1/rear_laser", -0.4, -0.3, 0.2,
                  quaternion(-2.356194, upside_down=True)))
    messages = [(0.0, "/tf_static", TF, static)]
    for t in odometry:
        messages.append((t, "/tf", TF, transforms(transform(
            t, "amr1/odom", "amr1/base_link", *true_pose(t)[:2], 0.0, quaternion(true_pose(t)[2])))))
    expected = []
    for number, t in enumerate(scans):
        # The rear lidar's driver is slower: its scans are recorded after later ones of the front.
        for name, lidar, at, delay in (("front", front, t, 0.01), ("rear", rear, t + 0.05, 0.25)):
            ranges = lidar.ranges(at, number)
            message = scan_message(at, f"amr1/{name}_laser", lidar, ranges)
            messages.append((at + delay, f"/{name}/scan", SCAN, message))
            expected.append(scan_json(at, odometry, lidar, ranges, name))
    with (HERE / "amr.mcap").open("wb") as file:
        writer = McapWriter(file, chunk_size=8192, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        channels = {}
        for t, topic, kind, message in sorted(messages, key=lambda m: m[0]):
            if topic not in channels:
                definition, _ = STORE.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, "ros2msg", definition.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(message, kind))
            writer.add_message(channels[topic], nanoseconds(t), data, nanoseconds(t))
        writer.finish()
    lidars = [{"id": "front"} | front.json(), {"id": "rear"} | rear.json()]
    write_expected("amr", {"lidars": lidars}, expected)


def foxglove():
    """JSON, in small chunks: the scan's pose in its frame, and the odometry as poses."""
    lidar = Lidar((0.1, -0.05, 0.3), 60, -1.5, 3.0 / 59, 8.0)
    scans, odometry = stamps()
    scans = scans[:20]

    def time(t):
        ns = nanoseconds(t)
        return {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}

    def rotation(yaw):
        return {"x": 0, "y": 0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}

    def pose(x, y, yaw):
        return {"position": {"x": x, "y": y, "z": 0}, "orientation": rotation(yaw)}

    messages = [(0.0, "/tf", "foxglove.FrameTransform", {
        "timestamp": time(0.0), "parent_frame_id": "base_link", "child_frame_id": "mast",
        "translation": {"x": 0.1, "y": 0, "z": 1}, "rotation": rotation(0.0)})]
    for t in odometry:
        message = {"timestamp": time(t), "frame_id": "odom", "pose": pose(*true_pose(t))}
        messages.append((t, "/pose", "foxglove.PoseInFrame", message))
    expected, longest = [], 0.0
    for number, t in enumerate(scans):
        ranges = [r if r <= 8.0 else None for r in lidar.ranges(t, number)]
        ranges = [None if r is None or math.isnan(r) else r for r in ranges]
        longest = max(longest, *(r for r in ranges if r is not None))
        message = {"timestamp": time(t), "frame_id": "mast", "pose": pose(0.0, -0.05, 0.3),
                   "start_angle": float(lidar.angle_min), "end_angle": lidar.angles()[-1],
                   "ranges": ranges, "intensities": []}
        messages.append((t + 0.01, "/scan", "foxglove.LaserScan", message))
        scan = scan_json(t, odometry, lidar, [math.inf if r is None else r for r in ranges])
        scan["ranges"] = ranges
        expected.append(scan)
    with (HERE / "foxglove.mcap").open("wb") as file:
        writer = McapWriter(file, chunk_size=16384)
        writer.start()
        channels = {}
        for t, topic, kind, message in sorted(messages, key=lambda m: m[0]):
            if topic not in channels:
                schema = writer.register_schema(kind, "jsonschema", b'{"type":"object"}')
                channels[topic] = writer.register_channel(topic, "json", schema)
            data = json.dumps(message, separators=(",", ":")).encode()
            writer.add_message(channels[topic], nanoseconds(t), data, nanoseconds(t))
        writer.finish()
    geometry = lidar.json() | {"range_min": 0.001, "range_max": math.ceil(longest * 10) / 10 + 0.1}
    write_expected("foxglove", {"lidar": geometry}, expected)


def small():
    """What the mutations of tests/decoders.rs begin with: without checksums, which would find each of them."""
    lidar = Lidar((0.2, 0.0, 0.0), 6, -1.0, 0.4, 8.0)
    level = quaternion(0.0)
    frames = transforms(transform(0.0, "base_link", "laser", 0.2, 0.0, 0.2, level))
    messages = [(0.0, "/tf_static", TF, frames)]
    for t in (0.0, 0.4, 0.8):
        messages.append((t, "/tf", TF, odometry_transform(t, "base_link")))
    for number, t in enumerate((0.1, 0.3, 0.5)):
        scan = scan_message(t, "laser", lidar, lidar.ranges(t, number), time_increment=0.01)
        messages.append((t, "/scan", SCAN, scan))
    folder = HERE.parent / "fuzz" / "corpus" / "mcap"
    folder.mkdir(exist_ok=True)
    for compression in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
        with (folder / f"{compression.name.lower()}.mcap").open("wb") as file:
            write_small(file, compression, messages)


def write_small(file, compression, messages):
    writer = McapWriter(file, chunk_size=1024, compression=compression, enable_crcs=False)
    writer.start(profile="ros2")
    channels = {}
    for t, topic, kind, message in sorted(messages, key=lambda m: m[0]):
        if topic not in channels:
            schema = writer.register_schema(kind, "ros2msg", b"")
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        data = bytes(STORE.serialize_cdr(message, kind))
        writer.add_message(channels[topic], nanoseconds(t), data, nanoseconds(t))
    writer.finish()


if __name__ == "__main__":
    for make in (turtlebot3, turtlebot4, amr, foxglove, small):
        make()
