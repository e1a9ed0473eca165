"""Progress of a stored mission: kept while it is driven, also around an obstacle; the rest of the plan is driven."""

import math
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest

from configs.site import PoseConfig
from geometry.pose2 import Pose2
from hmi.page_state import PageState
from hmi.plan_view.mission_store import MISSION, MissionStore
from hmi.plan_view.options import default_options, default_work, write_mission
from hmi.plan_view.progress import PROGRESS, Progress, ProgressKeeper, StoredDrive, place_on, read_progress
from messages.errors import ConfigError, HeadlandError
from messages.message import Envelope
from messages.plan import MissionState, MissionStatus, Path, PathSection, PathSectionType
from runtime.page.resume import rest_from, resumed_setup
from runtime.setup import Setup, load_setup
from tests.hmi.drive_messages import NOW_NS, demo_scene, machine, map_pose, odometry
from tests.hmi.planned import corner_field, geojson, planned_draft

STEP_M = 0.1


def loop(path_id: int = 1) -> Path:
    """100 m along x from the origin, back on the same line in a half circle of 10 m, and along x again."""
    s = np.arange(0.0, 100.0, STEP_M)
    arc = np.arange(0.0, math.pi, STEP_M / 10.0)
    x = np.r_[s, 100.0 + 10.0 * np.sin(arc), s[::-1]]
    y = np.r_[0.0 * s, 10.0 - 10.0 * np.cos(arc), 20.0 + 0.0 * s]
    heading = np.r_[0.0 * s, arc, math.pi + 0.0 * s]
    n = len(x)
    sections = (PathSection(PathSectionType.SWATH, 0, 0, n - 1),)
    return Path(
        NOW_NS, path_id, 1, np.stack([x, y], axis=1), heading, np.zeros(n), STEP_M * np.arange(n), np.ones(n),
        np.ones(n, np.uint8), sections, np.zeros(n, np.int32), True,
    )  # fmt: skip


def at(page: PageState, path: Path, s_m: float, pose: Pose2, **values: object) -> PageState:
    """The state after messages from a position."""
    section = values.pop("section", PathSectionType.SWATH)
    mission = MissionStatus(
        NOW_NS,
        MissionState.DRIVING,
        section,
        0,
        path.path_id,
        s_m,
        s_m,
        float(path.s_m[-1]),
        "",
        (),  # type: ignore[arg-type]
    )
    mission = replace(mission, **values)  # type: ignore[arg-type]
    messages = (
        ("map_pose", map_pose()), ("odom", odometry(pose.x_m, pose.y_m, pose.yaw_rad)),
        ("machine", machine(hitch=0.04, fold_position=0.0)), ("path", path), ("mission", mission),
    )  # fmt: skip
    page.take(NOW_NS, [Envelope(topic, 0, NOW_NS, message) for topic, message in messages])
    return page


@pytest.fixture
def state() -> PageState:
    return PageState(demo_scene(), 0.25)


def keeper(folder: File, resumed: Progress | None = None, last_path_id: int = 1) -> ProgressKeeper:
    return ProgressKeeper(StoredDrive(folder, resumed, last_path_id))


def known(folder: File) -> Progress:
    found = read_progress(folder)
    assert found is not None
    return found


