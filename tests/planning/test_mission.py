"""Mission node with an ideal path follower: start, progress, detours, uncovered areas, docking."""

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate, translate
from shapely.geometry import Polygon, box

from configs.mission import Mission
from configs.site import PoseConfig, Site
from configs.vehicle import MountedImplement, Vehicle
from geometry.footprint import footprints, is_inside
from messages.command import OperatorCommand, OperatorCommandKind
from messages.perception import ObstacleClass
from messages.plan import MissionState, MissionStatus, Path, PathSectionType
from planning.config import MissionConfig, PlanningConfig
from planning.mission import MissionNode
from planning.plan import Plan, plan_mission
from tests.planning.ideal import SUPERVISOR_GAP_M, Box, Ideal

SECOND = 1_000_000_000


@pytest.fixture
def config(planning: PlanningConfig) -> MissionConfig:
    return planning.mission


def status_of(outputs: object) -> tuple[MissionStatus, list[Path]]:
    found = list(outputs)  # type: ignore[call-overload]
    paths = [m for topic, m in found if topic == "path"]
    return next(m for topic, m in found if topic == "mission"), paths


@pytest.mark.parametrize(("expires", "starts"), [(0, True), (1, True), (-1, False)])
def test_start_command_expiry(plan: Plan, config: MissionConfig, expires: int, starts: bool) -> None:
    node, now = MissionNode(plan, config, 0), 7 * SECOND
    waiting, none = status_of(node.step(now, Box({})))
    assert waiting.state is MissionState.WAITING
    assert none == []
    command = OperatorCommand(now, OperatorCommandKind.START, "page", 1, now + expires)
    status, paths = status_of(node.step(now, Box({}, (command,))))
    assert (status.state is MissionState.DRIVING) is starts
    assert [p.stamp_ns for p in paths] == [now] * starts


def test_no_start_on_other_commands_or_old_sequence(plan: Plan, config: MissionConfig) -> None:
    node, now = MissionNode(plan, config, 0), 7 * SECOND
    others = tuple(
        OperatorCommand(now, o, "page", k, now + SECOND) for k, o in enumerate(OperatorCommandKind,
        1) if o is not OperatorCommandKind.START
    )  # fmt: skip
    assert status_of(node.step(now, Box({}, others)))[0].state is MissionState.WAITING
    late = OperatorCommand(now, OperatorCommandKind.START, "page", 1, now + SECOND)
    assert status_of(node.step(now, Box({}, (late,))))[0].state is MissionState.WAITING


def nudge(now: int, sequence: int, left_m: float, expires_s: float = 1.0) -> OperatorCommand:
    return OperatorCommand(now, OperatorCommandKind.NUDGE, "page", sequence, now + round(expires_s * 1e9), left_m)


def test_a_nudge_shifts_all_swaths_by_the_same_vector(plan: Plan, config: MissionConfig) -> None:
    """Left on the first swath is right on the way back; the end of the mission resets it."""
    drive = Ideal(plan, MissionNode(plan, config, 0))
    shifts: dict[tuple[str, int], set[tuple[float, ...]]] = {}
    is_nudged = False
    for _ in range(500):
        drive.run(3)
        status = drive.status
        assert status is not None
        shift = status.shift_x_m, status.shift_y_m, status.shift_left_m
        if status.section_type is PathSectionType.SWATH:
            if not is_nudged:
                now, steps = drive.now_ns, ((2, 0.03), (2, 0.03), (3, -0.01), (4, 0.09))  # repeated; above the limit
                box = Box(drive._messages(now), tuple(nudge(now, *step) for step in steps))
                is_nudged = bool(drive.node.step(now, box))
            elif any(shift):
                shifts.setdefault((status.section_type, status.line), set()).add(tuple(round(v, 4) for v in shift))
        elif any(shift):  # shortly before a swath
            assert status.section_type is PathSectionType.TURN
    assert status.state is MissionState.FINISHED
    assert (status.shift_x_m, status.shift_y_m, status.shift_left_m) == (0.0, 0.0, 0.0)
    vectors = {values[:2] for found in shifts.values() for values in found}
    assert len(vectors) == 1
    assert np.hypot(*next(iter(vectors))) == pytest.approx(0.02, abs=1e-4)
    assert {values[2] > 0 for found in shifts.values() for values in found} == {True, False}
    assert max(abs(values[2]) for found in shifts.values() for values in found) == pytest.approx(0.02, abs=1e-4)


