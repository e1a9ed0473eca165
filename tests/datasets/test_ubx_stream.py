"""UBX: values of NAV messages by epoch, times with and without a week, only what is valid."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyubx2 import GET, UBXMessage

from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from messages.sensors import GnssFix, GnssSolution

S = 1_000_000_000
TOW_MS = 555_072_500  # Saturday 2026-11-21 10:11:12.5 UTC, GPS week 2445
STAMP_NS = 1_795_255_872 * S + S // 2
PVT = {
    "iTOW": TOW_MS + 18_000, "year": 2026, "month": 11, "day": 21, "hour": 10, "min": 11, "second": 12,
    "nano": 500_000_000, "validDate": 1, "validTime": 1, "fixType": 3, "gnssFixOk": 1, "diffSoln": 1, "carrSoln": 2,
    "numSV": 21, "lat": 51.5115, "lon": 6.0625, "height": 70_600, "hMSL": 24_100, "hAcc": 14, "vAcc": 15,
    "velN": 100, "velE": -200, "velD": 30, "sAcc": 50, "headMot": 296.5, "headAcc": 2.0, "lastCorrectionAge": 2,
}  # fmt: skip
AT = {"iTOW": PVT["iTOW"]}


def message(name: str, **fields: Any) -> bytes:
    data: bytes = UBXMessage("NAV", f"NAV-{name}", GET, **fields).serialize()
    return data


def opened(folder: Path, *messages: bytes) -> Recording:
    path = folder / "stream.ubx"
    path.write_bytes(b"".join(messages))
    return open_recording(path)


def one_fix(folder: Path, *messages: bytes) -> GnssFix:
    ((_, topic, fix),) = opened(folder, *messages).read()
    assert topic == "gnss/ubx"
    assert isinstance(fix, GnssFix)
    return fix


def test_nav_pvt(tmp_path: Path) -> None:
    fix = one_fix(tmp_path, message("PVT", **PVT))
    assert fix.stamp_ns == STAMP_NS
    assert math.degrees(fix.latitude_rad) == pytest.approx(51.5115, abs=1e-9)
    assert math.degrees(fix.longitude_rad) == pytest.approx(6.0625, abs=1e-9)
    assert fix.height_m == pytest.approx(70.6)
    assert fix.sigma_enu_m == pytest.approx([0.014, 0.014, 0.015])
    assert fix.velocity_enu_mps == pytest.approx([-0.2, 0.1, -0.03])
    assert fix.sigma_velocity_mps == pytest.approx(0.05)
    assert (fix.solution, fix.satellites, fix.correction_age_s) == (GnssSolution.RTK_FIXED, 21, 2.0)
    assert np.isnan([fix.heading_rad, fix.sigma_heading_rad, fix.hdop]).all()
    assert fix.constellations == ""


@pytest.mark.parametrize(
    ("fields", "solution"),
    [
        ({"carrSoln": 1}, GnssSolution.RTK_FLOAT),
        ({"carrSoln": 0}, GnssSolution.SBAS),
        ({"carrSoln": 0, "diffSoln": 0}, GnssSolution.SINGLE),
        ({"fixType": 4}, GnssSolution.RTK_FIXED),
        ({"gnssFixOk": 0}, GnssSolution.NONE),
        ({"fixType": 1}, GnssSolution.NONE),
        ({"fixType": 5}, GnssSolution.NONE),
    ],
)
def test_solutions(tmp_path: Path, fields: dict[str, int], solution: GnssSolution) -> None:
    fix = one_fix(tmp_path, message("PVT", **PVT | fields))
    assert fix.solution is solution
    assert math.isnan(fix.latitude_rad) == (solution is GnssSolution.NONE)


@pytest.mark.parametrize(("value", "age_s"), [(0, math.nan), (1, 1.0), (5, 15.0), (11, 120.0), (12, math.inf)])
def test_correction_age_is_an_upper_bound(tmp_path: Path, value: int, age_s: float) -> None:
    fix = one_fix(tmp_path, message("PVT", **PVT | {"lastCorrectionAge": value}))
    assert fix.correction_age_s == pytest.approx(age_s, nan_ok=True)


def test_invalid_position_and_valid_heading_of_pvt(tmp_path: Path) -> None:
    fix = one_fix(tmp_path, message("PVT", **PVT | {"invalidLlh": 1, "headVehValid": 1, "headVeh": 100.0}))
    assert np.isnan([fix.latitude_rad, *fix.sigma_enu_m]).all()
    assert math.degrees(fix.heading_rad) == pytest.approx(-10.0)
    assert math.degrees(fix.sigma_heading_rad) == pytest.approx(2.0, abs=2e-5)


def test_high_precision_covariance_and_dop(tmp_path: Path) -> None:
    covariance = {f"posCov{name}": value for name, value in (("NN", 4e-4), ("EE", 1e-4), ("DD", 9e-4))}
    fix = one_fix(
        tmp_path,
        message(
            "HPPOSLLH", **AT, lat=51.5115, lon=6.0625, _HPlat=3.1e-9, height=70_600, _HPheight=0.4, hAcc=9, vAcc=12
        ),
        message("PVT", **PVT),
        message("COV", **AT, posCovValid=1, velCovValid=1, velCovNN=0.01, velCovEE=0.04, **covariance),
        message("DOP", **AT, hDOP=0.7),
    )
    assert math.degrees(fix.latitude_rad) == pytest.approx(51.511500003, abs=1.1e-10)
    assert fix.height_m == pytest.approx(70.6004)
    assert fix.sigma_enu_m == pytest.approx([0.01, 0.02, 0.03], rel=1e-5)
    assert (fix.sigma_velocity_mps, fix.hdop) == pytest.approx((0.2, 0.7))


@pytest.mark.parametrize(("is_moving", "is_valid"), [(1, 1), (0, 1), (1, 0)])
def test_heading_of_a_moving_base_line_only(tmp_path: Path, is_moving: int, is_valid: int) -> None:
    relative = {"relPosValid": 1, "isMoving": is_moving, "relPosHeadingValid": is_valid, "relPosHeading": 90.0}
    fix = one_fix(tmp_path, message("PVT", **PVT), message("RELPOSNED", version=1, **AT, **relative, accHeading=0.2))
    if is_moving and is_valid:
        assert fix.heading_rad == pytest.approx(0.0)
        assert math.degrees(fix.sigma_heading_rad) == pytest.approx(0.2, abs=2e-5)
    else:
        assert np.isnan([fix.heading_rad, fix.sigma_heading_rad]).all()


def test_satellites_in_use(tmp_path: Path) -> None:
    used = [(0, 1), (3, 1), (2, 0), (1, 1)]
    rows = {f"{name}_{k:02d}": v[i] for k, v in enumerate(used, 1) for i, name in enumerate(("gnssId", "svUsed"))}
    fix = one_fix(tmp_path, message("PVT", **PVT), message("SAT", **AT, version=1, numSvs=4, **rows))
    assert fix.constellations == "GPS+BDS"


OLD = {"iTOW": PVT["iTOW"]}


def test_messages_of_old_receivers(tmp_path: Path) -> None:
    sol = message("SOL", **OLD, week=2445, gpsFix=3, gpsfixOK=1, diffSoln=1, wknSet=1, towSet=1, numSV=9,
                  ecefX=637_818_700, pAcc=250)  # fmt: skip
    posllh = message("POSLLH", **OLD, lat=51.5, lon=6.0, height=70_000, hAcc=2500, vAcc=4000)
    velned = message("VELNED", **OLD, velN=10, velE=20, velD=-30, sAcc=5)
    fix = one_fix(tmp_path, sol, posllh, velned)
    assert (fix.stamp_ns, fix.solution, fix.satellites) == (STAMP_NS, GnssSolution.SBAS, 9)
    assert (math.degrees(fix.latitude_rad), fix.height_m) == pytest.approx((51.5, 70.0))
    assert fix.velocity_enu_mps == pytest.approx([0.2, 0.1, 0.3])
    alone = one_fix(tmp_path, sol)
    assert (alone.latitude_rad, alone.longitude_rad, alone.height_m) == pytest.approx((0.0, 0.0, 50.0), abs=1e-6)
    without = one_fix(tmp_path, posllh)
    assert without.solution is GnssSolution.NONE  # nothing says that there is one


def test_week_rollover_and_week_from_a_later_message(tmp_path: Path) -> None:
    end = 7 * 86_400_000
    posllh = [message("POSLLH", iTOW=tow, lat=51.5, lon=6.0) for tow in (end - 100, 0)]
    week = message("TIMEGPS", iTOW=0, week=2446, towValid=1, weekValid=1)
    stamps = [m.stamp_ns for _, _, m in opened(tmp_path, *posllh, week).read()]
    assert stamps == [stamps[1] - S // 10, (315_964_800 + 2446 * 7 * 86_400 - 18) * S]


def test_without_week(tmp_path: Path) -> None:
    recording = opened(tmp_path, message("POSLLH", iTOW=1000, lat=51.5, lon=6.0))
    assert [m.stamp_ns for _, _, m in recording.read()] == [315_964_801 * S]
    assert recording.description.notes == (
        "UBX without a week number: times count from the first GPS week, 1980-01-06",
    )


def test_bad_messages_are_counted_and_the_rest_is_read(tmp_path: Path) -> None:
    good, bad = message("PVT", **PVT), bytearray(message("DOP", **AT, hDOP=0.7))
    bad[8] ^= 1
    impossible = message("POSLLH", iTOW=PVT["iTOW"], lat=200.0, lon=6.0)
    late = message("PVT", **PVT | {"iTOW": 7 * 86_400_000})
    nothing = b"\xb5\x62\x01\x07\xff\x7f" + b"x" * 40
    recording = opened(tmp_path, nothing, bytes(bad), impossible, late, good, good[:50])
    ((_, _, fix),) = recording.read()
    assert isinstance(fix, GnssFix)
    assert math.isnan(fix.hdop)
    assert sum(recording.table()[0].reasons.values()) == 5
