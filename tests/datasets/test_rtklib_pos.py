"""RTKLIB solution files: geodetic, earth-fixed and baseline coordinates, time systems, qualities, damaged rows."""

import math
from pathlib import Path

import numpy as np
import pytest

from datasets.importers.formats import open_recording
from datasets.importers.recording import Recording
from messages.errors import LogError
from messages.sensors import GnssFix, GnssSolution
from tests.datasets.imported import fixes_of

S = 1_000_000_000
NOON_NS = 1_433_160_000 * S  # 2015-06-01 12:00 UTC; GPS time is 16 s ahead
# Header and rows in the format of RTKPOST 2.4.2
LLH = """% program   : RTKPOST ver.2.4.2
% obs start : 2015/06/01 12:00:16.0 GPST (week1847 129616.0s)
% ref pos   :  47.000000000   19.000000000   100.0000
%
% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio
"""  # noqa: E501
ROW = "2015/06/01 12:00:16.000   47.480954411  -19.056534073   181.7826   1   9   0.0125   0.0103   0.0333   0.0028  -0.0021   0.0049   0.80   12.3\n"  # noqa: E501


def opened(folder: Path, text: str) -> Recording:
    path = folder / "solution.pos"
    path.write_text(text)
    return open_recording(path)


def test_geodetic(tmp_path: Path) -> None:
    ((receive_ns, topic, fix),) = opened(tmp_path, LLH + ROW).read()
    assert isinstance(fix, GnssFix)
    assert (receive_ns, topic, fix.stamp_ns) == (NOON_NS, "gnss/rtklib", NOON_NS)
    place = math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad), fix.height_m
    assert place == pytest.approx((47.480954411, -19.056534073, 181.7826), abs=1e-12)
    assert fix.sigma_enu_m.tolist() == [0.0103, 0.0125, 0.0333]
    assert (fix.solution, fix.satellites, fix.correction_age_s) == (GnssSolution.RTK_FIXED, 9, 0.8)
    assert np.isnan([fix.hdop, fix.heading_rad, fix.sigma_velocity_mps, *fix.velocity_enu_mps]).all()


@pytest.mark.parametrize(
    ("system", "time", "offset_s"),
    [
        ("GPST", "2015/06/01 12:00:16.250", 0.25),
        ("UTC", "2015/06/01 12:00:00.250", 0.25),
        ("JST", "2015/06/01 21:00:00.250", 0.25),
        ("GPST", "1847 129616.250", 0.25),
        ("GPST", "2017/01/01 00:00:18", 1_483_228_800 - 1_433_160_000),
        ("UTC", "2015/05/31 23:59:59.9", -43_200.1),
    ],
)
def test_time_systems(tmp_path: Path, system: str, time: str, offset_s: float) -> None:
    text = LLH.replace("%  GPST", f"%  {system}") + ROW.replace("2015/06/01 12:00:16.000", time)
    (fix,) = fixes_of(opened(tmp_path, text))
    assert fix.stamp_ns - NOON_NS == round(offset_s * S)


@pytest.mark.parametrize(
    ("quality", "solution", "age_s"),
    [(1, GnssSolution.RTK_FIXED, 0.8), (2, GnssSolution.RTK_FLOAT, 0.8), (3, GnssSolution.SBAS, 0.8),
     (4, GnssSolution.SBAS, 0.8), (5, GnssSolution.SINGLE, math.nan), (6, GnssSolution.PPP, math.nan),
     (0, GnssSolution.NONE, math.nan), (7, GnssSolution.NONE, math.nan)],
)  # fmt: skip
def test_qualities(tmp_path: Path, quality: int, solution: GnssSolution, age_s: float) -> None:
    (fix,) = fixes_of(opened(tmp_path, LLH + ROW.replace("   1   9", f"   {quality}   9")))
    assert fix.solution is solution
    assert fix.correction_age_s == pytest.approx(age_s, nan_ok=True)


