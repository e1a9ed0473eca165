"""Totals of each drive by day, in SQLite: what is stored once more is the same, so nothing is counted twice."""

import csv
import io
import sqlite3
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from hmi.database import open_database
from messages.errors import HeadlandError


@dataclass(frozen=True)
class Totals:
    """Worked area, time in automatic operation, distance, and stops for obstacles, faults and emergencies."""

    area_m2: float = 0.0
    engaged_s: float = 0.0
    distance_m: float = 0.0
    stops: int = 0


@dataclass(frozen=True)
class DayOfField:
    """Totals of a field on a day, of `drives` drives."""

    day: str
    field: str
    drives: int
    totals: Totals


COLUMNS = tuple(one.name for one in fields(Totals))
CREATE = """CREATE TABLE IF NOT EXISTS drives (
  drive TEXT NOT NULL, day TEXT NOT NULL, field TEXT NOT NULL,
  area_m2 REAL NOT NULL, engaged_s REAL NOT NULL, distance_m REAL NOT NULL, stops INTEGER NOT NULL,
  PRIMARY KEY (drive, day)) WITHOUT ROWID"""
BEFORE = f"SELECT {', '.join(f'COALESCE(SUM({c}), 0)' for c in COLUMNS)} FROM drives WHERE drive = ? AND day <> ?"
UPSERT = f"""INSERT INTO drives VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO UPDATE SET
  {", ".join(f"{c} = MAX({c}, excluded.{c})" for c in COLUMNS)}"""  # totals only grow: a log may lack the last seconds
SUMMED = f"""SELECT day, field, COUNT(DISTINCT drive), {", ".join(f"SUM({c})" for c in COLUMNS)} FROM drives
  GROUP BY day, field ORDER BY day DESC, field LIMIT ?"""


class StatisticsStore:
    """Database of the statistics; raises HeadlandError for a file that is not one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._link = open_database(path, "statistics", "statistics", CREATE)

    def close(self) -> None:
        """Closes the database."""
        self._link.close()

    def put(self, drive: str, day: str, field: str, totals: Totals) -> None:
        """Stores the totals of a drive since its start; what exceeds those of other days belongs to `day`.

        Raises HeadlandError.
        """
        try:
            with self._link:
                self._link.execute("BEGIN IMMEDIATE")
                before = self._link.execute(BEFORE, (drive, day)).fetchone()
                own = [max(0, now - past) for now, past in zip(astuple(totals), before, strict=True)]
                if any(own):
                    self._link.execute(UPSERT, (drive, day, field, *own))
        except sqlite3.Error as error:
            raise HeadlandError(f"{self._path}: statistics cannot be stored ({error})") from error

    def by_day(self, most: int = 1000) -> list[DayOfField]:
        """Totals by day and field, the newest day first; raises HeadlandError."""
        try:
            rows = self._link.execute(SUMMED, (most,)).fetchall()
        except sqlite3.Error as error:
            raise HeadlandError(f"{self._path}: statistics cannot be read ({error})") from error
        return [DayOfField(day, field, drives, Totals(*totals)) for day, field, drives, *totals in rows]


def to_csv(days: list[DayOfField]) -> str:
    """Table in CSV (RFC 4180); a name that a spreadsheet would take for a formula begins with an apostrophe."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["day", "field", "drives", *COLUMNS])
    for one in days:
        name = f"'{one.field}" if one.field[:1] in "=+-@\t\r" and one.field else one.field
        totals = one.totals
        writer.writerow([
            one.day, name, one.drives, f"{totals.area_m2:.1f}", f"{totals.engaged_s:.1f}", f"{totals.distance_m:.1f}",
            totals.stops,
        ])  # fmt: skip
    return text.getvalue()
