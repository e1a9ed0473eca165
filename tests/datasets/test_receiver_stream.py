"""Streams of GNSS receivers: epochs of NMEA and UBX, times, damage; bad messages are counted and invent nothing."""

import math
from pathlib import Path

import numpy as np
import pytest

from datasets.importers.formats import open_recording
from datasets.importers.gnss.clock import gps_of_utc, utc_of_gps
from datasets.importers.gnss.nmea import ANOTHER
from datasets.importers.gnss.sentence import BadSentence, parse
from datasets.importers.receiver_stream import SNIFF_BYTES
from datasets.importers.recording import Recording
from messages.errors import LogError
from messages.sensors import GnssFix, GnssSolution
from tests.datasets.imported import fixes_of

MS, S = 1_000_000, 1_000_000_000
START_NS = 1_795_255_872_300 * MS  # 2026-11-21 10:11:12.3
GGA = "GNGGA,101112.30,5130.69000,N,00603.75000,E,4,21,0.7,24.100,M,46.500,M,1.2,0001"
RMC = "GNRMC,101112.30,A,5130.69000,N,00603.75000,E,5.40,090.00,211126,,,R"
GST = "GNGST,101112.30,0.01,,,,0.008,0.009,0.015"
HDT = "GNHDT,90.5,T"


def line(body: str) -> bytes:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


def opened(folder: Path, data: bytes) -> Recording:
    path = folder / "stream"
    path.write_bytes(data)
    return open_recording(path)


def skipped(recording: Recording) -> dict[str, int]:
    list(recording.read())
    return dict(recording.table()[0].reasons)


def test_fix_of_one_epoch(tmp_path: Path) -> None:
    recording = opened(tmp_path, b"".join(map(line, (GGA, RMC, GST, HDT))))
    ((receive_ns, topic, fix),) = recording.read()
    assert isinstance(fix, GnssFix)
    assert (receive_ns, topic, fix.stamp_ns) == (START_NS, "gnss/nmea", START_NS)
    assert math.degrees(fix.latitude_rad) == pytest.approx(51.5115, abs=1e-9)
    assert math.degrees(fix.longitude_rad) == pytest.approx(6.0625, abs=1e-9)
    assert fix.height_m == pytest.approx(70.6)
    assert fix.sigma_enu_m.tolist() == [0.009, 0.008, 0.015]
    assert fix.velocity_enu_mps[:2] == pytest.approx([2.778, 0.0], abs=1e-9)
    assert math.degrees(fix.heading_rad) == pytest.approx(-0.5)
    assert fix.solution is GnssSolution.RTK_FIXED
    assert (fix.satellites, fix.hdop, fix.correction_age_s, fix.constellations) == (21, 0.7, 1.2, "")
    assert not recording.description.notes


def test_missing_values_are_unknown(tmp_path: Path) -> None:
    (fix,) = fixes_of(opened(tmp_path, line("GPGGA,101112.30,5130.69000,N,00603.75000,E,1,,,24.1,M,,M,,")))
    unknown = [fix.height_m, *fix.sigma_enu_m, *fix.velocity_enu_mps, fix.heading_rad, fix.hdop, fix.correction_age_s]
    assert np.isnan(unknown).all()
    assert (fix.satellites, fix.solution, fix.constellations) == (None, GnssSolution.SINGLE, "GPS")


def test_no_position_without_a_solution(tmp_path: Path) -> None:
    (fix,) = fixes_of(opened(tmp_path, line(GGA.replace(",4,21", ",0,21")) + line("GNHDT,,T")))
    assert fix.solution is GnssSolution.NONE
    assert np.isnan([fix.latitude_rad, fix.longitude_rad, fix.height_m, fix.heading_rad]).all()


def test_a_warning_of_one_sentence_is_no_solution(tmp_path: Path) -> None:
    (fix,) = fixes_of(opened(tmp_path, line(GGA) + line(RMC.replace(",A,", ",V,"))))
    assert fix.solution is GnssSolution.NONE


def test_epochs_are_not_mixed(tmp_path: Path) -> None:
    late = GGA.replace("101112.30", "101112.40")
    first, second = fixes_of(opened(tmp_path, b"".join(map(line, (RMC, GST, late, HDT)))))
    assert math.isnan(first.heading_rad)
    assert np.isnan(second.sigma_enu_m).all()
    assert second.stamp_ns - first.stamp_ns == 100 * MS


def test_sentences_without_time_that_come_first(tmp_path: Path) -> None:
    later = [s.replace("101112.30", "101112.40").replace("90.5", "91.5") for s in (HDT, GGA)]
    first, second = fixes_of(opened(tmp_path, b"".join(map(line, (HDT, GGA, *later)))))
    assert math.degrees(first.heading_rad) == pytest.approx(-0.5)
    assert math.degrees(second.heading_rad) == pytest.approx(-1.5)


