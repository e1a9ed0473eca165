"""The supervisor: reads all inputs, evaluates the rules, keeps the mode and is the only builder of safe commands.

messages ─► collision monitor (field, tracks, detection range, geofence) ─┐
        └─► vehicle monitor, time-outs, sensor monitors ──────────────────┼─► situation ─► rules ─► most restrictive
operator commands ─► events ─► mode machine ◄─────────────────────────────┘                             │
                                    └──────────────────► safe command ◄─────────────────────────────────┘
"""

from collections.abc import Iterable, Mapping
from functools import partial

from configs.mission import Consent
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle, kmh
from messages.command import MachineState, Mode, OperatorCommand, SupervisorState
from messages.faults import Fault
from messages.node import All, Every, Inbox, Node, Output, Read
from messages.plan import MissionStatus
from safety.collision_monitor import CollisionMonitor
from safety.inputs import SupervisorInputs
from safety.mode_machine import COMMANDED, COMMANDED_ZH, ModeMachine
from safety.modes import WATCHED
from safety.monitors.brake_test import BrakeTest
from safety.monitors.vehicle import VehicleMonitor, VehicleState
from safety.monitors.watchdog import timed_out_topics
from safety.output.alarms import Alarms
from safety.output.command_builder import CommandBuilder, CommandInputs
from safety.output.supervisor_state import build_state
from safety.rules import RULES
from safety.rules.arbitration import Decision, allowance_m, evaluate_rules
from safety.rules.rule import Rule
from safety.rules.situation import Situation
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import footprints_of
from safety.zones.geofence import Geofence
from safety.zones.known_structure import KnownStructure

PERIOD_NS = 20_000_000
STATE_NS = 100_000_000


