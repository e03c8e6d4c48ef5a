"""Holds an exported recording to what the interface says of the route."""

import csv
import datetime
import json
import math
import sys
import urllib.request
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

url, route, recording, table = sys.argv[1:]


def get(path):
    with urllib.request.urlopen(url + path) as answer:
        return answer.read()


def items(path):
    cursor = ""
    while cursor is not None:
        page = json.loads(get(path + cursor))
        yield from page["items"]
        cursor = page["next_cursor"] and "&cursor=" + page["next_cursor"]


def nanoseconds(stamp):
    whole, _, rest = stamp.rstrip("Z").partition(".")
    seconds = datetime.datetime.fromisoformat(whole + "+00:00").timestamp()
    return int(seconds) * 10**9 + int(rest.ljust(9, "0") or 0)


def by_topic_mcap():
    found = {}
    with open(recording, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault((channel.topic, schema.name), []).append((message.log_time, decoded))
    counts = summary.statistics.channel_message_counts
    named = {summary.channels[k].topic: count for k, count in counts.items()}
    assert named == {topic: len(messages) for (topic, _), messages in found.items()}, named
    return found


def by_topic_rosbags():
    found = {}
    with AnyReader([Path(recording)]) as reader:
        for connection, time, raw in reader.messages():
            key = (connection.topic, connection.msgtype)
            found.setdefault(key, []).append((time, reader.deserialize(raw, connection.msgtype)))
    return found


def near(a, b):
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-6)


def check_grid(messages):
    [(_, grid)] = messages
    version = json.loads(get(f"/v1/routes/{route}"))["map_version"]
    head, pixels = get(f"/v1/routes/{route}/versions/{version}/map.pgm").split(b"\n255\n", 1)
    width, height = map(int, head.split()[1:])
    assert (grid.info.width, grid.info.height) == (width, height)
    rows = [pixels[k * width : (k + 1) * width] for k in range(height)]
    value = {0: 100, 254: 0, 205: -1}
    assert list(grid.data) == [value[grey] for row in reversed(rows) for grey in row]
    yaml = get(f"/v1/routes/{route}/versions/{version}/map.yaml").decode()
    origin = json.loads(yaml.split("origin: ")[1].split("\n")[0])
    at = grid.info.origin.position
    assert near(at.x, origin[0]) and near(at.y, origin[1]) and near(grid.info.resolution, 0.05)


def check_keyframes(transforms, scans):
    nodes = [node for node in items(f"/v1/routes/{route}/nodes?limit=1000") if node["localised"]]
    assert len(transforms) == len(scans) == len(nodes) > 0
    placed = {(time, m.transforms[0].child_frame_id): m.transforms for time, m in transforms}
    seen = {(time, m.header.frame_id): m for time, m in scans}
    for node in nodes:
        time = nanoseconds(node["stamp"])
        base, lidar = placed[(time, node["vehicle_id"] + "/base")]
        assert base.header.frame_id == "map"
        assert base.header.stamp.sec * 10**9 + base.header.stamp.nanosec == time
        at, turn = base.transform.translation, base.transform.rotation
        assert near(at.x, node["pose"]["x"]) and near(at.y, node["pose"]["y"])
        assert near(math.remainder(2 * math.atan2(turn.z, turn.w) - node["pose"]["theta"], math.tau), 0)
        assert lidar.header.frame_id == base.child_frame_id
        assert (time, lidar.child_frame_id) in seen
    for node in nodes[:: max(1, len(nodes) // 50)]:
        stored = json.loads(get(f"/v1/routes/{route}/nodes/{node['id']}/scan"))
        scan = seen[(nanoseconds(node["stamp"]), node["vehicle_id"] + "/lidar")]
        assert near(scan.angle_min, stored["lidar"]["angle_min"])
        assert near(scan.angle_increment, stored["lidar"]["angle_increment"])
        assert len(scan.ranges) == len(stored["ranges"])
        invalid = set(stored["invalid_beams"])
        for beam, (ours, theirs) in enumerate(zip(scan.ranges, stored["ranges"])):
            if beam in invalid:
                assert math.isnan(ours)
            else:
                assert math.isinf(ours) if theirs is None else near(ours, theirs)
    return len(nodes)


def check_alerts(messages):
    alerts = list(items(f"/v1/alerts?route_id={route}&limit=1000"))
    assert len(messages) == len(alerts) > 0
    shown = {}
    for time, message in messages:
        outline, title = message.markers
        shown[(time, title.text)] = [[corner.x, corner.y] for corner in outline.points]
    for alert in alerts:
        corners = shown[(nanoseconds(alert["first_seen"]), f"{alert['title']} ({alert['status']})")]
        region = alert["region"] + alert["region"][:1]
        assert len(corners) == len(region)
        for ours, theirs in zip(corners, region):
            assert near(ours[0], theirs[0]) and near(ours[1], theirs[1])
    with open(table, newline="", encoding="utf-8") as file:
        rows = {row["id"]: row for row in csv.DictReader(file)}
    assert len(rows) == len(alerts)
    for alert in alerts:
        row = rows[alert["id"]]
        assert (row["title"], row["summary"]) == (alert["title"], alert["summary"])
        assert near(float(row["x_m"]), alert["location"]["x"])
    return len(alerts)


for library, found in [("mcap", by_topic_mcap()), ("rosbags", by_topic_rosbags())]:
    check_grid(found[("/map", "nav_msgs/msg/OccupancyGrid")])
    keyframes = check_keyframes(
        found[("/tf", "tf2_msgs/msg/TFMessage")], found[("/scan", "sensor_msgs/msg/LaserScan")]
    )
    alerts = check_alerts(found[("/alerts", "visualization_msgs/msg/MarkerArray")])
    assert len(found) == 4
    print(f"{library}: the map, {keyframes} keyframes with their scans and {alerts} alerts are as the interface says")
