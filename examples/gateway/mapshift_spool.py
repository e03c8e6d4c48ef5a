"""The files between a gateway's callbacks and its uploader.

`NAME.open` is a batch that is being collected, `NAME.scans` one that is complete and waits for the service,
`last-stored` the one that was stored last, `refused/` has what the service will not take. The first line of a batch has
the fields of the upload but its scans, each further line is a scan. Python 3.10 or newer, standard library only.
"""
from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
from pathlib import Path
from typing import IO, Any, Callable, Optional


class Spool:
    """A written line survives the end of the process at once, and the end of the machine once its batch is complete."""

    def __init__(self, directory: Path, bytes_max: int, log: Callable[[str], None]) -> None:
        self._directory, self._refused, self._bytes_max, self._log = directory, directory / "refused", bytes_max, log
        self._refused.mkdir(parents=True, exist_ok=True)
        self._file: Optional[IO[bytes]] = None
        self._ended: queue.SimpleQueue[Optional[Path]] = queue.SimpleQueue()
        for left in sorted(directory.glob("*.open")):  # of a process that was killed
            self._publish(left)
        self._thread = threading.Thread(target=self._publish_ended, name="mapshift-spool", daemon=True)
        self._thread.start()

    def last(self) -> Optional[tuple[dict[str, Any], dict[str, Any]]]:
        """Head and last scan of the newest batch, by which a trip goes on after a restart.

        Raises if it is damaged: an older one does not say which sequences were given since.
        """
        kept = [*self._directory.glob("*.scans"), *self._refused.glob("*.scans")]
        newest = [max(kept, key=lambda file: file.name)] if kept else []
        stored = [file for file in [self._directory / "last-stored"] if file.exists()]
        found = []
        for batch in [*stored, *newest]:
            lines = batch.read_bytes().split(b"\n")
            found.append((json.loads(lines[0]), json.loads(lines[-2])))
        return max(found, key=lambda pair: (pair[0]["trip_id"], pair[0]["sequence"]), default=None)

    def begin(self, name: str, head: dict[str, Any]) -> bool:
        """Begins a batch, unless there is no room for it or its name is taken."""
        line = encoded(head)  # first: a batch without its head would not be taken
        if self._has(name) or not self._make_room():
            return False
        self._file = open(self._directory / f"{name}.open", "wb")
        self._write(line)
        return True

    def _has(self, name: str) -> bool:
        """Whether a batch of this name is being collected, waits or was refused: another would take its place."""
        complete = [self._directory / f"{name}.scans", self._refused / f"{name}.scans"]
        return any(file.exists() for file in [self._directory / f"{name}.open", *complete])

    def is_open(self) -> bool:
        return self._file is not None

    def write(self, line: dict[str, Any]) -> None:
        self._write(encoded(line))

    def _write(self, line: bytes) -> None:
        assert self._file
        self._file.write(line)
        self._file.flush()  # to the kernel, not to the disk: that would take too long here

    def end(self) -> None:
        """Completes the batch, if there is one."""
        if self._file:
            with contextlib.suppress(OSError):  # a full disk: the line that it cuts short is not uploaded
                self._file.close()
            self._ended.put(Path(self._file.name))
            self._file = None

    def close(self) -> None:
        self.end()
        self._ended.put(None)
        self._thread.join()

    def _publish_ended(self) -> None:
        while batch := self._ended.get():
            try:
                self._publish(batch)
            except OSError as error:  # the next start tries again
                self._log(f"{batch.name} cannot be completed: {error!r}")

    def _publish(self, batch: Path) -> None:
        if batch.read_bytes().count(b"\n") < 2:
            return batch.unlink()  # no scan
        with open(batch, "rb") as file:
            os.fsync(file.fileno())
        os.replace(batch, batch.with_suffix(".scans"))
        directory = os.open(self._directory, os.O_RDONLY)
        os.fsync(directory)
        os.close(directory)

    def _make_room(self) -> bool:
        """Forgets the oldest refused batches if the spool is full."""
        refused = sorted(self._refused.iterdir(), key=lambda file: file.stat().st_mtime)
        size = sum(map(size_of, [*self._directory.glob("*.*"), *refused]))
        for file in refused:
            if size > self._bytes_max:
                size -= size_of(file)
                file.unlink()
        return size <= self._bytes_max


def encoded(line: dict[str, Any]) -> bytes:
    return json.dumps(line, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def size_of(file: Path) -> int:
    with contextlib.suppress(FileNotFoundError):  # the uploader may just have moved it
        return file.stat().st_size
    return 0
