"""Mode machine: maps operator commands, rule results and mission state to mode transitions."""

import math

from configs.vehicle import kmh
from messages.command import Mode, OperatorCommand, RuleResult
from messages.plan import MissionState, MissionStatus
from safety.config import ModesConfig
from safety.modes import Event, next_mode
from safety.monitors.memory import DebounceTimer, FaultMemory
from safety.monitors.operator_commands import OperatorCommands
from safety.rules.arbitration import Decision
from safety.rules.results import emergency
from safety.rules.situation import Situation

COMMANDED = emergency("operator_command.emergency_stop", "emergency stop commanded")
COMMANDED_ZH = "操作员急停"
UNCONFIRMED = "operator_command.unconfirmed"
LATCHING = frozenset({Mode.FAULT_STOP, Mode.EMERGENCY_STOP, Mode.MANUAL})
BOUND_MPS = 0.02  # a limit this little below the commanded speed is not reported as the reason


class ModeMachine:
    """Holds the mode, its cause, the faults that other nodes report, and for how long the path has been clear."""

    def __init__(self, config: ModesConfig) -> None:
        self.mode = Mode.STANDBY
        self.latched: RuleResult | None = None
        self.fault_memory = FaultMemory()
        self._config = config
        self._orders = OperatorCommands(config.authorities, config.max_confirmation_s, config.max_pending_s)
        self._needs_confirmation = True
        self._was_waiting = False
        self._cause, self._is_urgent = "", False
        self._clear, self._warned, self._open = DebounceTimer(), DebounceTimer(), DebounceTimer()
        self._unsighted = DebounceTimer()
        self._warning_s = config.start_warning_s

    def update(
        self,
        orders: tuple[OperatorCommand, ...],
        situation: Situation,
        decision: Decision,
        mission: MissionStatus | None,
    ) -> None:
        """Takes the transition of this step."""
        if situation.clock_step_s != 0.0 or situation.has_pose_jumped:
            self._orders.forget_start()
            self._require_confirmation()
        self._watch_waiting(mission)
        self._watch_sight(situation)
        asked = self._orders.events(situation.now_ns, orders)
        permitted = filter_permitted(asked, situation, decision)
        events = permitted | self._observed(situation, decision, mission)
        if self._needs_confirmation and not self._orders.is_confirmed(situation.now_ns):
            events -= {Event.START, Event.CLEAR}
        before, self.mode = self.mode, next_mode(self.mode, events)
        if Event.EMERGENCY in asked and before is not Mode.EMERGENCY_STOP:
            self.latched = COMMANDED
        elif self.mode is not before:
            self.latched = decision.fault if self.mode in LATCHING and decision.is_fault else None
        if self.mode is not before:
            self._enter(before, situation, decision)
        if self.mode is Mode.STANDBY and (before in LATCHING or Event.RESET in permitted):
            self.fault_memory.reset()

    def _watch_waiting(self, mission: MissionStatus | None) -> None:
        """A mission that begins to wait, as at a refill place, waits where persons come near."""
        is_waiting = mission is not None and mission.state is MissionState.WAITING
        if is_waiting and not self._was_waiting:
            self._require_confirmation()
        self._was_waiting = is_waiting

    def _watch_sight(self, situation: Situation) -> None:
        """Who came while nothing was seen for a time may stand where no sensor sees them now."""
        silent = [topic for topic in situation.timed_out_topics if topic.startswith("lidar/")]
        is_without = bool(situation.blind or situation.frozen or silent) and not situation.is_moving
        if self._unsighted.update(situation.now_ns, is_without) >= self._config.unsighted_s:
            self._require_confirmation()

    def _observed(self, situation: Situation, decision: Decision, mission: MissionStatus | None) -> frozenset[Event]:
        """Events other than operator commands."""
        now_ns = situation.now_ns
        is_warning, is_blocked = self.mode is Mode.START_WARNING, self._is_blocked(situation, decision)
        warned_s = self._warned.update(now_ns, is_warning)
        open_s = self._open.update(now_ns, is_warning and not is_blocked)
        is_warned = warned_s >= self._warning_s
        is_at_rest = is_warning and not is_warned and not situation.is_moving
        is_passable = decision.passable_mps >= kmh(self._config.resume_kmh)
        clear_s = self._clear.update(now_ns, self.mode is Mode.OBSTACLE_STOP and is_passable)
        is_over = mission is not None and mission.state in (MissionState.FINISHED, MissionState.ABORTED)
        happened = {
            Event.EMERGENCY: decision.is_emergency,
            Event.HAND: decision.is_takeover,
            Event.FAULT: decision.is_fault,
            Event.DONE: is_over and not situation.is_moving,
            Event.WAIT: self._was_waiting and not situation.is_moving,
            Event.OBSTACLE: is_blocked and not is_at_rest,
            Event.CLEAR: clear_s >= self._config.resume_clear_s and not situation.is_departure_unresolved,
            Event.WARNED: is_warned and open_s >= min(warned_s, self._config.resume_clear_s),
        }
        return frozenset(event for event, holds in happened.items() if holds)

    def _is_blocked(self, situation: Situation, decision: Decision) -> bool:
        """Whether an obstacle stops the machine: inside the stopping distance, or at standstill in the path.

        Before a start it does so at the end of the warning; one that was gone by then makes the warning longer.
        One that was lost from view in the path, or that came near, keeps a machine at rest there as well, as while its
        implement folds. Before a person or animal that stands in the path, it waits until it may resume, instead of
        creeping up.
        """
        is_at_rest = self.mode is Mode.AUTOMATIC and not situation.is_moving
        is_held = is_at_rest and situation.is_somebody_near
        is_held |= self.mode is Mode.START_WARNING and situation.is_departure_unresolved
        if decision.is_obstacle_inside or is_held:
            return True
        if self._is_passable(situation, decision) or situation.is_moving:
            return False
        control_command = situation.inputs.control_command
        return self.mode is Mode.START_WARNING or (control_command is not None and control_command.speed_mps != 0.0)

    def _is_passable(self, situation: Situation, decision: Decision) -> bool:
        """Whether what is seen in the path lets the machine creep, or, with a standing body in the path, resume."""
        is_body_in_path = situation.standing_body.gap_m == 0.0
        least_mps = kmh(self._config.resume_kmh) if is_body_in_path else self._config.creep_mps
        return not decision.is_obstacle_inside and decision.passable_mps >= least_mps

    def _enter(self, before: Mode, situation: Situation, decision: Decision) -> None:
        """Sets what depends on a change of mode."""
        is_resuming = before is Mode.OBSTACLE_STOP
        self._warning_s = self._config.resume_warning_s if is_resuming else self._config.start_warning_s
        self._warned.update(situation.now_ns, False)
        self._clear.update(situation.now_ns, False)
        self._open.update(situation.now_ns, False)
        if self.mode is Mode.OBSTACLE_STOP:
            is_unconfirmed = self._is_passable(situation, decision) and situation.is_departure_unresolved
            self._cause = UNCONFIRMED if is_unconfirmed else decision.blocking.code
        is_waiting = self.mode is Mode.STANDBY and self._was_waiting
        if self.mode in (Mode.MANUAL, Mode.EMERGENCY_STOP) or is_waiting:
            self._require_confirmation()
        if self.mode is Mode.START_WARNING:
            self._needs_confirmation = False
            self._orders.forget_confirmation()
        self._orders.forget_start()

    @property
    def is_just_confirmed(self) -> bool:
        """Whether an operator confirmed in this step that nobody is near the machine."""
        return self._orders.is_just_confirmed

    def _require_confirmation(self) -> None:
        """Somebody may be near, unseen: after power-on, a step of the clock or the pose, manual driving, an emergency
        stop (somebody pressed the button), a time without sight, and while a mission waits."""
        self._needs_confirmation = True
        self._orders.forget_confirmation()

    def reason(self, situation: Situation, decision: Decision) -> str:
        """The code that bounds the safe command; "" when the control command passes unchanged."""
        if self.latched is not None:
            return self.latched.code
        if self.mode is Mode.OBSTACLE_STOP:
            is_passable = self.resume_in_s(situation.now_ns) == 0.0
            is_unresolved = situation.is_departure_unresolved or self._needs_confirmation
            return UNCONFIRMED if is_passable and is_unresolved else self._cause
        if self.mode is Mode.AUTOMATIC:
            command = situation.inputs.control_command
            is_bound = command is None or decision.allowed_mps < abs(command.speed_mps) - BOUND_MPS
            return decision.binding.code if is_bound else ""
        if self.mode is Mode.STANDBY and not decision.is_ready:
            return decision.fault.code
        if self.mode is Mode.STANDBY and self._orders.is_start_pending and self._needs_confirmation:
            return UNCONFIRMED
        return str(self.mode)

    def braking_clearance_m(self, situation: Situation, decision: Decision) -> float:
        """The clearance to brake within; once inside the stopping distance 0, all brakes, until standstill."""
        is_stopping = self.mode is Mode.OBSTACLE_STOP and situation.is_moving
        self._is_urgent = decision.is_obstacle_inside or (self._is_urgent and is_stopping)
        if self._is_urgent:
            return 0.0
        is_ahead = decision.binding_is_obstacle or self.mode is Mode.OBSTACLE_STOP
        return decision.clearance_m if is_ahead else math.inf

    def resume_in_s(self, now_ns: int) -> float:
        """Seconds until an obstacle stop ends if the path stays clear; 0 in other modes."""
        if self.mode is not Mode.OBSTACLE_STOP:
            return 0.0
        return max(0.0, self._config.resume_clear_s - self._clear.update(now_ns, self._clear.is_held))


def filter_permitted(asked: frozenset[Event], situation: Situation, decision: Decision) -> frozenset[Event]:
    """The operator commands permitted now: a reset and a start only at standstill and while nothing prevents them."""
    allowed = set(asked)
    is_still = situation.vehicle.speed_mps is not None and not situation.is_moving
    if not is_still or decision.is_emergency:
        allowed.discard(Event.RESET)
    if not is_still or not decision.is_ready:
        allowed.discard(Event.START)
    return frozenset(allowed)
