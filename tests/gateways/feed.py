"""The Python gateway with messages from standard input, a JSON object a line, instead of callbacks."""
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "gateway"))
from mapshift_gateway import Gateway, Settings  # noqa: E402


def main(url: str, route: str, vehicle: str, spool: str, *numbers: str) -> None:
    scans_per_batch, timeout_s, first_wait_s = map(float, numbers)
    settings = Settings(url, route, vehicle, Path(spool), scans_per_batch=int(scans_per_batch),
                        timeout_s=timeout_s, first_wait_s=first_wait_s)
    gateway = Gateway(settings, log=lambda text: print(text, file=sys.stderr))
    for line in sys.stdin:
        message = json.loads(line)
        if "ranges" in message:
            gateway.on_scan(message["stamp_ns"], message["lidar"], message["ranges"])
        else:
            gateway.on_odometry(**message)
    gateway.complete_batch()
    while any(settings.spool.glob("*.open")) or any(settings.spool.glob("*.scans")):
        time.sleep(0.05)
    gateway.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
