"""Supervisors composed for trials: without obstacle rules, and in shadow mode over a recording."""

import math
from typing import Any

import numpy as np
import pytest

from geometry.transforms import planar
from messages.command import Mode, OperatorCommandKind
from messages.faults import Fault, Response, Severity
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from runtime.ablation import REMAINING_RULES, ReportedAblation
from runtime.replay.shadow_supervisor import SHADOW_RULES, ShadowSupervisor
from safety.rules import RULES
from safety.supervisor import Supervisor
from safety.zones.tracked_obstacles import CriticalObject
from tests.safety.conftest import config, geofence, implement, sparse, vehicle  # noqa: F401
from tests.safety.safety_world import START_NS, Box, SyntheticInbox, World, straight_path


def person(x_m: float) -> Track:
    return Track(4, ObstacleClass.PERSON, 0.9, np.array([x_m, 0.0, 0.8]), np.zeros(3), np.eye(4) * 0.01,
                 np.array([0.5, 0.5, 1.7]), 0.0, START_NS, START_NS, True, ("camera_front",))  # fmt: skip


def test_rules_of_trials() -> None:
    assert set(SHADOW_RULES) == {"protective_field", "tracked_obstacle"}
    assert list(REMAINING_RULES) == [name for name in RULES if name not in SHADOW_RULES]


def test_ablation_is_reported_once(config: Any, sparse: Any, implement: Any, geofence: Any) -> None:  # noqa: F811
    supervisor = Supervisor(sparse, implement, config, geofence, (), rules=REMAINING_RULES)
    node = ReportedAblation(supervisor)
    assert (node.name, node.reads, node.writes, node.runs) == (
        supervisor.name, supervisor.reads, supervisor.writes, supervisor.runs,
    )  # fmt: skip
    inbox = SyntheticInbox()
    faults = [message for now in (0, 1) for topic, message in node.step(START_NS + now, inbox) if "fault" in topic]
    assert faults == [
        Fault(START_NS, "safety.ablation", "supervisor", Severity.WARNING, False, Response.NONE, True,
              "obstacle rules switched off for a trial", "注意：障碍物安全规则已关闭（试验）"),
    ]  # fmt: skip


class Shadowed(World):
    """A world around a shadow supervisor."""

    @property
    def mode(self) -> str:
        return str(self.supervisor.supervisor.mode)

    def __post_init__(self) -> None:
        pass


def test_shadow_supervisor_keeps_its_mode_and_commands_nothing(config, sparse, implement) -> None:  # noqa: F811
    shadow = ShadowSupervisor(sparse, implement, config, 1.0)
    assert shadow.writes == ("supervisor",)
    world: Any = Shadowed(shadow, sparse, straight_path())
    world.run(0.4)
    assert world.mode == Mode.AUTOMATIC
    assert world.command is None
    assert world.faults == []
    assert shadow.supervisor.collision_monitor.swept_field.arc is None
    assert len(world.state.triggering_points_base_m) == 0
    world.tracks = (person(6.0),)
    world.order(OperatorCommandKind.MANUAL)
    world.run(0.4)
    assert world.mode == Mode.AUTOMATIC
    assert world.state.triggering_points_base_m[:, 0].mean() == pytest.approx(6.0, abs=0.1)
    assert world.state.triggering_points_base_m.dtype == np.float32


def test_machine_and_arc_of_a_planned_recording(config, sparse, implement) -> None:  # noqa: F811
    shadow = ShadowSupervisor(sparse, implement, config, None)
    world: Any = Shadowed(shadow, sparse, straight_path())
    world.boxes = (Box(8.0, 0.0),)
    world.run(0.4)
    assert shadow.supervisor.collision_monitor.swept_field.arc is not None
    assert {rule.code for rule in world.state.rules} == {"protective_field", "tracked_obstacle"}


def test_box_of_the_critical_object_in_base(config, sparse, implement) -> None:  # noqa: F811
    shadow, inbox = ShadowSupervisor(sparse, implement, config, 1.0), SyntheticInbox()
    inbox.put("odom", Odometry(START_NS, planar(5.0, 1.0, math.pi / 2), 2.0, 0.0, 0.0, 0.0, 0.0, np.eye(6)))
    track = Track(4, ObstacleClass.PERSON, 0.9, np.array([9.0, 1.0, 0.8]), np.zeros(3), np.eye(4),
                  np.array([2.0, 1.0, 1.7]), math.pi / 2, 0, START_NS, True, ("lidar_front",))  # fmt: skip
    shadow.supervisor.collision_monitor.critical_object = lambda: CriticalObject(1.0, ObstacleClass.PERSON, 4)
    ((_, empty),) = shadow.step(START_NS, inbox)
    assert len(empty.triggering_points_base_m) == 0
    inbox.put("tracks", Tracks(START_NS, (track,)))
    with_box = shadow._with_box(empty, inbox).triggering_points_base_m
    expected = {(along, across, 0.8) for along in (-1.0, 0.0, 1.0) for across in (-4.5, -4.0, -3.5)}
    assert {tuple(np.round(point.astype(float), 6) + 0.0) for point in with_box} == expected
