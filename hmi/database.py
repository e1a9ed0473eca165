"""Databases of the page: SQLite files that keep what is stored, also after a power cut."""

import sqlite3
from pathlib import Path

from messages.errors import HeadlandError

VERSION = 1
BUSY_S = 5.0


def open_database(path: Path, name: str, names: str, create: str) -> sqlite3.Connection:
    """Database with the table of `create`; raises HeadlandError for a file that is not one.

    `name` and `names`: what it is for and what it contains, in the texts of errors.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        link = sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
        version = link.execute("PRAGMA user_version").fetchone()[0]
        if version not in (0, VERSION):
            raise HeadlandError(f"{path}: {names} of version {version}, this program reads {VERSION}")
        link.execute("PRAGMA journal_mode = WAL")
        link.execute("PRAGMA synchronous = FULL")  # one transaction in some seconds, also after a power cut
        link.execute(create)
        link.execute(f"PRAGMA user_version = {VERSION}")
    except (sqlite3.Error, OSError) as error:
        raise HeadlandError(f"{path}: cannot be used for the {name} ({error}); move it away") from error
    return link
