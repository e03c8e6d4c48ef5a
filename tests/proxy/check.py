"""What deploy/nginx.conf says, tried. See tests/proxy/run."""

import http.client
import http.server
import json
import os
import pathlib
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time

MAPSHIFT = sys.argv[1]
HOST = "maps.example.com"
BATCH = {
    "vehicle_id": "agv-07", "trip_id": "t", "sequence": 0,
    "lidar": {"angle_min": -3.0, "angle_increment": 0.78, "range_min": 0.05, "range_max": 20.0},
    "scans": [{"stamp": "2026-11-20T06:00:00Z", "odometry": {"x": 0, "y": 0, "theta": 0}, "ranges": [2.0] * 8}],
}


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def expect(what, found, wanted):
    if found != wanted:
        sys.exit(f"FAILED: {what}: {found!r} instead of {wanted!r}")
    print(f"ok: {what}")


class SignIn(http.server.BaseHTTPRequestHandler):
    """Stands in for oauth2-proxy: a cookie is a session of Kim."""

    def do_GET(self):
        signed_in = "_oauth2_proxy=kim" in self.headers.get("Cookie", "")
        self.send_response(202 if signed_in else 401)
        if signed_in:
            self.send_header("X-Auth-Request-Preferred-Username", "Kim")
            self.send_header("X-Auth-Request-Groups", "all,map-viewers")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


class Proxied:
    """mapshift, nginx and the stand-in, in a directory."""

    def __init__(self, directory):
        self.directory = directory
        self.people, self.machines, self.backend, self.sign_in = (free_port() for _ in range(4))
        key = subprocess.run(
            [MAPSHIFT, "keys", "create", "--data", directory / "data", "--name", "Robin", "--role", "admin"],
            check=True, capture_output=True, text=True).stdout
        self.key = key.strip()
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={HOST}",
             "-addext", f"subjectAltName=DNS:{HOST}", "-keyout", directory / "key.pem", "-out", directory / "cert.pem"],
            check=True, capture_output=True)
        stand_in = http.server.ThreadingHTTPServer(("127.0.0.1", self.sign_in), SignIn)
        threading.Thread(target=stand_in.serve_forever, daemon=True).start()
        self.config = self.write_config()
        self.service = self.start_service()
        command = ["nginx", "-p", str(directory), "-c", str(self.config), "-e", str(directory / "error.log")]
        subprocess.run([*command, "-t"], check=True, capture_output=True)
        self.nginx = subprocess.Popen([*command, "-g", "daemon off;"])

    def write_config(self):
        config = (pathlib.Path("deploy") / "nginx.conf").read_text()
        for old, new in [
            ("listen 443 ssl", f"listen 127.0.0.1:{self.people} ssl"),
            ("listen 8443 ssl", f"listen 127.0.0.1:{self.machines} ssl"),
            ("127.0.0.1:8080", f"127.0.0.1:{self.backend}"),
            ("127.0.0.1:4180", f"127.0.0.1:{self.sign_in}"),
            ("/etc/ssl/maps.example.com.pem", str(self.directory / "cert.pem")),
            ("/etc/ssl/private/maps.example.com.key", str(self.directory / "key.pem")),
        ]:
            if old not in config:
                sys.exit(f"FAILED: deploy/nginx.conf has no {old}")
            config = config.replace(old, new)
        temporary = "".join(f"{kind}_temp_path {self.directory}/{kind};" for kind in
                            ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"])
        path = self.directory / "nginx.conf"
        path.write_text(f"pid {self.directory}/nginx.pid; events {{}} http {{ access_log off; {temporary} {config} }}")
        return path

    def start_service(self):
        environment = {**os.environ, "MAPSHIFT_PUBLIC_URL": f"https://{HOST}", "MAPSHIFT_TRUSTED_PROXY": "127.0.0.1",
                       "MAPSHIFT_PROXY_ROLE": "map-viewers=viewer,map-keepers=maintainer,map-admins=admin",
                       "MAPSHIFT_ADDRESS_SHARE": "100"}
        service = subprocess.Popen(
            [MAPSHIFT, "serve", "--log", "off", "--listen", f"127.0.0.1:{self.backend}", "--data",
             str(self.directory / "data")], env=environment, stdout=subprocess.PIPE, text=True)
        service.stdout.readline()
        return service

    def connection(self, port):
        context = ssl.create_default_context(cafile=self.directory / "cert.pem")
        connection = http.client.HTTPSConnection("127.0.0.1", port, timeout=30, context=context)
        # The certificate is for the name.
        connection.sock = context.wrap_socket(socket.create_connection(("127.0.0.1", port), 30), server_hostname=HOST)
        return connection

    def ask(self, port, method, path, body=None, host=HOST, **headers):
        connection = self.connection(port)
        headers = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body=body, headers={"Host": host, **headers})
        answer = connection.getresponse()
        text = answer.read()
        connection.close()
        return answer.status, text

    def stop(self):
        for process in [self.nginx, self.service]:
            process.terminate()
        for process in [self.nginx, self.service]:
            process.wait(60)


