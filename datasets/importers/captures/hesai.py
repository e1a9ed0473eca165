"""Hesai lidars: Pandar40P, Pandar64, PandarQT64, PandarXT16, PandarXT32 and PandarXT32M.

Elevation and azimuth of the channels are those of the unit: a CSV file (channel, elevation, azimuth) beside the capture
`drive.pcap`: `drive.csv`, or else one named like the model in its folder, or in `calibration/` there or one folder up.
Without one, the even design angles of the XT models are used, which a note says; the other models are refused.

Points are in the frame of the manual turned by 90° (x forward at azimuth 0, y left, z up). All returns of a firing are
kept once. A scan begins at the first packet beyond azimuth 180°, or after a gap; its stamp is the last firing.
"""

import csv
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from datasets.importers.captures.clock import SensorClock
from datasets.importers.captures.continuity import Continuity, InOrder, Packet
from datasets.importers.captures.devices import Decoder, Lost, Stream
from datasets.importers.captures.hesai_models import RETURNS, TAILS, Model, model_of
from datasets.importers.point_clouds import list_scan
from datasets.importers.recording import Extrinsic
from geometry.arrays import Bool, Float64, UInt16
from messages.errors import LogError
from messages.message import Message
from messages.sensors import LidarScan

TURN = 36_000
CUT = 18_000
# Half a turn at 10 Hz: after a longer gap a scan cannot be continued.
GAP_NS = 50_000_000
GAP = "packets missing for more than 50 ms, or a jump of the sensor's time"
DISTANCE_UNIT_MM = 4
NS = 1_000_000_000


def recognize(payload: bytes) -> str | None:
    """A data packet, with its model."""
    model = model_of(payload)
    return f"Hesai {model.name}" if model is not None else None


def open_decoder(stream: Stream, payload: bytes, capture: Path) -> Decoder:
    """The decoder of a lidar; raises LogError without its angles."""
    model = model_of(payload)
    assert model is not None
    return HesaiLidar(model, capture)


class HesaiLidar:
    """Scans of one lidar."""

    kind = "lidar"
    frame = "hesai"
    extrinsics: tuple[Extrinsic, ...] = ()

    def __init__(self, model: Model, capture: Path) -> None:
        self._model = model
        self._elevation_rad, self._azimuth_rad, note = read_angles(model, capture)
        self.notes: tuple[str, ...] = (note,)
        self._clock = SensorClock()
        self._packets: list[bytes] = []
        self._times_ns: list[int] = []
        self._receive_ns = 0
        self._phase = 0
        self._last_ns: int | None = None
        self._order, self._continuity = InOrder(), Continuity()

    def receive(self, payload: bytes, receive_ns: int) -> Iterator[Message | Lost]:
        packet = self._fields(payload)
        azimuth = int(packet["blocks"]["azimuth"].max())
        mode = int(packet["tail"][TAILS[self._model.tail]["mode"]])
        if azimuth >= TURN or mode not in RETURNS:
            raise LogError(f"azimuth of {azimuth / 100:.2f}°, return mode 0x{mode:02x}")
        time_ns = _time_ns(packet["tail"].tobytes(), TAILS[self._model.tail], receive_ns)
        if self._last_ns is not None and abs(time_ns - self._last_ns) > GAP_NS:
            yield from self.finish()
            yield Lost(GAP)
        self._last_ns = time_ns
        for found in self._order.add(Packet(time_ns, payload, receive_ns)):
            yield from self._take(found)

    def finish(self) -> Iterator[Message | Lost]:
        for packet in self._order.finish():
            yield from self._take(packet)
        self._continuity.restart()
        yield from self._finish_scan()

    def _take(self, packet: Packet) -> Iterator[Message | Lost]:
        """What a packet in its order completes."""
        azimuths = self._fields(packet.payload)["blocks"]["azimuth"].tolist()
        yield from self._continuity.lost(azimuths, _sequence(packet.payload, self._model))
        phase = (azimuths[0] - CUT) % TURN
        if abs(phase - self._phase) > TURN // 2:
            yield from self._finish_scan()
        self._packets.append(packet.payload[: self._model.dtype.itemsize])
        self._times_ns.append(packet.time_ns)
        self._phase, self._receive_ns = phase, packet.receive_ns

    def _fields(self, payload: bytes) -> Any:
        return np.frombuffer(payload, self._model.dtype, 1)[0]

    def _finish_scan(self) -> Iterator[Message]:
        if self._packets:
            yield self._scan()
        self._packets, self._times_ns = [], []

    def _scan(self) -> LidarScan:
        model = self._model
        packets = np.frombuffer(b"".join(self._packets), model.dtype)
        returns = np.array([RETURNS[m] for m in packets["tail"][:, TAILS[model.tail]["mode"]].tolist()])
        firing_ns = {n: model.firing_ns(n) for n in set(returns.tolist())}
        time_ns = np.array(self._times_ns)[:, None, None] + np.stack([firing_ns[n] for n in returns.tolist()])
        units = packets["blocks"]["channels"]
        at = np.nonzero(is_return(units["distance"], returns))
        unit_m = 1e-3 * (DISTANCE_UNIT_MM if model.header == 0 else self._packets[0][5 if model.header == 8 else 9])
        range_m = units["distance"][at] * unit_m
        azimuth = packets["blocks"]["azimuth"][at[:2]] * np.radians(0.01) + self._azimuth_rad[at[2]]
        elevation = self._elevation_rad[at[2]]
        flat = range_m * np.cos(elevation)
        xyz_m = np.stack([flat * np.cos(azimuth), -flat * np.sin(azimuth), range_m * np.sin(elevation)], axis=1)
        end_ns = int(time_ns.max())
        stamp_ns = self._clock.stamp_ns(end_ns, self._receive_ns)
        age_ns = end_ns - time_ns[at]
        return list_scan(stamp_ns, xyz_m.astype(np.float32), units["reflectivity"][at], age_ns * -1e-9)


