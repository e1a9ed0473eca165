"""Velodyne lidars (VLP-16, Puck Hi-Res, HDL-32E, VLP-32C, VLS-128) by velodyne_decoder, and their position packets.

The model is the product number in the packets; angles and firing times are those of the model. Points are in the frame
of the manual turned by 90° (x forward at azimuth 0, y left, z up). A scan begins at the first packet beyond azimuth
180°; its stamp is the time of its last firing. Position packets hold an NMEA sentence, which is read once as a fix.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from velodyne_decoder import Config, Model, PointField, StreamDecoder  # type: ignore[import-untyped]

from datasets.importers.captures.clock import SensorClock
from datasets.importers.captures.continuity import Continuity, InOrder, Packet
from datasets.importers.captures.devices import Decoder, Lost, Stream
from datasets.importers.gnss.fix import fix_of
from datasets.importers.gnss.nmea import NmeaEpochs
from datasets.importers.gnss.sentence import parse
from datasets.importers.point_clouds import list_scan
from datasets.importers.recording import Extrinsic
from geometry.arrays import Float32, UInt16
from messages.errors import LogError
from messages.message import Message

SIZE, BLOCKS, BLOCK_SIZE = 1206, 12, 100
POSITION_SIZE, SENTENCE_AT = 512, 206
POSITION = "Velodyne position"
# product number → name, model of velodyne_decoder
MODELS = {
    0x21: ("HDL-32E", Model.HDL32E), 0x22: ("VLP-16", Model.VLP16), 0x24: ("Puck Hi-Res", Model.PuckHiRes),
    0x28: ("VLP-32C", Model.VLP32C), 0xA1: ("VLS-128", Model.VLS128),
}  # fmt: skip
RETURN_MODES = (0x37, 0x38, 0x39, 0x3B)
BANKS = (b"\xff\xee", b"\xff\xdd", b"\xff\xcc", b"\xff\xbb")
CUT_DEG = 180.0
MIN_RANGE_M, MAX_RANGE_M = 0.05, 300.0
DAY_NS = 86_400_000_000_000
HOUR_US = 3_600_000_000
# Half a turn at 10 Hz: after a longer gap, or a jump of the sensor's time, a scan cannot be continued.
GAP_US = 50_000
GAP = "packets missing for more than 50 ms, or a jump of the sensor's time"


def recognize(payload: bytes) -> str | None:
    """A data packet with its model, or a position packet with a sentence."""
    if len(payload) == POSITION_SIZE:
        return POSITION if payload[SENTENCE_AT : SENTENCE_AT + 1] == b"$" else None
    if len(payload) != SIZE or payload[-1] not in MODELS or payload[-2] not in RETURN_MODES:
        return None
    is_data = all(payload[at : at + 2] in BANKS for at in range(0, BLOCKS * BLOCK_SIZE, BLOCK_SIZE))
    return f"Velodyne {MODELS[payload[-1]][0]}" if is_data else None


def open_decoder(stream: Stream, payload: bytes, capture: Path) -> Decoder:
    """The decoder of a lidar or of its position packets."""
    return VelodynePosition() if stream.model == POSITION else VelodyneLidar(MODELS[payload[-1]][1])


def _azimuths(payload: bytes) -> UInt16:
    """Azimuth of each block in 0.01°."""
    return np.frombuffer(payload, "<u2", SIZE // 2)[1 : BLOCKS * BLOCK_SIZE // 2 : BLOCK_SIZE // 2]


class VelodyneLidar:
    """Scans of one lidar."""

    kind = "lidar"
    frame = "velodyne"
    notes: tuple[str, ...] = ("angles of the model, not of the unit",)
    extrinsics: tuple[Extrinsic, ...] = ()

    def __init__(self, model: Model) -> None:
        config = Config(model=model, cut_angle=CUT_DEG, min_range=MIN_RANGE_M, max_range=MAX_RANGE_M)
        self._stream = StreamDecoder(config)
        self._clock = SensorClock()
        self._last_us: int | None = None
        self._time_us = 0  # without the turn of the hour
        self._order, self._continuity = InOrder(), Continuity()

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        azimuths = _azimuths(payload)
        if azimuths.max() >= 36_000:
            raise LogError(f"azimuth of {azimuths.max() / 100:.2f}°")
        time_us = int.from_bytes(payload[-6:-2], "little")
        if time_us >= HOUR_US:
            raise LogError(f"time of {time_us} µs after the hour")
        since_us = (time_us - self._last_us + HOUR_US // 2) % HOUR_US - HOUR_US // 2 if self._last_us is not None else 0
        if abs(since_us) > GAP_US:
            yield from self.finish()
            yield Lost(GAP)
        self._last_us, self._time_us = time_us, self._time_us + since_us
        for packet in self._order.add(Packet(self._time_us * 1000, payload, receive_ns)):
            yield from self._take(packet)

    def finish(self) -> Iterator[Message | Lost]:
        for packet in self._order.finish():
            yield from self._take(packet)
        self._continuity.restart()
        yield from self._scan(self._stream.finish())

    def _take(self, packet: Packet) -> Iterator[Message | Lost]:
        """What a packet in its order completes."""
        yield from self._continuity.lost(_azimuths(packet.payload).tolist())
        yield from self._scan(self._stream.decode(packet.receive_ns * 1e-9, packet.payload))

    def _scan(self, decoded: tuple[Any, Float32] | None) -> Iterator[Message | Lost]:
        if decoded is None:
            return
        stamp, points = decoded
        time_s = points[:, PointField.time]
        last_s = float(time_s.max()) if len(points) else 0.0
        stamp_ns = self._clock.stamp_ns(round((stamp.device + last_s) * 1e9), round(stamp.host * 1e9))
        intensity = points[:, PointField.intensity].astype(np.uint8)
        yield list_scan(stamp_ns, points[:, :3], intensity, time_s - last_s)


class VelodynePosition:
    """Fixes of the GNSS receiver at one lidar, each sentence once, on the clock of the receiver."""

    kind = "gnss"
    frame = "velodyne_gnss"
    notes: tuple[str, ...] = ()
    extrinsics: tuple[Extrinsic, ...] = ()

    def __init__(self) -> None:
        self._clock = SensorClock()
        self._last = b""

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        line = payload[SENTENCE_AT:].partition(b"\0")[0].strip()
        if line == self._last:
            return
        self._last = line
        epochs = NmeaEpochs()
        epochs.add(parse(line))
        epoch = epochs.finish()
        if epoch is None or epoch.time_ns is None:
            raise LogError(f"sentence {line[:6].decode()} without position and time")
        half = DAY_NS // 2
        utc_ns = receive_ns + (epoch.time_ns - receive_ns + half) % DAY_NS - half
        yield fix_of(epoch.merged(), self._clock.stamp_ns(utc_ns, receive_ns))

    def finish(self) -> Iterator[Message | Lost]:
        yield from ()