def check_people(proxied):
    def ask(*args, **headers):
        return proxied.ask(proxied.people, *args, **headers)
    cookie = {"Cookie": "_oauth2_proxy=kim"}
    expect("who has not signed in is sent to do so", ask("GET", "/v1/routes")[0], 401)
    expect("who has may read", ask("GET", "/v1/routes", **cookie)[0], 200)
    session = json.loads(ask("GET", "/v1/session", **cookie)[1])
    expect("and is known by name and role", (session["name"], session["role"]), ("Kim", "viewer"))
    forged = {"X-Auth-Request-User": "root", "X-Auth-Request-Groups": "map-admins",
              "X-Forwarded-User": "root", "X-Forwarded-Groups": "map-admins",
              "Authorization": f"Bearer {proxied.key}"}
    session = json.loads(ask("GET", "/v1/session", **cookie, **forged)[1])
    expect("a forged identity is overwritten", (session["name"], session["role"]), ("Kim", "viewer"))
    expect("another name is none of the service's", ask("GET", "/v1/routes", host="evil.example", **cookie)[0], 421)
    put = ask("PUT", "/v1/routes/hall", "{}", **cookie, **{"Content-Type": "application/json"})
    expect("a viewer may not write", put[0], 403)


def check_stream(proxied):
    connection = proxied.connection(proxied.people)
    connection.request("GET", "/v1/alerts/stream", headers={"Host": HOST, "Cookie": "_oauth2_proxy=kim"})
    answer = connection.getresponse()
    kind = answer.getheader("Content-Type", "").split(";")[0]
    expect("the stream of events is open", (answer.status, kind), (200, "text/event-stream"))
    # A heartbeat, or whatever comes first: buffered it would not come before the stream ends.
    expect("and its first bytes come through", len(answer.read(1)), 1)
    connection.close()


def check_machines(proxied):
    key = {"Authorization": f"Bearer {proxied.key}", "Content-Type": "application/json"}

    def ask(*args, **headers):
        return proxied.ask(proxied.machines, *args, **headers)
    expect("a key makes a route", ask("PUT", "/v1/routes/hall", "{}", **key)[0], 201)
    expect("without one nothing is answered", ask("GET", "/v1/routes/hall")[0], 401)
    forged = ask("GET", "/v1/routes/hall", **{"X-Forwarded-User": "root", "X-Forwarded-Groups": "map-admins"})
    expect("a forged identity is removed", forged[0], 401)
    small = json.dumps(BATCH)
    expect("a batch is stored", ask("PUT", "/v1/routes/hall/batches/b-0", small, **key)[0], 202)
    large = json.dumps({**BATCH, "sequence": 1, "trip_id": "large"}) + " " * (15 << 20)
    expect("one of 15 MiB as well", ask("PUT", "/v1/routes/hall/batches/b-1", large, **key)[0], 202)
    try:
        status = ask("PUT", "/v1/routes/hall/batches/b-2", " " * (17 << 20), **key)[0]
    except (ConnectionError, ssl.SSLError):
        status = 413  # It was cut off before it was read.
    expect("one of 17 MiB is too large", status, 413)
    foreign = ask("PUT", "/v1/routes/yard", "{}", **key, Origin="https://evil.example")
    expect("a page of another origin may not write", foreign[0], 403)


def check_shutdown(proxied):
    """SIGTERM in the middle of an upload: it is finished, and what comes then is refused until the next start."""
    body = json.dumps({**BATCH, "trip_id": "slow"}).encode()
    connection = proxied.connection(proxied.machines)
    connection.putrequest("PUT", "/v1/routes/hall/batches/slow", skip_host=True)
    for name, value in [("Host", HOST), ("Authorization", f"Bearer {proxied.key}"),
                        ("Content-Type", "application/json"), ("Content-Length", str(len(body)))]:
        connection.putheader(name, value)
    connection.endheaders(body[:50])
    time.sleep(0.5)
    proxied.service.send_signal(signal.SIGTERM)
    time.sleep(0.5)
    connection.send(body[50:])
    expect("an upload under way is finished", connection.getresponse().status, 202)
    expect("the service ends in order", proxied.service.wait(60), 0)
    status = proxied.ask(proxied.machines, "GET", "/v1/routes")[0]
    expect("without it the proxy says so", status, 502)
    proxied.service = proxied.start_service()
    found = proxied.ask(proxied.machines, "GET", "/v1/routes/hall/batches?ids=slow,b-1", Authorization=f"Bearer {proxied.key}")
    expect("all of it is there after the next start", len(json.loads(found[1])["items"]), 2)


with tempfile.TemporaryDirectory() as name:
    # nginx's workers are another user.
    os.chmod(name, 0o755)
    proxied = Proxied(pathlib.Path(name))
    try:
        time.sleep(0.3)
        check_people(proxied)
        check_stream(proxied)
        check_machines(proxied)
        check_shutdown(proxied)
    finally:
        proxied.stop()
print("the proxy's configuration does what it says")
