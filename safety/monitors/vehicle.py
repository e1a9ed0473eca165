"""Vehicle monitor: speed, direction, braking and durations of fault conditions; the rules keep no state."""

import math
from dataclasses import dataclass

from messages.command import ControlCommand, MachineState, Mode, SafeCommand
from messages.motion import MapPose, Odometry
from messages.plan import Path
from safety.config import SafetyConfig
from safety.modes import WATCHED
from safety.monitors.memory import DebounceTimer, RecentDuration, RecentRange
from safety.pose_history import tilt_of
from safety.stopping_distance import GRAVITY_MPS2, Braking, on_grade

# below these the conditions are within the noise
BRAKE_COMMANDED_MPS2, BRAKE_MOVING_MPS, STEER_MOVING_MPS, DRIVE_COMMANDED_MPS = 1.0, 0.5, 0.3, 0.2
DIRECTION_MPS = 0.1


@dataclass(frozen=True)
class VehicleState:
    """Signed speed (None: unknown), highest speed of any source, direction, braking on this grade, condition durations.

    `downhill_mps2`: share of gravity along the direction.

    Durations in seconds, 0 while the condition does not hold. `lasting_level_m`: lowest protection level in the
    last `protection_alert_s`. `has_driver`: the seat is occupied, with an off-delay.
    """

    speed_mps: float | None
    fastest_mps: float
    direction: int
    braking: Braking
    downhill_mps2: float
    position_sigma_m: float
    lasting_level_m: float
    driver_override_s: float
    steering_deviation_s: float
    steering_unavailable_s: float
    drive_ineffective_s: float
    brake_ineffective_s: float
    overspeed_s: float
    has_driver: bool


