"""The half of a gateway that faces the service: uploads the batches of a spool until the service has stored them.

A batch is a file `NAME.scans`: a line with the fields of the upload but its scans, and a line for each scan.
docs/how-to/write-a-gateway.md has the rules. Python 3.10 or newer, standard library only.
"""
from __future__ import annotations

import base64
import contextlib
import gzip
import hashlib
import http.client
import os
import random
import threading
import urllib.parse
from pathlib import Path
from typing import Callable, NamedTuple, Optional

WAIT_MAX_S = 300.0
DAMAGED = "/problems/digest-mismatch"  # other bytes arrived than were sent: the one 400 that is worth a repeat


class Answer(NamedTuple):
    status: int  # 0 if none came whole
    text: str
    retry_after_s: Optional[float] = None

    def is_stored(self) -> bool:
        return self.status in (200, 202)

    def is_refusal(self) -> bool:
        return 400 <= self.status < 500 and self.status not in (408, 429) and DAMAGED not in self.text


def body_of(batch: Path) -> bytes:
    """The upload. Nothing is read as JSON and written anew, so a repeat has the same bytes, also after an update."""
    lines = batch.read_bytes().split(b"\n")[:-1]  # what follows the last line feed was not written to its end
    head, *scans = lines or [b""]  # of a damaged file, which the service refuses
    return head[:-1] + b',"scans":[' + b",".join(scans) + b"]}"


def put(url: str, body: bytes, timeout_s: float) -> Answer:
    """One attempt."""
    compressed = gzip.compress(body, mtime=0)
    digest = base64.b64encode(hashlib.sha256(compressed).digest()).decode()
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip", "Content-Digest": f"sha-256=:{digest}:"}
    if key := os.environ.get("MAPSHIFT_KEY", "").strip():
        headers["Authorization"] = f"Bearer {key}"
    address = urllib.parse.urlsplit(url)
    kind = http.client.HTTPSConnection if address.scheme == "https" else http.client.HTTPConnection
    connection = kind(address.netloc, timeout=timeout_s)
    try:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # refused before the body came whole: read why
            connection.request("PUT", address.path, compressed, headers)
        answer = connection.getresponse()
        after = answer.getheader("Retry-After", "")
        return Answer(answer.status, answer.read().decode(errors="replace"), float(after) if after.isdigit() else None)
    except (OSError, http.client.HTTPException) as error:  # of an answer that is cut short, too
        return Answer(0, repr(error))
    finally:
        connection.close()


class Uploader:
    """A thread that uploads one batch at a time, in the order of their names."""

    def __init__(self, url: str, spool: Path, timeout_s: float = 60.0, first_wait_s: float = 1.0,
                 log: Callable[[str], None] = print,
                 on_stored: Callable[[str, bytes], None] = lambda batch_id, body: None) -> None:
        """`url` is …/v1/routes/{route}/batches; `on_stored` gets name and body, in this thread, and must not raise."""
        self._url, self._spool, self._refused = url, spool, spool / "refused"
        self._timeout_s, self._first_wait_s, self._log, self._on_stored = timeout_s, first_wait_s, log, on_stored
        self._refused.mkdir(parents=True, exist_ok=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mapshift-uploader", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread after the attempt that is under way; what is not stored stays in the spool."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        failures = 0
        while not self._stop.is_set():
            batch = min(self._spool.glob("*.scans"), default=None)
            if batch is None:
                self._stop.wait(0.5)
                continue
            try:
                answer = self._attempt(batch)
            except Exception as error:  # a full disk, a lost mount, what cannot be foreseen: the thread goes on
                answer = Answer(0, repr(error))
            if answer.is_stored() or answer.is_refusal():
                failures = 0
            else:
                wait_s = self._wait_s(failures, answer.retry_after_s)
                self._log(f"{batch.stem}: {answer.status} {answer.text[:200].strip()}; again in {wait_s:.1f} s")
                failures += 1
                self._stop.wait(wait_s)

    def _attempt(self, batch: Path) -> Answer:
        body = body_of(batch)
        answer = put(f"{self._url}/{batch.stem}", body, self._timeout_s)
        if answer.is_stored():
            os.replace(batch, self._spool / "last-stored")  # forgotten, but for where its trip goes on
            self._on_stored(batch.stem, body)
        elif answer.is_refusal():
            self._log(f"{batch.stem} was refused: {answer.status} {answer.text}")
            (self._refused / f"{batch.stem}.problem.json").write_text(answer.text)
            os.replace(batch, self._refused / batch.name)
        return answer

    def _wait_s(self, failures: int, stated_s: Optional[float]) -> float:
        """What the service states and up to a quarter more; else twice as long each time, of which half is random."""
        if stated_s is not None:
            return stated_s * random.uniform(1.0, 1.25)
        return float(min(self._first_wait_s * 2 ** min(failures, 20), WAIT_MAX_S)) * random.uniform(0.5, 1.0)
