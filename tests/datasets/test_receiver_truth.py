"""Receiver streams against what gpsd decodes from the same bytes (`.chk`), and every file of devices/gnss.

Compared with gpsd's reports (TPV) of the same time: whether there is a position, latitude and longitude to 1e-9°
(its last digit), ellipsoidal height to 2 mm, speed to 2 mm/s, each of one report at least, since gpsd reports while an
epoch is still incomplete. Every time at which gpsd has a position has a fix. Two epochs with a solution may lack a
report: gpsd needs a complete cycle and a date first. Without a solution gpsd often reports no time. HDOP and the number
of satellites of every solution are among those that gpsd reports (SKY, which has no time).
"""

import gzip
import io
import json
import math
from collections import Counter, defaultdict
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from pyubx2 import ERR_IGNORE, RTCM3_PROTOCOL, UBX_PROTOCOL, UBXReader

from datasets.importers.formats import open_recording
from datasets.importers.gnss.framing import frames
from messages.errors import LogError
from messages.sensors import GnssFix, GnssSolution
from tests.recordings import DATA

GNSS = DATA / "devices/gnss"
pytestmark = pytest.mark.skipif(not GNSS.exists(), reason=f"needs recordings: devices/gnss not in {DATA}")
MS, WEEK_MS = 1_000_000, 7 * 86_400_000
ERA_MS = 1024 * WEEK_MS  # gpsd moves dates before its own release by multiples of 1024 weeks
MAX_UNREPORTED = 2
# Differences with their reasons, by file
DIFFERENCES = {
    "ac12_binary.log": {"position", "height"},  # gpsd prefers Ashtech's own PASHR, not read here, to GGA
    "bundg_zeus_9.log": {"position", "height", "speed"},  # GGA is 1 s behind RMC of the same time; gpsd reports both
    "ericsson-gru04-02-70sec.log": {"speed"},  # gpsd uses knots of VTG (0.1 kn), here km/h are used, which are finer
    "hemi.log": {"position", "speed"},  # gpsd refuses GGA with 0 satellites; here the fix states 0 satellites
    "ublox-lea-m8f.log": {"position"},  # fixed position of a timing receiver (fixType 5): not a measured one
    "ublox-lea-4t.log": {"missing"},  # first report: gpsd does not know the leap seconds yet and assumes 18, not 15
}
STREAMS = sorted(GNSS.glob("gpsd/*.log"))
# Not NMEA or UBX, or without positions: gpsd has no reports of positions from what is read here
UNREAD = {
    "bu303-moving", "bu303-stillfix", "hp58534a", "italk-binary", "naujoks-ntrip", "oncore-binary",
    "oncore-binary-pos-hold", "oncore-m12", "rtcm3.2", "sirfstarv", "skytraq-A8", "skytraq-bin", "skytraq-err",
    "superstar2", "tnt-revolution", "trimble-lassen_iq", "trimble-lassen_iq-3dfix", "zodiac", "pypilot",
}  # fmt: skip


def objects(stream: Path) -> list[dict[str, Any]]:
    """gpsd's reports of all classes."""
    packed = stream.with_name(stream.name + ".chk.gz")
    text = gzip.decompress(packed.read_bytes()) if packed.exists() else Path(f"{stream}.chk").read_bytes()
    return [json.loads(line) for line in text.splitlines() if line.startswith(b"{")]


def reports(stream: Path) -> dict[int, list[dict[str, Any]]]:
    """gpsd's reports of positions with a time, by Unix time in ms."""
    found: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for report in objects(stream):
        if report["class"] == "TPV" and "time" in report:
            found[round(datetime.fromisoformat(report["time"]).timestamp() * 1000) % ERA_MS].append(report)
    return found


def differences(fix: GnssFix, report: dict[str, Any]) -> set[str]:
    """Names of the values that differ from a report."""
    if (fix.solution is GnssSolution.NONE) != (report["mode"] < 2):
        return {"position"}
    if fix.solution is GnssSolution.NONE:
        return set()
    found = set()
    place = math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad)
    if max(abs(place[0] - report["lat"]), abs(place[1] - report["lon"])) > 1.1e-9:
        found.add("position")
    if math.isfinite(fix.height_m) and not abs(fix.height_m - report.get("altHAE", math.inf)) <= 2e-3:
        found.add("height")
    speed_mps = math.hypot(*fix.velocity_enu_mps[:2])
    if math.isfinite(speed_mps) and "speed" in report and abs(speed_mps - report["speed"]) > 2e-3:
        found.add("speed")
    return found


@pytest.mark.parametrize("stream", [s for s in STREAMS if s.stem not in UNREAD], ids=lambda s: s.stem)
def test_fixes_agree_with_gpsd(stream: Path) -> None:
    by_time = reports(stream)
    fixes = [message for _, _, message in open_recording(stream).read() if isinstance(message, GnssFix)]
    times = [round(fix.stamp_ns / MS) % ERA_MS for fix in fixes]
    found: set[str] = set()
    for fix, time_ms in zip(fixes, times, strict=True):
        if time_ms in by_time:
            found |= min((differences(fix, report) for report in by_time[time_ms]), key=len)
    unreported = [
        f for f, t in zip(fixes, times, strict=True) if t not in by_time and f.solution is not GnssSolution.NONE
    ]
    with_position = {time_ms for time_ms, rows in by_time.items() if any(row["mode"] >= 2 for row in rows)}
    found |= {"missing"} if with_position - set(times) else set()
    assert found == DIFFERENCES.get(stream.name, set())
    assert len(unreported) <= MAX_UNREPORTED


