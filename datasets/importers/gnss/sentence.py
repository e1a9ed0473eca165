"""NMEA 0183 sentence: checksum and fields; `$ttfff,field,field*hh`."""

import math
import re
from dataclasses import dataclass
from datetime import date

_NUMBER = re.compile(r"-?[0-9]{1,7}(\.[0-9]{0,12})?")
_TIME = re.compile(r"([01][0-9]|2[0-3])([0-5][0-9])([0-5][0-9]|60)(?:\.([0-9]{0,9}))?")
_ANGLE = {"latitude": re.compile(r"([0-9]{2})([0-5][0-9](?:\.[0-9]{0,12})?)"),
          "longitude": re.compile(r"([0-9]{3})([0-5][0-9](?:\.[0-9]{0,12})?)")}  # fmt: skip


class BadSentence(ValueError):
    """A sentence that must not be used; the text is the reason."""


@dataclass(frozen=True)
class Sentence:
    """Talker such as GN, formatter such as GGA, and the fields."""

    talker: str
    formatter: str
    fields: tuple[str, ...]

    def field(self, k: int) -> str:
        """Field k, counted from 0; raises BadSentence when there is none."""
        if k >= len(self.fields):
            raise BadSentence(f"{self.formatter} has {len(self.fields)} fields, not {k + 1}")
        return self.fields[k]

    def optional(self, k: int) -> str:
        """Field k, empty when an older version of the standard does not have it."""
        return self.fields[k] if k < len(self.fields) else ""

    def number(self, k: int, low: float, high: float) -> float:
        """Field k as a number within bounds, NaN when empty; raises BadSentence."""
        text = self.field(k)
        if not text:
            return math.nan
        if _NUMBER.fullmatch(text) is None or not low <= float(text) <= high:
            raise BadSentence(f"{self.formatter} field {k}: {text!r} is not a number within {low:g} to {high:g}")
        return float(text)

    def integer(self, k: int, low: int, high: int) -> int | None:
        """Field k as an integer within bounds, None when empty; raises BadSentence."""
        value = self.number(k, low, high)
        if not math.isnan(value) and value != int(value):
            raise BadSentence(f"{self.formatter} field {k}: {self.field(k)!r} is not an integer")
        return None if math.isnan(value) else int(value)

    def time_ns(self, k: int) -> int:
        """Field k, hhmmss.ss, as time since midnight; raises BadSentence."""
        found = _TIME.fullmatch(self.field(k))
        if not self.field(k):
            raise BadSentence(f"{self.formatter} without a time")
        if found is None:
            raise BadSentence(f"{self.formatter} field {k}: {self.field(k)!r} is not a time")
        seconds = int(found[1]) * 3600 + int(found[2]) * 60 + int(found[3])
        return seconds * 1_000_000_000 + int((found[4] or "").ljust(9, "0"))

    def day(self, year: str, month: str, day: str) -> date:
        """A calendar day from its digits; a year of two digits is within 1980 to 2079; raises BadSentence."""
        try:
            number = int(year)
            return date(number if len(year) == 4 else number + (1900 if number >= 80 else 2000), int(month), int(day))
        except ValueError as error:
            raise BadSentence(f"{self.formatter}: {year!r}, {month!r}, {day!r} is not a date") from error

    def angle_rad(self, k: int, kind: str) -> float:
        """Fields k and k + 1 as `latitude` or `longitude`, NaN when both are empty; raises BadSentence."""
        text, side = self.field(k), self.field(k + 1)
        if not text:
            return math.nan
        found, sides = _ANGLE[kind].fullmatch(text), "NS" if kind == "latitude" else "EW"
        if found is None or len(side) != 1 or side not in sides:
            raise BadSentence(f"{self.formatter} field {k}: {text!r} {side!r} is not a {kind}")
        degrees = int(found[1]) + float(found[2]) / 60.0
        if degrees > (90.0 if kind == "latitude" else 180.0):
            raise BadSentence(f"{self.formatter} field {k}: {kind} {degrees} out of range")
        return math.radians(degrees if side == sides[0] else -degrees)


def checksum(body: bytes) -> int:
    """Exclusive or of the bytes between `$` and `*`."""
    total = 0
    for byte in body:
        total ^= byte
    return total


def parse(line: bytes) -> Sentence:
    """A framed sentence; raises BadSentence when its checksum is missing or wrong."""
    body, star, expected = line[1:].rpartition(b"*")
    if not star:
        raise BadSentence("no checksum")
    if f"{checksum(body):02X}".encode() != expected.upper():
        raise BadSentence("wrong checksum")
    address, *fields = body.decode("ascii").split(",")
    at = 1 if address.startswith("P") else max(0, len(address) - 3)  # P: proprietary, the rest is the manufacturer's
    return Sentence(address[:at], address[at:], tuple(fields))
