"""Refill stops in a plan: area before each, the place, the ways, and how the mission waits there."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from shapely.geometry import Point, Polygon, box

from benchmarks.planning_check import check
from configs.mission import Mission, Refill, Work
from configs.site import DatumConfig, Site
from configs.vehicle import MountedImplement, Vehicle
from messages.command import Mode, OperatorCommand, OperatorCommandKind
from messages.errors import FieldError
from messages.plan import MissionState, PathSectionType
from planning.config import PlanningConfig
from planning.export.geojson import plan_to_geojson
from planning.field.field import FieldOutline
from planning.field.site_generation import site_within
from planning.mission import MissionNode
from planning.plan import Plan, plan_field, plan_mission
from tests.planning.ideal import Box, Ideal

DATUM = DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0)
FIELD = box(0.0, 0.0, 110.0, 80.0)
POND = FIELD.difference(box(45.0, 30.0, 65.0, 50.0))
L_SHAPE = Polygon([(0, 0), (150, 0), (150, 50), (50, 50), (50, 140), (0, 140)])
SEED = {"at_m": (40.0, -3.0), "every_m2": 3500.0, "reason": "seed"}
Make = Callable[..., Plan]


@pytest.fixture(scope="module")
def planned(vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig) -> Make:
    assert mission.work is not None
    base = mission.work

    def make(field: Polygon | Site, **changes: Any) -> Plan:
        work = Work.model_validate(base.model_dump() | {"turns": "reverse", "refill": SEED} | changes)
        site = field
        if not isinstance(site, Site):
            site = site_within(FieldOutline("refill", DATUM, field), vehicle, harrow, work)
        return plan_field(site, vehicle, harrow, work, planning.planner, 1)

    return make


def worked_m2(plan: Plan) -> list[float]:
    """Nominal area worked before each refill and after the last one."""
    found, stops = [0.0], {stop.path_id for stop in plan.refills}
    for path in plan.paths:
        moved = np.hypot(*np.diff(path.p_map_m, axis=0).T)
        found[-1] += plan.rig.working_width_m * float(moved[(path.is_working[1:] & path.is_working[:-1]) > 0].sum())
        found += [0.0] if path.path_id in stops else []
    return found


@pytest.mark.parametrize("turns", ["forward", "reverse"])
@pytest.mark.parametrize("field", [FIELD, POND, L_SHAPE])
def test_area_place_and_ways(
    field: Polygon, turns: str, planned: Make, vehicle: Vehicle, harrow: MountedImplement
) -> None:
    """By an independent sweep: no more is worked between two refills, nothing less in all, nobody leaves the field."""
    plan, plain = planned(field, turns=turns), planned(field, turns=turns, refill=None)
    assert [stop.number for stop in plan.refills] == list(range(1, len(plan.refills) + 1))
    areas = worked_m2(plan)
    assert len(areas) >= 3
    for area, stop in zip(areas, plan.refills, strict=False):
        assert area == pytest.approx(stop.worked_m2, rel=0.02)
    assert max(areas) < 1.01 * SEED["every_m2"]  # type: ignore[operator]
    paths = {path.path_id: path for path in plan.paths}
    for stop in plan.refills:
        end = paths[stop.path_id]
        assert np.hypot(*(end.p_map_m[-1] - stop.place[:2])) < 0.01
        assert (end.direction, end.is_last, float(end.speed_mps[-1])) == (1, False, 0.0)
        assert Point(stop.place[:2]).distance(Point(SEED["at_m"])) < 15.0  # type: ignore[arg-type]
    driven = [sum(float(p.s_m[-1]) for p in plan.paths if a < p.path_id <= b.path_id)
              for a, b in zip([0, *(s.path_id for s in plan.refills)], plan.refills, strict=False)]  # fmt: skip
    assert driven == pytest.approx([stop.driven_m for stop in plan.refills])
    found = check(plan.paths, field, field.buffer(-0.1), vehicle, harrow)
    assert found.outside_m == 0.0
    assert plan.planned_share == pytest.approx(plain.planned_share, abs=0.001)
    assert plan.length_m > plain.length_m


@pytest.mark.parametrize("headland", ["last", "none"])
def test_with_another_order_of_the_headland(headland: str, planned: Make) -> None:
    plan = planned(FIELD, headland=headland)
    assert len(plan.refills) >= 2
    assert max(worked_m2(plan)) < 1.01 * SEED["every_m2"]  # type: ignore[operator]


def test_a_large_area_needs_no_refill(planned: Make) -> None:
    plan, plain = planned(FIELD, refill=SEED | {"every_m2": 1e6}), planned(FIELD, refill=None)
    assert plan.refills == ()
    assert plan.length_m == plain.length_m


@pytest.mark.parametrize(
    ("field", "changes", "words"),
    [
        (FIELD, {"every_m2": 600.0}, r"headland pass 0 alone works \d+ m², more than every_m2 600: set a larger area"),
        (POND, {"at_m": (55.0, 40.0)}, r"x 55.0 m, y 40.0 m .* is in no-go area 1: name a place at the edge"),
        (FIELD, {"at_m": (55.0, 42.0)}, r"no free place .* within 30 m of x 55.0 m, y 42.0 m"),
        (FIELD, {"at_m": (55.0, -40.0)}, r"no free place .* within 30 m of x 55.0 m, y -40.0 m"),
    ],
)
def test_a_place_or_area_that_is_none_is_refused(
    field: Polygon, changes: dict[str, Any], words: str, planned: Make
) -> None:
    with pytest.raises(FieldError, match=words):
        planned(field, refill=SEED | changes)


def test_a_place_that_is_none_is_refused_before_the_route_is_planned(
    planned: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planning.coverage.route.drive_passes", None)
    with pytest.raises(FieldError, match="no free place"):
        planned(FIELD, refill=SEED | {"at_m": (55.0, 42.0)})


@pytest.mark.parametrize(
    "changes", [{"every_m2": 0.0}, {"every_m2": -1.0}, {"reason": ""}, {"at_m": [1.0]}, {"at_m": [1.0, float("nan")]}]
)
def test_wrong_values_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(changes))):
        Refill.model_validate(SEED | changes)


def test_at_the_gate_with_lane_and_bay(
    site: Site, vehicle: Vehicle, harrow: MountedImplement, mission: Mission, planning: PlanningConfig
) -> None:
    """Paths out of the bay come before; the tour ends at the lane and in the bay."""
    assert mission.work is not None
    refill = Refill(at_m=(20.0, 0.0), every_m2=1500.0)
    changed = mission.model_copy(update={"work": mission.work.model_copy(update={"refill": refill})})
    start = site.bay("wide").dock
    plan = plan_mission(changed, site, vehicle, harrow, planning, start, 1)
    paths = {path.path_id: path for path in plan.paths}
    assert len(plan.refills) >= 2
    for stop in plan.refills:
        assert np.hypot(*(paths[stop.path_id].p_map_m[-1] - stop.place[:2])) < 0.01
    before = sum(float(p.s_m[-1]) for p in plan.paths if p.path_id <= plan.refills[0].path_id)
    assert before == pytest.approx(plan.refills[0].driven_m)
    types = [s.section_type for path in plan.fixed_paths for s in path.sections]
    assert types[-1] is PathSectionType.LANE
    assert plan.docking_paths


def test_places_are_exported(planned: Make) -> None:
    plan = planned(FIELD)
    features = plan_to_geojson(plan, plan.drivable.site)["features"]
    refills = [f["properties"] for f in features if f["properties"]["kind"] == "refill"]
    assert [r["number"] for r in refills] == [stop.number for stop in plan.refills]
    assert [r["worked_m2"] for r in refills] == pytest.approx([s.worked_m2 for s in plan.refills], abs=0.1)
    numbers = ", ".join(plan.refill_labels.values()).split(", ")
    assert sorted(map(int, numbers)) == [stop.number for stop in plan.refills]


class _Waiting:
    """A mission node at its first refill place."""

    def __init__(self, plan: Plan, planning: PlanningConfig) -> None:
        self.drive = Ideal(plan, MissionNode(plan, planning.mission, 0))
        self.drive.run(3000, until="waiting at refill place 1 (seed) for the start command")

    def show(self, mode: Mode | None, *kinds: OperatorCommandKind) -> MissionState:
        drive = self.drive
        drive.now_ns += 100_000_000
        commands = tuple(
            OperatorCommand(drive.now_ns, kind, "test", drive.now_ns + k, drive.now_ns + 10**9)
            for k, kind in enumerate(kinds)
        )
        messages = drive._messages(drive.now_ns)
        supervisor = None if mode is None else replace(messages["supervisor"], mode=mode)
        found = dict(drive.node.step(drive.now_ns, Box({**messages, "supervisor": supervisor}, commands)))
        self.path = found.get("path")
        return found["mission"].state  # type: ignore[attr-defined, no-any-return]


def test_mission_waits_until_the_supervisor_has_taken_an_order(planned: Make, planning: PlanningConfig) -> None:
    """A start that the supervisor does not take, for want of a confirmation, moves nothing."""
    waiting, start = _Waiting(planned(FIELD), planning), OperatorCommandKind.START
    drive = waiting.drive
    assert drive.status is not None
    assert drive.status.state is MissionState.WAITING
    stop = drive.node._plan.refills[0]
    assert np.hypot(*(drive.pose[:2] - stop.place[:2])) < 0.05
    for mode in (Mode.AUTOMATIC, None, Mode.OBSTACLE_STOP, Mode.STANDBY, None):
        assert waiting.show(mode, start) is MissionState.WAITING
        assert waiting.path is None
    assert waiting.show(Mode.START_WARNING) is MissionState.DRIVING
    assert waiting.path is not None
    assert waiting.path.path_id == stop.path_id + 1
