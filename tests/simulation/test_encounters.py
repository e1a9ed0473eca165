"""Encounters: each allows one stop, and causes contact with an unslowed machine."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon, box

from configs.site import PoseConfig, Site
from configs.strict import find, load, parse
from geometry.transforms import apply
from messages.errors import ConfigError, FieldError
from messages.plan import PathSection, PathSectionType
from simulation.actors.actors import Actor
from simulation.actors.encounter import (
    MIN_STOPPING_GAP_M,
    SWEPT_MARGIN_M,
    EncounterPoint,
    EncounterSite,
    Walk,
    distance_to,
    draw_crossing,
    walk_state_at,
)
from simulation.actors.placement import ParkedVehicle, find_swaths, ground_geometry, place_encounters
from simulation.environment.terrain import Terrain
from simulation.randomness import generator
from simulation.scenario import Scenario
from tests.simulation.simulated_farm import SITE, Farm, flat, machine_file, straight_paths

DEMO = load(Scenario, find("scenarios", "demo"))
CROSSINGS = [e for e in DEMO.encounters if e.kind == "crossing"]
HALF_M = 3.05
SETTING = EncounterSite(Polygon(SITE.boundary_m), HALF_M)
seeds = st.integers(0, 2**31)


def walk_of(name, seed, speed_mps=10 / 3.6, heading_rad=0.7):
    crossing = next(e for e in CROSSINGS if e.name == name)
    return draw_crossing(
        crossing, EncounterPoint((30.0, 12.0), heading_rad, speed_mps, 1), SETTING, np.random.default_rng(seed)
    )


def lateral_of(walk, p):
    dx, dy = p[0] - walk.point.p_map_m[0], p[1] - walk.point.p_map_m[1]
    return dy * math.cos(walk.point.heading_rad) - dx * math.sin(walk.point.heading_rad)


@pytest.mark.parametrize("name", ["person", "animal"])
@given(seed=seeds, share=st.floats(0.88, 1.05), speed_kmh=st.floats(4.0, 12.0))
@settings(derandomize=True, max_examples=120)
def test_unslowed_machine_contact(name, seed, share, speed_kmh):
    """Without obstacle rules the front arrives while the actor stands, for all draws."""
    walk = walk_of(name, seed, speed_kmh / 3.6)
    arrival_s = walk.trigger_m / (share * speed_kmh / 3.6)
    assert walk.arrival_s + 0.5 < arrival_s < walk.departure_s - 1.0
    assert abs(lateral_of(walk, walk_state_at(walk, arrival_s).p_map_m)) < 0.01


@pytest.mark.parametrize("name", ["person", "animal"])
@given(seed=seeds)
@settings(derandomize=True, max_examples=120)
def test_stopping_gap_at_entry(name, seed):
    walk = walk_of(name, seed)
    times = np.arange(0.0, walk.arrival_s, 0.01)
    inside = [t for t in times if abs(lateral_of(walk, walk_state_at(walk, t).p_map_m)) <= HALF_M + SWEPT_MARGIN_M]
    gap = walk.trigger_m - walk.point.speed_mps * inside[0]
    assert gap >= MIN_STOPPING_GAP_M - 0.1


@pytest.mark.parametrize("name", ["person", "animal"])
@given(seed=seeds)
@settings(derandomize=True, max_examples=100)
def test_crossing_start_and_exit_clear(name, seed):
    walk = walk_of(name, seed)
    assert 7.0 <= abs(lateral_of(walk, walk.start_map_m)) <= 8.1
    end = walk_state_at(walk, walk.exit_end_s).p_map_m
    is_outside = 2.99 < SETTING.field.distance(Point(end)) < 4.3
    assert is_outside or walk.exit_end_s - walk.departure_s == pytest.approx(25.0)
    assert walk.exit_end_s - walk.departure_s < 25.01
    assert abs(lateral_of(walk, end)) >= 12.0
    assert walk_state_at(walk, -3.0).speed_mps == walk_state_at(walk, 1e4).speed_mps == 0.0
    sides = lateral_of(walk, walk.start_map_m) * lateral_of(walk, walk.exit_map_m)
    assert sides < 0.0


@pytest.mark.parametrize("name", ["person", "animal"])
def test_crossing_continuous(name):
    walk = walk_of(name, 5)
    points = np.array([walk_state_at(walk, t).p_map_m for t in np.arange(-1.0, walk.departure_s + 20.0, 0.01)])
    assert np.max(np.hypot(*np.diff(points, axis=0).T)) <= 0.011 * max(walk.walk_mps, walk.leave_mps)


def test_person_standing_time():
    stands = [walk_of("person", seed).stand_s for seed in range(200)]
    assert 6.0 < min(stands) < max(stands) < 10.0


def test_scenario_expected_stops():
    assert DEMO.expected_stops == {"person": 1, "animal": 1, "vehicle": 1}


@pytest.mark.parametrize("seed", range(40))
def test_encounter_spacing(seed):
    paths = straight_paths()
    swaths = {s.line: s for s in find_swaths(paths)}
    drawn = place_encounters(DEMO.encounters, paths, SETTING, generator(seed, "scenario"))
    assert len({d.point.line for d in drawn}) == 3
    for d in drawn:
        s_m = math.dist(swaths[d.point.line].start_map_m, d.point.p_map_m)
        assert s_m > 20.0
        assert swaths[d.point.line].length_m - s_m >= 8.0
        if isinstance(d, Walk):
            assert s_m >= d.trigger_m + 12.0
    grounds = [ground_geometry(d) for d in drawn]
    assert all(a.distance(b) >= 6.0 for k, a in enumerate(grounds) for b in grounds[:k])


@pytest.mark.parametrize("seed", range(40))
def test_parked_vehicle_clear_of_next_swath(seed):
    """On swaths 5 m apart the 6.1 m harrow passes 1.95 m beside the centre of this one."""
    (parked,) = place_encounters(DEMO.encounters[2:], straight_paths(), SETTING, generator(seed, "scenario"))
    assert isinstance(parked, ParkedVehicle)
    turned = parked.heading_rad - parked.point.heading_rad
    aside = abs(lateral_of_parked(parked))
    half = aside + 0.5 * 1.66 * abs(math.cos(turned)) + 0.5 * 3.8 * abs(math.sin(turned))
    assert half < 5.0 - HALF_M - 0.75


def lateral_of_parked(parked):
    dx = parked.p_map_m[0] - parked.point.p_map_m[0]
    dy = parked.p_map_m[1] - parked.point.p_map_m[1]
    return dy * math.cos(parked.point.heading_rad) - dx * math.sin(parked.point.heading_rad)


def test_encounters_by_seed():
    a, b, c = (
        place_encounters(DEMO.encounters, straight_paths(), SETTING, generator(s, "scenario")) for s in (7, 7, 8)
    )
    assert a == b != c


def test_plan_without_room_rejected():
    with pytest.raises(FieldError, match="person"):
        place_encounters(DEMO.encounters, straight_paths(length_m=20.0), SETTING, generator(1, "scenario"))


def test_forward_swaths_only():
    path = straight_paths(1)[0]
    headland = (PathSection(PathSectionType.HEADLAND, 0, 0, len(path.s_m) - 1),)
    from dataclasses import replace

    assert not find_swaths((replace(path, sections=headland),))
    assert not find_swaths((replace(path, direction=-1),))
    assert len(find_swaths((path,))) == 1


@pytest.mark.parametrize(
    ("x", "y", "heading_deg", "is_seen"),
    [(-10.0, 0.0, 0.0, True), (-20.0, 0.0, 0.0, True), (-20.01, 0.0, 0.0, False), (-0.01, 0.0, 0.0, True),
     (0.01, 0.0, 0.0, False), (-10.0, 1.49, 0.0, True), (-10.0, 1.51, 0.0, False), (-10.0, 0.0, 19.0, True),
     (-10.0, 0.0, 21.0, False), (-10.0, 0.0, 180.0, False)],
)  # fmt: skip
def test_approach(x, y, heading_deg, is_seen):
    point = EncounterPoint((0.0, 0.0), 0.0, 2.78, 0)
    assert (distance_to(point, np.array([x, y, 0.0]), math.radians(heading_deg)) <= 20.0) == is_seen


@pytest.mark.parametrize(("approach_m", "starts"), [(8.0, True), (4.0, False)])
def test_trigger_needs_approach_on_path(approach_m, starts):
    walk = walk_of("person", 0)
    actor = Actor(0, DEMO.encounters[0], walk, Terrain(SITE, flat().terrain, 0))
    (x, y), heading = walk.point.p_map_m, walk.point.heading_rad
    distances = np.arange(walk.trigger_m + approach_m, 1.0, -0.1)
    tips = np.column_stack(
        [x - distances * math.cos(heading), y - distances * math.sin(heading), np.zeros(len(distances))]
    )
    states = [actor.update(0.036 * k, tip, heading) for k, tip in enumerate(tips)]
    assert any(f is not None and f.gait >= 0.0 for f in states) == any(f is not None for f in states) == starts


@pytest.mark.parametrize(
    "change",
    [{"swath_fraction": [0.9, 0.1]}, {"kind": "flying"}, {"walk_speed_mps": [math.nan, 1.0]}, {"expected_stops": 2}],
)
def test_invalid_encounter_rejected(change):
    values = DEMO.model_dump()
    values["encounters"] = [{**values["encounters"][0], **change}]
    with pytest.raises(ConfigError):
        parse(Scenario, values, "test")


def drive_into(encounter, seed, seconds=21.0):
    """An unslowed machine on a swath with one encounter."""
    scenario = DEMO.model_copy(update={"encounters": (encounter,)})
    paths = straight_paths(count=1, length_m=60.0)
    config = flat(machine={"tyres": {"max_angle_offset_deg": 0.0, "soil_lateral_sigma_mps2": 0.0}})
    farm = Farm(scenario=scenario, paths=paths, seed=seed, config=config)
    farm.drive_at(10 / 3.6, seconds=seconds)
    truths = [m for t, m in farm.outputs if t == "truth_objects"]
    machine = [m for t, m in farm.outputs if t == "truth_machine"][-1]
    farm.close()
    return truths, machine


@pytest.mark.parametrize("encounter", DEMO.encounters, ids=lambda e: e.name)
def test_one_contact_without_stop(encounter):
    truths, machine = drive_into(encounter, 11)
    assert machine.contacts == 1
    gaps = [o.clearance_m for m in truths for o in m.objects]
    assert min(gaps) == 0.0
    roles = {(o.role, o.label) for m in truths for o in m.objects}
    assert roles == {(encounter.name, encounter.label)}


def test_truth_box_and_clearance():
    truths, _ = drive_into(DEMO.encounters[2], 3, 1.0)
    first = truths[0].objects[0]
    assert first.size_m == pytest.approx([3.8, 1.66, 1.65], abs=0.03)
    assert first.velocity_mps == pytest.approx([0.0, 0.0, 0.0])
    front = 3.5
    assert first.clearance_m == pytest.approx(first.center_map_m[0] - 0.5 * 3.8 - front, abs=0.1)


def test_zone_exit_count():
    farm = Farm()
    farm.curvature_radpm = 0.0
    farm.drive_at(5.0)
    farm.drive(14.0)
    machine = [m for t, m in farm.outputs if t == "truth_machine"]
    farm.close()
    counts = [m.zone_exits for m in machine]
    assert counts[0] == 0
    assert counts[-1] == 1
    crossed = next(m for m in machine if m.zone_exits)
    assert crossed.T_map_base[0, 3] + 3.5 == pytest.approx(100.0, abs=0.4)
    assert LineString([(0, 0), (96, 0)]).within(
        box(*np.array(SITE.boundary_m).min(0), *np.array(SITE.boundary_m).max(0))
    )


BYSTANDER = load(Scenario, find("scenarios", "docking_person")).encounters[0]


def back_in(encounter, seconds=30.0, sensors=()):
    """An unslowed machine that reverses straight into the wide bay, from 22 m before the dock."""
    shed_site = load(Site, find("sites", "demo"))
    dock = shed_site.shed.bay("wide").dock
    start = PoseConfig(x_m=dock.x_m + 22.0, y_m=dock.y_m, heading_deg=dock.heading_deg)
    scenario = DEMO.model_copy(update={"encounters": (encounter,)})
    config = flat(machine={"tyres": {"max_angle_offset_deg": 0.0, "soil_lateral_sigma_mps2": 0.0}})
    farm = Farm(site=shed_site, start=start, is_folded=True, scenario=scenario, config=config, seed=5,
                vehicle=machine_file(sensors=sensors))  # fmt: skip
    farm.drive_at(-0.5, seconds=seconds)
    truths = [m for t, m in farm.outputs if t == "truth_objects"]
    farm.close()
    return farm, truths


def test_bystander_behind_reversing_machine():
    farm, truths = back_in(BYSTANDER)
    states = [m.objects[0] for m in truths if m.objects]
    assert states[0].clearance_m > 6.0
    places = np.array([f.center_map_m[:2] for f in states])
    assert 3.0 <= np.ptp(places[:, 1]) <= 4.1
    dock = load(Site, find("sites", "demo")).shed.bay("wide").dock
    assert 7.4 < places[-1, 0] - dock.x_m < 9.1
    assert [m for t, m in farm.outputs if t == "truth_machine"][-1].contacts == 1


def test_bystander_absent_on_departure():
    shed_site = load(Site, find("sites", "demo"))
    scenario = DEMO.model_copy(update={"encounters": (BYSTANDER,)})
    farm = Farm(site=shed_site, start=shed_site.shed.bay("wide").dock, is_folded=True, scenario=scenario, config=flat())
    farm.drive_at(1.0, seconds=20.0)
    farm.close()
    assert not any(m.objects for t, m in farm.outputs if t == "truth_objects")


def test_bystander_unknown_bay_rejected():
    with pytest.raises(FieldError, match="'wide'"):
        place_encounters((BYSTANDER,), (), SETTING, generator(1, "scenario"))


@pytest.mark.parametrize("visible_to", [("lidar",), ("radar", "camera")])
def test_actor_visibility_to_lidar(visible_to):
    farm, truths = back_in(BYSTANDER.model_copy(update={"visible_to": visible_to}), seconds=21.0, sensors=("lidar",))
    scan = [m for t, m in farm.outputs if t == "lidar/rear"][-1]
    mount = farm.vehicle.sensors.lidar["rear"].mount.T_base_sensor
    points = apply(farm.machine.T_map_base @ mount, scan.points_m.astype(float))
    person = truths[-1].objects[0].center_map_m[:2]
    near = (np.hypot(*(points[:, :2] - person).T) < 0.5) & (points[:, 2] > 0.3)
    assert (near.sum() > 5) == ("lidar" in visible_to)


def test_unknown_sensor_rejected():
    values = DEMO.model_dump()
    values["encounters"] = [{**values["encounters"][0], "visible_to": ["nose"]}]
    with pytest.raises(ConfigError, match="visible_to"):
        parse(Scenario, values, "test")
