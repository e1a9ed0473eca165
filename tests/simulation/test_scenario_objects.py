"""Scripted objects: scenario files, placement against geometry computed by hand, determinism, behaviours."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import open3d
import pytest
import yaml

from configs.strict import CONFIGS, load, parse
from geometry.pose2 import Pose2
from messages.errors import ConfigError
from runtime.__main__ import main
from simulation.actors.outline import Outline
from simulation.actors.phases import PhaseTracker, PlanPosition, Situation
from simulation.machine.body import T_base_implement, implement_mesh, machine_mesh
from simulation.scenario import Scenario
from simulation.scenario_objects import OutlinePlace, Side
from tests.simulation.simulated_farm import Farm, straight_paths

HAZARDS = sorted((CONFIGS / "scenarios/hazards").glob("*.yaml"))
ADULT = {"name": "adult", "object": "adult", "height_m": 1.75, "place": {"frame": "map", "x_m": 30.0, "y_m": 5.0}}


def scenario_of(*objects):
    return parse(Scenario, {"name": "test", "operator_commands": [], "objects": list(objects)}, "test")


def farm_of(*objects, seed=1, paths=()):
    return Farm(scenario=scenario_of(*objects), seed=seed, paths=paths)


def actors_of(farm):
    return {actor.role: actor for actor in farm.world._scene.actors}


def gap_m(farm, name):
    """Distance from the outline to an object as it would stand: while walking its legs swing ahead and behind."""
    standing = replace(actors_of(farm)[name], gait=-1.0)
    return Outline.of(farm.machine, farm.vehicle).ground.distance(standing.footprint)


def run(farm, seconds, every_s=0.1):
    """States by name over time: a list of (time, actors)."""
    states = []
    for _ in range(round(seconds / every_s)):
        farm.drive(every_s)
        states.append((farm.elapsed_s, actors_of(farm)))
    farm.close()
    return states


def changed(**values):
    """An adult with values replaced; `place__x_m` replaces a value of a section, None removes it."""
    one = {key: dict(value) if isinstance(value, dict) else value for key, value in ADULT.items()}
    for name, value in values.items():
        *sections, key = name.split("__")
        target = one
        for section in sections:
            target = target.setdefault(section, {})
        if value is None:
            target.pop(key)
        else:
            target[key] = value
    return one


CROSS = {"kind": "cross", "speed_mps": 1.0, "distance_m": 5.0}
BAD = [  # object, texts of the error: key and value
    (changed(object="cow"), ("objects.0.object", "'cow'")),
    (changed(object=None), ("objects.0.object",)),
    (changed(name=None), ("objects.0.name",)),
    (changed(name="A B"), ("objects.0.name", "'A B'")),
    (changed(name=""), ("objects.0.name", "''")),
    (changed(posture="flying"), ("posture", "'flying'")),
    (changed(object="dog", height_m=0.5, posture="sitting"), ("posture", "'sitting'")),
    (changed(height_m=2.2), ("height_m", "2.2")),
    (changed(height_m=[1.8, 1.6]), ("height_m", "1.8")),
    (changed(height_m="tall"), ("height_m", "'tall'")),
    (changed(height_m=[1.6, 1.7, 1.8]), ("height_m", "1.7")),
    (changed(size_m=1.0), ("objects.0.size_m", "1.0")),
    (changed(place=None), ("objects.0.place",)),
    (changed(place__frame="body"), ("place", "'body'")),
    (changed(place__x_m=None), ("place.map.x_m",)),
    (changed(place__x_m=1e9), ("place.map.x_m", "1000000000")),
    (changed(place__ahead_m=3.0), ("place.map.ahead_m", "3.0")),
    (changed(place__heading_deg=[-500.0, 0.0]), ("heading_deg", "-500")),
    (changed(place={"frame": "path", "left_m": 1.0}), ("place.path", "ahead_m or path_m")),
    (changed(place={"frame": "path", "ahead_m": 3.0, "path_m": 9.0}), ("place.path", "9.0")),
    (changed(place={"frame": "outline", "side": "top", "gap_m": 1.0}), ("place.outline.side", "'top'")),
    (changed(place={"frame": "outline", "side": "front", "gap_m": -3.0}), ("place.outline.gap_m", "-3.0")),
    (changed(place={"frame": "object", "of": "car"}), ("place.of", "'car'")),
    (changed(when={"phase": "sleeping"}), ("when.phase", "'sleeping'")),
    (changed(when={"after_s": 2.0}), ("when", "none")),
    (changed(when={"at_s": 2.0, "phase": "turn"}), ("when", "at_s, phase")),
    (changed(when={"at_s": -1.0}), ("when.at_s", "-1.0")),
    (changed(when={"near_m": 1.0}), ("when near_m",)),
    (changed(behaviour={"kind": "dance"}), ("behaviour", "'dance'")),
    (changed(behaviour={"kind": "cross", "speed_mps": 1.0}), ("behaviour.cross", "distance_m or to")),
    (changed(behaviour=CROSS | {"speed_mps": 40.0}), ("behaviour.cross.speed_mps", "40.0")),
    (changed(behaviour=CROSS | {"to": "child"}), ("behaviour.cross", "'child'")),
    (changed(behaviour={"kind": "run", "speed_mps": 3.0, "to": "child"}), ("adult", "'child'")),
    (changed(behaviour={"kind": "step_out", "speed_mps": 3.0, "distance_m": 3.0}), ("step_out needs near_m",)),
    (changed(behaviour={"kind": "follow", "speed_mps": 1.0}), ("follow needs gap_m",)),
    (changed(object="stone", height_m=0.3, behaviour=CROSS), ("behaviour cross", "stone")),
    (changed(object="dog", height_m=0.5, behaviour={"kind": "lie_down"}), ("lie_down", "dog")),
    (changed(visible_to=["nose"]), ("visible_to", "'nose'")),
    (changed(expected_stops=2), ("expected_stops", "2")),
    (changed(must_avoid="perhaps"), ("must_avoid", "'perhaps'")),
]  # fmt: skip


@pytest.mark.parametrize(("one", "texts"), BAD)
def test_bad_scenario_files(tmp_path, one, texts):
    """One line that names file, key and value."""
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump({"name": "bad", "operator_commands": [], "objects": [one]}))
    with pytest.raises(ConfigError) as caught:
        load(Scenario, path)
    line = str(caught.value)
    assert "\n" not in line
    assert str(path) in line
    assert all(text in line for text in texts), line


def test_bad_scenario_file_exit_status(tmp_path, capsys, monkeypatch):
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump({"name": "bad", "operator_commands": [], "objects": [changed(object="cow")]}))
    monkeypatch.setattr("sys.argv", ["headland", "run", "--mission", "dock", "--scenario", str(path)])
    assert main() == 2
    found = capsys.readouterr().err.strip()
    assert "objects.0.object = 'cow'" in found
    assert "\n" not in found


def test_names_are_unique():
    with pytest.raises(ConfigError, match="'adult' is not unique"):
        scenario_of(ADULT, ADULT)


@pytest.mark.parametrize("path", HAZARDS, ids=lambda p: p.stem)
def test_hazard_scenarios(path):
    scenario = load(Scenario, path)
    assert scenario.objects or scenario.environment is not None


def mesh_gap_m(farm, actor):
    """Distance of an object's vertices to the meshes of machine and lowered implement."""
    machine, T = farm.machine, farm.machine.T_map_base
    tool = implement_mesh(machine.attached.current, 0.0).transformed(
        T @ T_base_implement(machine.attached.implement, machine.attached.yaw_rad - machine.yaw_rad)
    )
    gaps = []
    for mesh in (machine_mesh(farm.vehicle).transformed(T), tool):
        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(open3d.core.Tensor(mesh.vertices_m), open3d.core.Tensor(mesh.triangles.astype(np.uint32)))
        gaps.append(scene.compute_distance(open3d.core.Tensor(actor.vertices_map_m)).numpy().min())
    return min(gaps)


