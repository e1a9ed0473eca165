"""Who drives: events of people, rules and mission, put to the mode table; and what a change of mode sets."""

import math

from configs.vehicle import kmh
from messages.command import Mode, OperatorCommand, RuleResult
from messages.plan import MissionState, MissionStatus
from safety.config import ModesConfig
from safety.modes import Event, next_mode
from safety.monitors.fault_memory import FaultMemory
from safety.monitors.operator_commands import Orders
from safety.monitors.timers import DebounceTimer
from safety.rules.arbitration import Decision
from safety.rules.results import emergency
from safety.rules.situation import Situation

ORDERED = emergency("operator_command.emergency_stop", "emergency stop ordered")
LATCHING = frozenset({Mode.FAULT_STOP, Mode.EMERGENCY_STOP, Mode.MANUAL})
BOUND_MPS = 0.02  # a limit this little below the wish is not told as its reason


class ModeMachine:
    """Keeps the mode, what brought it about, and for how long the way has been clear.

    `is_held` keeps it in automatic mode whatever happens: nothing that is commanded then reaches a machine.
    """

    def __init__(self, config: ModesConfig, fault_memory: FaultMemory, is_held: bool) -> None:
        self.mode = Mode.AUTOMATIC if is_held else Mode.STANDBY
        self.latched: RuleResult | None = None
        self._config, self._fault_memory, self._is_held = config, fault_memory, is_held
        self._orders = Orders(config.authorities)
        self._cause, self._is_urgent = "", False
        self._clear, self._warned = DebounceTimer(), DebounceTimer()
        self._warning_s = config.start_warning_s

    def update(
        self,
        orders: tuple[OperatorCommand, ...],
        situation: Situation,
        decision: Decision,
        mission: MissionStatus | None,
    ) -> None:
        """The next mode."""
        if self._is_held:
            return
        if situation.clock_step_s != 0.0:
            self._orders.forget_start()
        asked = self._orders.events(situation.now_ns, orders)
        events = filter_permitted(asked, situation, decision) | self._observed(situation, decision, mission)
        before, self.mode = self.mode, next_mode(self.mode, events)
        if Event.EMERGENCY in asked and before is not Mode.EMERGENCY_STOP:
            self.latched = ORDERED
        elif self.mode is not before:
            self.latched = decision.fault if self.mode in LATCHING and decision.is_fault else None
        if self.mode is not before:
            self._enter(before, situation, decision)

    def _observed(self, situation: Situation, decision: Decision, mission: MissionStatus | None) -> frozenset[Event]:
        """Events that nobody ordered."""
        now_ns = situation.now_ns
        warned_s = self._warned.update(now_ns, self.mode is Mode.START_WARNING)
        is_passable = decision.passable_mps >= kmh(self._config.resume_kmh)
        clear_s = self._clear.update(now_ns, self.mode is Mode.OBSTACLE_STOP and is_passable)
        is_over = mission is not None and mission.state in (MissionState.FINISHED, MissionState.ABORTED)
        happened = {
            Event.EMERGENCY: decision.is_emergency,
            Event.HAND: decision.is_takeover,
            Event.FAULT: decision.is_fault,
            Event.DONE: is_over and not situation.is_moving,
            Event.OBSTACLE: self._is_blocked(situation, decision),
            Event.CLEAR: clear_s >= self._config.resume_clear_s,
            Event.WARNED: warned_s >= self._warning_s,
        }
        return frozenset(event for event, holds in happened.items() if holds)

    def _is_blocked(self, situation: Situation, decision: Decision) -> bool:
        """Whether an obstacle stops the machine: inside the stopping distance, or it stands and may not go on."""
        if decision.is_obstacle_inside:
            return True
        if decision.passable_mps >= self._config.creep_mps or situation.is_moving:
            return False
        control_command = situation.control_command
        return self.mode is Mode.START_WARNING or (control_command is not None and control_command.speed_mps != 0.0)

    def _enter(self, before: Mode, situation: Situation, decision: Decision) -> None:
        """What a change of mode sets and forgets."""
        is_resuming = before is Mode.OBSTACLE_STOP
        self._warning_s = self._config.resume_warning_s if is_resuming else self._config.start_warning_s
        self._warned.update(situation.now_ns, False)
        self._clear.update(situation.now_ns, False)
        if self.mode is Mode.OBSTACLE_STOP:
            self._cause = decision.blocking.code
        if before in LATCHING and self.mode is Mode.STANDBY:
            self._fault_memory.reset()
        self._orders.forget_start()

    def reason(self, situation: Situation, decision: Decision) -> str:
        """Why the command is what it is; "" when the wish passes whole."""
        if self.latched is not None:
            return self.latched.code
        if self.mode is Mode.OBSTACLE_STOP:
            return self._cause
        if self.mode is Mode.AUTOMATIC:
            wished = 0.0 if situation.control_command is None else abs(situation.control_command.speed_mps)
            is_bound = decision.allowed_mps < wished - BOUND_MPS or situation.control_command is None
            return decision.binding.code if is_bound else ""
        if self.mode is Mode.STANDBY and not decision.is_ready:
            return decision.fault.code
        return str(self.mode)

    def braking_clearance_m(self, situation: Situation, decision: Decision) -> float:
        """The gap that the brakes are to keep to; once inside the stopping distance: all the brakes to the end."""
        is_stopping = self.mode is Mode.OBSTACLE_STOP and situation.is_moving
        self._is_urgent = decision.is_obstacle_inside or (self._is_urgent and is_stopping)
        if self._is_urgent:
            return 0.0
        is_ahead = decision.binding_is_obstacle or self.mode is Mode.OBSTACLE_STOP
        return decision.clearance_m if is_ahead else math.inf

    def resume_in_s(self, now_ns: int) -> float:
        """Seconds until an obstacle stop ends if the way stays clear; 0 when there is none."""
        if self.mode is not Mode.OBSTACLE_STOP:
            return 0.0
        return max(0.0, self._config.resume_clear_s - self._clear.update(now_ns, self._clear.is_held))


def filter_permitted(asked: frozenset[Event], situation: Situation, decision: Decision) -> frozenset[Event]:
    """Orders that may be followed now: a reset and a start only at standstill and when nothing speaks against it."""
    allowed = set(asked)
    is_still = situation.is_speed_known and not situation.is_moving
    if not is_still or decision.is_emergency:
        allowed.discard(Event.RESET)
    if not is_still or not decision.is_ready:
        allowed.discard(Event.START)
    return frozenset(allowed)
