"""Versions of machine setups in SQLite: numbered by machine from 1, never changed, never removed."""

import sqlite3
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from configs.machine_setup import MachineSetup, setup_from_json
from hmi.database import open_database
from messages.errors import HeadlandError

FILES = "configs"  # author of the versions that come from the configuration files
CREATE = """CREATE TABLE IF NOT EXISTS versions (
  machine TEXT NOT NULL, number INTEGER NOT NULL, stored_s REAL NOT NULL, author TEXT NOT NULL, note TEXT NOT NULL,
  content TEXT NOT NULL, PRIMARY KEY (machine, number)) WITHOUT ROWID"""
INSERT = """INSERT INTO versions SELECT ?1, COALESCE(MAX(number), 0) + 1, ?2, ?3, ?4, ?5 FROM versions
  WHERE machine = ?1 RETURNING number"""
LISTED = "SELECT number, stored_s, author, note FROM versions WHERE machine = ? ORDER BY number DESC LIMIT 500"
BY_AUTHOR = "SELECT content FROM versions WHERE machine = ? AND author = ? ORDER BY number DESC LIMIT 1"


@dataclass(frozen=True)
class SetupVersion:
    """Who stored a version when (s since 1970) and why."""

    number: int
    stored_s: float
    author: str
    note: str

    @property
    def stored_at(self) -> str:
        """Date and time (UTC)."""
        return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(self.stored_s))


class SetupStore:
    """Database of the versions; raises HeadlandError for a file that is not one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._link = open_database(path, "setup", "setups", CREATE)

    def close(self) -> None:
        """Closes the database."""
        self._link.close()

    def put(self, setup: MachineSetup, author: str, note: str) -> int:
        """Stores a version; its number. Raises HeadlandError."""
        row = (setup.machine, time.time(), author, note, setup.to_json())
        return int(self._rows(INSERT, row)[0][0])

    def versions(self, machine: str) -> list[SetupVersion]:
        """Versions of a machine, the newest first; raises HeadlandError."""
        return [SetupVersion(*row) for row in self._rows(LISTED, (machine,))]

    def setup(self, machine: str, number: int) -> MachineSetup:
        """Content of a version; raises HeadlandError."""
        rows = self._rows("SELECT content FROM versions WHERE machine = ? AND number = ?", (machine, number))
        if not rows:
            raise HeadlandError(f"setup {number} of {machine}: is not stored")
        return setup_from_json(rows[0][0], f"setup {number} of {machine}")

    def newest(self, configured: MachineSetup) -> tuple[int, MachineSetup]:
        """Newest version of a machine; `configured` becomes one if the files have changed since their last version."""
        machine = configured.machine
        rows = self._rows(BY_AUTHOR, (machine, FILES))
        if not rows or rows[0][0] != configured.to_json():
            self.put(configured, FILES, "")
        number = self.versions(machine)[0].number
        return number, self.setup(machine, number)

    def _rows(self, query: str, values: tuple[object, ...]) -> list[tuple[Any, ...]]:
        try:
            with self._link:
                return self._link.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise HeadlandError(f"{self._path}: the setup cannot be stored or read ({error})") from error