def test_other_columns(tmp_path: Path) -> None:
    head = "%  UTC,latitude(d'\"),longitude(d'\"),height(m),Q,ns,sdn(m),sde(m),sdu(m),age(s),vn(m/s),ve(m/s),vu(m/s)\n"
    row = "2015/06/01 12:00:00.000,47,28,51.43588,-19,03,23.52266,181.7826,2,9,0,0,0,1.5,0.5,-1.5,0.1\n"
    (fix,) = fixes_of(opened(tmp_path, head + row))
    place = math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad)
    assert place == pytest.approx((47.480954411, -19.056534073), abs=1e-9)
    assert fix.velocity_enu_mps.tolist() == [-1.5, 0.5, 0.1]
    assert np.isnan(fix.sigma_enu_m).all()  # all zero: not estimated


def test_geodetic_height_is_unknown(tmp_path: Path) -> None:
    recording = opened(tmp_path, LLH.replace("ellipsoidal", "geodetic") + ROW)
    assert math.isnan(fixes_of(recording)[0].height_m)
    assert recording.description.notes == ("geodetic heights: the ellipsoidal height is unknown",)


def test_earth_fixed(tmp_path: Path) -> None:
    """Same place and covariance as ROW, calculated by hand: at latitude 0 and longitude 90° x is west, y is up."""
    head = "%  GPST  x-ecef(m) y-ecef(m) z-ecef(m) Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) sdzx(m) age(s) ratio\n"
    row = "2015/06/01 12:00:16.000 0.0000 6378187.0000 0.0000 1 9 0.02 0.03 0.04 0.01 0.01 -0.01 0.80 12.3\n"
    (fix,) = fixes_of(opened(tmp_path, head + row))
    assert math.degrees(fix.longitude_rad) == pytest.approx(90.0)
    assert fix.height_m == pytest.approx(50.0, abs=1e-6)
    assert fix.sigma_enu_m == pytest.approx([0.02, 0.04, 0.03])


def test_baseline(tmp_path: Path) -> None:
    head = LLH.splitlines(keepends=True)[2] + (
        "%  GPST  e-baseline(m) n-baseline(m) u-baseline(m) Q ns sde(m) sdn(m) sdu(m) sden(m) sdnu(m) sdue(m) age(s)\n"
    )
    row = "2015/06/01 12:00:16.000 0.0000 100.0000 5.0000 1 9 0.01 0.02 0.03 0 0 0 0.80\n"
    (fix,) = fixes_of(opened(tmp_path, head + row))
    assert math.degrees(fix.latitude_rad) == pytest.approx(47.0 + 100.0 / 111_172.6, abs=1e-9)  # arc of 1° at 47°
    assert fix.height_m == pytest.approx(105.0, abs=1e-3)
    assert fix.sigma_enu_m.tolist() == [0.01, 0.02, 0.03]
    with pytest.raises(LogError, match=r"without the position of its base"):
        list(opened(tmp_path, head.splitlines(keepends=True)[1] + row).read())


@pytest.mark.parametrize(
    "row",
    [
        ROW[:60] + "\n",
        ROW.replace("47.480954411", "97.480954411"),
        ROW.replace("47.480954411", "nan"),
        ROW.replace("47.480954411", "4_7.48"),
        ROW.replace("47.480954411", "1e9999"),
        ROW.replace("0.0125", "-0.0125"),
        ROW.replace("2015/06/01", "2015/13/01"),
        ROW.replace("12:00:16", "12:61:16"),
        ROW.replace("12:00:16", "12-00-16"),
        ROW.replace("   1   9", "   1.5   9"),
        ROW.replace("   1   9", "   1   -9"),
        ROW.replace("2015/06/01 12:00:16.000", "99999999999999999999 1.0"),
        "\x00\xff garbage\n",
    ],
)
def test_bad_row_is_counted(tmp_path: Path, row: str) -> None:
    recording = opened(tmp_path, LLH + row + ROW.replace("16.000", "17.000"))
    (fix,) = fixes_of(recording)
    assert fix.stamp_ns == NOON_NS + S
    assert recording.table()[0].skipped == 1


def test_datum_and_empty_file(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"datum Tokyo is not WGS84"):
        list(opened(tmp_path, LLH.replace("WGS84", "Tokyo") + ROW).read())
    with pytest.raises(LogError, match=r"contains no readable message"):
        list(opened(tmp_path, LLH).read())
