"""UBX (u-blox): the NAV messages of one iTOW as values of one epoch.

Sources: u-blox F9 HPG 1.32 interface description; of M8 and LEA-4 for NAV-SOL and NAV-SVINFO. u-blox gives one
horizontal accuracy, which is used for east and north alike unless NAV-COV has both.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from typing import Any

import numpy as np
from pyubx2 import UBXReader
from pyubx2.exceptions import UBXMessageError, UBXParseError, UBXStreamError, UBXTypeError

from datasets.importers.gnss.clock import WEEK_NS, S, day_ns, gps_of_utc
from geometry.angles import wrap
from geometry.geodesy import ellipsoidal
from messages.errors import LogError
from messages.sensors import GnssSolution

MS = 1_000_000
NO_DOP = 99.0  # 99.99: unknown
# Upper bounds (s) of the values 0 to 11 of lastCorrectionAge in NAV-PVT; above: older than 120 s, without a bound
AGE_S = (math.nan, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)
SYSTEMS = {0: "GPS", 6: "GLO", 2: "GAL", 3: "BDS", 5: "QZSS", 7: "NAVIC"}  # gnssId
SVIDS = {"GPS": (1, 32), "GLO": (65, 96), "GAL": (211, 246), "BDS": (159, 163), "QZSS": (193, 197)}  # of NAV-SVINFO
POSITIONS = ("NAV-PVT", "NAV-HPPOSLLH", "NAV-POSLLH", "NAV-SOL")
PLACE = ("latitude_rad", "longitude_rad", "height_m", "sigma_enu_m", "velocity_enu_mps", "sigma_velocity_mps")
Values = dict[str, Any]


@dataclass
class Epoch:
    """Values of one iTOW, by message; `gps_ns` is the GPS time, where a message of the epoch has a date or week."""

    tow_ns: int
    gps_ns: int | None = None
    values: dict[str, Values] = field(default_factory=dict)

    @property
    def has_position(self) -> bool:
        """Whether a message with a position was received."""
        return not self.values.keys().isdisjoint(POSITIONS)

    def merged(self) -> Values:
        """All known values; those of later entries of `READERS` replace those of earlier ones."""
        merged: Values = {}
        for kind in READERS:
            merged |= self.values.get(kind, {})
        if merged.get("solution") is GnssSolution.NONE:  # NAV-POSLLH then has the last or a coarse position
            merged = {name: value for name, value in merged.items() if name not in PLACE}
        return merged


class UbxEpochs:
    """Collects messages; `add` returns the epoch that a message completes."""

    def __init__(self) -> None:
        self._epoch: Epoch | None = None

    def add(self, data: bytes) -> Epoch | None:
        """Stores the values of a framed message of `READERS`; raises LogError and then changes nothing."""
        try:
            message: Any = UBXReader.parse(data)
            values, tow_ns = READERS[message.identity](message), message.iTOW * MS
        except (UBXMessageError, UBXParseError, UBXStreamError, UBXTypeError, AttributeError, ValueError) as error:
            raise LogError(" ".join(str(error).split())) from error
        if tow_ns >= WEEK_NS:
            raise LogError("iTOW is not within a week")
        done = None
        if self._epoch is None or self._epoch.tow_ns != tow_ns:
            done, self._epoch = self.finish(), Epoch(tow_ns)
        self._epoch.gps_ns = values.pop("gps_ns", self._epoch.gps_ns)
        self._epoch.values[message.identity] = values
        return done

    def finish(self) -> Epoch | None:
        """The epoch not yet complete, if it has a position."""
        return self._epoch if self._epoch is not None and self._epoch.has_position else None


def _pvt(m: Any) -> Values:
    is_fix = bool(m.gnssFixOk) and m.fixType in (2, 3, 4)  # 1 dead reckoning, 5 time only
    values: Values = {"solution": _solution(is_fix, m.diffSoln, m.carrSoln), "satellites": m.numSV}
    if m.validDate and m.validTime:
        values["gps_ns"] = gps_of_utc(_utc_ns(m, m.second))
    if not is_fix:
        return values
    values |= _velocity((m.velE, m.velN, m.velD, m.sAcc), 1e-3)
    if age := getattr(m, "lastCorrectionAge", 0):
        values["correction_age_s"] = AGE_S[age] if age < len(AGE_S) else math.inf
    if m.headVehValid:
        values |= _heading(m.headVeh, m.headAcc)
    return values | ({} if getattr(m, "invalidLlh", 0) else _place(m))


def _sol(m: Any) -> Values:
    is_fix = bool(m.gpsfixOK) and m.gpsFix in (2, 3, 4)
    values: Values = {"solution": _solution(is_fix, m.diffSoln, 0), "satellites": m.numSV}
    if m.wknSet and m.towSet and m.week >= 0:
        values["gps_ns"] = m.week * WEEK_NS + m.iTOW * MS
    if is_fix:
        position_m = np.array((m.ecefX, m.ecefY, m.ecefZ)) * 1e-2
        values |= _of_earth(position_m, m.pAcc * 1e-2)
    return values


def _status(m: Any) -> Values:
    is_fix = bool(m.gpsFixOk) and m.gpsFix in (2, 3, 4)
    return {"solution": _solution(is_fix, m.diffSoln, m.carrSoln if m.carrSolnValid else 0)}


def _hpposllh(m: Any) -> Values:
    return {} if m.invalidLlh else _place(m)


def _velned(m: Any) -> Values:
    return _velocity((m.velE, m.velN, m.velD, m.sAcc), 1e-2)


def _cov(m: Any) -> Values:
    values: Values = {}
    if m.posCovValid:
        values["sigma_enu_m"] = _root(m.posCovEE, m.posCovNN, m.posCovDD)
    if m.velCovValid:
        values["sigma_velocity_mps"] = float(np.max(_root(m.velCovEE, m.velCovNN)))
    return values


def _relposned(m: Any) -> Values:
    """Heading of a moving base line; relative to a fixed base the direction says nothing of the machine."""
    is_heading = m.relPosValid and m.isMoving and getattr(m, "relPosHeadingValid", 0)
    return _heading(m.relPosHeading, m.accHeading) if is_heading else {}


def _dop(m: Any) -> Values:
    return {"hdop": m.hDOP} if m.hDOP < NO_DOP else {}


def _sat(m: Any) -> Values:
    n = range(1, m.numSvs + 1)
    return _used(SYSTEMS.get(getattr(m, f"gnssId_{k:02d}"), "") for k in n if getattr(m, f"svUsed_{k:02d}"))


def _sig(m: Any) -> Values:
    n = range(1, m.numSigs + 1)
    return _used(SYSTEMS.get(getattr(m, f"gnssId_{k:02d}"), "") for k in n if getattr(m, f"prUsed_{k:02d}"))


def _svinfo(m: Any) -> Values:
    used = [getattr(m, f"svid_{k:02d}") for k in range(1, m.numCh + 1) if getattr(m, f"svUsed_{k:02d}")]
    return _used(name for name, (low, high) in SVIDS.items() for svid in used if low <= svid <= high)


def _timegps(m: Any) -> Values:
    return {"gps_ns": m.week * WEEK_NS + m.iTOW * MS} if m.towValid and m.weekValid and m.week >= 0 else {}


def _timeutc(m: Any) -> Values:
    return {"gps_ns": gps_of_utc(_utc_ns(m, m.sec))} if m.validUTC else {}


def _utc_ns(m: Any, second: int) -> int:
    time_s = int(m.hour) * 3600 + int(m.min) * 60 + second
    return day_ns(date(m.year, m.month, m.day)) + time_s * S + int(m.nano)


def _solution(is_fix: bool, is_differential: int, carrier: int) -> GnssSolution:
    if not is_fix:
        return GnssSolution.NONE
    if carrier:
        return GnssSolution.RTK_FIXED if carrier == 2 else GnssSolution.RTK_FLOAT
    return GnssSolution.SBAS if is_differential else GnssSolution.SINGLE


def _place(m: Any) -> Values:
    """Position of NAV-PVT, NAV-POSLLH or NAV-HPPOSLLH: degrees and mm."""
    if not (abs(m.lat) <= 90.0 and abs(m.lon) <= 180.0):
        raise LogError(f"position {m.lat}, {m.lon} is not on the earth")
    sigma_m = np.array((m.hAcc, m.hAcc, m.vAcc), np.float64) * 1e-3
    place = {"latitude_rad": math.radians(m.lat), "longitude_rad": math.radians(m.lon), "height_m": m.height * 1e-3}
    return place | {"sigma_enu_m": sigma_m}


def _of_earth(position_m: Any, sigma_m: float) -> Values:
    """An earth-fixed position with one accuracy for all directions."""
    latitude, longitude, height = ellipsoidal(*position_m)
    place = {"latitude_rad": latitude, "longitude_rad": longitude, "height_m": height}
    return place | {"sigma_enu_m": np.full(3, sigma_m)}


def _velocity(ned: tuple[float, ...], unit: float) -> Values:
    east, north, down, sigma = (v * unit for v in ned)
    return {"velocity_enu_mps": np.array((east, north, -down)), "sigma_velocity_mps": sigma}


def _heading(clockwise_deg: float, sigma_deg: float) -> Values:
    return {"heading_rad": wrap(math.radians(90.0 - clockwise_deg)), "sigma_heading_rad": math.radians(sigma_deg)}


def _root(*variance: float) -> Any:
    return np.sqrt(np.where(np.array(variance) >= 0.0, variance, np.nan))


def _used(names: Any) -> Values:
    used = set(names)
    return {"constellations": "+".join(name for name in SYSTEMS.values() if name in used)}


# Order: values of later messages replace those of earlier ones.
READERS: dict[str, Callable[[Any], Values]] = {
    "NAV-TIMEUTC": _timeutc, "NAV-TIMEGPS": _timegps, "NAV-SVINFO": _svinfo, "NAV-SIG": _sig, "NAV-SAT": _sat,
    "NAV-SOL": _sol, "NAV-STATUS": _status, "NAV-POSLLH": _place, "NAV-VELNED": _velned, "NAV-PVT": _pvt,
    "NAV-HPPOSLLH": _hpposllh, "NAV-RELPOSNED": _relposned, "NAV-DOP": _dop, "NAV-COV": _cov,
}  # fmt: skip
