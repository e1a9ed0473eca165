"""ARS548 datagrams: recorded cycle against its reference; malformed datagrams are counted."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.importers.captures.ars548 import (
    DETECTION,
    DETECTIONS_OFFSET,
    LENGTH,
    MAX_DETECTIONS,
    METHOD,
    Ars548,
    decode_detections,
    open_decoder,
    recognize,
    to_scan,
)
from datasets.importers.captures.devices import Stream
from messages.errors import LogError
from tests.recordings import DATA, needs

RECORDING = DATA / "tier4-nebula" / "ars548"


def datagram(count: int = 2, invalid: int = 0, sync: int = 1) -> bytes:
    head = struct.pack(">HHI", 0, METHOD, LENGTH - 8).ljust(36, b"\0") + struct.pack(">IIB", 5, 7, sync)
    raw = bytearray(head.ljust(LENGTH, b"\0"))
    places = np.zeros(MAX_DETECTIONS, DETECTION)
    places["range_m"], places["azimuth_rad"], places["doppler_mps"] = np.arange(MAX_DETECTIONS), 0.25, -1.5
    places["elevation_rad"], places["rcs_dbsm"], places["invalid"] = 0.1, -7, invalid
    raw[DETECTIONS_OFFSET : DETECTIONS_OFFSET + MAX_DETECTIONS * 44] = places.tobytes()
    struct.pack_into(">ffIff", raw, DETECTIONS_OFFSET + MAX_DETECTIONS * 44, -20.0, 20.0, count, 0.0, 0.0)
    return bytes(raw)


@needs("tier4-nebula/ars548")
def test_recorded_cycle_against_reference() -> None:
    import yaml

    from benchmarks.radar import datagrams, differences

    cycles = [c for c in map(decode_detections, datagrams(next(RECORDING.glob("*/*.db3")))) if c is not None]
    truth = yaml.load(next(RECORDING.glob("*_detection.yaml")).read_text(), yaml.CSafeLoader)
    assert len(cycles) == 1
    assert len(cycles[0].detections) == 308
    assert differences(cycles[0], truth) == []
    truth["detections"][100]["range_rate"] += 0.01
    assert differences(cycles[0], truth) == ["range_rate"]


def test_scan_from_datagram() -> None:
    cycle = decode_detections(datagram(3))
    assert cycle is not None
    assert cycle.stamp_ns == 7_000_000_005
    scan = to_scan(cycle, 9)
    assert scan.stamp_ns == 9
    np.testing.assert_array_equal(scan.range_m, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(scan.doppler_mps, [-1.5] * 3)
    np.testing.assert_array_equal(scan.rcs_dbsm, [-7.0] * 3)
    np.testing.assert_allclose(scan.elevation_rad, [0.1] * 3, atol=1e-7)


@pytest.mark.parametrize(("bit", "kept", "level"), [(0, 0, 0), (1, 2, 0), (2, 0, 0), (4, 2, 1), (6, 0, 0), (7, 2, 0)])
def test_invalid_flags(bit: int, kept: int, level: int) -> None:
    cycle = decode_detections(datagram(2, 1 << bit))
    assert cycle is not None
    scan = to_scan(cycle, 0)
    assert len(scan.range_m) == kept
    assert np.isnan(scan.elevation_rad).all() == bool(level or kept == 0)


def test_stamp_by_synchronization() -> None:
    for sync, stamp in ((1, 7_000_000_005), (2, 42), (3, 42)):
        (scan,) = Ars548().receive(datagram(sync=sync), 42)
        assert scan.stamp_ns == stamp


@pytest.mark.parametrize("count", [0, 1, MAX_DETECTIONS, MAX_DETECTIONS + 1, 2**32 - 1])
def test_count_limit(count: int) -> None:
    cycle = decode_detections(datagram(count))
    assert (cycle is None) == (count > MAX_DETECTIONS)


def test_other_and_malformed_messages() -> None:
    assert recognize(datagram()) == "Continental ARS548 detections"
    for method in (329, 380, 396):
        other = recognize(struct.pack(">HHI", 0, method, 10) + bytes(10))
        assert other is not None
        with pytest.raises(LogError, match="only the detection lists"):
            open_decoder(Stream("10.0.0.1", 42102, other), b"", Path())
    for broken in (b"", b"\0\0\1", datagram()[:-1], datagram() + b"\0", b"\1" + datagram()[1:]):
        assert recognize(broken) is None
        with pytest.raises(LogError, match="is no detection list"):
            list(Ars548().receive(broken, 0))


@given(st.binary(max_size=64), st.integers(0, LENGTH - 64))
@settings(derandomize=True, max_examples=100)
def test_arbitrary_bytes(noise: bytes, place: int) -> None:
    raw = bytearray(datagram())
    raw[place : place + len(noise)] = noise
    try:
        assert len(list(Ars548().receive(bytes(raw), 0))) == 1
    except LogError:
        assert decode_detections(bytes(raw)) is None
