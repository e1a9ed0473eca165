"""One step of the supervisor among parts that only say what they were asked: who is told what, in which order."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.vehicle import Vehicle
from messages.command import Mode, SafeCommand, SupervisorState
from messages.errors import ConfigError
from messages.faults import Fault, Response, Severity
from messages.node import All, Every
from messages.perception import ObstacleClass
from messages.plan import MissionState, MissionStatus, PathSectionType
from messages.topics import spec_of
from safety.config import SafetyConfig
from safety.inputs import SupervisorInputs
from safety.monitors.vehicle import VehicleState
from safety.rules.arbitration import allowance_m
from safety.rules.results import advisory, stop
from safety.rules.situation import Situation
from safety.supervisor import ABLATION, PERIOD_NS, STATE_NS, Observation, Supervisor
from safety.zones.footprint import footprints_of
from safety.zones.geofence import Geofence
from safety.zones.known_structure import KnownStructure
from safety.zones.protective_field import Clearance
from safety.zones.tracked_obstacles import CriticalObject
from tests.safety.safety_world import START_NS, SyntheticInbox, machine_state
from tests.safety.test_collision_monitor import CONTROL_COMMAND, SEEN, Spy

FAULT_TOPICS = ("fault/executor", "fault/planner")
COMMAND, STATE = object(), object()
ADVISORIES = [advisory("a.b", "something to be told")]
GAP = Clearance(7.0, 3.0, np.empty((0, 3)))
THREAT = CriticalObject(9.0, ObstacleClass.PERSON, 4)


class KindInbox(SyntheticInbox):
    """Gives nothing to who asks for another kind than the topic's."""

    def latest(self, topic: str, kind: type) -> Any:
        assert kind is spec_of(topic).type
        return super().latest(topic, kind)

    def all(self, topic: str, kind: type) -> Any:
        assert kind is spec_of(topic).type
        return super().all(topic, kind)


@pytest.fixture(scope="module")
def machine(full: Vehicle) -> Vehicle:
    """Its lidars differ in noise."""
    lidars = full.sensors.lidar
    noisy = {"front": lidars["front"], "rear": lidars["rear"].model_copy(update={"range_sigma_m": 0.07})}
    return full.model_copy(update={"sensors": full.sensors.model_copy(update={"lidar": noisy})})


@pytest.fixture
def make(machine: Vehicle, implement, config: SafetyConfig, geofence: Geofence) -> Callable[..., Any]:
    def made(**what: Any) -> Any:
        return Supervisor(what.pop("vehicle", machine), implement, config, geofence, FAULT_TOPICS, **what)

    return made


def measured(config: SafetyConfig, speed_mps: float | None = -1.5) -> VehicleState:
    return VehicleState(speed_mps, 1.5, -1, config.braking.flat, 0.03, 0.1, 0.2, 0.3, 0.4, True)


def source(name: str, covers: int, is_frozen: bool) -> Any:
    return SimpleNamespace(name=name, covers=lambda direction: direction == covers, is_frozen=is_frozen)


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch, config: SafetyConfig) -> Any:
    """Stands for all that a supervisor asks."""
    detection_range = {"lidar/rear": 30.0, "lidar/low": 0.5, "lidar/side": 0.0}
    lidars = [source("rear", -1, True), source("low", -1, False), source("front", 1, True)]
    decision: Any = SimpleNamespace(allowed_mps=1.2, advisories=ADVISORIES)
    found = SimpleNamespace(
        decision=decision, evaluate_rules=Spy(decision), build_state=Spy(STATE), timed_out_topics=Spy(("odom",)),
        inputs=SimpleNamespace(read=Spy(SEEN), ages=Spy(["ages"]), sensor_failures=Spy(("lost",))),
        vehicle_monitor=SimpleNamespace(update=Spy(measured(config))),
        collision_monitor=SimpleNamespace(
            config=config.docked, update=Spy(None), clearance=Spy(GAP), critical_object=Spy(THREAT),
            geofence_distance_m=Spy(8.0), wall_distance_m=Spy(6.0), is_docking=True, is_under_roof=False,
            swept_field=SimpleNamespace(is_planned=True), pose_history=SimpleNamespace(driven_m=12.0),
            sources=SimpleNamespace(lidars=lidars, detection_range_m=Spy(detection_range)),
        ),
        mode_machine=SimpleNamespace(mode=Mode.AUTOMATIC, latched=None, update=Spy(None), reason=Spy("why"),
                             braking_clearance_m=Spy(4.5), resume_in_s=Spy(0.5)),
        command_builder=SimpleNamespace(last=COMMAND, command=Spy(COMMAND)),
        brake_test=SimpleNamespace(update=Spy("phase")),
        alarms=SimpleNamespace(update=Spy(["fault"])),
    )  # fmt: skip
    for name in ("evaluate_rules", "build_state", "timed_out_topics"):
        monkeypatch.setattr(f"safety.supervisor.{name}", getattr(found, name))
    return found