def test_progress_is_kept_while_driving_and_removed_at_the_end(tmp_path: File, state: PageState) -> None:
    keep, path = keeper(tmp_path), loop()
    keep.store(at(state, path, 0.0, Pose2(0.0, 0.0, 0.0), state=MissionState.WAITING))
    assert read_progress(tmp_path) is None
    keep.store(at(state, path, 40.0, Pose2(40.0, 0.1, 0.0)))
    found = known(tmp_path)
    assert (found.path_id, found.path_s_m, found.hitch, found.is_folded) == (1, 40.0, 0.04, False)
    assert found.at == PoseConfig(x_m=40.0, y_m=0.1, heading_deg=0.0)
    assert found.share == pytest.approx(40.0 / path.s_m[-1], abs=0.001)
    keep.store(at(state, path, 50.0, Pose2(50.0, 0.0, 0.0), state=MissionState.ABORTED))
    assert known(tmp_path).path_s_m == 50.0
    keep.store(at(state, path, 231.0, Pose2(0.0, 20.0, math.pi), state=MissionState.FINISHED))
    assert read_progress(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_a_detour_is_no_progress_and_the_line_behind_it_is(tmp_path: File, state: PageState) -> None:
    """The last number of the plan is 1: 2 is a detour, 3 the rest of the line, whose arc length begins at 0 again."""
    keep, path = keeper(tmp_path), loop()
    keep.store(at(state, path, 40.0, Pose2(40.0, 0.0, 0.0)))
    around = replace(path, path_id=2)
    keep.store(at(state, around, 5.0, Pose2(45.0, 3.0, 0.2), section=PathSectionType.DETOUR))
    found = known(tmp_path)
    assert (found.path_id, found.path_s_m, found.at.y_m) == (1, 40.0, 3.0)
    keep.store(at(state, replace(path, path_id=3), 2.0, Pose2(57.0, 0.05, 0.0)))
    assert known(tmp_path).path_s_m == pytest.approx(57.0, abs=STEP_M)


def test_progress_of_a_resumed_drive_counts_from_the_plan(tmp_path: File, state: PageState) -> None:
    """The drive began at 40 m of path 1 with its rest; path 2 is a whole one."""
    keep, path = keeper(tmp_path), loop()
    keep.store(at(state, path, 40.0, Pose2(40.0, 0.0, 0.0)))
    before = known(tmp_path)
    again = keeper(tmp_path, before, 2)
    rest = replace(path, path_id=1)
    again.store(at(state, rest, 10.0, Pose2(50.0, 0.0, 0.0), total_m=before.left_m))
    found = known(tmp_path)
    assert (found.path_s_m, found.length_m) == (50.0, before.length_m)
    assert found.share == pytest.approx(50.0 / before.length_m, abs=0.001)
    again.store(at(state, replace(path, path_id=2), 7.0, Pose2(7.0, 0.0, 0.0)))
    assert (known(tmp_path).path_id, known(tmp_path).path_s_m) == (2, 7.0)


def test_damaged_progress_is_named_and_not_offered(tmp_path: File) -> None:
    store = MissionStore(tmp_path)
    stored = store.store(planned_draft(store), "north", None, "anna")
    for text in ("{", '{"path_id": 1}', "[1]"):
        (stored.folder / PROGRESS).write_text(text)
        with pytest.raises(ConfigError, match=PROGRESS):
            read_progress(stored.folder)
        assert MissionStore(tmp_path).interrupted() == {}


def test_progress_that_cannot_be_written_is_named(tmp_path: File, state: PageState) -> None:
    keep = keeper(tmp_path / "deleted")
    with pytest.raises(HeadlandError, match=r"deleted/progress\.json: progress cannot be stored"):
        keep.store(at(state, loop(), 40.0, Pose2(40.0, 0.0, 0.0)))


def test_place_needs_position_and_heading() -> None:
    path = loop()
    assert place_on(path, Pose2(40.0, 0.2, 0.1), 30.0, 50.0) == pytest.approx(40.0)
    assert place_on(path, Pose2(40.0, 0.2, math.pi), 30.0, 50.0) is None
    assert place_on(path, Pose2(40.0, 0.6, 0.0), 30.0, 50.0) is None
    assert place_on(path, Pose2(40.0, 0.2, 0.0), 60.0, 90.0) is None
    assert place_on(path, Pose2(0.0, 0.0, 0.0), 900.0, 990.0) is None


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    """An L-shaped field with sides of 70 m."""
    folder = tmp_path_factory.mktemp("field")
    (folder / "field.geojson").write_bytes(geojson(corner_field(70.0)))
    write_mission(default_options("", "").mission("corner", default_work()), folder / MISSION)
    return load_setup(str(folder / MISSION), None, None, str(folder / "field.geojson"), 1)


@pytest.mark.parametrize("share", [0.1, 0.35, 0.6, 0.9])
def test_the_rest_of_the_plan_begins_where_the_machine_stands(setup: Setup, share: float) -> None:
    """Lines cross each other: the rest has the whole length that is left, and all that is left to work."""
    path = setup.plan.fixed_paths[0]
    k = int(share * len(path.s_m))
    (x, y), yaw = path.p_map_m[k], float(path.heading_rad[k])
    stands = PoseConfig(x_m=x - 0.05 * math.sin(yaw), y_m=y + 0.05 * math.cos(yaw), heading_deg=math.degrees(yaw))
    progress = Progress(
        path_id=path.path_id, path_s_m=float(path.s_m[k]) + 1.0, at=stands, hitch=0.0, is_folded=False,
        length_m=setup.plan.length_m, left_m=100.0,
    )  # fmt: skip
    found = resumed_setup(setup, progress)
    rest = found.plan.fixed_paths[0]
    assert (rest.path_id, rest.is_last, rest.is_transport) == (path.path_id, path.is_last, path.is_transport)
    assert np.hypot(*(rest.p_map_m[0] - (stands.x_m, stands.y_m))) < 0.11
    assert float(rest.s_m[-1]) == pytest.approx(float(path.s_m[-1] - path.s_m[k]), abs=0.3)
    assert np.abs(np.diff(rest.s_m)).max() < 0.2
    assert rest.is_working.sum() == pytest.approx(path.is_working[k:].sum(), abs=3)
    assert rest.speed_mps[0] < 1.0
    assert (found.start, found.hitch, found.is_folded) == (stands, 0.0, False)


def test_a_machine_beside_its_line_or_another_plan_is_refused(setup: Setup) -> None:
    path = setup.plan.fixed_paths[0]
    x, y = path.p_map_m[500]
    yaw_deg = math.degrees(path.heading_rad[500])
    progress = Progress(
        path_id=path.path_id, path_s_m=float(path.s_m[500]), at=PoseConfig(x_m=x, y_m=y, heading_deg=yaw_deg),
        hitch=0.0, is_folded=False, length_m=1.0, left_m=1.0,
    )  # fmt: skip
    with pytest.raises(HeadlandError, match="path 99 is not in the plan"):
        resumed_setup(setup, progress.model_copy(update={"path_id": 99}))
    beside = PoseConfig(x_m=x + 2.0, y_m=y + 2.0, heading_deg=yaw_deg)
    with pytest.raises(HeadlandError, match=rf"x {x + 2.0:.1f} m, y {y + 2.0:.1f} m is not on path 1"):
        resumed_setup(setup, progress.model_copy(update={"at": beside}))
    end = PoseConfig(
        x_m=path.p_map_m[-1, 0], y_m=path.p_map_m[-1, 1], heading_deg=math.degrees(path.heading_rad[-1])
    )  # fmt: skip
    with pytest.raises(HeadlandError, match="nothing of it is left"):
        resumed_setup(setup, progress.model_copy(update={"at": end, "path_s_m": float(path.s_m[-1])}))


def test_no_place_of_the_plan_skips_what_is_left(setup: Setup) -> None:
    """A machine 2 cm beside its line is often nearer to where the path crosses itself later."""
    path = setup.plan.fixed_paths[0]
    for k in range(0, len(path.s_m) - 50, 20):
        (x, y), yaw = path.p_map_m[k], float(path.heading_rad[k])
        beside = (float(x - 0.02 * math.sin(yaw)), float(y + 0.02 * math.cos(yaw)))
        rest = rest_from(path, float(path.s_m[k]), beside, setup.plan.rig)
        assert float(rest.s_m[-1]) == pytest.approx(float(path.s_m[-1] - path.s_m[k]), abs=0.3), k
