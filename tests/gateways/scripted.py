"""A service that answers uploads by a script, and remembers them."""
from __future__ import annotations

import gzip
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Reply = tuple[int, dict[str, str], str]
STORED: Reply = (202, {}, "{}")


class ScriptedService:
    def __init__(self, *replies: Reply) -> None:
        """After the replies everything is stored."""
        self.replies = list(replies)
        self.uploads: list[tuple[str, bytes, dict[str, str]]] = []
        service = self

        class Handler(BaseHTTPRequestHandler):
            def do_PUT(self) -> None:
                wire = self.rfile.read(int(self.headers["Content-Length"]))
                service.uploads.append((self.path.rsplit("/", 1)[1], wire, dict(self.headers.items())))
                status, headers, text = service.replies.pop(0) if service.replies else STORED
                self.send_response(status)
                for name, value in {**headers, "Content-Length": str(len(text))}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(text.encode())

            def log_message(self, format: str, *args: Any) -> None: ...

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def batches(self) -> list[dict[str, Any]]:
        return [json.loads(gzip.decompress(wire)) for _, wire, _ in self.uploads]

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
