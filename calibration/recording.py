"""Recording of a trial: messages as arrays, times in seconds since its first wheel sample."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.geodesy import Datum
from messages.command import MachineState, SafeCommand
from messages.message import Envelope
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan, WheelSample

KINDS = ("imu", "wheel", "gnss", "machine", "safe_command", "lidar")  # topics that a recording needs
MAX_S = 900.0  # of a recording, whose beginning is kept
SCANS = 40  # of a lidar, at standstill
SCAN_S = 0.4  # between two of them
SCAN_M, SCAN_POINTS = 12.0, 4000  # range and number of the returns that are kept


@dataclass(frozen=True)
class Recording:
    """Columns of each array begin with the time (s).

    `imu` (N, 7): specific force and angular rate in the IMU frame. `wheel` (N, 3): speed, steering angle.
    `gnss` (N, 8), RTK fixed alone: antenna x, y, z in `map`, velocity east and north, heading, sigma of the position.
    `machine` (N, 3): hitch, PTO speed. `command` (N, 3): implement lowered, PTO on.
    `scans`: returns (N, 3) in the frame of each lidar by name, at standstill with raised implement.
    """

    imu: Float64
    wheel: Float64
    gnss: Float64
    machine: Float64
    command: Float64
    scans: dict[str, tuple[Float32, ...]]


@dataclass
class Recorder:
    """Collects the messages of a trial; positions are in the `map` frame of `datum`.

    `length_s` and `distance_m` are time and way by the wheel samples so far.
    """

    datum: Datum
    length_s: float = 0.0
    distance_m: float = 0.0
    _start_ns: int | None = None
    _rows: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    _scans: dict[str, list[tuple[float, Float32]]] = field(default_factory=dict)
    _speed_mps: float = 1.0
    _hitch: float = 0.0

    def take(self, envelopes: Iterable[Envelope]) -> None:
        """Takes messages in order; those of other topics have no effect."""
        for envelope in envelopes:
            kind, _, name = envelope.topic.partition("/")
            if self._start_ns is None and kind == "wheel":
                self._start_ns = envelope.message.stamp_ns
            if kind in KINDS and self._start_ns is not None:
                self._add(name, (envelope.message.stamp_ns - self._start_ns) * 1e-9, envelope.message)

    def recording(self) -> Recording:
        """What was recorded so far."""
        arrays = {
            kind: np.array(sorted(self._rows.get(kind, ())), np.float64).reshape(-1, width)
            for kind, width in (("imu", 7), ("wheel", 3), ("gnss", 8), ("machine", 3), ("command", 3))
        }
        return Recording(**arrays, scans={name: tuple(p for _, p in found) for name, found in self._scans.items()})

    def _add(self, name: str, at_s: float, message: object) -> None:
        if not 0.0 <= at_s <= MAX_S:
            return
        if isinstance(message, WheelSample):
            self.distance_m += abs(message.speed_mps) * max(0.0, at_s - self.length_s)
            self.length_s = max(at_s, self.length_s)
            self._speed_mps = message.speed_mps
            self._put("wheel", at_s, message.speed_mps, message.steering_angle_rad)
        elif isinstance(message, ImuSample):
            self._put("imu", at_s, *message.acceleration_mps2.tolist(), *message.rate_radps.tolist())
        elif isinstance(message, GnssFix) and message.solution is GnssSolution.RTK_FIXED:
            p = self.datum.to_map(message.latitude_rad, message.longitude_rad, message.height_m)
            east, north, _ = message.velocity_enu_mps.tolist()
            self._put("gnss", at_s, *p, east, north, message.heading_rad, float(message.sigma_enu_m[0]))
        elif isinstance(message, MachineState):
            self._hitch = message.hitch
            self._put("machine", at_s, message.hitch, message.pto_radps)
        elif isinstance(message, SafeCommand):
            self._put("command", at_s, float(message.is_implement_lowered), float(message.is_pto_on))
        elif isinstance(message, LidarScan):
            self._add_scan(name, at_s, message)

    def _put(self, name: str, *row: float) -> None:
        self._rows.setdefault(name, []).append(row)

    def _add_scan(self, name: str, at_s: float, scan: LidarScan) -> None:
        """Near returns of a scan at standstill, thinned evenly."""
        found = self._scans.setdefault(name, [])
        if self._speed_mps != 0.0 or self._hitch < 0.95 or len(found) >= SCANS:
            return
        if not found or at_s - found[-1][0] >= SCAN_S:
            points = scan.points_m[np.linalg.norm(scan.points_m, axis=1) < SCAN_M]
            found.append((at_s, points[:: max(1, -(-len(points) // SCAN_POINTS))].copy()))
