"""A trailed implement behind the controlled machine: its error where work begins, and how it decays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import Polygon

from configs.mission import Work
from configs.site import DatumConfig
from configs.strict import CONFIGS, load, parse, read_yaml
from configs.vehicle import ImplementFile
from messages.plan import PathSectionType
from planning.config import PlanningConfig
from planning.field.field import FieldOutline
from planning.field.site_generation import site_of
from planning.plan import plan_field
from tests.control.plant import VEHICLE, Ground, Plant, true_offsets

DISC_HARROW = load(ImplementFile, CONFIGS / "implements" / "disc_harrow_3m.yaml").implement
PLANNING = parse(PlanningConfig, read_yaml(CONFIGS / "stack/planning.yaml"), "stack/planning.yaml")
TURNS, BEFORE_M, AFTER_M = 5, 30.0, 40.0


@pytest.fixture(scope="module")
def turns():
    """Parts of a plan: the end of a swath, the turn and the beginning of the next swath."""
    work = Work(
        headland_passes=7, overlap_m=0.0, work_speed_kmh=10, turn_speed_kmh=5, lane_speed_kmh=10, boundary_margin_m=0.1
    )
    outline = FieldOutline("test", DatumConfig(latitude_deg=50.0, longitude_deg=10.0, height_m=0.0),
                           Polygon([(0, 0), (150, 0), (150, 80), (0, 80)]))  # fmt: skip
    (path,) = plan_field(
        site_of(outline, VEHICLE, DISC_HARROW, work), VEHICLE, DISC_HARROW, work, PLANNING.planner, 1
    ).paths
    found = []
    for before, turn, after in zip(path.sections, path.sections[1:], path.sections[2:], strict=False):
        kinds = [s.section_type for s in (before, turn, after)]
        long = min(before.last - before.first, after.last - after.first) > 600
        if kinds == [PathSectionType.SWATH, PathSectionType.TURN, PathSectionType.SWATH] and long:
            found.append((cut(path, turn.first - round(BEFORE_M * 10), after.first + round(AFTER_M * 10)), turn, after))
    return found[:: max(1, len(found) // TURNS)][:TURNS]


def cut(path, first, last):
    """Points `first` to `last` as a path that ends at standstill."""
    s = path.s_m[first:last] - path.s_m[first]
    speed = np.minimum(path.speed_mps[first:last], np.sqrt(2 * 0.5 * np.maximum(s[-1] - s, 0.0)))
    sections = tuple(
        replace(one, first=max(one.first - first, 0), last=min(one.last - first, last - first - 1))
        for one in path.sections
        if one.last >= first and one.first < last
    )
    index = path.section_index[first:last] - path.section_index[first]
    return replace(
        path, p_map_m=path.p_map_m[first:last], heading_rad=path.heading_rad[first:last], s_m=s, speed_mps=speed,
        curvature_radpm=path.curvature_radpm[first:last], is_working=path.is_working[first:last], sections=sections,
        section_index=index, is_last=True,
    )  # fmt: skip


def pulled(track):
    """Middle of the working line (N, 2) at each sample: wheels roll along the implement, in line at first."""
    d, yaw, found = DISC_HARROW, track.yaw_rad[0], []
    x, y, h = (np.array(v) for v in (track.x_m, track.y_m, track.yaw_rad))
    hitch = np.column_stack([x + d.hitch_m * np.cos(h), y + d.hitch_m * np.sin(h)])
    for k in range(len(hitch)):
        if k > 0:
            dx, dy = hitch[k] - hitch[k - 1]
            yaw += (dy * math.cos(yaw) - dx * math.sin(yaw)) / d.axle_length_m
        found.append(hitch[k] - d.working_length_m * np.array([math.cos(yaw), math.sin(yaw)]))
    return np.array(found)


def errors_on_swath(path, seed, ground):
    """Distance behind the start of work (N,), errors of machine and of the working line (N,), and whether lowered."""
    p, heading = path.p_map_m[0], float(path.heading_rad[0])
    plant = Plant(p[0], p[1], heading, float(path.speed_mps[0]), ground, seed=seed, implement=DISC_HARROW)
    track = plant.run(path)
    swath = path.sections[-1]
    start, along = path.p_map_m[swath.first], float(path.heading_rad[swath.first + 5])
    u, n = np.array([math.cos(along), math.sin(along)]), np.array([-math.sin(along), math.cos(along)])
    machine = np.column_stack([track.x_m, track.y_m])
    offsets, s = true_offsets(track, path)
    behind_m = (machine - start) @ u
    is_on = (s >= path.s_m[swath.first]) & (s < path.s_m[-1] - 3.0)
    return behind_m[is_on], offsets[is_on], ((pulled(track) - start) @ n)[is_on], np.array(track.hitch)[is_on]


@pytest.mark.parametrize("ground", [Ground(), Ground(side_slope_deg=3.0)], ids=["level", "side slope"])
def test_implement_is_on_its_line_where_work_begins(turns, ground):
    assert len(turns) == TURNS
    first_m, later_m = [], []
    for seed, (path, _, _) in enumerate(turns):
        behind_m, machine_m, implement_m, hitch = errors_on_swath(path, seed + 1, ground)
        assert hitch[behind_m > 1.0].max() < 0.1  # at work
        assert np.abs(machine_m).max() < 0.06
        first_m.append(np.abs(implement_m[behind_m < 0.5]).max())
        later_m.append(np.abs(implement_m[behind_m > 2.0 * DISC_HARROW.axle_length_m]).max())
    assert max(first_m) < 0.09
    assert max(later_m) < 0.05