@pytest.mark.parametrize("side", get_args(Side))
def test_gap_to_each_side(side):
    """0.15 m beside each side of the true outline: in plan view, and between the bodies where the side is a face."""
    child = {"name": "child", "object": "child", "height_m": 1.0,
             "place": {"frame": "outline", "side": side, "gap_m": 0.15, "heading_deg": 30.0}}  # fmt: skip
    farm = farm_of(child)
    farm.drive(0.02)
    actor, ground = actors_of(farm)["child"], Outline.of(farm.machine, farm.vehicle).ground
    if not side.startswith("wheel_front"):  # within the machine's width
        assert ground.distance(actor.footprint) == pytest.approx(0.15, abs=0.01)
    if side not in ("left", "right"):  # the middle of the machine is narrower than its wheels
        assert mesh_gap_m(farm, actor) == pytest.approx(0.15, abs=0.01)
    farm.close()


@pytest.mark.parametrize(("side", "along", "ahead", "left"), [
    ("front", 0.5, 0.0, 0.5), ("rear", 0.5, 0.0, 0.5), ("wing_front_left", 0.5, 0.0, 0.5),
    ("wing_rear_right", 0.5, 0.0, 0.5), ("left", 0.5, 0.5, 0.0), ("right", 0.5, 0.5, 0.0),
    ("wing_left", 0.5, 0.5, 0.0), ("wheel_rear_right", 0.5, 0.5, 0.0),
])  # fmt: skip
def test_offset_along_a_side(side, along, ahead, left):
    def place_at(offset):
        place = {"frame": "outline", "side": side, "gap_m": 1.0, "along_m": offset}
        farm = farm_of(changed(place=place))
        farm.drive(0.02)
        p = np.array(actors_of(farm)["adult"].p_map_m[:2])
        farm.close()
        return p

    assert place_at(along) - place_at(0.0) == pytest.approx([ahead, left], abs=0.01)