def test_plan_completion(plan: Plan, config: MissionConfig) -> None:
    drive = Ideal(plan, MissionNode(plan, config, 0))
    drive.run(1200)
    assert drive.status is not None
    assert drive.status.state is MissionState.FINISHED
    assert drive.status.driven_m == pytest.approx(plan.length_m)
    assert [p.path_id for p in drive.paths] == [1]
    assert drive.status.uncovered_areas == ()


def car(x: float, y: float, degrees: float) -> Polygon:
    return translate(rotate(box(-2.2, -0.9, 2.2, 0.9), degrees), x, y)


def is_detour(path: Path) -> bool:
    return any(t.section_type is PathSectionType.DETOUR for t in path.sections)


def gap_m(plan: Plan, path: Path, outline: Polygon) -> float:
    bodies = footprints(plan.rig.bodies, path.p_map_m, path.heading_rad)
    return float(shapely.distance(bodies, outline).min())


@pytest.mark.parametrize(
    ("x", "y", "degrees"),
    [
        pytest.param(45, 25, 2, id="swath"),
        pytest.param(30, 15, -3, id="next", marks=pytest.mark.slow),
        pytest.param(42, 3.5, 0, id="edge", marks=pytest.mark.slow),
        pytest.param(76, 46, 45, id="corner", marks=pytest.mark.slow),
    ],
)
def test_detour_around_static_obstacle(plan: Plan, config: MissionConfig, x: float, y: float, degrees: float) -> None:
    outline = car(x, y, degrees)
    drive = Ideal(plan, MissionNode(plan, config, 0), {1: (ObstacleClass.VEHICLE, outline)})
    drive.run(2000)
    assert drive.status is not None
    assert drive.status.state is MissionState.FINISHED
    assert drive.least_gap_m > SUPERVISOR_GAP_M  # also where the plan passes it later
    assert min(gap_m(plan, p, outline) for p in drive.paths if is_detour(p)) > 0.5
    poses = np.array(drive.trail)
    assert is_inside(plan.rig.bodies, poses[:, :2], poses[:, 2], plan.drivable.allowed.buffer(0.05)).all()
    assert {p.direction for p in drive.paths} == {1, -1}
    assert any(map(is_detour, drive.paths))
    (uncovered,) = drive.status.uncovered_areas
    rectangle = np.asarray(Polygon(uncovered.outline_map_m).minimum_rotated_rectangle.exterior.coords)
    assert np.hypot(*np.diff(rectangle[:3], axis=0).T).max() < 4.4 + 12.0
    assert drive.status.total_m == pytest.approx(drive.status.driven_m, abs=1.0)
    assert sum(p.is_last for p in drive.paths) == 2  # the planned path and its remainder


