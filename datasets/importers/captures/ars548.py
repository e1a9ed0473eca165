"""Continental ARS548 RDI: detection lists from its UDP datagrams (SOME/IP service 0, method 336, big-endian).

    0  service, method (u16), length (u32) │ 8 client, session, versions │ 16 E2E profile 7 │ 36 time, sync, qualifier
    50 flags, mount: x y z roll pitch yaw, each with sigma │ 100 flags │ 101 800 x 44 │ 35301 Doppler limits, count …

The list always has 800 entries, of which `count` are valid. Ranges and angles are from the sensor, angles left
and up positive, range rate away positive (ARS548 interface description, checked against the recording in
`tier4-nebula`).
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from datasets.importers.captures.devices import Decoder, Lost, Stream
from datasets.importers.recording import Extrinsic
from geometry.arrays import Bool, Float64
from messages.errors import LogError
from messages.message import Message
from messages.sensors import RadarScan

NAME = "Continental ARS548"
METHOD = 336
METHODS = {METHOD: "detections", 329: "objects", 380: "sensor status", 396: "filter status"}
LENGTH = 35336
MAX_DETECTIONS = 800
DETECTIONS_OFFSET = 101
SYNCHRONIZED = 1

DETECTION = np.dtype(
    [
        ("azimuth_rad", ">f4"), ("azimuth_sigma_rad", ">f4"), ("invalid", "u1"), ("elevation_rad", ">f4"),
        ("elevation_sigma_rad", ">f4"), ("range_m", ">f4"), ("range_sigma_m", ">f4"), ("doppler_mps", ">f4"),
        ("doppler_sigma_mps", ">f4"), ("rcs_dbsm", "i1"), ("measurement", ">u2"), ("existence_percent", "u1"),
        ("classification", "u1"), ("several_percent", "u1"), ("object", ">u2"), ("ambiguity_percent", "u1"),
        ("sort", ">u2"),
    ]
)  # fmt: skip
# bits of `invalid`, from the lowest: value and sigma in turn
INVALID = (
    "distance",
    "distance_std",
    "azimuth",
    "azimuth_std",
    "elevation",
    "elevation_std",
    "range_rate",
    "range_rate_std",
)


@dataclass(frozen=True, eq=False)
class DetectionList:
    """One cycle: `detections` (N,) of type `DETECTION`; `mount` (6,) is x, y, z, roll, pitch, yaw as set in the device.

    `doppler_limits_mps` bound the Doppler without ambiguity; `alignment_rad` is the device's own correction of azimuth
    and elevation.
    """

    stamp_ns: int
    is_synchronized: bool
    mount: Float64
    detections: npt.NDArray[Any]
    doppler_limits_mps: tuple[float, float]
    alignment_rad: tuple[float, float]


def decode_detections(datagram: bytes) -> DetectionList | None:
    """Detection list of a datagram, or None for other content or a malformed datagram."""
    if len(datagram) != LENGTH or struct.unpack_from(">HHI", datagram) != (0, METHOD, LENGTH - 8):
        return None
    nanoseconds, seconds, sync = struct.unpack_from(">IIB", datagram, 36)
    end = DETECTIONS_OFFSET + MAX_DETECTIONS * DETECTION.itemsize
    low, high, count, azimuth, elevation = struct.unpack_from(">ffIff", datagram, end)
    if count > MAX_DETECTIONS or nanoseconds >= 1_000_000_000:
        return None
    mount = np.array(struct.unpack_from(">12f", datagram, 52)[::2], np.float64)
    detections = np.frombuffer(datagram, DETECTION, count, DETECTIONS_OFFSET).copy()
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    return DetectionList(stamp_ns, sync == SYNCHRONIZED, mount, detections, (low, high), (azimuth, elevation))


def is_invalid(detections: npt.NDArray[Any], field: str) -> Bool:
    """Whether the device marks a field of `INVALID` of each detection (N,) as invalid."""
    return np.asarray(detections["invalid"] >> INVALID.index(field) & 1 == 1)


def to_scan(cycle: DetectionList, stamp_ns: int) -> RadarScan:
    """The valid detections as a scan; an elevation that is not valid is NaN."""
    d = cycle.detections
    good = ~(is_invalid(d, "distance") | is_invalid(d, "azimuth") | is_invalid(d, "range_rate"))
    d = d[good]
    elevation = np.where(is_invalid(d, "elevation"), np.nan, d["elevation_rad"].astype(np.float64))
    range_m, azimuth, doppler, rcs = (
        d[k].astype(np.float64) for k in ("range_m", "azimuth_rad", "doppler_mps", "rcs_dbsm")
    )
    return RadarScan(stamp_ns, range_m, azimuth, elevation, doppler, rcs)


def recognize(payload: bytes) -> str | None:
    """A detection list, or another message of the device."""
    if len(payload) < 8:
        return None
    service, method, length = struct.unpack_from(">HHI", payload)
    if service != 0 or length != len(payload) - 8 or method not in METHODS:
        return None
    return f"{NAME} {METHODS[method]}"


def open_decoder(stream: Stream, payload: bytes, capture: Path) -> Decoder:
    """The decoder of detection lists; raises LogError for the other messages."""
    if stream.model != f"{NAME} {METHODS[METHOD]}":
        raise LogError("only the detection lists of this radar are read")
    return Ars548()


class Ars548:
    """Detection lists of one radar as scans, stamped by the device's clock once that is synchronized."""

    kind = "radar"
    frame = "ars548"
    notes: tuple[str, ...] = ()
    extrinsics: tuple[Extrinsic, ...] = ()

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        cycle = decode_detections(payload)
        if cycle is None:
            raise LogError(f"datagram of {len(payload)} bytes is no detection list of {LENGTH} bytes")
        yield to_scan(cycle, cycle.stamp_ns if cycle.is_synchronized else receive_ns)

    def finish(self) -> Iterator[Message | Lost]:
        yield from ()