class VehicleMonitor:
    """Keeps the state that the conditions need; updated at every step."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._direction = 1
        self._fastest_mps = 0.0
        self._pitch_rad = 0.0
        self._curvatures = RecentRange(config.limits.curvature_delay_s)
        self._levels = RecentRange(config.limits.protection_alert_s)
        self._has_driver, self._seat_empty = False, DebounceTimer()
        self._override, self._ineffective, self._standing = DebounceTimer(), DebounceTimer(), DebounceTimer()
        self._overspeed = DebounceTimer()
        self._expected_mps, self._expected_ns = 0.0, 0
        self._deviation, self._unavailable = RecentDuration(config.limits.curvature_memory_s), DebounceTimer()

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
        """State of the vehicle now; `command` is the last safe command."""
        speeds = [m.speed_mps for m in (odom, machine) if m is not None and math.isfinite(m.speed_mps)]
        speed = max(speeds, key=abs, default=None)
        self._fastest_mps = self._fastest_mps if speed is None else abs(speed)
        self._direction = direction_of(speed, path, control_command, self._direction)
        if odom is not None:
            self._pitch_rad = tilt_of(odom.T_odom_base)[1]
        flat, min_mps2 = self._config.braking.flat, self._config.braking.min_deceleration_mps2
        is_watched = mode in WATCHED
        return VehicleState(
            speed,
            self._fastest_mps,
            self._direction,
            on_grade(flat, self._direction * self._pitch_rad, min_mps2),
            GRAVITY_MPS2 * math.sin(self._direction * self._pitch_rad),
            position_sigma_m(map_pose),
            self._lasting_level_m(now_ns, map_pose),
            self._override.update(now_ns, is_forced(machine, self._config.limits.driver_torque_nm)),
            self._deviation.update(now_ns, is_watched, self._steering_deviates(now_ns, machine, command)),
            self._unavailable.update(now_ns, is_watched and self._steering_unavailable(machine)),
            self._standing.update(now_ns, is_watched and self._drive_ineffective(odom, machine, command)),
            self._ineffective.update(now_ns, self._brake_ineffective(odom, command)),
            self._overspeed.update(now_ns, self._is_overspeed(now_ns, is_watched, command)),
            self._driver_present(now_ns, machine),
        )

    def _lasting_level_m(self, now_ns: int, map_pose: MapPose | None) -> float:
        if map_pose is not None:
            level_m = map_pose.protection_level_m
            self._levels.add(now_ns, math.inf if math.isnan(level_m) else level_m)
        return self._levels.lowest

    def _driver_present(self, now_ns: int, machine: MachineState | None) -> bool:
        """Whether a driver is present; unchanged without a machine state."""
        if machine is not None:
            empty_s = self._seat_empty.update(now_ns, not machine.is_seat_occupied)
            has_left = empty_s > self._config.modes.seat_empty_s
            self._has_driver = machine.is_seat_occupied or (self._has_driver and not has_left)
        return self._has_driver

    def _steering_deviates(self, now_ns: int, machine: MachineState | None, command: SafeCommand | None) -> bool:
        """Whether the measured curvature is outside the range of the recent commands by more than the tolerance."""
        if command is not None:
            self._curvatures.add(now_ns, command.curvature_radpm)
        if machine is None or self._fastest_mps < STEER_MOVING_MPS:
            return False
        return not self._curvatures.distance(machine.curvature_radpm) <= self._config.limits.curvature_error_radpm

    def _steering_unavailable(self, machine: MachineState | None) -> bool:
        return machine is not None and not machine.is_steering_ready and self._fastest_mps >= STEER_MOVING_MPS

    def _drive_ineffective(
        self, odom: Odometry | None, machine: MachineState | None, command: SafeCommand | None
    ) -> bool:  # fmt: skip
        """Whether the machine stands, creeps or rolls back while commanded to drive, or stands and reports motion."""
        if odom is None or command is None or not command.is_drive_enabled:
            return False
        reported_mps = 0.0 if machine is None else abs(machine.speed_mps)
        least_mps = DIRECTION_MPS + 0.5 * self._config.limits.overspeed_mps
        if abs(odom.speed_mps) < DIRECTION_MPS and reported_mps > least_mps:
            return True
        if command.deceleration_mps2 > 0.0:
            return False
        asked_mps = abs(command.speed_mps)
        moved_mps = math.copysign(odom.speed_mps, odom.speed_mps * command.speed_mps)
        return asked_mps >= DRIVE_COMMANDED_MPS and moved_mps < self._config.limits.min_drive_ratio * asked_mps

    def _brake_ineffective(self, odom: Odometry | None, command: SafeCommand | None) -> bool:
        if odom is None or command is None or abs(odom.speed_mps) < BRAKE_MOVING_MPS:
            return False
        measured = -math.copysign(odom.acceleration_mps2, odom.acceleration_mps2 * odom.speed_mps)
        downhill_rad = math.copysign(self._pitch_rad, self._pitch_rad * odom.speed_mps)
        measured += GRAVITY_MPS2 * max(0.0, math.sin(downhill_rad))  # the brake holds that as well
        commanded = command.deceleration_mps2
        return commanded >= BRAKE_COMMANDED_MPS2 and measured < self._config.limits.min_brake_ratio * commanded

    def _is_overspeed(self, now_ns: int, is_watched: bool, command: SafeCommand | None) -> bool:
        """Whether the speed is above that of the commands, which falls as slowly as a machine may follow them."""
        if not is_watched or command is None:
            self._expected_mps, self._expected_ns = self._fastest_mps, now_ns
            return False
        limits = self._config.limits
        fallen_mps = limits.min_slowing_mps2 * max(now_ns - self._expected_ns, 0) * 1e-9
        self._expected_mps = max(abs(command.speed_mps), self._expected_mps - fallen_mps)
        self._expected_ns = now_ns
        return self._fastest_mps > self._expected_mps + limits.overspeed_mps


def direction_of(
    speed_mps: float | None, path: Path | None, control_command: ControlCommand | None, before: int
) -> int:
    """+1 forward, -1 reverse: of the motion; at standstill of the path, else of the control command, else unchanged."""
    if speed_mps is not None and abs(speed_mps) > DIRECTION_MPS:
        return 1 if speed_mps > 0.0 else -1
    if path is not None:
        return 1 if path.direction > 0 else -1
    if control_command is not None and abs(control_command.speed_mps) > 0.0:
        return 1 if control_command.speed_mps > 0.0 else -1
    return before


def position_sigma_m(map_pose: MapPose | None) -> float:
    """Standard deviation of the horizontal position; 0 without a pose (another rule stops the machine then)."""
    if map_pose is None:
        return 0.0
    variance = max(float(map_pose.covariance[3, 3]), float(map_pose.covariance[4, 4]))
    return math.sqrt(variance) if variance > 0.0 else 0.0


def is_forced(machine: MachineState | None, torque_nm: float) -> bool:
    """Whether the driver's torque on the steering wheel reaches the threshold; NaN counts as torque."""
    return machine is not None and not abs(machine.driver_torque_nm) < torque_nm