def _sequence(payload: bytes, model: Model) -> int | None:
    """Number of a packet after its tail, where the sensor sends it."""
    after = payload[model.dtype.itemsize :]
    return int.from_bytes(after, "little") if len(after) == 4 and any(after) else None


def _time_ns(tail: bytes, at: dict[str, int], receive_ns: int) -> int:
    """Time of a packet; of a sensor without a date the second is that of the reception."""
    microseconds = int.from_bytes(tail[at["us"] : at["us"] + 4], "little")
    date = tail[at["date"] : at["date"] + 6]
    if not any(date):
        return receive_ns + (microseconds * 1000 - receive_ns + NS // 2) % NS - NS // 2
    year, month, day, hour, minute, second = date
    moment = datetime(at["year"] + year, month, day, hour, minute, second, tzinfo=UTC)
    return int(moment.timestamp()) * NS + microseconds * 1000


def is_return(distance: UInt16, returns: np.ndarray) -> Bool:
    """Distances (packets, blocks, channels) that are returns; of equal ones of a firing only the first."""
    is_new = distance > 0
    for count in set(returns.tolist()) - {1}:
        rows = np.flatnonzero(returns == count)
        blocks = distance.shape[1] // count * count
        firings = distance[rows, :blocks].reshape(len(rows), -1, count, distance.shape[2])
        new = np.stack([(firings[:, :, k, None] != firings[:, :, :k]).all(axis=2) for k in range(count)], axis=2)
        is_new[rows, :blocks] &= new.reshape(len(rows), blocks, -1)
    return is_new


def read_angles(model: Model, capture: Path) -> tuple[Float64, Float64, str]:
    """Elevation and azimuth (channels,) in rad and their origin, by the rule of this module; raises LogError."""
    name = model.name.lower()
    folders = (capture.parent, capture.parent / "calibration", capture.parent.parent / "calibration")
    named = [p for folder in folders for p in sorted(folder.glob("*.csv")) if _plain(p.stem) == name]
    for path in [p for p in [capture.with_suffix(".csv"), *named] if p.is_file()]:
        table = _read_table(path)
        if len(table) != model.channels:
            raise LogError(f"{path}: angles of {len(table)} channels; {model.name} has {model.channels}")
        return *np.radians(table).T, f"angles of {path.name}"
    if model.angles_deg is None:
        raise LogError(f"needs the angles of the {model.name} as {capture.with_suffix('.csv').name} beside it")
    first, step = model.angles_deg
    elevation = np.radians(first + step * np.arange(model.channels))
    return elevation, np.zeros(model.channels), f"design angles of {model.name}, not of the unit"


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _read_table(path: Path) -> Float64:
    """Elevation and azimuth (N, 2) in degrees, by channel; raises LogError."""
    try:
        rows = [row for row in csv.reader(path.read_text(encoding="utf-8-sig").splitlines()) if row]
        columns = [name.strip().lower() for name in rows[0]]
        at = columns.index("elevation"), columns.index("azimuth")
        numbers = [int(row[0]) for row in rows[1:]]
        if numbers != list(range(1, len(numbers) + 1)):
            raise ValueError("channels are not numbered from 1")
        table = np.array([[float(row[k]) for k in at] for row in rows[1:]], np.float64)
        if not np.isfinite(table).all():
            raise ValueError("an angle is not finite")
    except (OSError, ValueError, IndexError) as error:
        raise LogError(f"{path}: no table of channel, elevation and azimuth ({error})") from error
    return table
