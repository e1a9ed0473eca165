"""NMEA 0183 sentence: framing, checksum and fields; `$ttfff,field,field*hh`."""

import math
import re
from dataclasses import dataclass

MAX_LENGTH = 120  # standard: 82; receivers with centimetre positions need more
_SENTENCE = re.compile(rb"\$([A-Z]{2})([A-Z]{3}),([\x20-\x7e]*)\*([0-9A-F]{2})")
_NUMBER = re.compile(r"-?[0-9]{1,7}(\.[0-9]{1,12})?")
_TIME = re.compile(r"([01][0-9]|2[0-3])([0-5][0-9])([0-5][0-9](\.[0-9]{1,6})?)")
_ANGLE = {"latitude": re.compile(r"([0-9]{2})([0-5][0-9]\.[0-9]{1,12})"),
          "longitude": re.compile(r"([0-9]{3})([0-5][0-9]\.[0-9]{1,12})")}  # fmt: skip


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

    def number(self, k: int, low: float, high: float) -> float:
        """Field k as a number within bounds, NaN when empty; raises BadSentence."""
        text = self.field(k)
        if not text:
            return math.nan
        if _NUMBER.fullmatch(text) is None or not low <= float(text) <= high:
            raise BadSentence(f"{self.formatter} field {k}: {text!r} is not a number within {low:g} to {high:g}")
        return float(text)

    def time(self, k: int) -> str:
        """Field k as a time of day, hhmmss.ss; raises BadSentence."""
        text = self.field(k)
        if _TIME.fullmatch(text) is None:
            raise BadSentence(f"{self.formatter} field {k}: {text!r} is not a time")
        return text

    def angle_rad(self, k: int, kind: str) -> float:
        """Fields k and k + 1 as `latitude` or `longitude`, NaN when both are empty; raises BadSentence."""
        text, side = self.field(k), self.field(k + 1)
        if not text and not side:
            return math.nan
        found, sides = _ANGLE[kind].fullmatch(text), "NS" if kind == "latitude" else "EW"
        if found is None or len(side) != 1 or side not in sides:
            raise BadSentence(f"{self.formatter} field {k}: {text!r} {side!r} is not a {kind}")
        degrees = int(found[1]) + float(found[2]) / 60.0
        if degrees > (90.0 if kind == "latitude" else 180.0):
            raise BadSentence(f"{self.formatter} field {k}: {kind} {degrees} out of range")
        return math.radians(degrees if side == sides[0] else -degrees)


def parse(line: bytes) -> Sentence:
    """The sentence of a line without its end; raises BadSentence unless frame and checksum are right."""
    found = _SENTENCE.fullmatch(line) if len(line) <= MAX_LENGTH else None
    if found is None:
        raise BadSentence("not framed as a sentence")
    checksum = 0
    for byte in line[1:-3]:
        checksum ^= byte
    if checksum != int(found[4], 16):
        raise BadSentence(f"checksum {found[4].decode()} instead of {checksum:02X}")
    return Sentence(found[1].decode(), found[2].decode(), tuple(found[3].decode().split(",")))
