"""The supervisor: reads what others say, asks the rules, keeps the mode, and alone builds the safe command.

messages ─► lookout (field, tracks, proven range, fence) ─┐
        └─► watchdog, timers ─────────────────────────────┼─► situation ─► rules ─► most restrictive
orders ─► events ─► mode table (helm) ◄───────────────────┘                             │
                        └──────────────────────────────────────► safe command ◄─────────┘
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from configs.vehicle import MountedImplement, TrailedImplement, Vehicle, kmh
from messages.command import MachineState, Mode, OperatorCommand, SupervisorState
from messages.errors import ConfigError
from messages.faults import Fault
from messages.node import All, Every, Inbox, Node, Output, Read
from messages.plan import MissionStatus
from safety.collision_monitor import CollisionMonitor, MonitorInputs
from safety.config import SafetyConfig
from safety.inputs import SupervisorInputs
from safety.mode_machine import ModeMachine
from safety.modes import WATCHED
from safety.monitors.brake_test import BrakeTest
from safety.monitors.fault_memory import FaultMemory
from safety.monitors.vehicle import VehicleMonitor, VehicleState
from safety.monitors.watchdog import timed_out_topics
from safety.output.alarms import Alarms
from safety.output.command_builder import CommandBuilder, CommandInputs
from safety.output.supervisor_state import build_state
from safety.rules import RULES
from safety.rules.arbitration import Decision, allowance_m, evaluate_rules
from safety.rules.results import advisory
from safety.rules.situation import Situation
from safety.zones.footprint import footprints_of
from safety.zones.geofence import Geofence
from safety.zones.known_structure import KnownStructure

PERIOD_NS = 20_000_000
STATE_NS = 100_000_000
ABLATION = advisory("safety.ablation", "obstacle rules switched off for a trial")


@dataclass(frozen=True)
class Observation:
    """The supervisor only looks on: its mode is held, and only its state leaves it, with a threat's box among the hits.

    `is_arc_checked` False judges the way that was driven alone, not what the steering would sweep if it failed.
    """

    is_arc_checked: bool


class Supervisor(Node):
    """Lets through of control's wish what the rules allow, every 20 ms.

    `fault_topics` are those of other nodes. `geofence` None means that no area is known (a recorded log),
    `known_structure` None that there is no shed. `idle` names sensors that detect nothing as they are set up:
    `camera_front` without a model. `disabled_rules` names rules of `safety.rules.RULES` that a trial switches off; it
    is never configuration, and it is told and logged. With `observation` nothing is commanded.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        implement: MountedImplement | TrailedImplement | None,
        config: SafetyConfig,
        geofence: Geofence | None,
        fault_topics: tuple[str, ...],
        disabled_rules: frozenset[str] = frozenset(),
        known_structure: KnownStructure | None = None,
        idle: frozenset[str] = frozenset(),
        observation: Observation | None = None,
    ) -> None:
        unknown = sorted(disabled_rules - RULES.keys())
        if unknown:
            raise ConfigError(f"disabled_rules: no rule {unknown[0]!r}; there are {', '.join(RULES)}")
        self.name = "supervisor"
        self._sensors = sensors = vehicle.sensors
        self._inputs = SupervisorInputs(sensors, idle, config)
        self._fault_topics = fault_topics
        self.reads: dict[str, Read] = self._inputs.reads | {
            topic: All(50) for topic in ("operator_command", *fault_topics)
        }
        self.writes = ("safe_command", "supervisor", "fault/supervisor") if observation is None else ("supervisor",)
        self.runs = Every(PERIOD_NS)
        self._config, self._disabled, self._observation = config, disabled_rules, observation
        self._max_speed_mps = min(kmh(vehicle.max_speed_kmh), kmh(config.limits.speed_kmh))
        self._range_sigma_m = max((lidar.range_sigma_m for lidar in sensors.lidar.values()), default=0.0)
        self._footprints, self._geofence, self._known_structure = (
            footprints_of(vehicle, implement),
            geofence,
            known_structure,
        )
        self._collision_monitor, self._vehicle_monitor = self._new_collision_monitor(), VehicleMonitor(config)
        self._command_builder, self._brake_test = CommandBuilder(vehicle, config), BrakeTest(config)
        self._fault_memory, self._alarms = FaultMemory(), Alarms()
        self._mode_machine = ModeMachine(config.modes, self._fault_memory, is_held=observation is not None)
        self._last_ns: int | None = None
        self._state_ns: int | None = None
        self._told = (self.mode, "")

    @property
    def mode(self) -> Mode:
        """Who drives now."""
        return self._mode_machine.mode

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Read, judge, decide, command."""
        clock_step_s = self._watch_clock(now_ns)
        for topic in self._fault_topics:
            self._fault_memory.update(inbox.all(topic, Fault))
        machine = inbox.latest("machine", MachineState)
        inputs = self._inputs.read(inbox, machine)
        vehicle_state = self._vehicle_monitor.update(
            now_ns,
            self.mode,
            inputs.odom,
            machine,
            inputs.map_pose,
            inputs.path,
            inputs.control_command,
            self._command_builder.last,
        )
        field = self._collision_monitor.config.field
        allowance = allowance_m(field, self._range_sigma_m, vehicle_state.position_sigma_m)
        self._collision_monitor.update(
            inputs, vehicle_state.direction, vehicle_state.fastest_mps, vehicle_state.braking, allowance
        )
        situation = self._situation(now_ns, inbox, inputs, machine, vehicle_state, clock_step_s)
        decision = evaluate_rules(situation, self._disabled)
        mission = inbox.latest("mission", MissionStatus)
        self._mode_machine.update(inbox.all("operator_command", OperatorCommand), situation, decision, mission)
        reason = self._mode_machine.reason(situation, decision)
        command = self._command_builder.command(self._command_inputs(situation, vehicle_state, decision, reason))
        outputs: list[Output] = [("safe_command", command)]
        outputs += [("fault/supervisor", fault) for fault in self._tell(now_ns, decision)]
        if self._is_state_due(now_ns, reason):
            outputs.append(("supervisor", self._state(situation, inputs, decision, reason)))
        return [(topic, message) for topic, message in outputs if topic in self.writes]

    def _watch_clock(self, now_ns: int) -> float:
        """By how much the clock stepped, 0 when it did not; after a step nothing seen before counts."""
        late_s = 0.0 if self._last_ns is None else (now_ns - self._last_ns - PERIOD_NS) * 1e-9
        is_step = abs(late_s) > self._config.limits.clock_step_s
        if is_step:
            self._collision_monitor, self._vehicle_monitor = self._new_collision_monitor(), VehicleMonitor(self._config)
        self._last_ns = now_ns
        return late_s if is_step else 0.0

    def _new_collision_monitor(self) -> CollisionMonitor:
        is_arc_checked = self._observation is None or self._observation.is_arc_checked
        return CollisionMonitor(
            self._footprints, self._sensors, self._geofence, self._known_structure, self._config, is_arc_checked
        )

    def _situation(
        self,
        now_ns: int,
        inbox: Inbox,
        inputs: MonitorInputs,
        machine: MachineState | None,
        vehicle_state: VehicleState,
        clock_step_s: float,
    ) -> Situation:
        collision_monitor, config, direction = (
            self._collision_monitor,
            self._collision_monitor.config,
            vehicle_state.direction,
        )
        lidars = [source for source in collision_monitor.sources.lidars if source.covers(direction)]
        detection_range_m = collision_monitor.sources.detection_range_m(now_ns, direction, inputs.health)
        return Situation(
            now_ns=now_ns,
            config=config,
            mode=self.mode,
            direction=direction,
            speed_mps=vehicle_state.fastest_mps,
            is_speed_known=vehicle_state.speed_mps is not None,
            max_speed_mps=self._max_speed_mps,
            braking=vehicle_state.braking,
            allowance_m=allowance_m(config.field, self._range_sigma_m, vehicle_state.position_sigma_m),
            odom=inputs.odom,
            machine=machine,
            map_pose=inputs.map_pose,
            control_command=inputs.control_command,
            timed_out_topics=timed_out_topics(self._inputs.ages(now_ns, inbox, collision_monitor, direction)),
            frozen=tuple(f"lidar/{source.name}" for source in lidars if source.is_frozen),
            faults=self._fault_memory.active,
            clearance=collision_monitor.clearance(),
            is_planned=collision_monitor.swept_field is not None and collision_monitor.swept_field.is_planned,
            critical_object=collision_monitor.critical_object(),
            detection_range_m=max(detection_range_m.values(), default=0.0),
            blind=tuple(topic for topic, range_m in detection_range_m.items() if range_m <= 0.0),
            geofence_distance_m=collision_monitor.geofence_distance_m(),
            position_sigma_m=vehicle_state.position_sigma_m,
            driver_override_s=vehicle_state.driver_override_s,
            steering_deviation_s=vehicle_state.steering_deviation_s,
            steering_unavailable_s=vehicle_state.steering_unavailable_s,
            brake_ineffective_s=vehicle_state.brake_ineffective_s,
            is_foldable=self._footprints.is_foldable,
            fold=inputs.fold,
            clock_step_s=clock_step_s,
            brake_test=self._brake_test.update(
                self.mode, vehicle_state.speed_mps, collision_monitor.pose_history.driven_m
            ),
            sensor_failures=self._inputs.sensor_failures(now_ns, inbox, inputs, collision_monitor, direction),
            is_docking=collision_monitor.is_docking,
            is_under_roof=collision_monitor.is_under_roof,
            wall_distance_m=collision_monitor.wall_distance_m(),
        )

    def _command_inputs(
        self, situation: Situation, vehicle_state: VehicleState, decision: Decision, reason: str
    ) -> CommandInputs:
        curvature = None if situation.machine is None else situation.machine.curvature_radpm
        clearance_m = self._mode_machine.braking_clearance_m(situation, decision)
        return CommandInputs(
            situation.now_ns, self.mode, reason, situation.control_command, situation.machine, vehicle_state.speed_mps,
            curvature,
            decision.allowed_mps, clearance_m, situation.braking, vehicle_state.has_driver,
        )  # fmt: skip

    def _tell(self, now_ns: int, decision: Decision) -> list[Fault]:
        told = [ABLATION] if self._disabled else []
        told += [self._mode_machine.latched] if self._mode_machine.latched is not None else []
        told += decision.advisories if self.mode in WATCHED else []
        return self._alarms.update(now_ns, told)

    def _is_state_due(self, now_ns: int, reason: str) -> bool:
        is_due = self._state_ns is None or abs(now_ns - self._state_ns) >= STATE_NS
        if not is_due and self._told == (self.mode, reason):
            return False
        self._state_ns, self._told = now_ns, (self.mode, reason)
        return True

    def _state(self, situation: Situation, inputs: MonitorInputs, decision: Decision, reason: str) -> SupervisorState:
        resume_in_s = self._mode_machine.resume_in_s(situation.now_ns)
        now = replace(situation, mode=self.mode)
        return build_state(
            now, inputs, self._collision_monitor, decision, reason, resume_in_s, self._observation is not None
        )
