"""Docking in closed loop: field and known structure at the shed, in both directions; fold of the implement."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from configs.site import PoseConfig, Site
from configs.strict import load
from messages.command import Mode, OperatorCommandKind
from messages.faults import Response
from messages.perception import ObstacleClass, Track
from messages.plan import Path, PathSection, PathSectionType
from safety.monitors.sensors import SensorFailure
from safety.rules import RULES
from safety.supervisor import Supervisor
from safety.supervisor_config import SupervisorConfig
from safety.zones.geofence import bay_rings, distance_across, geofence_of, is_within
from safety.zones.known_structure import KnownStructure, structure_of_site
from safety.zones.swept_area import arc_poses, spaced, sweep_along
from safety.zones.tracked_obstacles import without_known_structure
from tests.safety.safety_world import ROOT, Box, Target, World, around, situation_of, straight_path

REAR_M = 2.4
DOCK_KMH = 1.8


@pytest.fixture(scope="module")
def site() -> Site:
    return load(Site, ROOT / "configs/sites/demo.yaml")


@pytest.fixture(scope="module")
def known_structure(site: Site) -> KnownStructure:
    found = structure_of_site(site)
    assert found is not None
    return found


def shed_boxes(site: Site) -> tuple[Box, ...]:
    assert site.shed is not None
    walls = [Box(-4.0, y, (10.0, 0.15, 4.0)) for y in (-46.0, -34.0)]
    posts = [Box(*post.at_m, (0.24, 0.24, 4.0)) for post in site.shed.posts]
    return (Box(-9.0, -40.0, (0.15, 12.0, 4.0)), *walls, *posts)


def dock_path(direction: int, start: tuple[float, float], length_m: float) -> Path:
    path = straight_path(7, length_m, start, direction, speed_mps=0.5)
    return replace(path, sections=(PathSection(PathSectionType.DOCK, -1, 0, len(path.s_m) - 1),), is_transport=True)


def at_shed(world: World, site: Site, bay: str, direction: int) -> World:
    """Docked and heading out, or 4 m before the dock and reversing in."""
    assert site.shed is not None
    dock: PoseConfig = site.shed.bay(bay).dock
    length_m = 12.0 if direction > 0 else 4.0
    world.x_m, world.y_m = dock.x_m + (0.0 if direction > 0 else length_m), dock.y_m
    world.path = dock_path(direction, (world.x_m, world.y_m), length_m)
    world.boxes, world.fold, world.commanded_mps = shed_boxes(site), 1.0, 0.5
    world.command_changes = {"is_implement_lowered": False, "is_pto_on": False, "is_implement_folded": True}
    world.machine_changes = {"is_hitch_in_work": False}
    world.pose_changes = {"uwb_age_s": 0.1, "protection_level_m": 0.15, "covariance": np.eye(6) * 0.03**2}
    return world


@pytest.fixture
def shed_world(config, sparse, implement, site: Site, known_structure: KnownStructure) -> World:
    return World(
        Supervisor(sparse, implement, config, geofence_of(site), (), known_structure=known_structure),
        sparse,
        straight_path(),
    )


def engaged(world: World) -> World:
    """State after the start warning."""
    world.run(0.3)
    assert world.command.reason == "standby"
    world.supervisor._mode_machine.mode = Mode.AUTOMATIC
    return world


def drive_in(world: World, until_s: float = 11.0) -> World:
    """Reverses in; the control command stops at the end of the path."""
    world.mute.add("lidar/front")
    engaged(world)
    length_m = float(world.path.s_m[-1])
    for _ in range(round(until_s * 50)):
        left_m = length_m - abs(world.x_m - float(world.path.p_map_m[0, 0]))
        world.path_s_m = length_m - left_m
        world.commanded_mps = min(0.5, math.sqrt(max(0.0, 0.6 * (left_m - 0.02)))) if left_m > 0.03 else 0.0
        world.step()
    return world


@pytest.mark.parametrize("bay", ["narrow", "wide"])
def test_leaves_bay(shed_world: World, site: Site, bay: str) -> None:
    engaged(at_shed(shed_world, site, bay, 1)).mute.add("lidar/rear")
    before = shed_world.x_m
    shed_world.run(9.0)
    driven = [c for mode, c in shed_world.history if mode == Mode.AUTOMATIC]
    assert shed_world.mode == Mode.AUTOMATIC
    assert shed_world.x_m - before > 4.0
    assert {c.reason for c in driven} <= {""}
    assert all(c.is_implement_folded for c in driven)


@pytest.mark.parametrize("bay", ["narrow", "wide"])
def test_reverses_into_bay_to_dock(shed_world: World, site: Site, bay: str) -> None:
    """The dock is 0.6 m before the back wall."""
    drive_in(at_shed(shed_world, site, bay, -1))
    assert shed_world.mode == Mode.AUTOMATIC
    assert shed_world.speed_mps == pytest.approx(0.0, abs=0.01)
    assert shed_world.x_m == pytest.approx(-5.9, abs=0.08)
    assert max(abs(c.speed_mps) for _, c in shed_world.history) <= DOCK_KMH / 3.6 + 1e-6


@pytest.mark.parametrize(("box", "stops"), [
    (Box(-7.0, -43.68, (0.4, 0.4, 1.7)), True),  # somebody in the bay
    (Box(-7.0, -44.8, (0.3, 0.3, 1.0)), True),  # something narrow, in the tube beside the machine's middle
    (Box(-7.0, -45.75, (0.3, 0.3, 1.0)), False),  # behind the posts, at the wall
])  # fmt: skip
def test_unknown_object_stops(shed_world: World, site: Site, box: Box, stops: bool) -> None:
    at_shed(shed_world, site, "narrow", -1)
    shed_world.boxes = (*shed_world.boxes, box)
    drive_in(shed_world)
    assert (shed_world.mode == Mode.OBSTACLE_STOP) == stops
    if stops:
        left_m = shed_world.x_m - REAR_M - (box.x_m + box.size_m[0] / 2)
        assert 0.03 < left_m < 0.6


def test_displaced_wall_stops(shed_world: World, site: Site) -> None:
    at_shed(shed_world, site, "wide", -1)
    shed_world.boxes = (*shed_world.boxes, Box(-8.0, -40.0, (0.15, 6.0, 3.0)))
    drive_in(shed_world)
    assert shed_world.mode == Mode.OBSTACLE_STOP
    assert shed_world.x_m - REAR_M > -7.9


def test_path_into_wall(shed_world: World, site: Site) -> None:
    at_shed(shed_world, site, "wide", -1)
    shed_world.path = dock_path(-1, (shed_world.x_m, shed_world.y_m), 5.5)
    drive_in(shed_world)
    assert shed_world.command.reason in ("wall_clearance", "geofence")
    assert 0.05 < shed_world.x_m - REAR_M + 9.0 - 0.075 < 0.4
    assert shed_world.speed_mps == 0.0


def test_posts_beside_bay_stop(shed_world: World, site: Site) -> None:
    at_shed(shed_world, site, "narrow", -1)
    shed_world.y_m -= 0.25
    shed_world.path = dock_path(-1, (shed_world.x_m, shed_world.y_m), 4.0)
    before = shed_world.x_m
    drive_in(shed_world, 2.0)
    assert shed_world.command.reason == "wall_clearance"
    assert shed_world.x_m == before


@pytest.mark.parametrize(("changes", "reason"), [
    ({"uwb_age_s": 1.2}, "localization.uwb_lost"), ({"uwb_age_s": math.inf}, "localization.uwb_lost"),
    ({"protection_level_m": 0.3}, "localization.protection"),
])  # fmt: skip
def test_localization_limits_in_shed(shed_world: World, site: Site, changes: dict[str, float], reason: str) -> None:
    engaged(at_shed(shed_world, site, "narrow", 1))
    shed_world.run(1.0)
    shed_world.pose_changes |= changes
    shed_world.run(2.0)
    assert shed_world.mode == Mode.FAULT_STOP
    assert shed_world.command.reason == reason
    assert shed_world.speed_mps == 0.0


@pytest.mark.parametrize("fold", [0.0, 0.985])
def test_unfolded_implement_in_bay(shed_world: World, site: Site, fold: float) -> None:
    at_shed(shed_world, site, "wide", 1).fold = fold
    before = shed_world.x_m
    shed_world.start().run(0.5)
    assert shed_world.x_m == before


def test_open_field_on_other_section_type(shed_world: World, site: Site) -> None:
    at_shed(shed_world, site, "wide", -1)
    path = shed_world.path
    shed_world.path = replace(path, sections=(PathSection(PathSectionType.LANE, -1, 0, len(path.s_m) - 1),))
    drive_in(shed_world, 0.3)
    assert shed_world.supervisor.collision_monitor.config is shed_world.supervisor._config
    shed_world.path = path
    shed_world.run(0.3)
    assert shed_world.supervisor.collision_monitor.config.field.margin_m == 0.12


def test_tracks_on_walls_filtered(shed_world: World, site: Site) -> None:
    def track(x: float, y: float, size: tuple[float, float], label: ObstacleClass) -> Track:
        return Track(1, label, 0.9, np.array([x, y, 1.0]), np.zeros(3), np.eye(4) * 0.01, np.array([*size, 2.0]), 0.0,
                     0, 10**10, True, ("lidar_rear",))  # fmt: skip

    engaged(at_shed(shed_world, site, "wide", -1))
    shed_world.tracks = (track(-9.0, -40.0, (0.3, 1.9), ObstacleClass.MOUND),
                         track(-4.0, -40.0, (10.0, 12.0), ObstacleClass.VEHICLE))  # fmt: skip
    shed_world.run(2.0)
    assert shed_world.mode == Mode.AUTOMATIC
    assert shed_world.command.reason == ""
    shed_world.tracks = (track(shed_world.x_m - REAR_M - 0.5, -40.0, (0.5, 0.5), ObstacleClass.PERSON),)
    shed_world.run(1.5)
    assert shed_world.mode == Mode.OBSTACLE_STOP
    assert shed_world.state.obstacle_class is ObstacleClass.PERSON


def test_ultrasonic_loss_while_docking(config: SupervisorConfig) -> None:
    sensor_failures = (SensorFailure("ultrasonic", "ultrasonic/rear.silent", ""),)
    assert RULES["sensor_loss"](
        docking_situation(config, sensor_failures=sensor_failures)
    ).speed_limit_mps == pytest.approx(0.25)
    radar = (SensorFailure("radar", "radar/front.silent", ""),)
    assert RULES["sensor_loss"](docking_situation(config, sensor_failures=radar)).speed_limit_mps > 0.5


def test_echoes_of_known_walls_filtered(shed_world: World, config, full, implement, site, known_structure) -> None:
    world = at_shed(World(Supervisor(full, implement, config, geofence_of(site), (),
    known_structure=known_structure), full,
                          straight_path()), site, "wide", -1)  # fmt: skip
    world.targets = (Target(-8.9, -40.0, rcs_dbsm=-60.0, has_echo=True),)
    drive_in(world)
    assert world.mode == Mode.AUTOMATIC
    assert world.x_m == pytest.approx(-5.9, abs=0.1)


def test_tracks_of_known_structure_filtered() -> None:
    def track(id: int, x_m: float, length_m: float) -> Track:
        size, place = np.array([length_m, 0.5, 1.0]), np.array([x_m, 0.0, 0.0])
        return Track(id, ObstacleClass.PERSON, 0.9, place, np.zeros(3), np.eye(4), size, 0.0, 0, 1, True, ())

    tracks = [track(1, 1.0, 0.5), track(2, 9.0, 0.5), track(3, 1.0, 5.0), track(4, 1.0, math.nan)]
    left = without_known_structure(tracks, lambda points: points[:, 0] > 5.0, 2.0)
    assert [t.id for t in left] == [1, 4]


def test_known_structure_distances(known_structure: KnownStructure) -> None:
    points = np.array([(-8.0, -40.0), (-9.0, -40.0), (0.8, -41.0), (-4.0, -47.0), (5.0, -34.0)])
    assert known_structure.distance_m(points) == pytest.approx([0.925, -0.075, 0.84, 0.925, 3.925], abs=1e-9)


def test_is_near_shed(known_structure: KnownStructure) -> None:
    for x in around(9.0, 0.001):
        assert known_structure.is_near(np.array([x, -40.0, 0.0]), 8.0) == (x <= 9.0 + 1e-9), x
    assert known_structure.is_near(np.array([-5.0, -40.0, 0.0]), 0.0)
    assert not known_structure.is_near(np.array([60.0, 20.0, 0.0]), 8.0)
    assert structure_of_site(load(Site, ROOT / "configs/sites/demo.yaml").model_copy(update={"shed": None})) is None


def test_clear_distance_to_wall(known_structure: KnownStructure, config: SupervisorConfig, shed_world: World) -> None:
    footprint = shed_world.supervisor._footprints.transport
    s = spaced(6.0, 0.2)
    area = sweep_along(footprint, -1, s, arc_poses(0.0, -1, s), 0.0, config.docked.field, True)
    pose = np.array([-3.0, -39.84, 0.0])
    for clearance in (0.0, 0.1, 0.3):
        assert known_structure.clear_distance_m(area, pose, clearance) == pytest.approx(
            -3.0 - REAR_M + 9.0 - 0.075 - clearance, abs=0.03
        )
    assert math.isinf(known_structure.clear_distance_m(area, np.array([30.0, -39.84, 0.0]), 0.1))


def test_geofence_in_shed(site: Site) -> None:
    geofence = geofence_of(site)
    inside = [(-8.8, -43.68), (-5.0, -42.2), (0.9, -43.68), (1.5, -41.0), (1.5, -46.5), (-5.0, -38.0)]
    outside = [(-9.0, -43.68), (-5.0, -41.96), (-5.0, -36.0), (-5.0, -45.5), (0.8, -45.4)]
    assert geofence.contains(np.array(inside)).all()
    assert not geofence.contains(np.array(outside)).any()
    assert site.shed is not None
    bay, _ = bay_rings(site.shed, site.shed.bay("narrow"))
    assert is_within(np.array([(-5.9, -43.68)]), bay)[0]
    assert distance_across(np.array([20.0, 20.0]), np.array([1.0, 0.0]), np.array(site.shed.outline_m)) == 0.0


def folding(world: World) -> World:
    world.folds = True
    world.machine_changes = {"is_hitch_in_work": False}
    world.command_changes = {"is_implement_lowered": False, "is_pto_on": False}
    return world


def test_fold_at_standstill_only(world: World) -> None:
    folding(world).start()
    world.run(2.0)
    world.command_changes |= {"is_implement_folded": True}
    world.run(1.0)
    assert world.speed_mps > 0.5
    assert not world.command.is_implement_folded
    world.commanded_mps = 0.0
    world.run(8.0)
    assert world.command.is_implement_folded
    world.commanded_mps = 1.0
    world.run(1.0)  # between: the machine is held
    assert 0.01 < world.fold < 0.99
    assert (world.command.reason, world.speed_mps) == ("implement_fold", 0.0)
    world.run(6.0)
    assert world.fold == 1.0
    assert world.command.reason == ""
    assert world.speed_mps > 0.3


@pytest.mark.parametrize("hindrance", ["hitch", "mode"])
def test_no_fold_with_hitch_lowered_or_stop_latched(world: World, hindrance: str) -> None:
    folding(world)
    world.command_changes |= {"is_implement_folded": True}
    world.commanded_mps = 0.0
    if hindrance == "hitch":
        world.machine_changes = {"is_hitch_in_work": True}
        world.start()
    world.run(3.0)
    assert world.fold == 0.0
    assert not world.command.is_implement_folded


def test_folded_implement_not_lowered_no_pto(world: World) -> None:
    world.fold = 1.0
    world.command_changes = {"is_implement_folded": True}
    world.start().run(1.0)
    assert (world.command.is_implement_lowered, world.command.is_pto_on) == (False, False)
    assert world.command.is_implement_folded
    assert world.mode == Mode.AUTOMATIC


def test_initial_fold_kept(world: World) -> None:
    world.fold = 1.0
    world.run(1.0)
    assert world.command.is_implement_folded


def test_transport_width_passes_gap(world: World) -> None:
    post = Box(9.0, 2.0, (0.2, 0.2, 1.5))
    world.fold, world.boxes = 1.0, (post,)
    world.command_changes = {"is_implement_folded": True}
    world.start().run(5.0)
    assert all(c.reason == "" for mode, c in world.history if mode == Mode.AUTOMATIC)
    world.fold = 0.98  # no longer locked: the full width, and stand
    world.run(2.0)
    assert world.command.reason in ("implement_fold", "protective_field")
    assert world.speed_mps == 0.0


@pytest.mark.parametrize(("fold", "speed_mps"), [
    (0.0, math.inf), (0.009, math.inf), (0.011, 0.0), (0.5, 0.0), (0.989, 0.0), (0.991, math.inf), (math.nan, 0.0),
])  # fmt: skip
def test_standstill_while_folding(config: SupervisorConfig, fold: float, speed_mps: float) -> None:
    result = RULES["implement_fold"](situation_of(config, is_foldable=True, fold=fold))
    assert result.speed_limit_mps == speed_mps
    assert RULES["implement_fold"](situation_of(config, is_foldable=False, fold=fold)).speed_limit_mps == math.inf


def test_implement_state_timeout(world: World) -> None:
    world.start()
    world.machine_changes = {"implement_stamp_ns": 0}
    world.run(3.0)
    assert (world.mode, world.command.reason) == (Mode.FAULT_STOP, "machine.implement.silent")
    world.order(OperatorCommandKind.RESET)
    world.run(0.2)
    assert world.mode == Mode.STANDBY


def test_missing_machine_state(config: SupervisorConfig) -> None:
    assert (
        RULES["implement_fold"](situation_of(config, is_foldable=True, fold=None, machine=None)).response
        is Response.NONE
    )


def docking_situation(config: SupervisorConfig, **changes: Any) -> Any:
    return situation_of(config.docked, is_docking=True, **changes)


def test_docking_speed_limits(config: SupervisorConfig) -> None:
    assert RULES["speed_limit"](docking_situation(config)).speed_limit_mps == pytest.approx(0.5)
    speeds = [
        RULES["wall_clearance"](docking_situation(config, wall_distance_m=m)).speed_limit_mps
        for m in np.linspace(0, 2, 21)
    ]
    assert speeds[0] == 0.0
    assert speeds == sorted(speeds)
    assert speeds[6] >= 0.5  # 0.6 m