@pytest.fixture
def among(make: Callable[..., Any], parts: Any) -> Callable[..., Any]:
    """A supervisor among these parts."""

    def made(**what: Any) -> Any:
        supervisor = make(**what)
        for name in (
            "inputs",
            "vehicle_monitor",
            "collision_monitor",
            "mode_machine",
            "command_builder",
            "brake_test",
            "alarms",
        ):
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


def test_what_it_reads_writes_and_when_it_runs(make: Any, machine: Vehicle, config: SafetyConfig) -> None:
    supervisor = make()
    reads = SupervisorInputs(machine.sensors, frozenset(), config).reads
    assert supervisor.reads == reads | dict.fromkeys(("operator_command", *FAULT_TOPICS), All(50))
    assert supervisor.writes == ("safe_command", "supervisor", "fault/supervisor")
    assert (supervisor.name, supervisor.runs, supervisor.mode) == ("supervisor", Every(PERIOD_NS), Mode.STANDBY)
    watching = make(observation=Observation(True), idle=frozenset({"camera_front"}))
    assert (watching.writes, watching.mode) == (("supervisor",), Mode.AUTOMATIC)
    assert set(supervisor.reads) - set(watching.reads) == {"obstacles/camera_front", "health/camera_front"}


def test_a_rule_that_there_is_not_cannot_be_disabled(make: Any) -> None:
    with pytest.raises(ConfigError, match=r"^disabled_rules: no rule 'alpha'; there are \w+(, \w+)+$"):
        make(disabled_rules=frozenset({"zeta", "alpha", "clock"}))


def test_all_parts_are_of_the_same_machine(
    make: Any, machine: Vehicle, implement, config: SafetyConfig, geofence: Geofence
) -> None:
    known_structure = KnownStructure(
        np.empty((0, 4)), 0.1, np.empty((0, 3)), np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)])
    )
    supervisor = make(known_structure=known_structure)
    collision_monitor = supervisor._collision_monitor
    assert collision_monitor._footprints == footprints_of(machine, implement)
    assert (collision_monitor._geofence, collision_monitor._known_structure, collision_monitor.config) == (
        geofence,
        known_structure,
        config,
    )
    assert [source.name for source in collision_monitor.sources.lidars] == ["front", "rear"]
    assert supervisor._mode_machine._fault_memory is supervisor._fault_memory
    for observation, is_judged in ((None, True), (Observation(True), True), (Observation(False), False)):
        assert make(observation=observation)._collision_monitor._is_arc_checked is is_judged


def test_nothing_known_is_standby_in_one_step(make: Any) -> None:
    outputs = dict(make().step(START_NS, KindInbox()))
    command, state = outputs["safe_command"], outputs["supervisor"]
    assert isinstance(command, SafeCommand)
    assert isinstance(state, SupervisorState)
    assert (command.mode, command.speed_mps, command.reason) == (Mode.STANDBY, 0.0, "machine.silent")
    assert (state.detection_range_m, state.clearance_m, state.mode) == (0.0, math.inf, Mode.STANDBY)


def test_only_the_state_of_who_looks_on_gets_out(make: Any) -> None:
    outputs = make(observation=Observation(True)).step(START_NS, KindInbox())
    assert [topic for topic, _ in outputs] == ["supervisor"]


def test_measured_and_looked_at_is_what_was_seen(among: Any, parts: Any, inbox: Any, config: SafetyConfig) -> None:
    supervisor, machine = among(), inbox.messages["machine"]
    supervisor.step(START_NS, inbox)
    assert parts.inputs.read.asked == (inbox, machine)
    assert parts.vehicle_monitor.update.asked == (
        START_NS, Mode.AUTOMATIC, SEEN.odom, machine, SEEN.map_pose, SEEN.path, CONTROL_COMMAND, COMMAND,
    )  # fmt: skip
    allowance = allowance_m(config.docked.field, 0.07, 0.03)
    assert parts.collision_monitor.update.asked == (SEEN, -1, 1.5, config.braking.flat, allowance)
    assert [fault.code for fault in supervisor._fault_memory.active] == list(FAULT_TOPICS)


