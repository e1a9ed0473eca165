"""Damaged receiver streams: nothing but LogError is raised, the readable part is kept, and no value is invented."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError
from pyubx2 import GET, UBXMessage

from datasets.importers.formats import open_recording
from messages.errors import LogError
from messages.sensors import GnssFix
from tests.recordings import SAMPLES

NMEA = (SAMPLES / "gnss/nmea_rtk.log").read_bytes()[284:3000]
UBX = b"".join(
    UBXMessage("NAV", "NAV-PVT", GET, iTOW=555_090_000 + 100 * k, year=2026, month=11, day=21, hour=10, min=11,
               second=12, validDate=1, validTime=1, fixType=3, gnssFixOk=1, carrSoln=2, numSV=20, lat=51.5 + 1e-6 * k,
               lon=6.0 - 1e-6 * k, height=70_000 + k, hAcc=14, vAcc=20, velN=k, velE=-k, sAcc=50).serialize()
    for k in range(8)
)  # fmt: skip
SENTENCES = re.compile(rb"\$[A-Z]{2}(?:GGA|RMC),[^$*!\r\n]*\*[0-9A-Fa-f]{2}")
Change = tuple[int, float, bytes]
CHANGES = st.lists(st.tuples(st.integers(0, 4), st.floats(0.0, 1.0), st.binary(min_size=1, max_size=12)), max_size=12)


def changed(data: bytes, changes: list[Change]) -> bytes:
    """Data with bits changed, bytes replaced, inserted, deleted, or its end cut off."""
    result = bytearray(data)
    for how, place, value in changes:
        at = int(place * len(result))
        if how == 0 and at < len(result):
            result[at] ^= value[0] or 1
        elif how == 1:
            result[at : at + len(value)] = value
        elif how == 2:
            result[at:at] = value
        elif how == 3:
            del result[at : at + 9 * len(value)]
        elif place > 0.5:
            del result[at:]
    return bytes(result)


def fixes_of(folder: Path, data: bytes) -> list[GnssFix]:
    """Fixes of a stream, none when it is refused."""
    path = folder / "stream"
    path.write_bytes(data)
    try:
        return [message for _, _, message in open_recording(path).read() if isinstance(message, GnssFix)]
    except LogError:
        return []


def stated(data: bytes) -> set[tuple[float, float]]:
    """Places of all sentences with a right checksum, read by pynmeagps."""
    places = set()
    for found in SENTENCES.findall(data):
        try:
            message = NMEAReader.parse(found, validate=1)
            places.add((float(message.lat), float(message.lon)))
        except (
            NMEAMessageError,
            NMEAParseError,
            NMEAStreamError,
            NMEATypeError,
            ValueError,
            TypeError,
            AttributeError,
        ):
            continue
    return places


def place_of(fix: GnssFix) -> tuple[float, float]:
    return round(math.degrees(fix.latitude_rad), 9), round(math.degrees(fix.longitude_rad), 9)


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
@given(changes=CHANGES)
def test_damaged_nmea(tmp_path: Path, changes: list[Change]) -> None:
    data = changed(NMEA, changes)
    places = stated(data)
    for fix in fixes_of(tmp_path, data):
        found = math.degrees(fix.latitude_rad), math.degrees(fix.longitude_rad)
        assert math.isnan(fix.latitude_rad) or any(math.dist(found, place) < 1e-9 for place in places)


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
@given(changes=CHANGES)
def test_damaged_ubx(tmp_path: Path, changes: list[Change]) -> None:
    original = {place_of(fix): fix for fix in fixes_of(tmp_path, UBX)}
    assert len(original) == 8
    for fix in fixes_of(tmp_path, changed(UBX, changes)):
        same = original[place_of(fix)]
        assert (fix.stamp_ns, fix.height_m, fix.solution) == (same.stamp_ns, same.height_m, same.solution)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(data=st.binary(max_size=3000), at=st.floats(0.0, 1.0))
def test_bytes_between_messages_cost_only_themselves(tmp_path: Path, data: bytes, at: float) -> None:
    messages = [UBX[k : k + 100] for k in range(0, len(UBX), 100)]
    place = 1 + int(at * (len(messages) - 1))  # at the beginning they could be those of another format
    fixes = fixes_of(tmp_path, b"".join(messages[:place]) + data + b"\r\n" + b"".join(messages[place:]))
    assert len(fixes) >= len(messages)


LINE = NMEA[NMEA.index(b"$") :].splitlines(keepends=True)
HOSTILE: dict[str, tuple[bytes, int]] = {
    "empty lines": (b"\r\n" * 1000, 0),
    "only a dollar": (b"$", 0),
    "zeros": (bytes(100_000), 0),
    "syncs of UBX": (b"\xb5\x62" * 20_000, 0),
    "syncs of RTCM": (b"\xd3\x00" * 20_000, 0),
    "headers of UBX with lengths": (b"\xb5\x62\x01\x07\xff\x3f" * 2000, 0),
    "addresses without end": (b"$GNGGA," * 20_000, 0),
    "a sentence without end": (b"$GNGGA," + b"1" * 100_000, 0),
    "two on one line": (LINE[0].strip() + LINE[2].strip(), 2),
    "one interrupted by the next": (LINE[0][:30] + LINE[0] + LINE[2], 2),
    "line ends of old computers": (LINE[0].strip() + b"\r" + LINE[2].strip() + b"\r", 2),
    "checksums in small letters": (re.sub(rb"\*..", lambda m: m[0].lower(), b"".join(LINE[:4])), 2),
    "byte order mark": (b"\xef\xbb\xbf" + LINE[0], 1),
    "long prefix": (b"x" * 5000 + LINE[0], 1),
    "the same sentence again and again": (LINE[0] * 50, 1),
    "UBX within a sentence": (LINE[0][:20] + UBX[:100] + LINE[0][20:] + LINE[2], 2),
    "a sentence within UBX": (UBX[:50] + LINE[0] + UBX[50:200], 2),
    "time jumps back by a day": (LINE[1] + LINE[1].replace(b"180320", b"170320") + LINE[3], 2),
    "UTF-16": (b"\xff\xfe" + LINE[0].decode().encode("utf-16-le"), 0),
    "NAV-SAT that announces more than it has": (
        UBXMessage(b"\x01", b"\x35", GET, payload=b"\x00" * 5 + b"\xff" + b"\x00" * 14).serialize() + UBX[:100], 1),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_stream(tmp_path: Path, name: str) -> None:
    data, count = HOSTILE[name]
    assert len(fixes_of(tmp_path, data)) == count


@pytest.mark.parametrize(
    "change", [Path.unlink, lambda path: path.write_bytes(b""), lambda path: path.write_bytes(LINE[0][:9])]
)
def test_file_that_changes_after_opening(tmp_path: Path, change: Callable[[Path], object]) -> None:
    path = tmp_path / "stream"
    path.write_bytes(NMEA)
    recording = open_recording(path)
    change(path)
    with pytest.raises(LogError, match=r"cannot be read|no readable message"):
        list(recording.read())
