"""GNSS fixes from NMEA: GGA (position), RMC or VTG (velocity), GST (sigmas) and HDT (heading) of one epoch."""

import math
from dataclasses import dataclass

import numpy as np

from interfaces.gnss.sentence import MAX_LENGTH, BadSentence, Sentence, parse
from messages.sensors import GnssFix, GnssSolution

KNOT_MPS = 1852.0 / 3600.0
SOLUTIONS = {  # GGA's quality
    0: GnssSolution.NONE, 1: GnssSolution.SINGLE, 2: GnssSolution.SBAS, 4: GnssSolution.RTK_FIXED,
    5: GnssSolution.RTK_FLOAT,
}  # fmt: skip
CONSTELLATIONS = {"GP": "GPS", "GL": "GLO", "GA": "GAL", "GB": "BDS", "BD": "BDS", "GQ": "QZSS", "GN": "mixed"}


@dataclass
class _Epoch:
    """Content of the sentences of one time of day."""

    time: str = ""
    position: Sentence | None = None
    velocity_enu_mps: tuple[float, float] = (math.nan, math.nan)
    sigma_enu_m: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    heading_rad: float = math.nan


class NmeaReader:
    """Reads a byte stream; a fix is complete with the sentence `ends_with`, the last one by the receiver's setting.

    Invalid sentences are counted in `rejected` and change nothing. The stamp is the time of reception of the first byte
    less `latency_ns`. Missing values are NaN; `sigma_heading_rad` is from the data sheet, since no sentence has it.
    """

    def __init__(self, ends_with: str, latency_ns: int, sigma_heading_rad: float) -> None:
        self.rejected = 0
        self._ends_with, self._latency_ns, self._sigma_heading_rad = ends_with, latency_ns, sigma_heading_rad
        self._rest = b""
        self._epoch = _Epoch()
        self._start_ns = 0

    def receive(self, now_ns: int, data: bytes) -> list[GnssFix]:
        """Fixes completed by these bytes."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > MAX_LENGTH + 1:
            self._rest = b""
            self.rejected += 1
        fixes = []
        for line in lines:
            try:
                sentence = parse(line.removesuffix(b"\r"))
                self._store(now_ns, sentence)
                if sentence.formatter == self._ends_with:
                    fixes += self._finish()
            except BadSentence:
                self.rejected += 1
        return fixes

    def _store(self, now_ns: int, sentence: Sentence) -> None:
        kind = sentence.formatter
        if kind in ("GGA", "RMC", "GST") and (time := sentence.time(0)) != self._epoch.time:
            self._epoch, self._start_ns = _Epoch(time), now_ns
        if kind == "GGA":
            _check_position(sentence)
            self._epoch.position = sentence
        elif kind == "RMC" and sentence.field(1) == "A":
            self._epoch.velocity_enu_mps = _velocity(sentence.number(6, 0.0, 400.0) * KNOT_MPS, sentence, 7)
        elif kind == "VTG":
            self._epoch.velocity_enu_mps = _velocity(sentence.number(6, 0.0, 700.0) / 3.6, sentence, 0)
        elif kind == "GST":
            north, east, up = (sentence.number(k, 0.0, 1e6) for k in (5, 6, 7))
            self._epoch.sigma_enu_m = (east, north, up)
        elif kind == "HDT":
            clockwise = sentence.number(0, 0.0, 360.0)
            self._epoch.heading_rad = math.remainder(math.radians(90.0 - clockwise), 2.0 * math.pi)

    def _finish(self) -> list[GnssFix]:
        epoch, self._epoch = self._epoch, _Epoch()
        if epoch.position is None:
            return []
        return [_fix(epoch, epoch.position, self._start_ns - self._latency_ns, self._sigma_heading_rad)]


def _check_position(gga: Sentence) -> None:
    """Raises BadSentence for an invalid position, before anything is changed."""
    quality = gga.number(5, 0.0, 9.0)
    if math.isnan(quality) or quality != int(quality):
        raise BadSentence(f"GGA quality {gga.field(5)!r}")
    heights = [gga.number(8, -1e4, 1e5), gga.number(10, -200.0, 200.0)]
    values = [gga.angle_rad(1, "latitude"), gga.angle_rad(3, "longitude"), *heights]
    if (gga.field(9), gga.field(11)) not in (("M", "M"), ("", "")):
        raise BadSentence(f"GGA heights in {gga.field(9)!r} and {gga.field(11)!r}")
    if quality > 0 and any(map(math.isnan, values)):
        raise BadSentence("GGA with a fix and without its position")
    for k, low, high in ((6, 0.0, 99.0), (7, 0.0, 100.0), (12, 0.0, 1e4)):
        gga.number(k, low, high)


def _velocity(speed_mps: float, sentence: Sentence, course: int) -> tuple[float, float]:
    """East and north, from speed and course over ground, clockwise from north; a receiver at rest may leave it out."""
    clockwise = math.radians(sentence.number(course, 0.0, 360.0))
    if speed_mps < 0.1 and math.isnan(clockwise):
        return 0.0, 0.0
    return speed_mps * math.sin(clockwise), speed_mps * math.cos(clockwise)


def _fix(epoch: _Epoch, gga: Sentence, stamp_ns: int, sigma_heading_rad: float) -> GnssFix:
    satellites = gga.number(6, 0.0, 99.0)
    return GnssFix(
        stamp_ns=stamp_ns,
        latitude_rad=gga.angle_rad(1, "latitude"),
        longitude_rad=gga.angle_rad(3, "longitude"),
        height_m=gga.number(8, -1e4, 1e5) + gga.number(10, -200.0, 200.0),  # above the geoid, plus geoid separation
        sigma_enu_m=np.array(epoch.sigma_enu_m),
        velocity_enu_mps=np.array([*epoch.velocity_enu_mps, math.nan]),
        sigma_velocity_mps=math.nan,
        heading_rad=epoch.heading_rad,
        sigma_heading_rad=sigma_heading_rad if math.isfinite(epoch.heading_rad) else math.nan,
        solution=SOLUTIONS.get(int(gga.number(5, 0.0, 9.0)), GnssSolution.NONE),
        satellites=0 if math.isnan(satellites) else int(satellites),
        hdop=gga.number(7, 0.0, 100.0),
        correction_age_s=gga.number(12, 0.0, 1e4),
        constellations=CONSTELLATIONS.get(gga.talker, ""),
    )