def test_the_situation_says_it_all(among: Any, parts: Any, inbox: Any, machine: Vehicle, config: SafetyConfig) -> None:
    supervisor = among()
    supervisor.step(START_NS, inbox)
    situation, disabled = parts.evaluate_rules.asked
    assert disabled == frozenset()
    assert situation == Situation(
        now_ns=START_NS, config=config.docked, mode=Mode.AUTOMATIC, direction=-1, speed_mps=1.5, is_speed_known=True,
        max_speed_mps=min(machine.max_speed_kmh, config.limits.speed_kmh) / 3.6, braking=config.braking.flat,
        allowance_m=allowance_m(config.docked.field, 0.07, 0.03), odom=SEEN.odom, machine=inbox.messages["machine"],
        map_pose=SEEN.map_pose, control_command=CONTROL_COMMAND, timed_out_topics=("odom",), frozen=("lidar/rear",),
        faults=supervisor._fault_memory.active,
        clearance=GAP, is_planned=True, critical_object=THREAT, detection_range_m=30.0, blind=("lidar/side",),
        geofence_distance_m=8.0,
        position_sigma_m=0.03, driver_override_s=0.1, steering_deviation_s=0.2, steering_unavailable_s=0.3,
        brake_ineffective_s=0.4,
        is_foldable=True, fold=0.0, clock_step_s=0.0, brake_test="phase", sensor_failures=("lost",), is_docking=True,
        is_under_roof=False, wall_distance_m=6.0,
    )  # fmt: skip
    assert parts.timed_out_topics.asked == (["ages"],)
    assert parts.inputs.ages.asked == (START_NS, inbox, parts.collision_monitor, -1)
    assert parts.inputs.sensor_failures.asked == (START_NS, inbox, SEEN, parts.collision_monitor, -1)
    assert parts.collision_monitor.sources.detection_range_m.asked == (START_NS, -1, SEEN.health)
    assert parts.brake_test.update.asked == (Mode.AUTOMATIC, -1.5, 12.0)


def test_what_is_not_known_is_not_taken_for_known(among: Any, parts: Any, inbox: Any, config: SafetyConfig) -> None:
    parts.vehicle_monitor.update.answer = measured(config, None)
    parts.collision_monitor.sources.detection_range_m.answer = {}
    supervisor = among()
    for swept_field, is_planned in ((None, False), (SimpleNamespace(is_planned=False), False)):
        parts.collision_monitor.swept_field = swept_field
        supervisor.step(START_NS, inbox)
        situation = parts.evaluate_rules.asked[0]
        assert (situation.is_planned, situation.is_speed_known) == (is_planned, False)
        assert (situation.detection_range_m, situation.blind) == (0.0, ())


def test_no_faster_than_machine_and_configuration_allow(
    among: Any, parts: Any, inbox: Any, machine: Vehicle, config: SafetyConfig
) -> None:
    for kmh in (12.0, 90.0):
        among(vehicle=machine.model_copy(update={"max_speed_kmh": kmh})).step(START_NS, inbox)
        most_mps = parts.evaluate_rules.asked[0].max_speed_mps
        assert most_mps == pytest.approx(min(kmh, config.limits.speed_kmh) / 3.6)


def test_without_lidars_there_is_no_noise(
    among: Any, parts: Any, inbox: Any, machine: Vehicle, config: SafetyConfig
) -> None:
    bare = machine.model_copy(update={"sensors": machine.sensors.model_copy(update={"lidar": {}})})
    among(vehicle=bare).step(START_NS, inbox)
    assert parts.evaluate_rules.asked[0].allowance_m == allowance_m(config.docked.field, 0.0, 0.03)


def test_helm_and_commander_get_the_judgement(among: Any, parts: Any, inbox: Any, config: SafetyConfig) -> None:
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
    del inbox.messages["machine"]
    supervisor.step(START_NS, inbox)
    assert parts.command_builder.command.asked[0].curvature_radpm is None