def test_gap_beside_a_turned_machine():
    place = OutlinePlace(frame="outline", side="wing_front_left", gap_m=(0.0, 0.0))
    farm = farm_of()
    outline = Outline(farm.vehicle, farm.machine.attached.current, Pose2(3.0, 4.0, math.pi / 2), math.pi / 2)
    x, y = outline.beside(place.side, 0.4, 0.0, np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 1.0]], np.float32), 0.0)
    # front edge at -1.1, wing from 1.15 to 3.05 m to the left, which is west; the body reaches 0 across it
    assert (x, y) == pytest.approx((3.0 - 2.1, 4.0 - 1.1 + 0.4))
    farm.close()


@pytest.mark.parametrize("heading_deg", [0.0, 60.0, 90.0])
def test_long_bodies_beside_a_wing_begin_beside_every_part(heading_deg):
    """A wall before the wing would reach into the rear wheel."""
    place = {"frame": "outline", "side": "wing_front_right", "gap_m": 0.1, "heading_deg": heading_deg}
    farm = farm_of({"name": "wall", "object": "low_wall", "place": place})
    farm.drive(0.02)
    actor, ground = actors_of(farm)["wall"], Outline.of(farm.machine, farm.vehicle).ground
    assert ground.distance(actor.footprint) < 0.2
    assert ground.intersection(actor.footprint).area < 1e-3
    farm.close()


def test_place_on_the_path():
    ahead = changed(place={"frame": "path", "ahead_m": 10.0, "left_m": 1.0, "heading_deg": 90.0})
    absolute = changed(name="other", place={"frame": "path", "path_m": 58.0, "left_m": 1.0})
    farm = farm_of(ahead, absolute, paths=straight_paths())
    farm.drive(0.02)
    one, other = actors_of(farm)["adult"], actors_of(farm)["other"]
    assert one.p_map_m[:2] == pytest.approx((13.5, 1.0), abs=0.01)  # the front is 3.5 m ahead of base
    assert one.yaw_rad == pytest.approx(math.pi / 2)
    assert other.p_map_m[:2] == pytest.approx((54.0, 4.0), abs=0.1)  # the second swath leads back, 5 m to the left
    assert math.cos(other.yaw_rad) == pytest.approx(-1.0)
    farm.close()


def test_draws_depend_on_seed_and_name_alone():
    ranged = changed(place__x_m=[20.0, 40.0], place__heading_deg=[0.0, 360.0], height_m=[1.5, 1.9])
    more = changed(name="another", place__x_m=[20.0, 40.0], height_m=[1.5, 1.9])

    def first(seed, *objects):
        farm = farm_of(*objects, seed=seed)
        farm.drive(0.02)
        actor = actors_of(farm)
        farm.close()
        return {name: (*a.p_map_m[:2], a.yaw_rad, float(a.box_m()[1][2])) for name, a in actor.items()}

    alone, both = first(1, ranged), first(1, more, ranged)
    assert both["adult"] == alone["adult"] == first(1, ranged)["adult"]
    assert first(2, ranged)["adult"] != alone["adult"]
    assert both["another"][0] != both["adult"][0]
    assert 20.0 <= alone["adult"][0] <= 40.0
    assert 1.5 <= alone["adult"][3] <= 1.91


