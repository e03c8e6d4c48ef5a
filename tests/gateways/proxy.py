"""A bad line between gateways and a service: one request a connection, whose fate a seed decides."""
from __future__ import annotations

import asyncio
import random
import socket
import struct
import threading
from collections import Counter
from typing import Optional

FAULTS = (
    "drop_before", "reset_in_body", "reset_after", "cut_answer", "stall", "twice", "busy", "bad_gateway", "corrupt",
)
CLOSE = b"Connection: close\r\n"
BUSY = b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nContent-Length: 0\r\n" + CLOSE + b"\r\n"
BAD_GATEWAY = b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 13\r\n" + CLOSE + b"\r\n<h1>502</h1>\n"


class Proxy:
    """Listens on a free port, in a thread of its own."""

    def __init__(self, service_port: int, fault_share: float, stall_s: float, seed: int) -> None:
        self._service_port, self._fault_share, self._stall_s = service_port, fault_share, stall_s
        self._random = random.Random(seed)
        self.fates: Counter[str] = Counter()
        self.answers: Counter[int] = Counter()
        listening: threading.Event = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(listening)), daemon=True)
        self._thread.start()
        listening.wait()

    async def _serve(self, listening: threading.Event) -> None:
        server = await asyncio.start_server(self._connection, "127.0.0.1", 0)
        self.port: int = server.sockets[0].getsockname()[1]
        listening.set()
        await server.serve_forever()

    async def _connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._request(reader, writer)
        except (OSError, asyncio.IncompleteReadError):
            pass  # the gateway has gone: killed, or tired of waiting
        finally:
            writer.close()

    def _fate(self) -> str:
        faulty = self._random.random() < self._fault_share
        fate = self._random.choice(FAULTS) if faulty else "pass"
        self.fates[fate] += 1
        return fate

    async def _request(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readuntil(b"\r\n\r\n")
        length = content_length(head)
        fate = self._fate()
        if fate == "reset_in_body":
            await reader.readexactly(length // 2)
            return reset(writer)
        body = await reader.readexactly(length)
        if fate == "drop_before":
            return
        if fate in ("busy", "bad_gateway"):
            writer.write(BUSY if fate == "busy" else BAD_GATEWAY)
            return await writer.drain()
        if fate == "corrupt" and body:
            at = self._random.randrange(length)
            body = body[:at] + bytes([body[at] ^ 16]) + body[at + 1 :]
        if fate == "twice":
            _, answer = await asyncio.gather(self._forward(head, body), self._forward(head, body))
        else:
            answer = await self._forward(head, body)
        if fate == "reset_after":
            return reset(writer)
        if fate == "stall":
            await asyncio.sleep(self._stall_s)
        writer.write(answer[: len(answer) // 2] if fate == "cut_answer" else answer)
        await writer.drain()

    async def _forward(self, head: bytes, body: bytes) -> bytes:
        lines = [line for line in head.split(b"\r\n") if not line.lower().startswith(b"connection:")]
        lines.insert(1, b"Connection: close")
        reader, writer = await asyncio.open_connection("127.0.0.1", self._service_port)
        writer.write(b"\r\n".join(lines) + body)
        answer = await reader.read()
        writer.close()
        self.answers[int(answer.split(b" ", 2)[1])] += 1
        return answer


def content_length(head: bytes) -> int:
    for line in head.lower().split(b"\r\n"):
        if line.startswith(b"content-length:"):
            return int(line.partition(b":")[2])
    return 0


def reset(writer: asyncio.StreamWriter) -> None:
    """Closes so that the other side sees a reset."""
    connection: Optional[socket.socket] = writer.get_extra_info("socket")
    if connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()