def test_constellations_of_gsa_and_gns(tmp_path: Path) -> None:
    gsa = ("GNGSA,A,3,14,23,,,,,,,,,,,1.2,0.7,1.0,1", "GNGSA,A,3,,,,,,,,,,,,,1.2,0.7,1.0,2",
           "GNGSA,A,3,21,,,,,,,,,,,,1.2,0.7,1.0,4")  # fmt: skip
    (fix,) = fixes_of(opened(tmp_path, b"".join(map(line, (GGA, *gsa)))))
    assert fix.constellations == "GPS+BDS"
    gns = "GNGNS,101112.30,5130.69000,N,00603.75000,E,RRNF,21,0.7,24.1,46.5,1.2,0001,V"
    (fix,) = fixes_of(opened(tmp_path, line(gns)))
    assert (fix.constellations, fix.solution) == ("GPS+GLO+BDS", GnssSolution.RTK_FIXED)
    assert fix.height_m == pytest.approx(70.6)


def test_heading_of_another_compass_is_not_read(tmp_path: Path) -> None:
    recording = opened(tmp_path, line(GGA) + line("HEHDT,90.5,T") + line("HCHDG,90.5,,,1.0,E"))
    assert math.isnan(fixes_of(recording)[0].heading_rad)
    assert {row.source for row in recording.table()[1:]} == {"NMEA 0183 HEHDT", "NMEA 0183 HCHDG"}


def test_midnight_and_date_of_later_sentence(tmp_path: Path) -> None:
    times = ("235959.80", "235959.90", "000000.00", "000000.10")
    lines = [GGA.replace("101112.30", time) for time in times] + [RMC.replace("101112.30", "000000.10")]
    fixes = fixes_of(opened(tmp_path, b"".join(map(line, lines))))
    end_ns = START_NS // (86_400 * S) * 86_400 * S + 100 * MS
    assert [fix.stamp_ns - end_ns for fix in fixes] == [-300 * MS, -200 * MS, -100 * MS, 0]


