"""Builds the safe command; no other part of the tree may."""

import math
from dataclasses import dataclass

from configs.vehicle import FOLDED, Vehicle
from messages.command import ControlCommand, MachineState, Mode, SafeCommand
from safety.config import SafetyConfig
from safety.modes import WATCHED
from safety.output.limiters import (
    SpeedDemand,
    braking_demand,
    limit_acceleration,
    limit_curvature,
    limit_jerk,
    stopping_deceleration,
    target_speed,
)
from safety.stopping_distance import Braking

BEACON = frozenset({Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP})


@dataclass(frozen=True)
class CommandInputs:
    """Inputs of one safe command.

    `direction` is that in which the machine looks and moves, `downhill_mps2` the share of gravity along it;
    `is_pto_barred`: a body moves near the machine.
    """

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
    direction: int
    downhill_mps2: float
    has_driver: bool
    is_pto_barred: bool

    @property
    def is_driver_controlled(self) -> bool:
        """Whether a driver controls the machine: manual mode with an occupied seat."""
        return self.mode is Mode.MANUAL and self.has_driver


class CommandBuilder:
    """Keeps the last command and the time at standstill."""

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

    def command(self, inputs: CommandInputs) -> SafeCommand:
        """The safe command for now."""
        before_ns = inputs.now_ns if self.last is None else self.last.stamp_ns
        dt_s = min(0.1, max(0.0, (inputs.now_ns - before_ns) * 1e-9))
        standing_s = self._standing_s(inputs)
        is_enabled = self._is_enabled(inputs.mode)
        speed = self._speed(inputs, dt_s) if is_enabled else SpeedDemand(0.0, self._disabled_brake(inputs))
        is_parked = self._park(inputs, speed, standing_s)
        is_lowered, is_pto_on = self._implement(inputs)
        is_folded = self._fold(inputs, standing_s, is_lowered)
        self.last = SafeCommand(
            stamp_ns=inputs.now_ns,
            mode=inputs.mode,
            is_drive_enabled=is_enabled,
            speed_mps=self._held_by_park_brake(inputs, speed.speed_mps),
            deceleration_mps2=speed.deceleration_mps2,
            curvature_radpm=self._curvature(inputs, is_enabled, dt_s),
            is_implement_lowered=is_lowered,
            is_pto_on=is_pto_on,
            is_park_brake_set=is_parked,
            is_horn_on=inputs.mode is Mode.START_WARNING,
            is_beacon_on=inputs.mode in BEACON,
            reason=inputs.reason,
            is_implement_folded=is_folded,
        )
        return self.last

    def _standing_s(self, inputs: CommandInputs) -> float:
        """Time at standstill; 0 while moving or while the speed is unknown."""
        if inputs.mode is not self._mode:
            self._mode, self._has_stopped = inputs.mode, False
        still = inputs.measured_mps is not None and abs(inputs.measured_mps) <= self._config.modes.standstill_mps
        if not still:
            self._standing_since_ns = None
            return 0.0
        if self._standing_since_ns is None:
            self._standing_since_ns = inputs.now_ns
        self._has_stopped = True
        return (inputs.now_ns - self._standing_since_ns) * 1e-9

    def _is_enabled(self, mode: Mode) -> bool:
        """Whether drive and steering are enabled: while engaged, and until the end of a controlled stop."""
        if mode in WATCHED:
            return True
        is_stopping = mode in (Mode.FAULT_STOP, Mode.STANDBY, Mode.FINISHED)
        was_enabled = self.last is not None and self.last.is_drive_enabled
        return is_stopping and was_enabled and not self._has_stopped

    def _speed(self, inputs: CommandInputs, dt_s: float) -> SpeedDemand:
        modes, braking = self._config.modes, self._config.braking
        measured = 0.0 if inputs.measured_mps is None else inputs.measured_mps
        before = self.last
        brake_before = 0.0 if before is None else before.deceleration_mps2
        if inputs.mode is not Mode.AUTOMATIC:
            asked = stopping_deceleration(abs(measured), inputs.clearance_m, braking)
            if inputs.mode is Mode.FAULT_STOP:  # debounced already: at once, with the deceleration that S assumes
                return SpeedDemand(
                    0.0, self._standstill_brake(inputs, self._on_grade(inputs, max(asked, braking.deceleration_mps2)))
                )
            asked = self._standstill_brake(inputs, self._on_grade(inputs, asked))
            return SpeedDemand(
                0.0, limit_jerk(asked, brake_before, braking.controlled_mps2, self._config.jerk_mps3 * dt_s)
            )
        target = target_speed(inputs.control_command, inputs.allowed_mps, measured, modes.creep_mps, inputs.direction)
        out = limit_acceleration(
            target, 0.0 if before is None else before.speed_mps, measured, self._acceleration_mps2 * dt_s
        )
        limit = inputs.allowed_mps if inputs.allowed_mps >= modes.creep_mps else 0.0
        asked = braking_demand(
            inputs.control_command, limit, abs(measured), inputs.clearance_m, inputs.braking, braking
        )
        asked = self._on_grade(inputs, asked) if asked > 0.0 else 0.0
        asked = self._standstill_brake(inputs, asked) if target == 0.0 else asked
        return SpeedDemand(out, limit_jerk(asked, brake_before, braking.controlled_mps2, self._config.jerk_mps3 * dt_s))

    def _on_grade(self, inputs: CommandInputs, asked_mps2: float) -> float:
        """Brake that slows by so much on this slope: downhill it holds gravity as well."""
        return min(self._config.braking.full_mps2, asked_mps2 + max(0.0, inputs.downhill_mps2))

    def _standstill_brake(self, inputs: CommandInputs, moving_mps2: float) -> float:
        is_standing = self._standing_since_ns is not None
        return max(self._holding_mps2(inputs), 0.0 if is_standing else moving_mps2)

    def _holding_mps2(self, inputs: CommandInputs) -> float:
        """Brake that holds the machine at rest, on a slope with a reserve, until the park brake is set."""
        braking = self._config.braking
        return min(braking.full_mps2, max(braking.hold_mps2, braking.hold_factor * abs(inputs.downhill_mps2)))

    def _disabled_brake(self, inputs: CommandInputs) -> float:
        """Brake while disabled: full in an emergency; for a driver only until the first standstill.

        With an empty seat it is that of a fault stop, and holds: a touch of the wheel from outside, or a wrong torque,
        does not release the machine.
        """
        if inputs.is_driver_controlled:
            return 0.0 if self._has_stopped else self._config.braking.controlled_mps2
        is_standing = self._standing_since_ns is not None
        if inputs.mode is Mode.EMERGENCY_STOP and not is_standing:
            return self._config.braking.full_mps2
        if is_standing:
            return self._holding_mps2(inputs)
        is_manual = inputs.mode is Mode.MANUAL
        return self._config.braking.deceleration_mps2 if is_manual else self._config.braking.controlled_mps2

    def _park(self, inputs: CommandInputs, speed: SpeedDemand, standing_s: float) -> bool:
        """Park brake: set after a time at standstill, released to drive; unchanged while the speed is unknown."""
        is_leaving = inputs.mode is Mode.AUTOMATIC and speed.speed_mps != 0.0
        if inputs.is_driver_controlled or is_leaving:
            self._is_parked = False
        elif standing_s > self._config.modes.park_after_s:
            self._is_parked = True
        elif inputs.measured_mps is not None and self._standing_since_ns is None:
            self._is_parked = False
        return self._is_parked

    def _held_by_park_brake(self, inputs: CommandInputs, speed_mps: float) -> float:
        """The drive does not pull against a park brake that is still set."""
        is_set = inputs.machine is not None and inputs.machine.is_park_brake_set
        return 0.0 if is_set else speed_mps

    def _curvature(self, inputs: CommandInputs, is_enabled: bool, dt_s: float) -> float:
        """The limited command while enabled, else the measured curvature."""
        measured = inputs.curvature_radpm
        before = measured if self.last is None else self.last.curvature_radpm
        if not is_enabled or before is None:
            return measured if measured is not None and math.isfinite(measured) else before or 0.0
        is_steering = inputs.mode is Mode.AUTOMATIC or self._standing_since_ns is None
        control_command = inputs.control_command if is_steering else None
        return limit_curvature(control_command, before, self._most_radpm, self._config.curvature_rate_radpms * dt_s)

    def _implement(self, inputs: CommandInputs) -> tuple[bool, bool]:
        """Lowered and PTO: as commanded in automatic mode; while waiting only up, and off; else as measured, off."""
        machine, control_command = inputs.machine, inputs.control_command
        was_lowered = self.last.is_implement_lowered if self.last is not None else False
        is_folded = machine is not None and not machine.fold_position <= 1.0 - FOLDED
        if inputs.mode is Mode.AUTOMATIC and control_command is not None:
            is_pto_on = control_command.is_pto_on and not inputs.is_pto_barred
            return control_command.is_implement_lowered and not is_folded, is_pto_on and not is_folded
        if inputs.mode in WATCHED:
            is_on = self.last is not None and self.last.is_pto_on and inputs.mode is Mode.AUTOMATIC
            return was_lowered and (control_command is None or control_command.is_implement_lowered), is_on
        return machine.is_hitch_in_work if machine is not None else was_lowered, False

    def _fold(self, inputs: CommandInputs, standing_s: float, is_lowered: bool) -> bool:
        """Fold as commanded in automatic mode at standstill with the hitch raised; else as before, or measured."""
        machine, control_command = inputs.machine, inputs.control_command
        is_raised = machine is not None and not machine.is_hitch_in_work and not is_lowered
        is_still = standing_s >= self._config.modes.fold_after_s
        if inputs.mode is Mode.AUTOMATIC and control_command is not None and is_raised and is_still:
            self._is_folded = control_command.is_implement_folded
        if self._is_folded is None:
            return machine is not None and machine.fold_position >= 0.5
        return self._is_folded