@pytest.mark.parametrize("stream", [s for s in STREAMS if s.stem not in UNREAD], ids=lambda s: s.stem)
def test_satellites_and_hdop_agree_with_gpsd(stream: Path) -> None:
    skies = [report for report in objects(stream) if report["class"] == "SKY"]
    numbers = {sky["uSat"] for sky in skies if "uSat" in sky}
    numbers |= {sum(s["used"] for s in sky["satellites"]) for sky in skies if "satellites" in sky}
    fixes = [m for _, _, m in open_recording(stream).read() if isinstance(m, GnssFix) and m.solution > 0]
    extra = {0} if stream.stem == "hemi" else set()  # gpsd has no fix then, see DIFFERENCES
    assert {fix.satellites for fix in fixes} - {None} <= numbers | extra
    hdops = {round(fix.hdop, 2) for fix in fixes if not math.isnan(fix.hdop)}
    assert hdops <= {round(sky["hdop"], 2) for sky in skies if "hdop" in sky}


MGA = {
    "pyubx2/assistnow.log",
    "pyubx2/pygpsdata-MGASF.log",
}  # messages to a receiver, which pyubx2 does not read as output


@pytest.mark.parametrize("folder", ["gpsd", "pyubx2", "pyrtcm", "pygnssutils", "rtklib"])
def test_numbers_of_messages_agree_with_pyubx2(folder: str) -> None:
    total = 0
    for path in sorted(p for p in GNSS.glob(f"{folder}/*") if p.suffix in (".log", ".ubx", ".bin", ".rtcm3")):
        data = path.read_bytes()
        if path.relative_to(GNSS).as_posix() in MGA or (b"\xb5\x62" not in data and b"\xd3\x00" not in data):
            continue
        reader = UBXReader(io.BytesIO(data), protfilter=UBX_PROTOCOL | RTCM3_PROTOCOL, quitonerror=ERR_IGNORE)
        expected = Counter("UBX" if raw[0] == 0xB5 else "RTCM 3" for raw, _ in reader)
        found = Counter(frame.protocol for frame in frames(data) if not frame.fault and frame.protocol != "NMEA 0183")
        assert found == expected, path
        total += expected.total()
    assert total > 0


@pytest.mark.parametrize(
    "path", sorted(p for p in GNSS.rglob("*") if p.is_file()), ids=lambda p: f"{p.parent.name}-{p.name}"
)
def test_every_file_is_imported_or_refused_with_the_reason(path: Path) -> None:
    try:
        recording = open_recording(path)
        messages = list(recording.read())
    except LogError as error:
        text = str(error).removeprefix(str(path))
        if text == str(error) or len(text) < len(": is empty"):
            pytest.fail(f"refused without the file or a reason: {error}")
        return
    fixes = [message for _, _, message in messages if isinstance(message, GnssFix)]
    assert fixes
    assert sum(row.read for row in recording.table()) == len(messages)
    for fix in fixes:
        assert not abs(fix.latitude_rad) > math.pi / 2
        assert (fix.solution is GnssSolution.NONE) or not math.isnan(fix.latitude_rad)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("pysbf2/pygpsdata_x5pvt.log", "a Septentrio SBF stream"),
        ("novatel_edie/BESTUTMBIN.GPS.BINARY", "a NovAtel binary stream"),
        ("novatel_edie/BESTUTMBIN.GPS.ASCII", "a NovAtel or Unicore ASCII stream"),
        ("novatel_edie/BESTUTMBIN.GPS.ABBREV_ASCII", "a NovAtel abbreviated ASCII stream"),
        ("gpsd/sirfstarv.log", "a SiRF binary stream"),
        ("gpsd/skytraq-A8.log", "a SkyTraq binary stream"),
        ("gpsd/oncore-m12.log", "a Motorola Oncore stream"),
        ("gpsd/zodiac.log", "a Rockwell Zodiac stream"),
        ("gpsd/trimble-lassen_iq.log", "a Trimble TSIP stream"),
        ("gpsd/trimble-lassen_iq-3dfix.log", "a Trimble TSIP stream"),
        ("gpsd/superstar2.log", "a NovAtel SuperStar II stream"),
        ("gpsd/italk-binary.log", "a Fastrax iTalk stream"),
        ("gpsd/naujoks-ntrip.log", "an RTCM 2 stream"),
        ("gpsd/rtcm3.2.log", "an RTCM 3 stream"),
        ("rtklib/testglo.rtcm3", "an RTCM 3 stream"),
        ("rtklib/testglo.rtcm2", "an RTCM 2 stream"),
        ("pyrtcm/pygpsdata-1240-1264.log", "an RTCM 3 stream"),
        ("pyubx2/pygpsdata-CFG.log", "1 UBX CFG-ANT"),
        ("gpsd/tnt-revolution.log", "50 NMEA 0183 PTNTHTM"),
    ],
)
def test_refusal_names_the_format(name: str, reason: str) -> None:
    with pytest.raises(LogError, match=reason):
        open_recording(GNSS / name)
