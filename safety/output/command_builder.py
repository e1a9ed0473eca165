"""Builds the safe command, the only one there is."""

import math
from dataclasses import dataclass

from configs.vehicle import FOLDED, Vehicle
from messages.command import ControlCommand, MachineState, Mode, SafeCommand
from safety.config import SafetyConfig
from safety.modes import WATCHED
from safety.output.limiters import Speed, eased, rising, slowing, steered, stopping, target_speed
from safety.stopping_distance import Braking

BEACON = frozenset({Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP})


@dataclass(frozen=True)
class Moment:
    """What the command is made of."""

    now_ns: int
    mode: Mode
    reason: str
    control_command: ControlCommand | None
    machine: MachineState | None
    measured_mps: float | None
    curvature_radpm: float | None
    allowed_mps: float
    clearance_m: float
    braking: Braking
    has_driver: bool

    @property
    def is_drivers(self) -> bool:
        """Whether the machine is a driver's; in manual mode with the seat empty it is nobody's and must stand."""
        return self.mode is Mode.MANUAL and self.has_driver


class Commander:
    """Keeps what the next command must follow on: speed, brake, curvature, and how long the machine has stood."""

    def __init__(self, vehicle: Vehicle, config: SafetyConfig) -> None:
        self.last: SafeCommand | None = None
        self._config = config
        self._acceleration_mps2 = vehicle.acceleration_mps2
        self._most_radpm = vehicle.drivetrain.max_curvature_radpm * 1.02  # the planner's tightest, and room to correct
        self._standing_since_ns: int | None = None
        self._has_stopped = True
        self._is_parked = True
        self._mode = Mode.STANDBY
        self._is_folded: bool | None = None

    def command(self, moment: Moment) -> SafeCommand:
        """The safe command for now."""
        before_ns = moment.now_ns if self.last is None else self.last.stamp_ns
        dt_s = min(0.1, max(0.0, (moment.now_ns - before_ns) * 1e-9))
        standing_s = self._standing_s(moment)
        is_enabled = self._is_enabled(moment.mode)
        speed = self._speed(moment, dt_s) if is_enabled else Speed(0.0, self._disabled_brake(moment))
        is_parked = self._park(moment, speed, standing_s)
        is_lowered, is_pto_on = self._implement(moment)
        is_folded = self._fold(moment, standing_s, is_lowered)
        self.last = SafeCommand(
            stamp_ns=moment.now_ns,
            mode=moment.mode,
            is_drive_enabled=is_enabled,
            speed_mps=self._held_by_park_brake(moment, speed.speed_mps),
            deceleration_mps2=speed.deceleration_mps2,
            curvature_radpm=self._curvature(moment, is_enabled, dt_s),
            is_implement_lowered=is_lowered,
            is_pto_on=is_pto_on,
            is_park_brake_set=is_parked,
            is_horn_on=moment.mode is Mode.START_WARNING,
            is_beacon_on=moment.mode in BEACON,
            reason=moment.reason,
            is_implement_folded=is_folded,
        )
        return self.last

    def _standing_s(self, moment: Moment) -> float:
        """For how long the machine has stood; 0 while it moves or nobody knows."""
        if moment.mode is not self._mode:
            self._mode, self._has_stopped = moment.mode, False
        still = moment.measured_mps is not None and abs(moment.measured_mps) <= self._config.modes.standstill_mps
        if not still:
            self._standing_since_ns = None
            return 0.0
        if self._standing_since_ns is None:
            self._standing_since_ns = moment.now_ns
        self._has_stopped = True
        return (moment.now_ns - self._standing_since_ns) * 1e-9

    def _is_enabled(self, mode: Mode) -> bool:
        """Drive and steering are ours while engaged, and to the end of a controlled stop."""
        if mode in WATCHED:
            return True
        is_stopping = mode in (Mode.FAULT_STOP, Mode.STANDBY, Mode.FINISHED)
        was_enabled = self.last is not None and self.last.is_drive_enabled
        return is_stopping and was_enabled and not self._has_stopped

    def _speed(self, moment: Moment, dt_s: float) -> Speed:
        modes, braking = self._config.modes, self._config.braking
        measured = 0.0 if moment.measured_mps is None else moment.measured_mps
        before = self.last
        brake_before = 0.0 if before is None else before.deceleration_mps2
        if moment.mode is not Mode.AUTOMATIC:
            asked = stopping(abs(measured), moment.clearance_m, braking)
            if moment.mode is Mode.FAULT_STOP:  # what has failed has had its time: at once, and all that S counts on
                return Speed(0.0, self._standstill_brake(max(asked, braking.deceleration_mps2)))
            asked = self._standstill_brake(asked)
            return Speed(0.0, eased(asked, brake_before, braking.controlled_mps2, self._config.jerk_mps3 * dt_s))
        target = target_speed(moment.control_command, moment.allowed_mps, measured, modes.creep_mps)
        out = rising(target, 0.0 if before is None else before.speed_mps, measured, self._acceleration_mps2 * dt_s)
        limit = moment.allowed_mps if moment.allowed_mps >= modes.creep_mps else 0.0
        asked = slowing(moment.control_command, limit, abs(measured), moment.clearance_m, moment.braking, braking)
        asked = self._standstill_brake(asked) if target == 0.0 else asked
        return Speed(out, eased(asked, brake_before, braking.controlled_mps2, self._config.jerk_mps3 * dt_s))

    def _standstill_brake(self, moving_mps2: float) -> float:
        is_standing = self._standing_since_ns is not None
        return max(self._config.braking.hold_mps2, 0.0 if is_standing else moving_mps2)

    def _disabled_brake(self, moment: Moment) -> float:
        """Full in an emergency; under a driver's hands until the first standstill, then the pedals are the driver's.

        With nobody on the seat it holds on: whoever touched the wheel from outside does not brake the machine.
        """
        if moment.is_drivers:
            return 0.0 if self._has_stopped else self._config.braking.controlled_mps2
        is_standing = self._standing_since_ns is not None
        if moment.mode is Mode.EMERGENCY_STOP and not is_standing:
            return self._config.braking.full_mps2
        return self._config.braking.hold_mps2 if is_standing else self._config.braking.controlled_mps2

    def _park(self, moment: Moment, speed: Speed, standing_s: float) -> bool:
        """Set after some standing, released to drive; while nobody knows the speed it stays as it is."""
        is_leaving = moment.mode is Mode.AUTOMATIC and speed.speed_mps != 0.0
        if moment.is_drivers or is_leaving:
            self._is_parked = False
        elif standing_s > self._config.modes.park_after_s:
            self._is_parked = True
        elif moment.measured_mps is not None and self._standing_since_ns is None:
            self._is_parked = False
        return self._is_parked

    def _held_by_park_brake(self, moment: Moment, speed_mps: float) -> float:
        """The drive does not pull against a park brake that is still set."""
        is_set = moment.machine is not None and moment.machine.is_park_brake_set
        return 0.0 if is_set else speed_mps

    def _curvature(self, moment: Moment, is_enabled: bool, dt_s: float) -> float:
        """The wish while driving; what is measured while the steering is not ours."""
        measured = moment.curvature_radpm
        before = measured if self.last is None else self.last.curvature_radpm
        if not is_enabled or before is None:
            return measured if measured is not None and math.isfinite(measured) else before or 0.0
        is_steering = moment.mode is Mode.AUTOMATIC or self._standing_since_ns is None
        control_command = moment.control_command if is_steering else None
        return steered(control_command, before, self._most_radpm, self._config.curvature_rate_radpms * dt_s)

    def _implement(self, moment: Moment) -> tuple[bool, bool]:
        """Lowered and PTO: as wished in automatic mode; while waiting only up and off; else as it is, and off."""
        machine, control_command = moment.machine, moment.control_command
        was_lowered = self.last.is_implement_lowered if self.last is not None else False
        was_on = self.last.is_pto_on if self.last is not None else False
        is_folded = machine is not None and not machine.fold_position <= 1.0 - FOLDED
        if moment.mode is Mode.AUTOMATIC and control_command is not None:
            return control_command.is_implement_lowered and not is_folded, control_command.is_pto_on and not is_folded
        if moment.mode in WATCHED:
            return was_lowered and (control_command is None or control_command.is_implement_lowered), was_on and (
                control_command is None or control_command.is_pto_on
            )
        return machine.is_hitch_in_work if machine is not None else was_lowered, False

    def _fold(self, moment: Moment, standing_s: float, is_lowered: bool) -> bool:
        """As wished while driving by itself, standing, with the hitch raised; else as commanded last, or measured."""
        machine, control_command = moment.machine, moment.control_command
        is_raised = machine is not None and not machine.is_hitch_in_work and not is_lowered
        is_still = standing_s >= self._config.modes.fold_after_s
        if moment.mode is Mode.AUTOMATIC and control_command is not None and is_raised and is_still:
            self._is_folded = control_command.is_implement_folded
        if self._is_folded is None:
            return machine is not None and machine.fold_position >= 0.5
        return self._is_folded
