"""Drives gateways through a bad line, kills them in between, and asks the service what it has.

usage: story.py SERVICE_BINARY SCRATCH NAME=COMMAND…, a command is called with: url route vehicle spool scans_per_batch
timeout_s first_wait_s, and reads messages from its standard input.
"""
from __future__ import annotations

import fcntl
import json
import re
import shlex
import struct
import subprocess
import sys
import termios
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any, Iterator

import room
from proxy import Proxy

SCANS, TRIP_AT, PER_BATCH = 220, 80, 8
KILLED_AT = (60, 150)
FAULT_SHARE, STALL_S, TIMEOUT_S, FIRST_WAIT_S = 0.4, 1.5, 1.0, 0.05
DONE_S = 45.0
Finding = list[str]


class Service:
    """A service on a free port, with data of its own."""

    def __init__(self, binary: str, data: Path) -> None:
        command = [binary, "serve", "--listen", "127.0.0.1:0", "--data", str(data)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self._process.stdout
        for line in self._process.stdout:
            if found := re.search(r"127\.0\.0\.1:(\d+)", line):
                self.port = int(found[1])
                break
        else:
            raise SystemExit("the service has not begun to listen")
        self._reader = threading.Thread(target=self._process.stdout.read, daemon=True)
        self._reader.start()

    def call(self, path: str, body: Any = None) -> Any:
        data, method = (None, "GET") if body is None else (json.dumps(body).encode(), "PUT")
        headers = {"Content-Type": "application/json"}
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}/v1/routes/{path}", data, headers, method=method)
        with urllib.request.urlopen(request, timeout=30) as answer:
            return json.load(answer)

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout
        self._process.stdout.close()


def read_so_far(process: subprocess.Popen[bytes]) -> None:
    """Waits until the gateway has read every message that it was given."""
    assert process.stdin
    unread = 1
    while unread and process.poll() is None:
        unread = struct.unpack("i", fcntl.ioctl(process.stdin, termios.FIONREAD, b"\0\0\0\0"))[0]
        time.sleep(0.2)


def drive(command: list[str], log: Path) -> Finding:
    """Gives a gateway all messages, and kills it twice."""
    scans, kills = 0, list(KILLED_AT)
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=output)
        for message in room.messages(SCANS, TRIP_AT):
            write(process, message)
            if "ranges" in message:
                scans += 1
                time.sleep(0.02)
            elif scans in kills and message["stamp_ns"] > room.stamp_ns(scans - 1):
                kills.remove(scans)
                read_so_far(process)
                process.kill()
                process.wait()
                process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=output)
        assert process.stdin
        process.stdin.close()
        try:
            code = process.wait(DONE_S)
            return [f"the gateway ended with {code}"] if code else []
        except subprocess.TimeoutExpired:
            process.kill()
            return [f"the gateway has not uploaded everything within {DONE_S:.0f} s"]


def write(process: subprocess.Popen[bytes], message: dict[str, Any]) -> None:
    assert process.stdin
    process.stdin.write(json.dumps(message).encode() + b"\n")
    process.stdin.flush()


def without_retries(url: str) -> None:
    """The control: a gateway that sends every batch once and keeps nothing."""
    odometry: dict[str, Any] = {}
    scans: list[dict[str, Any]] = []
    sequence = 0
    for message in room.messages(TRIP_AT, TRIP_AT):
        if "ranges" not in message:
            odometry = {axis: message[axis] for axis in ("x", "y", "theta")}
            continue
        scans.append({"stamp": room.stamp_text(message["stamp_ns"]), "odometry": odometry, "ranges": message["ranges"]})
        if len(scans) == PER_BATCH:
            head = {"vehicle_id": "control", "trip_id": "control", "sequence": sequence, "lidar": room.GEOMETRY}
            body = json.dumps({**head, "scans": scans}).encode()
            target = f"{url}/v1/routes/control/batches/control-{sequence}"
            request = urllib.request.Request(target, body, {"Content-Type": "application/json"}, method="PUT")
            try:
                urllib.request.urlopen(request, timeout=TIMEOUT_S).close()
            except OSError:
                pass
            sequence, scans = sequence + 1, []


