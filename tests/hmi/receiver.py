"""Example of a platform that takes uploads: stores each item once, then confirms it; cuts connections for tests."""

import json
import random
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

CREATE = "CREATE TABLE IF NOT EXISTS items (id TEXT PRIMARY KEY, kind TEXT NOT NULL, body TEXT NOT NULL)"
CUTS = ("before reading", "while reading", "before storing", "before answering", "while answering", "error")


class Receiver(ThreadingHTTPServer):
    """Platform with its database; the next `cuts` requests are cut at random places, those with `token` are taken."""

    daemon_threads = True

    def __init__(self, path: Path, token: str = "", seed: int = 1) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.path, self.token, self.cuts = path, token, 0
        self.repeated = 0  # items that came again
        self.random = random.Random(seed)
        self.lock = threading.Lock()
        with closing(sqlite3.connect(path)) as link:
            link.execute(CREATE)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/upload"

    def take(self, items: list[dict[str, Any]]) -> list[str]:
        """Stores items; ids of those that are stored, also before."""
        with self.lock, closing(sqlite3.connect(self.path)) as link, link:
            for item in items:
                row = (item["id"], item["kind"], json.dumps(item["body"]))
                self.repeated += 1 - link.execute("INSERT OR IGNORE INTO items VALUES (?, ?, ?)", row).rowcount
        return [item["id"] for item in items]

    def bodies(self, kind: str) -> list[dict[str, Any]]:
        with closing(sqlite3.connect(self.path)) as link:
            rows = link.execute("SELECT body FROM items WHERE kind = ? ORDER BY rowid", (kind,))
            return [json.loads(body) for (body,) in rows]

    def handle_error(self, *_: Any) -> None:
        """A cut is no error."""


class Handler(BaseHTTPRequestHandler):
    """One request of a machine."""

    server: Receiver

    def do_POST(self) -> None:
        server = self.server
        with server.lock:
            server.cuts -= 1
            cut = server.random.choice(CUTS) if server.cuts >= 0 else ""
        if cut == "before reading":
            return self.cut()
        length = int(self.headers["Content-Length"])
        if cut == "while reading":
            self.rfile.read(length // 2)
            return self.cut()
        items = json.loads(self.rfile.read(length))["items"]
        if cut == "before storing":
            return self.cut()
        token = f"Bearer {server.token}" if server.token else ""
        if cut == "error" or self.headers.get("Authorization", "") != token:
            self.send_response(503 if cut else 401)
            self.end_headers()
            return None
        answer = json.dumps({"taken": server.take(items)}).encode()
        if cut == "before answering":
            return self.cut()
        self.send_response(200)
        self.send_header("Content-Length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer[: len(answer) // 2] if cut else answer)
        return self.cut() if cut else None

    def cut(self) -> None:
        """Ends the connection without more."""
        self.close_connection = True
        self.connection.close()

    def log_message(self, *_: Any) -> None:
        """Nothing is printed."""


@contextmanager
def receiver(path: Path, token: str = "", seed: int = 1) -> Iterator[Receiver]:
    """A platform that runs."""
    with Receiver(path, token, seed) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        yield server
        server.shutdown()
