"""One step of the supervisor with spies for its parts: their arguments and the order of the outputs."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.mission import Consent
from configs.vehicle import Vehicle
from messages.command import Mode, SafeCommand, SupervisorState
from messages.faults import Fault, Response, Severity
from messages.node import All, Every
from messages.perception import ObstacleClass
from messages.plan import MissionState, MissionStatus, PathSectionType
from messages.topics import spec_of
from safety.collision_monitor import CollisionMonitor
from safety.inputs import SupervisorInputs
from safety.mode_machine import ModeMachine
from safety.monitors.memory import FaultMemory
from safety.monitors.vehicle import VehicleState
from safety.rules import RULES
from safety.rules.arbitration import allowance_m
from safety.rules.results import advisory, stop
from safety.rules.situation import Situation
from safety.supervisor import PERIOD_NS, STATE_NS, Supervisor
from safety.supervisor_config import SupervisorConfig
from safety.zones.footprint import footprints_of
from safety.zones.geofence import Geofence
from safety.zones.known_structure import KnownStructure
from safety.zones.protective_field import Clearance
from safety.zones.standing_bodies import NO_STANDING_BODY
from safety.zones.tracked_obstacles import CriticalObject
from tests.safety.safety_world import START_NS, SyntheticInbox, machine_state
from tests.safety.test_collision_monitor import CONTROL_COMMAND, SEEN, Spy

FAULT_TOPICS = ("fault/executor", "fault/planner")
COMMAND, STATE = object(), object()
ADVISORIES = [advisory("a.b", "advisory text")]
CONSENT = Consent(by="A. Bauer", vegetation_m=0.3)
GAP = Clearance(7.0, 3.0, np.empty((0, 3)))
THREAT = CriticalObject(9.0, ObstacleClass.PERSON, 4)


class KindInbox(SyntheticInbox):
    """Asserts the message type of the topic."""

    def latest(self, topic: str, kind: type) -> Any:
        assert kind is spec_of(topic).type
        return super().latest(topic, kind)

    def all(self, topic: str, kind: type) -> Any:
        assert kind is spec_of(topic).type
        return super().all(topic, kind)


@pytest.fixture(scope="module")
def machine(full: Vehicle) -> Vehicle:
    """A machine whose lidars differ in noise."""
    lidars = full.sensors.lidar
    noisy = {"front": lidars["front"], "rear": lidars["rear"].model_copy(update={"range_sigma_m": 0.07})}
    return full.model_copy(update={"sensors": full.sensors.model_copy(update={"lidar": noisy})})


@pytest.fixture
def make(machine: Vehicle, implement, config: SupervisorConfig, geofence: Geofence) -> Callable[..., Any]:
    def made(**what: Any) -> Any:
        return Supervisor(what.pop("vehicle", machine), implement, config, geofence, FAULT_TOPICS, **what)

    return made


def measured(config: SupervisorConfig, speed_mps: float | None = -1.5) -> VehicleState:
    return VehicleState(speed_mps, 1.5, -1, config.braking.flat, 0.0, 0.03, 0.07, 0.1, 0.2, 0.3, 0.35, 0.4, 0.5, True)


def source(name: str, covers: int, is_frozen: bool) -> Any:
    return SimpleNamespace(name=name, covers=lambda direction: direction == covers, is_frozen=is_frozen)


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch, config: SupervisorConfig) -> Any:
    """Spies for all parts of a supervisor."""
    proven = {"lidar/rear": 30.0, "lidar/low": 0.5, "lidar/side": 0.0}
    lidars = [source("rear", -1, True), source("low", -1, False), source("front", 1, True)]
    decision: Any = SimpleNamespace(allowed_mps=1.2, advisories=tuple(ADVISORIES))
    found = SimpleNamespace(
        decision=decision, evaluate_rules=Spy(decision), build_state=Spy(STATE), timed_out_topics=Spy(("odom",)),
        inputs=SimpleNamespace(read=Spy(SEEN), ages=Spy(["ages"]), sensor_failures=Spy(("lost",))),
        vehicle_monitor=SimpleNamespace(update=Spy(measured(config))),
        monitor=SimpleNamespace(
            config=config.docked, update=Spy(None), clearance=Spy(GAP), critical_object=Spy(THREAT),
            standing_bodies=SimpleNamespace(slowest=NO_STANDING_BODY), geofence_distance_m=Spy(8.0),
            wall_distance_m=Spy(6.0), is_docking=True, is_under_roof=False,
            is_departure_unresolved=lambda command: command is not None, is_somebody_near=lambda command: False,
            confirm_clear=Spy(None),
            bystanders=SimpleNamespace(bars_pto=Spy(True)),
            swept_field=SimpleNamespace(is_planned=True),
            pose_history=SimpleNamespace(driven_m=12.0, has_jumped=False),
            sources=SimpleNamespace(
                lidars=lidars, lidar_failures=Spy(("wrong",)), detection_range_m=Spy(proven), vegetation_m=0.3
            ),
        ),
        mode_machine=SimpleNamespace(
            mode=Mode.AUTOMATIC, latched=None, is_just_confirmed=True, fault_memory=FaultMemory(), update=Spy(None),
            reason=Spy("why"), braking_clearance_m=Spy(4.5), resume_in_s=Spy(0.5),
        ),
        command_builder=SimpleNamespace(last=COMMAND, command=Spy(COMMAND)),
        brake_test=SimpleNamespace(update=Spy("phase")),
        alarms=SimpleNamespace(update=Spy(["fault"])),
    )  # fmt: skip
    for name in ("evaluate_rules", "build_state", "timed_out_topics"):
        monkeypatch.setattr(f"safety.supervisor.{name}", getattr(found, name))
    return found


@pytest.fixture
def among(make: Callable[..., Any], parts: Any) -> Callable[..., Any]:
    """A supervisor with these parts."""

    def made(**what: Any) -> Any:
        supervisor = make(**what)
        supervisor.collision_monitor = parts.monitor
        for name in ("inputs", "vehicle_monitor", "mode_machine", "command_builder", "brake_test", "alarms"):
            setattr(supervisor, f"_{name}", getattr(parts, name))
        return supervisor

    return made


@pytest.fixture
def inbox() -> KindInbox:
    found = KindInbox()
    status = MissionStatus(START_NS, MissionState.DRIVING, PathSectionType.SWATH, 1, 7, 3.0, 0.0, 1.0, "", ())
    found.put("machine", machine_state(START_NS, curvature_radpm=0.05))
    found.put("mission", status)
    found.put("operator_command", status)
    for topic in FAULT_TOPICS:
        found.put(topic, Fault(START_NS, topic, "x", Severity.ALARM, True, Response.CONTROLLED_STOP, True, "e", "d"))
    return found


def test_topics_and_period(make: Any, machine: Vehicle, config: SupervisorConfig) -> None:
    supervisor = make()
    reads = SupervisorInputs(machine.sensors, frozenset(), config).reads
    assert supervisor.reads == reads | dict.fromkeys(("operator_command", *FAULT_TOPICS), All(50))
    assert supervisor.writes == ("safe_command", "supervisor", "fault/supervisor")
    assert (supervisor.name, supervisor.runs, supervisor.mode) == ("supervisor", Every(PERIOD_NS), Mode.STANDBY)
    idle = make(idle=frozenset({"camera_front"}))
    assert set(supervisor.reads) - set(idle.reads) == {"obstacles/camera_front", "health/camera_front"}


def test_parts_have_the_same_configuration(
    make: Any, machine: Vehicle, implement, config: SupervisorConfig, geofence: Geofence
) -> None:
    known_structure = KnownStructure(
        np.empty((0, 4)), 0.1, np.empty((0, 3)), np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)])
    )
    supervisor = make(known_structure=known_structure)
    monitor = supervisor.collision_monitor
    assert monitor._footprints == footprints_of(machine, implement)
    assert (monitor._geofence, monitor._known_structure, monitor.config) == (geofence, known_structure, config)
    assert [source.name for source in monitor.sources.lidars] == ["front", "rear"]


def test_composed_parts(make: Any, config: SupervisorConfig) -> None:
    class OtherMonitor(CollisionMonitor):
        """Composed by a caller."""

    mode_machine = ModeMachine(config.modes)
    supervisor = make(mode_machine=mode_machine, monitor=OtherMonitor)
    assert isinstance(supervisor.collision_monitor, OtherMonitor)
    assert supervisor._mode_machine is mode_machine


def test_standby_without_inputs(make: Any) -> None:
    outputs = dict(make().step(START_NS, KindInbox()))
    command, state = outputs["safe_command"], outputs["supervisor"]
    assert isinstance(command, SafeCommand)
    assert isinstance(state, SupervisorState)
    assert (command.mode, command.speed_mps, command.reason) == (Mode.STANDBY, 0.0, "machine.silent")
    assert (state.detection_range_m, state.clearance_m, state.mode) == (0.0, math.inf, Mode.STANDBY)


def test_monitors_get_the_inputs(among: Any, parts: Any, inbox: Any, config: SupervisorConfig) -> None:
    supervisor, machine = among(), inbox.messages["machine"]
    supervisor.step(START_NS, inbox)
    assert parts.inputs.read.asked == (inbox, machine)
    assert parts.vehicle_monitor.update.asked == (
        START_NS, Mode.AUTOMATIC, SEEN.odom, machine, SEEN.map_pose, SEEN.path, CONTROL_COMMAND, COMMAND,
    )  # fmt: skip
    allowance = allowance_m(config.docked.field, 0.07, 0.03)
    assert parts.monitor.update.asked == (SEEN, -1, 1.5, config.braking.flat, allowance)
    assert [fault.code for fault in parts.mode_machine.fault_memory.active] == list(FAULT_TOPICS)


def test_situation(among: Any, parts: Any, inbox: Any, machine: Vehicle, config: SupervisorConfig) -> None:
    supervisor = among(consent=CONSENT)
    supervisor.step(START_NS, inbox)
    situation, rules = parts.evaluate_rules.asked
    assert rules is RULES
    assert situation == Situation(
        now_ns=START_NS, config=config.docked, rule_limits=config.rules, inputs=SEEN,
        machine=inbox.messages["machine"], vehicle=measured(config),
        max_speed_mps=min(machine.max_speed_kmh, config.limits.speed_kmh) / 3.6,
        allowance_m=allowance_m(config.docked.field, 0.07, 0.03), timed_out_topics=("odom",), frozen=("lidar/rear",),
        faults=parts.mode_machine.fault_memory.active,
        clearance=GAP, critical_object=THREAT, standing_body=NO_STANDING_BODY,
        detection_range_m=30.0, blind=("lidar/side",),
        geofence_distance_m=8.0,
        is_foldable=True, clock_step_s=0.0, has_pose_jumped=False, brake_test="phase", sensor_failures=("lost",),
        is_departure_unresolved=True, is_somebody_near=False, lidar_failures=("wrong",), vegetation_m=0.3,
        consent=CONSENT, is_docking=True, is_under_roof=False, wall_distance_m=6.0,
    )  # fmt: skip
    assert parts.timed_out_topics.asked == (["ages"],)
    assert parts.inputs.ages.asked == (START_NS, inbox, parts.monitor, -1)
    assert parts.inputs.sensor_failures.asked == (START_NS, inbox, SEEN, parts.monitor, -1)
    assert parts.monitor.sources.lidar_failures.asked == (-1,)
    assert parts.monitor.sources.detection_range_m.asked == (START_NS, -1, SEEN.health)
    assert parts.brake_test.update.asked == (Mode.AUTOMATIC, -1.5, 12.0, config.braking.flat)


def test_a_confirmation_reaches_the_monitor(among: Any, parts: Any, inbox: Any) -> None:
    among().step(START_NS, inbox)
    assert parts.monitor.confirm_clear.calls == [()]
    parts.mode_machine.is_just_confirmed = False
    among().step(START_NS, inbox)
    assert parts.monitor.confirm_clear.calls == [()]


def test_situation_with_unknown_values(among: Any, parts: Any, inbox: Any, config: SupervisorConfig) -> None:
    parts.vehicle_monitor.update.answer = measured(config, None)
    parts.monitor.sources.detection_range_m.answer = {}
    supervisor = among()
    supervisor.step(START_NS, inbox)
    situation = parts.evaluate_rules.asked[0]
    assert situation.vehicle.speed_mps is None
    assert (situation.detection_range_m, situation.blind) == (0.0, ())


def test_max_speed(among: Any, parts: Any, inbox: Any, machine: Vehicle, config: SupervisorConfig) -> None:
    for kmh in (12.0, 90.0):
        among(vehicle=machine.model_copy(update={"max_speed_kmh": kmh})).step(START_NS, inbox)
        most_mps = parts.evaluate_rules.asked[0].max_speed_mps
        assert most_mps == pytest.approx(min(kmh, config.limits.speed_kmh) / 3.6)


def test_allowance_without_lidars(
    among: Any, parts: Any, inbox: Any, machine: Vehicle, config: SupervisorConfig
) -> None:
    bare = machine.model_copy(update={"sensors": machine.sensors.model_copy(update={"lidar": {}})})
    among(vehicle=bare).step(START_NS, inbox)
    assert parts.evaluate_rules.asked[0].allowance_m == allowance_m(config.docked.field, 0.0, 0.03)


def test_mode_machine_and_command_builder_get_the_decision(
    among: Any, parts: Any, inbox: Any, config: SupervisorConfig
) -> None:
    supervisor = among()
    supervisor.step(START_NS, inbox)
    situation = parts.evaluate_rules.asked[0]
    mission = inbox.messages["mission"]
    assert parts.mode_machine.update.asked == ((mission,), situation, parts.decision, mission)
    assert (
        parts.mode_machine.reason.asked == parts.mode_machine.braking_clearance_m.asked == (situation, parts.decision)
    )
    (inputs,) = parts.command_builder.command.asked
    assert (inputs.now_ns, inputs.mode, inputs.reason, inputs.control_command) == (
        START_NS,
        Mode.AUTOMATIC,
        "why",
        CONTROL_COMMAND,
    )
    assert (inputs.machine, inputs.measured_mps, inputs.curvature_radpm) == (situation.machine, -1.5, 0.05)
    assert (inputs.allowed_mps, inputs.clearance_m, inputs.braking) == (1.2, 4.5, config.braking.flat)
    assert inputs.has_driver is True
    assert inputs.is_pto_barred is True
    assert parts.monitor.bystanders.bars_pto.asked == (START_NS,)
    del inbox.messages["machine"]
    supervisor.step(START_NS, inbox)
    assert parts.command_builder.command.asked[0].curvature_radpm is None


def test_outputs(among: Any, parts: Any, inbox: Any) -> None:
    supervisor = among()
    parts.alarms.update.answer = ["one", "other"]
    assert supervisor.step(START_NS, inbox) == [
        ("safe_command", COMMAND), ("fault/supervisor", "one"), ("fault/supervisor", "other"), ("supervisor", STATE),
    ]  # fmt: skip
    for k, reason, count in ((1, "why", 0), (2, "other", 1), (3, "other", 0)):
        parts.mode_machine.reason.answer = reason
        topics = [topic for topic, _ in supervisor.step(START_NS + k * PERIOD_NS, inbox)]
        assert topics.count("supervisor") == count, k


def test_state_has_the_new_mode(among: Any, parts: Any, inbox: Any) -> None:
    parts.mode_machine.update = lambda *_: setattr(parts.mode_machine, "mode", Mode.OBSTACLE_STOP)
    among().step(START_NS, inbox)
    situation, *rest = parts.build_state.asked
    assert parts.vehicle_monitor.update.asked[1] is Mode.AUTOMATIC
    assert situation is parts.evaluate_rules.asked[0]
    assert rest == [parts.monitor, parts.decision, Mode.OBSTACLE_STOP, "why", 0.5]
    assert parts.mode_machine.resume_in_s.asked == (START_NS,)


def test_alarms_of_the_latched_cause_and_of_advisories_while_engaged(among: Any, parts: Any, inbox: Any) -> None:
    latched = stop("x.y", "stands")
    for one, mode, expected in (
        (None, Mode.STANDBY, ()), (None, Mode.AUTOMATIC, (*ADVISORIES,)), (latched, Mode.MANUAL, (latched,)),
        (latched, Mode.AUTOMATIC, (latched, *ADVISORIES)),
    ):  # fmt: skip
        parts.mode_machine.mode, parts.mode_machine.latched = mode, one
        among().step(START_NS, inbox)
        assert parts.alarms.update.asked == (START_NS, expected)


def test_state_period(among: Any, parts: Any) -> None:
    supervisor = among()
    due = supervisor._is_state_due
    assert due(START_NS, "")
    assert not due(START_NS, "")
    assert not due(START_NS + STATE_NS - 1, "")
    assert due(START_NS + STATE_NS, "")
    assert not due(START_NS + 2 * STATE_NS - 1, "")
    assert due(START_NS + 2 * STATE_NS - 1, "x")
    assert not due(START_NS + 2 * STATE_NS, "x")
    parts.mode_machine.mode = Mode.MANUAL
    assert due(START_NS + 2 * STATE_NS, "x")
    assert not due(START_NS + STATE_NS + 1, "x")
    assert due(START_NS + STATE_NS, "x")
    assert due(START_NS + 2 * STATE_NS, "x")


def test_monitors_restart_after_a_clock_step(make: Any, config: SupervisorConfig, parts: Any) -> None:
    supervisor = make()
    limit_ns = round(config.limits.clock_step_s * 1e9)
    collision_monitor, vehicle_monitor, now_ns = supervisor.collision_monitor, supervisor._vehicle_monitor, START_NS
    assert supervisor._watch_clock(now_ns) == 0.0
    for late_ns in (0, limit_ns, -limit_ns, 1000):
        now_ns += PERIOD_NS + late_ns
        assert supervisor._watch_clock(now_ns) == 0.0, late_ns
        assert supervisor.collision_monitor is collision_monitor
        assert supervisor._vehicle_monitor is vehicle_monitor
    for late_ns in (limit_ns + 1000, -limit_ns - 1000):
        now_ns += PERIOD_NS + late_ns
        assert supervisor._watch_clock(now_ns) == pytest.approx(late_ns * 1e-9, abs=1e-12)
        assert supervisor.collision_monitor is not collision_monitor
        assert supervisor.collision_monitor.config is config
        assert supervisor._vehicle_monitor is not vehicle_monitor
        assert supervisor._vehicle_monitor._config is config
        collision_monitor, vehicle_monitor = supervisor.collision_monitor, supervisor._vehicle_monitor
    now_ns += PERIOD_NS
    assert supervisor._watch_clock(now_ns) == 0.0


def test_clock_step_in_the_situation(among: Any, parts: Any, inbox: Any) -> None:
    supervisor = among()
    supervisor._new_monitor = lambda: parts.monitor
    supervisor.step(START_NS, inbox)
    supervisor._watch_clock = Spy(2.5)
    supervisor.step(START_NS + PERIOD_NS, inbox)
    assert supervisor._watch_clock.asked == (START_NS + PERIOD_NS,)
    assert parts.evaluate_rules.asked[0].clock_step_s == 2.5
