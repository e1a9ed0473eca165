"""True shapes: parts of machine and implement, solids of the site, and shapes of objects as the log carries them."""

import json

import numpy as np
import pytest
import shapely

from configs.strict import find, load, parse
from messages.truth import TrueObjects, TrueShapes
from simulation.environment.scenery import build_scenery
from simulation.environment.terrain import Terrain
from simulation.machine.body import machine_outline_m
from simulation.scenario import Scenario
from simulation.true_shapes import shapes_text
from tests.simulation.simulated_farm import CONFIG, IMPLEMENT, SITE, Farm, machine_file

DEMO_FENCE_M = 0.8


def values(negative=()):
    pieces = build_scenery(SITE, Terrain(SITE, CONFIG.terrain, 1), CONFIG.scenery, 1)
    return json.loads(shapes_text(machine_file(), IMPLEMENT, SITE, pieces, negative, 1))


def union(parts):
    return shapely.union_all([shapely.Polygon(p["outline_m"]) for p in parts])


def test_parts_are_within_the_outline_and_reach_it():
    found = values()
    vehicle = machine_file()
    outline = machine_outline_m(vehicle, (0.0, 0.0, 0.0))
    ground = union(found["machine"])
    assert outline.buffer(0.01).covers(ground)
    assert np.allclose(ground.bounds, outline.bounds, atol=0.15)
    assert max(p["z_m"][1] for p in found["machine"]) == pytest.approx(vehicle.body.height_m, abs=1e-5)
    tool = [p for p in found["implement"] if p["name"] == "implement"]
    assert union(tool).bounds[3] - union(tool).bounds[1] == pytest.approx(IMPLEMENT.width_m, abs=1e-3)
    assert all(np.ptp(np.array(p["outline_m"])[:, 1]) < 0.6 for p in tool)


def test_fence_is_solid_and_outside_the_field():
    fence = [p for p in values()["static"] if p["name"] == "fence"]
    assert len(fence) > 100
    field = shapely.Polygon(SITE.boundary_m)
    assert all(field.distance(shapely.Polygon(p["outline_m"])) > 0.5 * DEMO_FENCE_M for p in fence)
    assert max(p["z_m"][1] for p in fence) > 1.0


SCENARIO = parse(Scenario, {
    "name": "shapes", "operator_commands": [],
    "objects": [{"name": "gate", "object": "gate", "posture": "half_open",
                 "place": {"frame": "map", "x_m": 10.0, "y_m": 3.0, "heading_deg": 30.0}}],
}, "test")  # fmt: skip


def test_shapes_of_an_object_lie_in_its_box_and_are_thin():
    """A half open gate is a plane turned against its box; its shape is not the box."""
    farm = Farm(scenario=SCENARIO)
    farm.drive(0.3)
    farm.close()
    shapes = [m for t, m in farm.outputs if t == "truth_shapes"]
    objects = [m for t, m in farm.outputs if t == "truth_objects"]
    assert [m.stamp_ns for m in shapes] == [m.stamp_ns for m in objects]
    assert isinstance(shapes[0], TrueShapes)
    assert isinstance(objects[0], TrueObjects)
    (gate,) = objects[0].objects
    assert set(shapes[0].object_id.tolist()) == {gate.id}
    assert shapes[0].offsets[-1] == len(shapes[0].outline_map_m)
    away = np.hypot(*(shapes[0].outline_map_m - gate.center_map_m[:2]).T)
    assert away.max() < 0.5 * np.hypot(*gate.size_m[:2]) + 0.05
    ring = shapes[0].outline_map_m[shapes[0].offsets[0] : shapes[0].offsets[1]]
    assert shapely.Polygon(ring).area < 0.3
    assert gate.size_m[0] * gate.size_m[1] > 3.0
    assert shapes[0].pto_radps == 0.0


def test_a_scenario_without_objects_logs_no_shapes():
    farm = Farm()
    farm.drive(0.3)
    farm.close()
    assert not [m for t, m in farm.outputs if t == "truth_shapes"]
    assert load(Scenario, find("scenarios", "demo")).objects == ()
