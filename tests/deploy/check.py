"""Whether a real Prometheus understands deploy/, and finds what it asks for. See tests/deploy/run."""

import json
import pathlib
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request

MAPSHIFT = sys.argv[1]
DEPLOY = pathlib.Path("deploy")
# Nothing has been refused or called yet, and nothing is open.
MAY_BE_EMPTY = ["mapshift_limit_refusals_total", "mapshift_webhook_attempt_duration_seconds", "mapshift_open_alerts"]
BATCH = {
    "vehicle_id": "agv-07", "trip_id": "t",
    "lidar": {"angle_min": -3.0, "angle_increment": 0.78, "range_min": 0.05, "range_max": 20.0},
    "scans": [{"stamp": "2026-11-20T06:00:00Z", "odometry": {"x": 0, "y": 0, "theta": 0}, "ranges": [2.0] * 8}],
}


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def ask(url, method="GET", body=None, key=None):
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json", **({"Authorization": f"Bearer {key}"} if key else {})}
    with urllib.request.urlopen(urllib.request.Request(url, data, headers, method=method), timeout=30) as answer:
        return json.load(answer)


def make_key(data, name, role):
    command = [MAPSHIFT, "keys", "create", "--data", data, "--name", name, "--role", role]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def write_config(directory, key, target):
    config = (DEPLOY / "prometheus.yml").read_text()
    for old, new in [
        ("/run/secrets/prometheus_key", str(directory / "key")),
        ("prometheus.rules.yml", str((DEPLOY / "prometheus.rules.yml").resolve())),
        ("_interval: 15s", "_interval: 1s"),
        ("dns_sd_configs:", "static_configs:"),
        ("{names: [mapshift], type: A, port: 8080}", f'{{targets: ["{target}"]}}'),
    ]:
        if old not in config:
            sys.exit(f"FAILED: deploy/prometheus.yml has no {old}")
        config = config.replace(old, new)
    (directory / "key").write_text(key)
    (directory / "prometheus.yml").write_text(config)


def wait_for(what, ready):
    for _ in range(150):
        try:
            if ready():
                return
        except OSError:
            pass
        time.sleep(0.2)
    sys.exit(f"FAILED: {what}")


def queries():
    dashboard = json.loads((DEPLOY / "grafana" / "mapshift.json").read_text())
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            expr = target["expr"].replace("$instance", ".*").replace("$__rate_interval", "1m")
            yield panel["title"], expr


def check(directory, prometheus, target):
    def query(expr):
        return ask(f"{prometheus}/api/v1/query?{urllib.parse.urlencode({'query': expr})}")["data"]["result"]
    wait_for("Prometheus scrapes the service", lambda: query('up{job="mapshift"} == 1'))
    key = (directory / "admin").read_text().strip()
    ask(f"http://{target}/v1/routes/hall", "PUT", {}, key)
    for sequence in [0, 1]:
        ask(f"http://{target}/v1/routes/hall/batches/b-{sequence}", "PUT", {**BATCH, "sequence": sequence}, key)
    wait_for("the uploads are counted", lambda: query('rate(mapshift_uploads_total{outcome="stored"}[1m]) > 0'))
    wait_for("the requests are counted", lambda: query('rate(mapshift_http_requests_total{method="PUT"}[1m])'))

    groups = ask(f"{prometheus}/api/v1/rules")["data"]["groups"]
    rules = [rule for group in groups for rule in group["rules"]]
    wait_for("every rule is evaluated", lambda: all(
        rule["health"] == "ok" for group in ask(f"{prometheus}/api/v1/rules")["data"]["groups"] for rule in group["rules"]))
    firing = [alert["labels"]["alertname"] for alert in ask(f"{prometheus}/api/v1/alerts")["data"]["alerts"] if alert["state"] == "firing"]
    if firing:
        sys.exit(f"FAILED: a healthy service fires {firing}")
    empty, count = [], 0
    for title, expr in queries():
        count += 1
        if not query(expr) and not any(name in expr for name in MAY_BE_EMPTY):
            empty.append(f"{title}: {expr}")
    if empty:
        sys.exit("FAILED: these queries of the dashboard find nothing:\n" + "\n".join(empty))
    instance = query("mapshift_build_info")[0]["metric"]["instance"]
    if instance != "mapshift":
        sys.exit(f"FAILED: the instance is called {instance}")
    print(f"{len(rules)} rules and {count} queries of the dashboard are understood, and find what they ask for")


with tempfile.TemporaryDirectory() as name:
    directory = pathlib.Path(name)
    data = str(directory / "data")
    (directory / "admin").write_text(make_key(data, "Robin", "admin"))
    target, port = f"127.0.0.1:{free_port()}", free_port()
    write_config(directory, make_key(data, "prometheus", "viewer"), target)
    service = subprocess.Popen([MAPSHIFT, "serve", "--log", "off", "--listen", target, "--data", data], stdout=subprocess.DEVNULL)
    prometheus = subprocess.Popen(
        ["prometheus", f"--config.file={directory}/prometheus.yml", f"--storage.tsdb.path={directory}/tsdb",
         f"--web.listen-address=127.0.0.1:{port}", "--log.level=error"])
    try:
        check(directory, f"http://127.0.0.1:{port}", target)
    finally:
        for process in [prometheus, service]:
            process.terminate()
        for process in [prometheus, service]:
            process.wait(60)
