"""NMEA: fixes from epochs; invalid sentences are rejected."""

import math

import pytest

from interfaces.gnss.nmea import NmeaReader
from interfaces.gnss.sentence import BadSentence, parse
from messages.sensors import GnssSolution

MS = 1_000_000


def line(body: str) -> bytes:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


GGA = "GNGGA,101112.30,5130.69000,N,00603.75000,E,4,21,0.7,24.100,M,46.500,M,1.2,0001"
RMC = "GNRMC,101112.30,A,5130.69000,N,00603.75000,E,5.40,090.00,211126,,,R"
GST = "GNGST,101112.30,0.01,,,,0.008,0.009,0.015"
HDT = "GNHDT,90.5,T"


def reader() -> NmeaReader:
    return NmeaReader("HDT", 20 * MS, math.radians(0.1))


def test_fix_from_one_epoch() -> None:
    nmea = reader()
    data = b"".join(map(line, (GGA, RMC, GST, HDT)))
    fixes = [fix for k in range(0, len(data), 7) for fix in nmea.receive(1000 * MS, data[k : k + 7])]
    assert nmea.rejected == 0
    (fix,) = fixes
    assert fix.stamp_ns == 980 * MS
    assert math.degrees(fix.latitude_rad) == pytest.approx(51.5115, abs=1e-9)
    assert math.degrees(fix.longitude_rad) == pytest.approx(6.0625, abs=1e-9)
    assert fix.height_m == pytest.approx(70.6)
    assert fix.sigma_enu_m.tolist() == [0.009, 0.008, 0.015]
    assert fix.velocity_enu_mps[:2] == pytest.approx([2.778, 0.0], abs=1e-9)
    assert math.degrees(fix.heading_rad) == pytest.approx(-0.5)
    assert fix.solution is GnssSolution.RTK_FIXED
    assert (fix.satellites, fix.hdop, fix.correction_age_s, fix.constellations) == (21, 0.7, 1.2, "mixed")


def test_sentences_of_two_epochs() -> None:
    nmea = reader()
    late = GGA.replace("101112.30", "101112.40")
    nmea.receive(0, line(RMC) + line(GST) + line(late))
    (fix,) = nmea.receive(0, line(HDT))
    assert math.isnan(fix.velocity_enu_mps[0])
    assert math.isnan(fix.sigma_enu_m[0])


def test_missing_position_and_missing_solution() -> None:
    nmea = reader()
    assert nmea.receive(0, line(RMC) + line(HDT)) == []
    (fix,) = nmea.receive(0, line("GNGGA,101112.30,,,,,0,00,99.9,,M,,M,,") + line("GNHDT,,T"))
    assert fix.solution is GnssSolution.NONE
    assert math.isnan(fix.latitude_rad)
    assert math.isnan(fix.heading_rad)
    assert math.isnan(fix.sigma_heading_rad)


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
        HDT.replace("90.5", "360.5"),
    ],
)
def test_invalid_sentence_is_counted(body: str) -> None:
    nmea = reader()
    nmea.receive(0, line(body))
    assert nmea.rejected == 1


def test_single_bit_errors() -> None:
    sentence = line(GGA)[:-2]
    for k in range(8 * len(sentence)):
        broken = bytearray(sentence)
        broken[k // 8] ^= 1 << k % 8
        with pytest.raises(BadSentence):
            parse(bytes(broken))


def test_unterminated_line() -> None:
    nmea = reader()
    for _ in range(1000):
        nmea.receive(0, b"x" * 50)
    assert nmea.rejected > 300
    assert len(nmea._rest) <= 121
    assert len(nmea.receive(0, b"\r\n" + b"".join(map(line, (GGA, HDT))))) == 1
