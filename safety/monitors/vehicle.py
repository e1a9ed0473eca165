"""What is measured of the machine itself, and for how long it has been so: the rules have no memory of their own."""

import math
from dataclasses import dataclass

from messages.command import ControlCommand, MachineState, Mode, SafeCommand
from messages.motion import MapPose, Odometry
from messages.plan import Path
from safety.config import SafetyConfig
from safety.modes import WATCHED
from safety.monitors.timers import DebounceTimer, RecentRange
from safety.pose_history import tilt_of
from safety.stopping_distance import Braking, on_grade

BRAKE_ASKED_MPS2, BRAKE_MOVING_MPS, STEER_MOVING_MPS = 1.0, 0.5, 0.3  # below, too little to be told from noise
DIRECTION_MPS = 0.1


@dataclass(frozen=True)
class VehicleState:
    """Signed speed (None: not known), the highest that any source gives, direction, braking here, held conditions.

    `has_driver`: someone sits on the seat, or did until a moment ago.
    """

    speed_mps: float | None
    fastest_mps: float
    direction: int
    braking: Braking
    position_sigma_m: float
    driver_override_s: float
    steering_deviation_s: float
    steering_unavailable_s: float
    brake_ineffective_s: float
    has_driver: bool


class VehicleMonitor:
    """Measures step by step."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._direction = 1
        self._fastest_mps = 0.0
        self._pitch_rad = 0.0
        self._curvatures = RecentRange(config.limits.curvature_late_s)
        self._has_driver, self._seat_empty = False, DebounceTimer()
        self._override, self._deviation, self._unavailable, self._ineffective = (
            DebounceTimer(),
            DebounceTimer(),
            DebounceTimer(),
            DebounceTimer(),
        )

    def update(
        self,
        now_ns: int,
        mode: Mode,
        odom: Odometry | None,
        machine: MachineState | None,
        map_pose: MapPose | None,
        path: Path | None,
        control_command: ControlCommand | None,
        command: SafeCommand | None,
    ) -> VehicleState:
        """The machine as it is now; `command` is what was last commanded."""
        speeds = [m.speed_mps for m in (odom, machine) if m is not None and math.isfinite(m.speed_mps)]
        speed = max(speeds, key=abs, default=None)
        self._fastest_mps = self._fastest_mps if speed is None else abs(speed)
        self._direction = direction_of(speed, path, control_command, self._direction)
        if odom is not None:
            self._pitch_rad = tilt_of(odom.T_odom_base)[1]
        flat, least = self._config.braking.flat, self._config.braking.min_deceleration_mps2
        is_watched = mode in WATCHED
        return VehicleState(
            speed,
            self._fastest_mps,
            self._direction,
            on_grade(flat, self._direction * self._pitch_rad, least),
            position_sigma_m(map_pose),
            self._override.update(now_ns, is_forced(machine, self._config.limits.driver_torque_nm)),
            self._deviation.update(now_ns, is_watched and self._steering_deviates(now_ns, machine, command)),
            self._unavailable.update(now_ns, is_watched and self._steering_unavailable(machine)),
            self._ineffective.update(now_ns, self._brake_ineffective(odom, command)),
            self._is_driven(now_ns, machine),
        )

    def _is_driven(self, now_ns: int, machine: MachineState | None) -> bool:
        """Whether there is a driver; what the seat says no more is as it was."""
        if machine is not None:
            empty_s = self._seat_empty.update(now_ns, not machine.is_seat_occupied)
            is_gone = empty_s > self._config.modes.seat_empty_s
            self._has_driver = machine.is_seat_occupied or (self._has_driver and not is_gone)
        return self._has_driver

    def _steering_deviates(self, now_ns: int, machine: MachineState | None, command: SafeCommand | None) -> bool:
        """Whether the steering is where no command of the last moments would have it."""
        if command is not None:
            self._curvatures.add(now_ns, command.curvature_radpm)
        if machine is None or self._fastest_mps < STEER_MOVING_MPS:
            return False
        return not self._curvatures.distance(machine.curvature_radpm) <= self._config.limits.curvature_error_radpm

    def _steering_unavailable(self, machine: MachineState | None) -> bool:
        return machine is not None and not machine.is_steering_ready and self._fastest_mps >= STEER_MOVING_MPS

    def _brake_ineffective(self, odom: Odometry | None, command: SafeCommand | None) -> bool:
        if odom is None or command is None or abs(odom.speed_mps) < BRAKE_MOVING_MPS:
            return False
        felt = -math.copysign(odom.acceleration_mps2, odom.acceleration_mps2 * odom.speed_mps)
        asked = command.deceleration_mps2
        return asked >= BRAKE_ASKED_MPS2 and felt < self._config.limits.min_brake_ratio * asked


def direction_of(
    speed_mps: float | None, path: Path | None, control_command: ControlCommand | None, before: int
) -> int:
    """+1 forward, -1 reverse: of the motion; at standstill of the path, else of the wish, else as before."""
    if speed_mps is not None and abs(speed_mps) > DIRECTION_MPS:
        return 1 if speed_mps > 0.0 else -1
    if path is not None:
        return 1 if path.direction > 0 else -1
    if control_command is not None and abs(control_command.speed_mps) > 0.0:
        return 1 if control_command.speed_mps > 0.0 else -1
    return before


def position_sigma_m(map_pose: MapPose | None) -> float:
    """Standard deviation of the horizontal position, 0 when there is none (another rule stops then)."""
    if map_pose is None:
        return 0.0
    variance = max(float(map_pose.covariance[3, 3]), float(map_pose.covariance[4, 4]))
    return math.sqrt(variance) if variance > 0.0 else 0.0


def is_forced(machine: MachineState | None, torque_nm: float) -> bool:
    """Whether a hand holds the wheel."""
    return machine is not None and not abs(machine.driver_torque_nm) < torque_nm
