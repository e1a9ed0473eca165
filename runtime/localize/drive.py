"""The localizer over a recording: trajectory, fixes, and what was awaited while there was no position."""

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from datasets.importers.recording import Received
from geometry.arrays import Float64, Int64
from geometry.geodesy import Datum
from localization.config import LocalizationConfig
from localization.gnss_gate import RejectionReason, check, position_of
from localization.localizer import IMU, WHEEL, Localizer
from messages.errors import HeadlandError, LogError
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import MapPose, Odometry
from messages.sensors import GnssFix, ImuSample, WheelSample
from runtime.executor import FAULT_TOPIC, Executor
from runtime.localize.clocks import Clocks
from runtime.localize.sources import Sources, datum_of
from runtime.localize.wheel_scale import WheelScale
from runtime.replay.recorded_localization import wheel_sample
from runtime.replay.world import ReplayWorld, in_order
from validation.localization.trajectory import Trajectory, TrajectoryRows

LIDAR = ("lidar_odometry/", "lidar_localization")
MAX_STEP_NS = 1_000_000_000
UNPROCESSED = "received at the end"


@dataclass
class Localized:
    """Sink that gathers the run of a localizer; times by the stamps of the IMU samples that it took."""

    node: Localizer
    datum: Datum
    config: LocalizationConfig
    clocks: Clocks
    wheels: WheelScale | None
    _rows: TrajectoryRows = field(default_factory=TrajectoryRows)
    _fix_count: int = 0
    _fix_ns: "array[int]" = field(default_factory=lambda: array("q"))
    _fix_m: "array[float]" = field(default_factory=lambda: array("d"))
    faults: Counter[str] = field(default_factory=Counter)
    awaited_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    first_ns: int | None = None
    last_ns: int = 0
    placed_first_ns: int | None = None
    placed_s: float = 0.0
    unmeasured: Counter[str] = field(default_factory=Counter)
    odometries: int = 0
    path_m: float = 0.0
    origin_m: Float64 | None = None
    _T_odom: Float64 | None = None
    _first_odom: Float64 | None = None

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message = envelope.message
        if isinstance(message, (ImuSample, GnssFix, WheelSample)):
            self.clocks.add(envelope)
            if self.wheels is not None and self.node.is_timely(message.stamp_ns, envelope.receive_ns):
                self._compare(self.wheels, message)
        if isinstance(message, ImuSample):
            self._add_imu(message)
        elif isinstance(message, GnssFix):
            self._add_fix(message)
        elif isinstance(message, Odometry):
            self._add_odometry(message)
        elif isinstance(message, MapPose):
            self._add_pose(message)
        elif isinstance(message, Fault):
            if envelope.topic == FAULT_TOPIC:
                raise HeadlandError(message.text_en)
            self.faults[message.code] += message.is_active

    def _compare(self, wheels: WheelScale, message: ImuSample | GnssFix | WheelSample) -> None:
        gnss = self.config.map_alignment.gnss
        if isinstance(message, WheelSample):
            wheels.add_speed(message.speed_mps)
        elif isinstance(message, ImuSample):
            wheels.add_rates(message.stamp_ns, message.rate_radps)
        elif check(message, gnss) is RejectionReason.NONE:
            wheels.add_fix(position_of(message, self.datum, gnss, 1.0))

    def _add_imu(self, sample: ImuSample) -> None:
        values = {"angular velocity": sample.rate_radps, "linear acceleration": sample.acceleration_mps2}
        self.unmeasured.update(name for name, value in values.items() if np.isnan(value).all())
        self.advance()

    def advance(self) -> None:
        """Counts the time up to the newest IMU sample that the localizer took."""
        stamp_ns = self.node.imu_ns
        if stamp_ns is None:
            return
        if self.first_ns is None:
            self.first_ns = self.last_ns = stamp_ns
        step_s = min(max(stamp_ns - self.last_ns, 0), MAX_STEP_NS) * 1e-9
        self.last_ns = max(self.last_ns, stamp_ns)
        awaited = self.node.awaited
        if awaited:
            self.awaited_s[awaited.partition(":")[0]] += step_s
        else:
            self.placed_s += step_s
            self.placed_first_ns = self.placed_first_ns or stamp_ns

    def _add_fix(self, fix: GnssFix) -> None:
        self._fix_count += 1
        if check(fix, self.config.map_alignment.gnss) is RejectionReason.NONE:
            self._fix_ns.append(fix.stamp_ns)
            self._fix_m.extend(position_of(fix, self.datum, self.config.map_alignment.gnss, 1.0).p_map_m[:2])

    def _add_odometry(self, odom: Odometry) -> None:
        self.odometries += 1
        if self._T_odom is not None:
            self.path_m += float(np.linalg.norm((odom.T_odom_base - self._T_odom)[:2, 3]))
        self._T_odom = odom.T_odom_base
        if self._first_odom is None:
            self._first_odom = odom.T_odom_base

    def _add_pose(self, pose: MapPose) -> None:
        if pose.is_initialized and self.origin_m is None and self._first_odom is not None:
            self.origin_m = (pose.T_map_odom @ self._first_odom)[:2, 3]
        self._rows.add(pose)

    @property
    def trajectory(self) -> Trajectory:
        """All poses with a position."""
        return self._rows.trajectory()

    @property
    def fixes(self) -> tuple[Int64, Float64]:
        """Stamps (N,) and antenna positions (N, 2) in `map` of the usable fixes."""
        return np.array(self._fix_ns, np.int64), np.array(self._fix_m, np.float64).reshape(-1, 2)

    @property
    def fix_counts(self) -> dict[str, int]:
        """Number of fixes by what became of them: used in the graph, or why not."""
        found = {"used" if r is RejectionReason.NONE else r.value: n for r, n in self.node.fixes.items() if n}
        left = self._fix_count - sum(found.values())
        return found | ({UNPROCESSED: left} if left else {})

    @property
    def notes(self) -> list[str]:
        """What some samples lack."""
        samples, imu = self.clocks.count(IMU), self.clocks.names[IMU]
        return [f"{imu}: {count} of {samples} samples without {name}" for name, count in self.unmeasured.items()]

    @property
    def span_s(self) -> float:
        """Duration by the stamps of the IMU."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9

    @property
    def placed_after_alignment(self) -> float | None:
        """Share of the time with a position, from the first position on; None without any."""
        if self.placed_first_ns is None:
            return None
        return min(1.0, self.placed_s / max((self.last_ns - self.placed_first_ns) * 1e-9, 1e-9))


def localize(
    sources: Sources, config: LocalizationConfig, latency_ns: int, fixes_every: int
) -> tuple[Localized, list[GnssFix]]:
    """Runs the localizer with every n-th fix; the run, and the fixes that were withheld. Raises LogError."""
    datum = datum_of(sources, _first_fix(sources, config))
    site, sensors = sources.site, sources.vehicle.sensors
    topics = {s.topic for s in sources.recording.description.sensors}
    lidars = sensors.lidar if any(t.startswith(LIDAR) for t in topics) else {}
    receiver = config.map_alignment.gnss.sensor
    antenna = sensors.gnss[receiver]
    antenna = antenna.model_copy(update={"rate_hz": antenna.rate_hz / fixes_every})
    update = {"lidar": lidars, "gnss": {**sensors.gnss, receiver: antenna}}
    vehicle = sources.vehicle.model_copy(update={"sensors": sensors.model_copy(update=update)})
    shed, dock = (None, None) if site is None else (site.shed, site.dock)
    node = Localizer(vehicle, datum, config, shed, dock)
    withheld: list[GnssFix] = []

    def stream() -> Iterator[Received]:
        number = 0
        for receive_ns, topic, message in sources.recording.read():
            if topic == sources.wheels and isinstance(message, Odometry):
                yield receive_ns, WHEEL, wheel_sample(message, vehicle.drivetrain.wheelbase_m)
            elif topic == sources.gnss and isinstance(message, GnssFix):
                number += 1
                if (number - 1) % fixes_every:
                    withheld.append(message)
                else:
                    yield receive_ns, topic, message
            elif topic in node.reads:
                yield receive_ns, topic, message

    sensors_read = sources.recording.description.sensors
    names = {s.topic: s.topic if s.source in ("", s.topic) else f"{s.topic} ({s.source})" for s in sensors_read}
    named = {IMU: names[IMU], sources.gnss: names.get(sources.gnss, ""), WHEEL: names.get(sources.wheels, "")}
    imu, arm_m = vehicle.sensors.imu, float(np.hypot(*antenna.mount.xyz_m[:2]))
    scale = WheelScale(imu.mount.T_base_sensor[2, :3], arm_m) if imu is not None and sources.wheels else None
    out = Localized(node, datum, config, Clocks(named, config), scale)
    Executor(ReplayWorld(in_order(stream()), ()), [(node, latency_ns)], [out]).run(lambda: False)
    out.advance()
    samples = out.clocks.count(IMU)
    if not samples:
        raise LogError(f"{sources.recording.path}: no IMU sample was read from {IMU}")
    for name, count in out.unmeasured.items():
        if count == samples:
            raise LogError(f"{sources.recording.path}: {names[IMU]} has no {name}, without which nothing is localized")
    return out, withheld


def _first_fix(sources: Sources, config: LocalizationConfig) -> tuple[float, float, float] | None:
    for _, topic, message in sources.recording.read():
        if topic != sources.gnss or not isinstance(message, GnssFix):
            continue
        if check(message, config.map_alignment.gnss) is RejectionReason.NONE:
            height_m = message.height_m if math.isfinite(message.height_m) else 0.0  # unknown
            return message.latitude_rad, message.longitude_rad, height_m
    return None
