"""Time stamps that a recorder writes before a sentence: ISO 8601 (also AM or PM), or Unix time in s, ms, µs or ns."""

import re
from datetime import UTC, datetime

from datasets.importers.gnss.clock import S

_ISO = re.compile(
    rb"(\d{4})[-/](\d\d)[-/](\d\d)[T ,](\d\d?):(\d\d):(\d\d)(?:[.,](\d{1,9}))?\d*"
    rb"(?:\s*([AaPp])\.?[Mm]\b\.?)?\s*(Z|[+-]\d\d:?\d\d)?",
    re.ASCII,
)
_UNIX = re.compile(rb"(?<![\d.,:/-])(\d{10})(?:\.(\d{1,9})|(\d{3}|\d{6}|\d{9}))?(?![\d.:/-])")


def stamp_of(prefix: bytes) -> tuple[int, bool] | None:
    """Unix time (ns) of a prefix, and whether its zone is stated (else it is read as UTC); None without a stamp."""
    if (found := _ISO.search(prefix)) is not None:
        try:
            year, month, day, hour, minute, second = (int(found[k]) for k in range(1, 7))
            if found[8] is not None:  # a clock of 12 h
                hour = hour % 12 + (12 if found[8] in b"Pp" else 0) if 1 <= hour <= 12 else 24  # refused
            at = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        except ValueError:
            return None
        return round(at.timestamp()) * S + _fraction(found[7]) - _zone_s(found[9]) * S, found[9] is not None
    if (found := _UNIX.search(prefix)) is not None:
        return int(found[1]) * S + _fraction(found[2] or found[3]), True
    return None


def _fraction(digits: bytes | None) -> int:
    return int((digits or b"").ljust(9, b"0"))


def _zone_s(zone: bytes | None) -> int:
    if zone is None or zone == b"Z":
        return 0
    sign = -1 if zone[:1] == b"-" else 1
    return sign * (int(zone[1:3]) * 3600 + int(zone[-2:]) * 60)