def pages(service: Service, path: str) -> Iterator[dict[str, Any]]:
    cursor = ""
    while True:
        page = service.call(f"{path}?limit=100{cursor}")
        yield from page["items"]
        if page["next_cursor"] is None:
            return
        cursor = f"&cursor={page['next_cursor']}"


def check(service: Service, route: str, scans: int, trips: int) -> Finding:
    """What the service lacks, or has more than once."""
    deadline = time.monotonic() + DONE_S
    while service.call(route)["pending_batches"] and time.monotonic() < deadline:
        time.sleep(0.2)
    batches = list(pages(service, f"{route}/batches"))
    others = [batch for batch in batches if batch["status"] != "merged"]
    findings = [f"batch {batch['id']} is {batch['status']}: {batch['reason']}" for batch in others]
    sequences: dict[str, list[int]] = {}
    for batch in batches:
        sequences.setdefault(batch["trip_id"], []).append(batch["sequence"])
    if len(sequences) != trips:
        findings.append(f"{len(sequences)} trips, not {trips}")
    for trip, numbers in sequences.items():
        if sorted(numbers) != list(range(len(numbers))):
            findings.append(f"trip {trip} has the sequences {sorted(numbers)}")
    stamps = [alike(pose["stamp"]) for trip in sequences for pose in poses(service, route, trip)]
    wanted = [room.stamp_text(room.stamp_ns(k))[:-1] for k in range(scans)]
    if sorted(stamps) != wanted:
        missing = len(set(wanted) - set(stamps))
        findings.append(f"of {scans} scans {missing} are missing; there are {len(stamps)}, of which {len(set(stamps))} differ")
    print(f"  {route}: {len(batches)} batches, {len(stamps)} scans, {len(sequences)} trips")
    return findings


def poses(service: Service, route: str, trip: str) -> list[dict[str, Any]]:
    try:
        found: list[dict[str, Any]] = service.call(f"{route}/trajectories/{trip}?poses=all")["poses"]
        return found
    except urllib.error.HTTPError:
        return []


def alike(stamp: str) -> str:
    """The service leaves out zeros at the end."""
    seconds, _, fraction = stamp.rstrip("Z").partition(".")
    return f"{seconds}.{fraction:0<9}"


def left_in(spool: Path) -> Finding:
    left = [file for file in spool.rglob("*") if file.is_file() and file.name != "last-stored"]
    return [f"{file.relative_to(spool)} is left in the spool" for file in left]


def main(binary: str, scratch: Path, gateways: dict[str, list[str]]) -> int:
    service = Service(binary, scratch / "data")
    proxy = Proxy(service.port, FAULT_SHARE, STALL_S, seed=7)
    url = f"http://127.0.0.1:{proxy.port}"
    findings: dict[str, Finding] = {}

    def run(name: str, command: list[str]) -> None:
        rest = [url, name, f"agv-{name}", str(scratch / name), str(PER_BATCH), str(TIMEOUT_S), str(FIRST_WAIT_S)]
        findings[name] = drive([*command, *rest], scratch / f"{name}.log") + left_in(scratch / name)

    for route in [*gateways, "control"]:
        service.call(route, {})
    threads = [threading.Thread(target=run, args=one) for one in gateways.items()]
    threads.append(threading.Thread(target=without_retries, args=(url,)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for name in gateways:
        findings[name] += check(service, name, SCANS, trips=2)
    control = check(service, "control", TRIP_AT // PER_BATCH * PER_BATCH, trips=1)
    service.stop()

    print(f"  requests: {proxy.fates.total()}, of which {dict(sorted(proxy.fates.items()))}")
    print(f"  answers of the service: {dict(sorted(proxy.answers.items()))}; 200 is a batch that it had already")
    found_control = "; ".join(control)[:160]
    print(f"  control, as it should be: {found_control}" if control else "  CONTROL: nothing is found missing")
    for name, found in findings.items():
        for finding in found:
            print(f"  {name}: {finding}")
    repeated = proxy.answers[200] > 0
    return 0 if control and repeated and not any(findings.values()) else 1


if __name__ == "__main__":
    named = dict(argument.split("=", 1) for argument in sys.argv[3:])
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), {name: shlex.split(command) for name, command in named.items()}))