def test_date_of_zda_after_midnight(tmp_path: Path) -> None:
    zda = line("GPZDA,000000.03,22,11,2026,00,00")
    fixes = fixes_of(opened(tmp_path, line(GGA.replace("101112.30", "235959.90")) + zda))
    assert fixes[0].stamp_ns == (START_NS // (86_400 * S) + 1) * 86_400 * S - 100 * MS


def test_without_date(tmp_path: Path) -> None:
    recording = opened(tmp_path, line(GGA))
    assert fixes_of(recording)[0].stamp_ns == START_NS % (86_400 * S)
    assert recording.description.notes == ("NMEA 0183 without a date: times count from 1970-01-01 UTC",)


@pytest.mark.parametrize(
    ("times", "days"),
    [
        (("000416.00", "235800.00", "000000.00"), (0, 0, 1)),  # a clock that was set: not before 1970
        (("001640.00", "131640.00", "131641.00"), (0, 0, 0)),  # a gap of 13 h
        (("131640.00", "001640.00"), (0, 1)),
        (("101112.30", "101110.30"), (0, 0)),
    ],
)
def test_time_of_day_goes_forwards(tmp_path: Path, times: tuple[str, ...], days: tuple[int, ...]) -> None:
    lines = [GGA.replace("101112.30", time) for time in times]
    for dated, day_ns in ((lines, 0), ([RMC.replace("101112.30", times[0]), *lines], START_NS // (86_400 * S))):
        stamps = [fix.stamp_ns // (86_400 * S) for fix in fixes_of(opened(tmp_path, b"".join(map(line, dated))))]
        assert stamps == [day_ns + day for day in days]


def test_no_time_without_date_is_before_1970(tmp_path: Path) -> None:
    lines = [GGA.replace("101112.30", time) for time in ("000010.00", "235959.00")]
    assert [fix.stamp_ns // S for fix in fixes_of(opened(tmp_path, b"".join(map(line, lines))))] == [10, 86_399]


@pytest.mark.parametrize(
    ("prefix", "delay_ns"),
    [
        (b"2026-11-21T10:11:12.35Z ", 50 * MS),
        (b"[2026-11-21 10:11:12.350+00:00] ", 50 * MS),
        (b"2026-11-21T18:11:12.35+08:00,", 50 * MS),
        (b"2026-11-21 18:11:12.350: ", 50 * MS),  # without zone: found by comparison
        (b"2026-11-21 10:11:12.350 AM Z ", 50 * MS),
        (b"2026-11-21 6:11:12.35 pm +0800,", 50 * MS),
        (b"2026-11-21 13:11:12.350 PM ", 0),  # no time of a clock of 12 h
        (b"1795255872.35 ", 50 * MS),
        (b"1795255872350,", 50 * MS),
        (b"1795255872350000000\t", 50 * MS),
        (b"/dev/ttyS0: ", 0),
        (b"10:11:12 INFO ", 0),
        (b"2026-13-41T99:11:12 ", 0),
    ],
)
def test_stamps_of_a_recorder(tmp_path: Path, prefix: bytes, delay_ns: int) -> None:
    recording = opened(tmp_path, prefix + line(GGA) + prefix + line(RMC))
    ((receive_ns, _, fix),) = recording.read()
    assert (receive_ns - START_NS, fix.stamp_ns) == (delay_ns, START_NS)
    assert bool(recording.description.notes) == (delay_ns > 0)


@pytest.mark.parametrize(
    "body",
    [
        GGA.replace("5130.69000", "9100.00000"),
        GGA.replace("5130.69000", "5160.00000"),
        GGA.replace("5130.69000,N", "5130.69000,E"),
        GGA.replace("00603.75000", "18000.00001"),
        GGA.replace("101112.30", "251112.30"),
        GGA.replace("24.100,M", "24.100,F"),
        GGA.replace(",4,21", ",4.5,21"),
        GGA.replace("24.100", "1e3"),
        GGA.replace("24.100", "nan"),
        GGA.replace("24.100", "2_4"),
        GGA.replace("5130.69000,N", ","),
        "GNGGA,101112.30",
        GST.replace("0.008", "-0.008"),
        RMC.replace("090.00", "360.01"),
        RMC.replace("211126", "310226"),
        RMC.replace("211126", "2111"),
        RMC.replace("5.40", "5400"),
        HDT.replace("90.5", "360.5"),
        "GNGNS,101112.30,5130.69000,N,00603.75000,E,R?NF,21,0.7,24.1,46.5,1.2,0001,V",
    ],
)
def test_invalid_sentence_is_counted(tmp_path: Path, body: str) -> None:
    recording = opened(tmp_path, line(body) + line(GGA.replace("101112.30", "101113.30")))
    assert len(fixes_of(recording)) == 1
    assert sum(skipped(recording).values()) == 1


def test_single_bit_errors() -> None:
    sentence = line(GGA)[:-2]
    for k in range(8, 8 * (len(sentence) - 3)):  # within the frame
        broken = bytearray(sentence)
        broken[k // 8] ^= 1 << k % 8
        with pytest.raises(BadSentence):
            parse(bytes(broken))


def test_leap_seconds() -> None:
    for unix_s, gps_s in ((315964800, 0), (1136073599, 820108812), (1483228799, 1167264016), (1483228800, 1167264018)):
        assert gps_of_utc(unix_s * S) == gps_s * S
        assert utc_of_gps(gps_s * S) == unix_s * S
    assert utc_of_gps(1167264017 * S) == 1483228800 * S  # the leap second itself


def test_stream_without_a_fix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no GNSS fix with a time.*2 NMEA 0183 GPGSV"):
        opened(tmp_path, line("GPGSV,1,1,00") + line("GPGSV,1,1,00"))


def test_second_receiver_is_skipped_and_counted(tmp_path: Path) -> None:
    far = GGA.replace("GNGGA", "GPGGA").replace("5130.69", "5131.69")  # 1.85 km north
    near = RMC.replace("5130.69000", "5130.691")  # 1.85 m, as of rounding
    recording = opened(tmp_path, b"".join(map(line, (GGA, far, near, GGA.replace("12.30", "12.40")))))
    first, second = fixes_of(recording)
    assert math.degrees(first.latitude_rad) == pytest.approx(51.5115, abs=2e-5)
    assert not np.isnan(first.velocity_enu_mps[:2]).any()
    assert second.stamp_ns - first.stamp_ns == 100 * MS
    assert skipped(recording) == {ANOTHER: 1}


def test_sentences_after_much_rtcm(tmp_path: Path) -> None:
    message = b"\xd3\x00\x13" + bytes.fromhex("3ed7d30202980edeef34b4bd62ac0941986f33") + bytes.fromhex("360b98")
    sent = message * (SNIFF_BYTES // len(message) + 99)
    (fix,) = fixes_of(opened(tmp_path, sent + line(GGA)))
    assert fix.satellites == 21
    with pytest.raises(LogError, match="is an RTCM 3 stream"):
        opened(tmp_path, sent)