def test_command_faults_and_state_leave_it(among: Any, parts: Any, inbox: Any) -> None:
    supervisor = among()
    parts.alarms.update.answer = ["one", "other"]
    assert supervisor.step(START_NS, inbox) == [
        ("safe_command", COMMAND), ("fault/supervisor", "one"), ("fault/supervisor", "other"), ("supervisor", STATE),
    ]  # fmt: skip
    for k, reason, count in ((1, "why", 0), (2, "other", 1), (3, "other", 0)):
        parts.mode_machine.reason.answer = reason
        topics = [topic for topic, _ in supervisor.step(START_NS + k * PERIOD_NS, inbox)]
        assert topics.count("supervisor") == count, k


def test_the_state_tells_the_mode_that_was_decided(among: Any, parts: Any, inbox: Any) -> None:
    parts.mode_machine.update = lambda *_: setattr(parts.mode_machine, "mode", Mode.OBSTACLE_STOP)
    for observation, has_threat in ((None, False), (Observation(True), True)):
        parts.mode_machine.mode = Mode.AUTOMATIC
        among(observation=observation).step(START_NS, inbox)
        situation, *rest = parts.build_state.asked
        assert (parts.evaluate_rules.asked[0].mode, situation.mode) == (Mode.AUTOMATIC, Mode.OBSTACLE_STOP)
        assert situation.now_ns == START_NS
        assert situation.odom is SEEN.odom
        assert rest == [SEEN, parts.collision_monitor, parts.decision, "why", 0.5, has_threat]
        assert parts.mode_machine.resume_in_s.asked == (START_NS,)


def test_told_are_ablation_then_what_latched_then_notes_while_watched(among: Any, parts: Any, inbox: Any) -> None:
    latched = stop("x.y", "stands")
    for disabled, one, mode, expected in (
        (frozenset(), None, Mode.STANDBY, []), (frozenset(), None, Mode.AUTOMATIC, ADVISORIES),
        (frozenset({"clock_step"}), None, Mode.AUTOMATIC, [ABLATION, *ADVISORIES]),
        (frozenset(), latched, Mode.MANUAL, [latched]),
        (frozenset({"clock_step"}), latched, Mode.AUTOMATIC, [ABLATION, latched, *ADVISORIES]),
    ):  # fmt: skip
        parts.mode_machine.mode, parts.mode_machine.latched = mode, one
        among(disabled_rules=disabled).step(START_NS, inbox)
        assert parts.alarms.update.asked == (START_NS, expected)
        assert parts.evaluate_rules.asked[1] == disabled


def test_the_state_is_due_ten_times_a_second_and_when_mode_or_reason_change(among: Any, parts: Any) -> None:
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


def test_after_a_step_of_the_clock_nothing_seen_before_counts(make: Any, config: SafetyConfig, parts: Any) -> None:
    supervisor = make()
    limit_ns = round(config.limits.clock_step_s * 1e9)
    collision_monitor, vehicle_monitor, now_ns = supervisor._collision_monitor, supervisor._vehicle_monitor, START_NS
    assert supervisor._watch_clock(now_ns) == 0.0
    for late_ns in (0, limit_ns, -limit_ns, 1000):
        now_ns += PERIOD_NS + late_ns
        assert supervisor._watch_clock(now_ns) == 0.0, late_ns
        assert supervisor._collision_monitor is collision_monitor
        assert supervisor._vehicle_monitor is vehicle_monitor
    for late_ns in (limit_ns + 1000, -limit_ns - 1000):
        now_ns += PERIOD_NS + late_ns
        assert supervisor._watch_clock(now_ns) == pytest.approx(late_ns * 1e-9, abs=1e-12)
        assert supervisor._collision_monitor is not collision_monitor
        assert supervisor._collision_monitor.config is config
        assert supervisor._vehicle_monitor is not vehicle_monitor
        assert supervisor._vehicle_monitor._config is config
        collision_monitor, vehicle_monitor = supervisor._collision_monitor, supervisor._vehicle_monitor
    now_ns += PERIOD_NS
    assert supervisor._watch_clock(now_ns) == 0.0


def test_the_step_of_the_clock_is_judged(among: Any, parts: Any, inbox: Any) -> None:
    supervisor = among()
    supervisor._fresh_lookout = lambda: parts.collision_monitor
    supervisor.step(START_NS, inbox)
    supervisor._watch_clock = Spy(2.5)
    supervisor.step(START_NS + PERIOD_NS, inbox)
    assert supervisor._watch_clock.asked == (START_NS + PERIOD_NS,)
    assert parts.evaluate_rules.asked[0].clock_step_s == 2.5