class Supervisor(Node):
    """Passes the part of the control command that the rules permit, every 20 ms.

    `fault_topics` are those of other nodes. `fence` None means that no area is known (a recorded log), `survey` None
    that there is no shed. `idle` names sensors that detect nothing as configured: `camera_front` without a model.
    `consent` None: the mission allows no work in plants that hide a person who lies.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        implement: MountedImplement | TrailedImplement | None,
        config: SupervisorConfig,
        geofence: Geofence | None,
        fault_topics: tuple[str, ...],
        known_structure: KnownStructure | None = None,
        idle: frozenset[str] = frozenset(),
        consent: Consent | None = None,
        rules: Mapping[str, Rule] = RULES,
        mode_machine: ModeMachine | None = None,
        monitor: type[CollisionMonitor] = CollisionMonitor,
    ) -> None:
        self.name = "supervisor"
        sensors = vehicle.sensors
        self._inputs = SupervisorInputs(sensors, idle, config)
        self._fault_topics = fault_topics
        self.reads: dict[str, Read] = self._inputs.reads | {
            topic: All(50) for topic in ("operator_command", *fault_topics)
        }
        self.writes = ("safe_command", "supervisor", "fault/supervisor")
        self.runs = Every(PERIOD_NS)
        self._config, self._rules = config, rules
        self._max_speed_mps = min(kmh(vehicle.max_speed_kmh), kmh(config.limits.speed_kmh))
        self._range_sigma_m = max((lidar.range_sigma_m for lidar in sensors.lidar.values()), default=0.0)
        self._footprints = footprints_of(vehicle, implement)
        self._consent = consent
        consented_m = 0.0 if consent is None else consent.vegetation_m
        self._new_monitor = partial(monitor, self._footprints, sensors, geofence, known_structure, config, consented_m)
        self.collision_monitor, self._vehicle_monitor = self._new_monitor(), VehicleMonitor(config)
        self._command_builder, self._brake_test = CommandBuilder(vehicle, config), BrakeTest(config)
        self._mode_machine = mode_machine or ModeMachine(config.modes)
        self._alarms = Alarms(texts_of(rules))
        self._last_ns: int | None = None
        self._state_ns: int | None = None
        self._reported = (self.mode, "")

    @property
    def mode(self) -> Mode:
        """The mode of operation."""
        return self._mode_machine.mode

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Reads, evaluates, decides and commands."""
        clock_step_s = self._watch_clock(now_ns)
        situation = self._situation(now_ns, inbox, clock_step_s)
        decision = evaluate_rules(situation, self._rules)
        mission = inbox.latest("mission", MissionStatus)
        self._mode_machine.update(inbox.all("operator_command", OperatorCommand), situation, decision, mission)
        if self._mode_machine.is_just_confirmed:
            self.collision_monitor.confirm_clear()
        reason = self._mode_machine.reason(situation, decision)
        command = self._command_builder.command(self._command_inputs(situation, decision, reason))
        outputs: list[Output] = [("safe_command", command)]
        outputs += [("fault/supervisor", fault) for fault in self._report(now_ns, decision)]
        if self._is_state_due(now_ns, reason):
            outputs.append(("supervisor", self._state(situation, decision, reason)))
        return outputs

    def _watch_clock(self, now_ns: int) -> float:
        """The jump of the clock, 0 without one; after a jump the monitors restart."""
        late_s = 0.0 if self._last_ns is None else (now_ns - self._last_ns - PERIOD_NS) * 1e-9
        is_step = abs(late_s) > self._config.limits.clock_step_s
        if is_step:
            self.collision_monitor, self._vehicle_monitor = self._new_monitor(), VehicleMonitor(self._config)
        self._last_ns = now_ns
        return late_s if is_step else 0.0

    def _situation(self, now_ns: int, inbox: Inbox, clock_step_s: float) -> Situation:
        for topic in self._fault_topics:
            self._mode_machine.fault_memory.update(inbox.all(topic, Fault))
        machine = inbox.latest("machine", MachineState)
        inputs = self._inputs.read(inbox, machine)
        vehicle = self._vehicle_monitor.update(
            now_ns, self.mode, inputs.odom, machine, inputs.map_pose, inputs.path, inputs.control_command,
            self._command_builder.last,
        )  # fmt: skip
        monitor, direction = self.collision_monitor, vehicle.direction
        allowance = self._allowance_m(vehicle)  # of the field before this step
        monitor.update(inputs, direction, vehicle.fastest_mps, vehicle.braking, allowance)
        detection_range_m = monitor.sources.detection_range_m(now_ns, direction, inputs.health)
        return Situation(
            now_ns=now_ns,
            config=monitor.config,
            rule_limits=self._config.rules,
            inputs=inputs,
            machine=machine,
            vehicle=vehicle,
            max_speed_mps=self._max_speed_mps,
            allowance_m=self._allowance_m(vehicle),
            timed_out_topics=timed_out_topics(self._inputs.ages(now_ns, inbox, monitor, direction)),
            frozen=tuple(
                f"lidar/{source.name}"
                for source in monitor.sources.lidars
                if source.covers(direction) and source.is_frozen
            ),
            faults=self._mode_machine.fault_memory.active,
            clearance=monitor.clearance(),
            critical_object=monitor.critical_object(),
            standing_body=monitor.standing_bodies.slowest,
            detection_range_m=max(detection_range_m.values(), default=0.0),
            blind=tuple(topic for topic, range_m in detection_range_m.items() if range_m <= 0.0),
            geofence_distance_m=monitor.geofence_distance_m(),
            is_foldable=self._footprints.is_foldable,
            clock_step_s=clock_step_s,
            has_pose_jumped=monitor.pose_history.has_jumped,
            brake_test=self._brake_test.update(
                self.mode, vehicle.speed_mps, monitor.pose_history.driven_m, vehicle.braking
            ),
            sensor_failures=self._inputs.sensor_failures(now_ns, inbox, inputs, monitor, direction),
            is_departure_unresolved=monitor.is_departure_unresolved(inputs.control_command),
            is_somebody_near=monitor.is_somebody_near(inputs.control_command),
            lidar_failures=monitor.sources.lidar_failures(direction),
            vegetation_m=monitor.sources.vegetation_m,
            consent=self._consent,
            is_docking=monitor.is_docking,
            is_under_roof=monitor.is_under_roof,
            wall_distance_m=monitor.wall_distance_m(),
        )

    def _allowance_m(self, vehicle: VehicleState) -> float:
        return allowance_m(self.collision_monitor.config.field, self._range_sigma_m, vehicle.position_sigma_m)

    def _command_inputs(self, situation: Situation, decision: Decision, reason: str) -> CommandInputs:
        machine, vehicle = situation.machine, situation.vehicle
        clearance_m = self._mode_machine.braking_clearance_m(situation, decision)
        return CommandInputs(
            situation.now_ns, self.mode, reason, situation.inputs.control_command, machine, vehicle.speed_mps,
            None if machine is None else machine.curvature_radpm,
            decision.allowed_mps, clearance_m, vehicle.braking, vehicle.direction, vehicle.downhill_mps2,
            vehicle.has_driver, self.collision_monitor.bystanders.bars_pto(situation.now_ns),
        )  # fmt: skip

    def _report(self, now_ns: int, decision: Decision) -> list[Fault]:
        latched = self._mode_machine.latched
        advisories = decision.advisories if self.mode in WATCHED else ()
        return self._alarms.update(now_ns, (*(() if latched is None else (latched,)), *advisories))

    def _is_state_due(self, now_ns: int, reason: str) -> bool:
        is_due = self._state_ns is None or abs(now_ns - self._state_ns) >= STATE_NS
        if not is_due and self._reported == (self.mode, reason):
            return False
        self._state_ns, self._reported = now_ns, (self.mode, reason)
        return True

    def _state(self, situation: Situation, decision: Decision, reason: str) -> SupervisorState:
        resume_in_s = self._mode_machine.resume_in_s(situation.now_ns)
        return build_state(situation, self.collision_monitor, decision, self.mode, reason, resume_in_s)


def texts_of(rules: Mapping[str, Rule]) -> dict[str, str]:
    """The Chinese text of every code that the supervisor reports."""
    return {COMMANDED.code: COMMANDED_ZH} | {
        code: text for rule in rules.values() for code, text in rule.texts_zh.items()
    }
