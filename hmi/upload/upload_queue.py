"""Queue of items for the platform, in SQLite: an item is there until the platform has confirmed it."""

import json
import secrets
import sqlite3
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hmi.database import open_database
from messages.errors import HeadlandError

MAX_ITEMS = 200_000  # then the oldest are dropped, and counted
CREATE = """CREATE TABLE IF NOT EXISTS items (
  number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, body TEXT NOT NULL)"""
OVER = "DELETE FROM items WHERE number <= (SELECT MAX(number) - ? FROM items)"


@dataclass(frozen=True)
class Item:
    """One item: `id` is the same at each attempt, by which the platform recognizes what it has already."""

    id: str
    kind: str
    body: dict[str, Any]


class UploadQueue:
    """Queue in a file, for one thread; several objects may share the file. Methods raise HeadlandError."""

    def __init__(self, path: Path, most: int = MAX_ITEMS) -> None:
        self._path, self._most = path, most
        self.dropped = 0
        self._link = open_database(path, "upload queue", "upload queue", CREATE)

    def put(self, kind: str, body: Mapping[str, Any]) -> str:
        """Adds an item, on disk when this returns; its id."""
        row = secrets.token_hex(16), kind, json.dumps(body, allow_nan=False)
        try:
            self._link.execute("INSERT INTO items (id, kind, body) VALUES (?, ?, ?)", row)
            self.dropped += self._link.execute(OVER, (self._most,)).rowcount
        except sqlite3.Error as error:
            raise self._error(error) from error
        return row[0]

    def oldest(self, most: int) -> list[Item]:
        """The oldest items, in their order."""
        try:
            rows = self._link.execute("SELECT id, kind, body FROM items ORDER BY number LIMIT ?", (most,)).fetchall()
        except sqlite3.Error as error:
            raise self._error(error) from error
        return [Item(item_id, kind, json.loads(body)) for item_id, kind, body in rows]

    def remove(self, ids: Iterable[str]) -> None:
        """Removes items that the platform has confirmed."""
        try:
            with self._link:
                self._link.execute("BEGIN IMMEDIATE")
                self._link.executemany("DELETE FROM items WHERE id = ?", [(one,) for one in ids])
        except sqlite3.Error as error:
            raise self._error(error) from error

    def __len__(self) -> int:
        try:
            return int(self._link.execute("SELECT COUNT(*) FROM items").fetchone()[0])
        except sqlite3.Error as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Closes the file."""
        self._link.close()

    def _error(self, error: sqlite3.Error) -> HeadlandError:
        return HeadlandError(f"{self._path}: upload queue cannot be used ({error})")
