"""NMEA 0183: the sentences of one time of day as values of one epoch.

A sentence without a time (VTG, HDT, THS, GSA) belongs to the epoch before it, unless that has one already: then it
begins the next epoch. A receiver that sends its heading before the position of the same time is so read one epoch late
only when the stream begins between the two.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from typing import Any

import numpy as np

from datasets.importers.gnss.sentence import BadSentence, Sentence
from geometry.angles import wrap
from messages.sensors import GnssSolution

KNOT_MPS = 1852.0 / 3600.0
MAX_KNOTS = 1000.0  # export rules: receivers give no position above
NO_DOP = 99.0  # receivers write 99.9 or 99.99 for unknown
SOLUTIONS = {  # quality of GGA: 3 is PPS; 6 estimated, 7 manual and 8 simulated are no solution
    1: GnssSolution.SINGLE, 2: GnssSolution.SBAS, 3: GnssSolution.SINGLE, 4: GnssSolution.RTK_FIXED,
    5: GnssSolution.RTK_FLOAT,
}  # fmt: skip
MODES = {  # of GNS, RMC, GLL and VTG: autonomous, differential, precise (PPS), float, RTK; all others are no solution
    "A": GnssSolution.SINGLE, "D": GnssSolution.SBAS, "P": GnssSolution.SINGLE, "F": GnssSolution.RTK_FLOAT,
    "R": GnssSolution.RTK_FIXED,
}  # fmt: skip
EARTH_M = 6.371e6
SAME_PLACE_M = 5.0  # receivers round the minutes of some sentences to 2 m
ANOTHER = f"another receiver: more than {SAME_PLACE_M} m from the position of the same time before"
TALKERS = {  # of GNSS receivers; GN: several systems
    "GN": "", "GP": "GPS", "GL": "GLO", "GA": "GAL", "GB": "BDS", "BD": "BDS", "GQ": "QZSS", "QZ": "QZSS",
    "GI": "NAVIC",
}  # fmt: skip
SYSTEMS = ("GPS", "GLO", "GAL", "BDS", "QZSS", "NAVIC")  # system 1 to 6 of GSA, and in this order the modes of GNS
# Later entries replace the values of earlier ones.
PRECEDENCE = ("GSA", "VTG", "GLL", "RMC", "GNS", "GGA", "GST", "THS", "HDT")
Values = dict[str, Any]


@dataclass
class Epoch:
    """Values of one time of day, by formatter; `systems` are those that GSA and GNS report as used."""

    time_ns: int | None = None
    values: dict[str, Values] = field(default_factory=dict)
    systems: set[str] = field(default_factory=set)

    @property
    def has_position(self) -> bool:
        """Whether a sentence with position and time was received."""
        return self.time_ns is not None and not self.values.keys().isdisjoint(("GGA", "GNS", "RMC", "GLL"))

    def is_elsewhere(self, values: Values) -> bool:
        """Whether the position of a sentence is not that of this epoch."""
        latitude, longitude = values.get("latitude_rad", math.nan), values.get("longitude_rad", math.nan)
        place = next((v for v in self.values.values() if "latitude_rad" in v and "longitude_rad" in v), values)
        north = latitude - place.get("latitude_rad", math.nan)
        east = wrap(longitude - place.get("longitude_rad", math.nan)) * math.cos(latitude)
        return math.hypot(north, east) * EARTH_M > SAME_PLACE_M  # False where one is unknown

    def merged(self) -> Values:
        """All known values; without a solution when one sentence says so."""
        merged: Values = {}
        for formatter in PRECEDENCE:
            merged |= self.values.get(formatter, {})
        if any(v.get("solution") is GnssSolution.NONE for v in self.values.values()):
            merged["solution"] = GnssSolution.NONE
        used = self.systems or {merged.get("talker", "")}  # of GSA and GNS; the talker of GGA is often just a setting
        return merged | {"constellations": "+".join(name for name in SYSTEMS if name in used)}


class NmeaEpochs:
    """Collects sentences; `add` returns the epoch that a sentence completes."""

    def __init__(self) -> None:
        self._epoch = Epoch()

    def add(self, sentence: Sentence) -> Epoch | None:
        """Stores the values of a sentence; raises BadSentence and then changes nothing."""
        values = READERS[sentence.formatter](sentence)
        time_ns, systems = values.pop("time_ns", None), values.pop("systems", set())
        if time_ns is not None and time_ns == self._epoch.time_ns and self._epoch.is_elsewhere(values):
            raise BadSentence(ANOTHER)
        done = None
        if self._begins_next(sentence.formatter, time_ns):
            done, self._epoch = self.finish(), Epoch()
        if time_ns is not None:
            self._epoch.time_ns = time_ns
        self._epoch.systems |= systems
        self._epoch.values[sentence.formatter] = values
        return done

    def finish(self) -> Epoch | None:
        """The epoch not yet complete, if it has a position."""
        return self._epoch if self._epoch.has_position else None

    def _begins_next(self, formatter: str, time_ns: int | None) -> bool:
        if time_ns is not None:
            return self._epoch.time_ns not in (None, time_ns)
        return formatter in self._epoch.values and formatter != "GSA"


def date_of(sentence: Sentence) -> tuple[date, int] | None:
    """Day and time of day of a valid RMC or of a ZDA; raises BadSentence."""
    if sentence.formatter == "ZDA" and sentence.field(1):
        return sentence.day(sentence.field(3), sentence.field(2), sentence.field(1)), sentence.time_ns(0)
    if sentence.formatter == "RMC" and sentence.field(1) == "A" and (text := sentence.field(8)):
        if len(text) != 6:
            raise BadSentence(f"RMC field 8: {text!r} is not a date")
        return sentence.day(text[4:], text[2:4], text[:2]), sentence.time_ns(0)
    return None


def _gga(s: Sentence) -> Values:
    quality = s.integer(5, 0, 9)
    values = _position(s, 1, SOLUTIONS.get(quality or 0, GnssSolution.NONE), bool(quality))
    heights = s.number(8, -1e4, 1e5), s.number(10, -200.0, 200.0)
    if not {s.field(9), s.field(11)} <= {"M", ""}:
        raise BadSentence(f"GGA heights in {s.field(9)!r} and {s.field(11)!r}")
    common = _quality(s, 6) | _known("correction_age_s", s.number(12, 0.0, 1e4) if s.optional(12) else math.nan)
    return values | common | (_known("height_m", sum(heights)) if quality else {}) | _talker(s)


def _gns(s: Sentence) -> Values:
    modes = s.field(5)
    if not modes.isalpha():
        raise BadSentence(f"GNS modes {modes!r}")
    solution = max((MODES.get(mode, GnssSolution.NONE) for mode in modes), default=GnssSolution.NONE)
    is_valid = bool(set(modes) - {"N"})
    values = _position(s, 1, solution, is_valid) | _quality(s, 6)
    heights = s.number(8, -1e4, 1e5) + s.number(9, -200.0, 200.0)
    used = {name for name, mode in zip(SYSTEMS, modes, strict=False) if mode in MODES}
    age = _known("correction_age_s", s.number(10, 0.0, 1e4))
    return values | age | (_known("height_m", heights) if is_valid else {}) | {"systems": used}


def _rmc(s: Sentence) -> Values:
    solution = _validity(s, 1, 11)
    values = _position(s, 2, solution, s.field(1) == "A")
    velocity = _velocity(s.number(6, 0.0, MAX_KNOTS) * KNOT_MPS, s.number(7, 0.0, 360.0))
    date_of(s)
    return values | (velocity if solution > GnssSolution.NONE else {}) | _talker(s)


def _gll(s: Sentence) -> Values:
    solution = _validity(s, 5, 6)
    return _position(s, 0, solution, s.field(5) == "A") | {"time_ns": s.time_ns(4)} | _talker(s)


def _vtg(s: Sentence) -> Values:
    course, speed_mps = s.number(0, 0.0, 360.0), s.number(6, 0.0, MAX_KNOTS * 1.852) / 3.6
    return _velocity(speed_mps, course) if s.optional(8) != "N" else {}


def _gst(s: Sentence) -> Values:
    north, east, up = (s.number(k, 0.0, 1e6) for k in (5, 6, 7))
    return {"time_ns": s.time_ns(0), "sigma_enu_m": np.array((east, north, up))}


def _hdt(s: Sentence) -> Values:
    return _heading(s.number(0, 0.0, 360.0)) if s.optional(1) in ("T", "") else {}


def _ths(s: Sentence) -> Values:
    clockwise = s.number(0, 0.0, 360.0)
    return _heading(clockwise) if s.field(1) == "A" else {}


def _gsa(s: Sentence) -> Values:
    used = any(s.field(k) for k in range(2, 14))
    system = s.optional(17)
    name = SYSTEMS[int(system) - 1] if system in tuple("123456") else TALKERS.get(s.talker, "")
    dop = s.number(15, 0.0, 100.0)
    return (_known("hdop", dop) if dop < NO_DOP else {}) | {"systems": {name} if used else set()}


def _position(s: Sentence, k: int, solution: GnssSolution, is_valid: bool) -> Values:
    time = {"time_ns": s.time_ns(0)} if s.formatter != "GLL" else {}
    if not is_valid:  # some receivers then write numbers that are no position
        return time | {"solution": solution}
    latitude, longitude = s.angle_rad(k, "latitude"), s.angle_rad(k + 2, "longitude")
    if solution > GnssSolution.NONE and (math.isnan(latitude) or math.isnan(longitude)):
        raise BadSentence(f"{s.formatter} with a fix and without its position")
    return time | _known("latitude_rad", latitude) | _known("longitude_rad", longitude) | {"solution": solution}


def _quality(s: Sentence, k: int) -> Values:
    """Satellites and HDOP in fields k and k + 1."""
    satellites, hdop = s.integer(k, 0, 199), s.number(k + 1, 0.0, 1e4)
    return ({} if satellites is None else {"satellites": satellites}) | (_known("hdop", hdop) if hdop < NO_DOP else {})


def _validity(s: Sentence, status: int, mode: int) -> GnssSolution:
    """Solution of status (A valid, V not) and mode, which older versions of the standard do not have."""
    if s.field(status) not in ("A", "V"):
        raise BadSentence(f"{s.formatter} field {status}: status {s.field(status)!r} is not A or V")
    is_valid = s.field(status) == "A"
    return MODES.get(s.optional(mode) or "A", GnssSolution.NONE) if is_valid else GnssSolution.NONE


def _velocity(speed_mps: float, course_deg: float) -> Values:
    """East and north, from speed and course over ground clockwise from north; slow receivers state no course."""
    clockwise = math.radians(course_deg) if speed_mps != 0.0 else 0.0
    east, north = speed_mps * math.sin(clockwise), speed_mps * math.cos(clockwise)
    return {} if math.isnan(east) else {"velocity_enu_mps": np.array((east, north, math.nan))}


def _heading(clockwise_deg: float) -> Values:
    return _known("heading_rad", wrap(math.radians(90.0 - clockwise_deg)))


def _talker(s: Sentence) -> Values:
    return {"talker": TALKERS.get(s.talker, "")}


def _known(name: str, value: float) -> Values:
    return {} if math.isnan(value) else {name: value}


READERS: dict[str, Callable[[Sentence], Values]] = {
    "GGA": _gga, "GNS": _gns, "RMC": _rmc, "GLL": _gll, "VTG": _vtg, "GST": _gst, "HDT": _hdt, "THS": _ths, "GSA": _gsa,
}  # fmt: skip