def test_cross_without_halting():
    states = run(farm_of(changed(place__heading_deg=90.0, when={"at_s": 1.0}, behaviour=CROSS)), 8.0)
    for at_s, actors in states:
        if at_s < 0.995:
            assert not actors
        elif at_s > 1.05:
            y = 5.0 + min(at_s - 1.0, 5.0)
            assert actors["adult"].p_map_m[:2] == pytest.approx((30.0, y), abs=0.011)
            speed = math.hypot(*actors["adult"].velocity_mps)
            assert speed == pytest.approx(1.0 if at_s < 5.98 else 0.0 if at_s > 6.02 else speed)
    gaits = {actors["adult"].solid.step(actors["adult"].gait) for at_s, actors in states if 1.1 < at_s < 5.9}
    assert len(gaits) > 8
    assert states[-1][1]["adult"].gait < 0.0


def test_run():
    states = run(farm_of(changed(behaviour={"kind": "run", "speed_mps": 3.0, "distance_m": 6.0})), 3.0)
    at_s, actors = states[9]
    assert actors["adult"].p_map_m[0] == pytest.approx(30.0 + 3.0 * at_s, abs=0.04)
    assert actors["adult"].solid.stride_m == pytest.approx(2.4 * 1.75 / 1.757)
    assert states[-1][1]["adult"].p_map_m[0] == pytest.approx(36.0)


def test_lie_down_over_a_second():
    behaviour = {"kind": "lie_down", "over_s": 1.0, "when": {"at_s": 1.0, "after_s": 0.5}}
    heights = {round(t, 1): a["adult"].box_m()[1][2] for t, a in run(farm_of(changed(behaviour=behaviour)), 3.5)}
    assert heights[1.4] == pytest.approx(1.75, abs=0.01)
    assert 0.5 < heights[2.0] < 1.6
    assert heights[2.6] == heights[3.4] == pytest.approx(0.246, abs=0.01)
    assert all(b <= a + 1e-6 for a, b in zip(list(heights.values())[:-1], list(heights.values())[1:], strict=True))


def test_step_out_of_occlusion():
    car = {"name": "car", "object": "car", "place": {"frame": "map", "x_m": 20.0, "y_m": 6.0}}
    child = {"name": "child", "object": "child", "height_m": 1.0,
             "place": {"frame": "object", "of": "car", "left_m": 1.5, "heading_deg": -90.0},
             "behaviour": {"kind": "step_out", "near_m": 12.0, "speed_mps": 2.0, "distance_m": 6.0}}  # fmt: skip
    farm = farm_of(car, child)
    farm.drive(1.0)
    assert actors_of(farm)["child"].p_map_m[:2] == pytest.approx((20.0, 7.5))
    farm.drive_at(2.0, seconds=0.1)
    starts = []
    for _ in range(190):
        farm.drive(0.05)
        if actors_of(farm)["child"].p_map_m[1] < 7.49:
            starts.append(gap_m(farm, "child"))
    assert starts[0] == pytest.approx(12.0, abs=0.3)
    assert actors_of(farm)["child"].p_map_m[:2] == pytest.approx((20.0, 1.5), abs=0.02)
    farm.close()


@pytest.mark.parametrize(
    ("kind", "side", "gap"), [("follow", "rear", 1.0), ("stay_in_blind_zone", "wing_rear_left", 0.3)]
)
def test_accompanies_the_moving_machine(kind, side, gap):
    behaviour = {"kind": kind, "side": side, "gap_m": gap, "speed_mps": 1.5}
    farm = farm_of(changed(place={"frame": "outline", "side": side, "gap_m": gap + 2.0}, behaviour=behaviour))
    farm.drive_at(1.0, seconds=8.0)
    assert farm.machine.x_m > 3.0
    for _ in range(10):
        farm.drive(0.2)
        assert gap_m(farm, "adult") == pytest.approx(gap, abs=0.03)
        assert actors_of(farm)["adult"].velocity_mps[0] == pytest.approx(farm.machine.speed_mps, abs=0.15)
    farm.close()


@pytest.mark.parametrize(("side", "x", "y"), [("rear", -8.0, 0.3), ("left", 1.0, 6.0)])
def test_approach_until_contact(side, x, y):
    behaviour = {"kind": "approach", "side": side, "speed_mps": 1.0}
    farm = farm_of(changed(place={"frame": "map", "x_m": x, "y_m": y}, behaviour=behaviour))
    places = []
    for _ in range(14):
        farm.drive(0.5)
        places.append(actors_of(farm)["adult"].p_map_m)
    assert math.dist(places[1], places[3]) == pytest.approx(1.0, abs=0.01)
    assert gap_m(farm, "adult") == pytest.approx(0.0, abs=0.01)
    assert places[-1] == places[-2]
    farm.close()


