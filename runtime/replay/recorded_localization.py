"""The localizer on the GNSS, IMU and wheel data of an imported recording, compared with the recorded odometry."""

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from datasets.importers.recording import Received, Recording
from geometry.arrays import Float64, Int64
from geometry.geodesy import Datum
from geometry.pose2 import from_frame
from localization.config import LocalizationConfig
from localization.gnss_gate import RejectionReason, check
from localization.localizer import IMU, WHEEL, Localizer
from messages.errors import HeadlandError
from messages.faults import Fault
from messages.message import Envelope
from messages.motion import MapPose, Odometry
from messages.sensors import GnssFix, WheelSample
from runtime.executor import FAULT_TOPIC, Executor
from runtime.replay.log_inspection import LogInspection, RecordingMachine
from runtime.replay.topic_binding import ODOMETRY
from runtime.replay.trajectory import OdometrySamples
from runtime.replay.world import ReplayWorld, in_order

STEP_S = 10.0  # interval of the compared motions
MOVING_MPS = 0.1
MAX_STEERING_RAD = 1.2


def localization_note(
    recording: Recording, inspection: LogInspection, machine: RecordingMachine, config: LocalizationConfig,
    latency_ns: int,
) -> str | None:  # fmt: skip
    """Result of the localizer as text; None when vehicle or streams (which need no fixes) lack its sensors.

    `map` begins at the first fix; without one there is dead reckoning only. Wheel speed and steering angle of an
    odometry are those of a vehicle that turns by its front wheels.
    """
    vehicle, receiver = machine.vehicle, f"gnss/{config.map_alignment.gnss.sensor}"
    wheels = next((topic for topic in (WHEEL, ODOMETRY) if topic in inspection.streams), None)
    first = inspection.first_fixes.get(receiver)
    sensors = vehicle.sensors
    has_sensors = sensors.imu is not None and sensors.wheels is not None and receiver.partition("/")[2] in sensors.gnss
    if wheels is None or IMU not in inspection.streams or not has_sensors:
        return None
    datum = Datum(0.0, 0.0, 0.0) if first is None else Datum(first.latitude_rad, first.longitude_rad, first.height_m)
    localized = LocalizedDrive(config)
    read = {IMU, receiver, wheels}

    def stream() -> Iterator[Received]:
        for receive_ns, topic, message in recording.read():
            if topic in read and isinstance(message, Odometry):
                yield receive_ns, WHEEL, wheel_sample(message, vehicle.drivetrain.wheelbase_m)
            elif topic in read:
                yield receive_ns, topic, message

    # the lidars of the vehicle are not read here
    alone = vehicle.model_copy(update={"sensors": sensors.model_copy(update={"lidar": {}})})
    node = Localizer(alone, datum, config)
    Executor(ReplayWorld(in_order(stream()), ()), [(node, latency_ns)], [localized]).run(lambda: False)
    return localized.text(inspection.odometry.get(wheels), node.dropped)


class LocalizedDrive:
    """Bus sink that gathers fixes, poses and faults of a localizer."""

    def __init__(self, config: LocalizationConfig) -> None:
        self._gnss = config.map_alignment.gnss
        self._checks: Counter[str] = Counter()
        self._odometry = OdometrySamples()
        self._initialized = 0
        self._faults: Counter[str] = Counter()

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message = envelope.message
        if isinstance(message, GnssFix):
            self._checks[check(message, self._gnss).name] += 1
        elif isinstance(message, Odometry):
            self._odometry.add(message)
        elif isinstance(message, MapPose):
            self._initialized += message.is_initialized
        elif isinstance(message, Fault):
            if envelope.topic == FAULT_TOPIC:
                raise HeadlandError(message.text_en)
            self._faults[message.code] += message.is_active

    def text(self, recorded: OdometrySamples | None, dropped: int) -> str:
        """Fixes that are usable, poses, motion against the recorded odometry, and faults."""
        fixes, usable = sum(self._checks.values()), self._checks[RejectionReason.NONE.name]
        refused = ", ".join(f"{name.lower()} {n}" for name, n in self._checks.items() if name != "NONE")
        parts = [f"{usable} of {fixes} fixes usable" + (f" ({refused})" if refused else "")] if fixes else ["no fixes"]
        parts.append(f"{len(self._odometry.stamps_ns)} odometries, {self._initialized} poses in map")
        if not len(self._odometry.stamps_ns):
            parts.append("the initial tilt, which needs a standstill or fixes in motion, was not found")
        off = None if recorded is None else motion_difference(self._odometry, recorded)
        if off is not None:
            parts.append(f"in {STEP_S:.0f} s {off[0]:.2f} m (median; 95 %: {off[1]:.2f} m) from the recorded odometry")
        parts += [f"{dropped} samples dropped"] if dropped else []
        faults = [f"{code} ({n})" for code, n in sorted(self._faults.items()) if n]
        parts += [f"faults: {', '.join(faults)}"] if faults else []
        return f"localizer: {'; '.join(parts)}"


def wheel_sample(odom: Odometry, wheelbase_m: float) -> WheelSample:
    """Wheel speed, and the angle of front wheels that gives the turn rate; 0 at standstill."""
    is_moving = abs(odom.speed_mps) > MOVING_MPS
    angle_rad = math.atan(wheelbase_m * odom.yaw_rate_radps / odom.speed_mps) if is_moving else 0.0
    return WheelSample(odom.stamp_ns, odom.speed_mps, max(-MAX_STEERING_RAD, min(angle_rad, MAX_STEERING_RAD)))


def motion_difference(one: OdometrySamples, two: OdometrySamples) -> tuple[float, float] | None:
    """Median and 95th percentile of the distance (m) between the motions of two odometries over `STEP_S`.

    None when they do not overlap for so long.
    """
    (stamps_1, planar_1), (stamps_2, planar_2) = _planar(one), _planar(two)
    if not len(stamps_1) or not len(stamps_2):
        return None
    step_ns = round(STEP_S * 1e9)
    first_ns, last_ns = max(stamps_1[0], stamps_2[0]), min(stamps_1[-1], stamps_2[-1])
    at = np.arange(first_ns, last_ns - step_ns, step_ns // 10)
    if not len(at):
        return None
    moved = []
    for stamps, planar in ((stamps_1, planar_1), (stamps_2, planar_2)):
        before, after = (_at(t, stamps, planar) for t in (at, at + step_ns))
        moved.append(np.vstack([from_frame(p, q[None, :2]) for p, q in zip(before, after, strict=True)]))
    off = np.hypot(*(moved[0] - moved[1]).T)
    return float(np.median(off)), float(np.percentile(off, 95))


def _planar(samples: OdometrySamples) -> tuple[Int64, Float64]:
    """Stamps (N,), and x, y and unwrapped yaw (N, 3), of the samples without NaN."""
    stamps, poses, _ = samples.by_stamp()
    is_real = np.isfinite(poses).all(axis=(1, 2))
    stamps, poses = stamps[is_real], poses[is_real]
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    return stamps, np.column_stack([poses[:, :2, 3], yaw])


def _at(t_ns: Int64, stamps_ns: Int64, planar: Float64) -> Float64:
    t, stamps = (t_ns - stamps_ns[0]) * 1e-9, (stamps_ns - stamps_ns[0]) * 1e-9
    return np.column_stack([np.interp(t, stamps, planar[:, k]) for k in range(3)])