@pytest.mark.slow
def test_longer_wait_before_an_unknown_obstacle(plan: Plan, config: MissionConfig) -> None:
    outline = box(44.7, 24.7, 45.3, 25.3)
    drive = Ideal(plan, MissionNode(plan, config, 0), {1: (ObstacleClass.UNKNOWN, outline)})
    drive.run(10_000, until="driving around an obstacle")
    assert drive.stopped_s == pytest.approx(config.blocked_unknown_s, abs=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("label", [ObstacleClass.PERSON, ObstacleClass.ANIMAL])
def test_person_or_animal_is_not_driven_around(plan: Plan, config: MissionConfig, label: ObstacleClass) -> None:
    outline = box(44.7, 24.7, 45.3, 25.3)
    drive = Ideal(plan, MissionNode(plan, config, 0), {1: (label, outline)})
    waiting = f"waiting until {label} has left the path"
    drive.run(10_000, until=waiting)
    drive.run(100)
    assert drive.status is not None
    assert drive.status.text == waiting
    drive.obstacles = {}
    drive.run(5)
    assert drive.status.text == "driving"


@pytest.mark.slow
def test_abort_on_blocked_lane(plan: Plan, config: MissionConfig) -> None:
    drive = Ideal(plan, MissionNode(plan, config, 0), {1: (ObstacleClass.VEHICLE, car(20, -12, 90))})
    drive.run(300)
    assert drive.status is not None
    assert drive.status.state is MissionState.ABORTED
    assert "no path around vehicle at x 20.0 m, y -12.0 m" in drive.status.text


# docking


@pytest.fixture
def docking(site: Site, vehicle: Vehicle, harrow: MountedImplement, planning: PlanningConfig) -> Plan:
    start = PoseConfig(x_m=20.0, y_m=-30.0, heading_deg=-90.0)
    mission = Mission(name="dock", site="demo", machine="m", implement="i", bay="wide", start=start)
    return plan_mission(mission, site, vehicle, harrow, planning, start, 0)


def test_docking_from_measured_pose(docking: Plan, config: MissionConfig) -> None:
    drive = Ideal(docking, MissionNode(docking, config, 0))
    start = docking.paths[0]
    drive.pose = np.array([*start.p_map_m[0] + [0.4, -0.3], start.heading_rad[0] + 0.1])
    drive.run(300)
    assert drive.status is not None
    assert drive.status.state is MissionState.FINISHED
    assert drive.pose[:2] == pytest.approx([-5.9, -39.84], abs=1e-3)
    assert all(p.is_transport for p in drive.paths)
    assert [p.is_last for p in drive.paths] == [False] * (len(drive.paths) - 1) + [True]
    assert drive.status.section_type is PathSectionType.DOCK
    assert drive.status.driven_m == pytest.approx(drive.status.total_m)


@pytest.mark.parametrize(("age_s", "docks"), [(0.9, True), (1.0, True), (1.01, False), (np.inf, False)])
def test_no_docking_without_uwb(docking: Plan, config: MissionConfig, age_s: float, docks: bool) -> None:
    drive = Ideal(docking, MissionNode(docking, config, 0), uwb_age_s=age_s)
    drive.run(30 if not docks else 200)
    assert drive.status is not None
    assert (drive.status.state is MissionState.FINISHED) is docks
    if not docks:
        assert drive.status.state is MissionState.ABORTED
        assert "no UWB range" in drive.status.text
        assert drive.paths == []


def test_abort_on_uwb_loss_while_docking(docking: Plan, config: MissionConfig) -> None:
    drive = Ideal(docking, MissionNode(docking, config, 0))
    drive.run(20)
    assert drive.status is not None
    assert drive.status.state is MissionState.DRIVING
    drive.uwb_age_s = 5.1
    drive.run(3)
    assert drive.status.state is MissionState.ABORTED
    assert "no UWB range for 5.1 s" in drive.status.text


def test_docking_replanned_around_obstacle(docking: Plan, config: MissionConfig) -> None:
    last = docking.paths[-1]
    x, y = last.p_map_m[len(last.s_m) // 3]
    node = MissionNode(docking, config, 0)
    drive = Ideal(docking, node)
    drive.run(4)
    drive.obstacles = {1: (ObstacleClass.VEHICLE, box(x - 0.4, y - 0.4, x + 0.4, y + 0.4))}
    drive.run(400)
    assert drive.status is not None
    assert drive.status.state is MissionState.FINISHED
    assert drive.least_gap_m > 0.5
    assert drive.stopped_s >= config.blocked_s


def test_abort_on_obstacle_in_bay(docking: Plan, config: MissionConfig) -> None:
    drive = Ideal(docking, MissionNode(docking, config, 0))
    drive.run(4)
    drive.obstacles = {1: (ObstacleClass.UNKNOWN, box(3.0, -40.3, 4.0, -39.3))}
    drive.run(400)
    assert drive.status is not None
    assert drive.status.state is MissionState.ABORTED
    assert "unknown on the path at x 3.5 m, y -39.8 m: bay 'wide' leaves 0.00 m" in drive.status.text
    assert docking.docking is not None
    assert drive.stopped_s >= docking.docking.config.blocked_timeout_s


def test_mission_from_bay_to_bay(
    plan: Plan, site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    bayed = mission.model_copy(update={"bay": "narrow"})
    complete = plan_mission(bayed, site, vehicle, harrow, planning, site.bay("narrow").dock, 0)
    assert [p.is_transport for p in complete.fixed_paths] == [True, False]
    assert complete.length_m == pytest.approx(
        plan.length_m + sum(p.s_m[-1] for p in (complete.paths[0], *complete.docking_paths))
    )
    drive = Ideal(complete, MissionNode(complete, planning.mission, 0), end_error_m=0.02)
    drive.run(1500)
    assert drive.status is not None
    assert drive.status.state is MissionState.FINISHED
    assert drive.pose == pytest.approx([-5.9 + 0.02, -43.68, 0.0], abs=2e-3)
    folded = [p.is_transport for p in drive.paths]
    assert folded == [True, False] + [True] * (len(folded) - 2)
    assert [p.path_id for p in drive.paths][:2] == [1, 2]
    assert len({p.path_id for p in drive.paths}) == len(drive.paths)