def test_objects_interact():
    """A child runs to the adult, who leaves when it has arrived."""
    leave = CROSS | {"when": {"meets": "child", "within_m": 0.8}}
    child = {"name": "child", "object": "child", "place": {"frame": "map", "x_m": 24.0, "y_m": 5.0},
             "behaviour": {"kind": "run", "speed_mps": 3.0, "to": "adult", "when": {"at_s": 0.5}}}  # fmt: skip
    states = run(farm_of(changed(behaviour=leave), child), 4.0)
    met = next(t for t, a in states if a["adult"].p_map_m[0] > 30.005)
    assert met == pytest.approx(0.5 + (6.0 - 0.8) / 3.0, abs=0.15)
    assert states[3][1]["child"].p_map_m[0] == pytest.approx(24.0)
    last = states[-1][1]
    assert last["adult"].p_map_m[0] == pytest.approx(30.0 + 4.0 - met, abs=0.15)
    assert math.dist(last["adult"].p_map_m, last["child"].p_map_m) == pytest.approx(0.6, abs=0.05)


def test_gull_may_be_touched():
    gull = {
        "name": "gull",
        "object": "gull",
        "height_m": 2.0,
        "place": {"frame": "outline", "side": "front", "gap_m": -0.8},
    }
    stone = {"name": "stone", "object": "stone", "place": {"frame": "outline", "side": "rear", "gap_m": -0.2}}
    farm = farm_of(gull, stone)
    outputs = farm.drive(0.2)
    farm.close()
    assert farm.world._ground_truth.contact_ids == (101,)
    objects = [m for t, m in outputs if t == "truth_objects"][-1].objects
    assert [(o.role, o.kind, o.must_avoid) for o in objects] == [("gull", "gull", False), ("stone", "stone", True)]


def test_a_gull_does_not_stand_in_the_air():
    place = {"frame": "map", "x_m": 30.0, "y_m": 5.0}
    gull = {"name": "gull", "object": "gull", "height_m": 1.5, "place": place, "behaviour": {"kind": "stand"}}
    states = [(t, actors["gull"]) for t, actors in run(farm_of(gull), 12.0) if "gull" in actors]
    points = np.array([actor.p_map_m[:2] for _, actor in states])
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    speeds = [math.hypot(*actor.velocity_mps) for _, actor in states]
    assert min(speeds) == pytest.approx(max(speeds))
    assert 6.0 <= speeds[0] <= 10.0
    assert steps_m == pytest.approx(0.1 * speeds[0], rel=0.05)
    assert np.linalg.norm(points - np.array([30.0, 5.0]), axis=1).max() <= 24.1  # diameter of the largest circle


def test_phases():
    """Start warning, start, straight, turn, reverse, resume; a short halt between directions is no resume."""
    tracker, found = PhaseTracker(), []
    drive = [(1.0, 0.0, 0.0, True), (1.0, 0.0, 0.0, False), (3.0, 1.0, 0.0, False),
             (2.0, 1.0, 0.5, False), (0.3, 0.0, 0.0, False), (2.0, -0.6, 0.0, False),
             (2.0, 0.0, 0.0, False), (2.0, 1.0, 0.0, False)]  # fmt: skip
    at_s = 0.0
    for seconds, speed, angle, is_horn_on in drive:
        phases = set()
        for _ in range(round(seconds / 0.1)):
            phases |= tracker.update(Situation(at_s, (0.0, 0.0, 0.0), speed, angle, False, is_horn_on, False))
            at_s += 0.1
        found.append(phases)
    assert found == [{"start_warning"}, set(), {"start", "straight"}, {"turn"}, set(), {"reverse"}, set(),
                     {"resume", "straight"}]  # fmt: skip


def test_position_on_neighbouring_paths():
    position = PlanPosition(straight_paths(3, length_m=20.0))
    for s in np.arange(0.0, 20.0, 0.2):
        assert position.update(s, 0.3, 0.0)[0] == pytest.approx(s, abs=0.06)
    for s in np.arange(0.0, 20.0, 0.2):
        assert position.update(20.0 - s, 4.8, math.pi)[0] == pytest.approx(20.0 + s, abs=0.06)
    assert math.isnan(PlanPosition(()).update(0.0, 0.0, 0.0)[0])
