"""Shed: level floor, closed solids, free bays, contacts with walls and posts."""

import math

import numpy as np
import pytest
import shapely
from shapely import Point, Polygon

from configs.site import PoseConfig, Site
from configs.strict import find, load
from geometry.transforms import apply
from simulation.environment.scenery import build_scenery
from simulation.environment.shed import bay_ground, prism, shed_solids, storage_floor
from simulation.environment.terrain import Terrain
from simulation.ground_truth import allowed_area
from tests.simulation.simulated_farm import CONFIG, IMPLEMENT, Farm, flat, machine_file
from tests.simulation.test_machine import volume_m3

SITE = load(Site, find("sites", "demo"))
SHED = SITE.shed


@pytest.mark.parametrize("seed", range(3))
def test_floor_and_yard_level_without_steps(seed):
    terrain = Terrain(SITE, CONFIG.terrain, seed)
    for x in np.linspace(-9.0, 38.0, 12):
        assert {terrain.height_m(x, y) for y in np.linspace(-52.0, -25.0, 8)} == {0.0}
    for x in (-5.0, 10.0, 20.0, 37.0):
        y = np.arange(-60.0, 10.0, 0.1)
        z = terrain.heights_m(np.column_stack([np.full_like(y, x), y]))
        assert np.abs(np.diff(z)).max() < 0.1 * 0.09
        assert np.abs(np.diff(z, 2)).max() < 1e-3
    assert abs(terrain.height_m(70.0, 40.0)) > 0.1


def test_prism_is_closed():
    ground = Polygon([(0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)])
    assert volume_m3(prism(ground, 0.5, 2.0)) == pytest.approx(1.5 * ground.area)
    assert all(volume_m3(s.mesh) == pytest.approx(s.ground.area * s.top_m, rel=1e-3) for s in shed_solids(SHED, 1))


def test_shed_solids():
    solids = shed_solids(SHED, 1)
    kinds = [s.kind for s in solids]
    assert (kinds.count("wall"), kinds.count("post"), kinds.count("mast")) == (1, 6, 2)
    assert kinds.count("store") >= 4
    wall = solids[0].ground
    assert wall.area == pytest.approx(32.0 * 0.15, rel=0.02)
    assert not wall.contains(Point(1.0, -40.0))


@pytest.mark.parametrize("seed", range(8))
def test_stored_goods_clear_of_bays(seed):
    stored = [s.ground for s in shed_solids(SHED, seed) if s.kind == "store"]
    (floor,) = storage_floor(SHED)
    assert floor.bounds[1] > -37.72
    assert all(floor.covers(g) for g in stored)
    assert all(a.distance(b) > 0.09 for k, a in enumerate(stored) for b in stored[:k])
    for bay in SHED.bays:
        assert all(bay_ground(SHED, bay).distance(g) >= 0.3 - 1e-9 for g in stored)
    other = [s.ground for s in shed_solids(SHED, seed + 1) if s.kind == "store"]
    assert [g.wkb for g in stored] != [g.wkb for g in other]


def at_dock(name, dx=0.0, dy=0.0, is_folded=True):
    dock = SHED.bay(name).dock
    pose = PoseConfig(x_m=dock.x_m + dx, y_m=dock.y_m + dy, heading_deg=dock.heading_deg)
    farm = Farm(site=SITE, config=flat(), start=pose, is_folded=is_folded)
    truth = [m for t, m in farm.drive(0.1) if t == "truth_machine"][-1]
    farm.close()
    return truth


@pytest.mark.parametrize("name", ["narrow", "wide"])
def test_docked_without_contact_or_exit(name):
    truth = at_dock(name)
    assert (truth.contacts, truth.zone_exits) == (0, 0)
    assert truth.T_map_base[2, 3] == 0.0
    assert truth.T_map_base[0, 3] == SHED.bay(name).dock.x_m


@pytest.mark.parametrize(
    ("dx", "dy", "is_folded", "touches"),
    [(-0.4, 0.0, True, False), (-0.7, 0.0, True, True), (0.0, 0.0, False, True), (2.7, 0.25, True, False),
     (2.7, 0.5, True, True)],
)  # fmt: skip
def test_wall_and_post_contacts(dx, dy, is_folded, touches):
    """Clearance 0.6 m behind the raised harrow, 0.33 m beside the folded one to the post at x = -4."""
    truth = at_dock("narrow", dx, dy, is_folded)
    assert (truth.contacts > 0) == touches
    assert (truth.zone_exits > 0) == (not is_folded)  # unfolded it extends through the wall


def test_allowed_area_of_shed_and_yard():
    area = allowed_area(SITE)
    assert area.covers(shapely.box(-8.9, -45.0, 30.0, -35.0))


def test_shed_pieces_in_scenery():
    names = [p.name for p in build_scenery(SITE, Terrain(SITE, CONFIG.terrain, 1), CONFIG.scenery, 1)]
    assert {"roof", "wall", "post", "mast", "store"} <= set(names)


def test_lidar_in_bay():
    vehicle = machine_file(sensors=("lidar",))
    dock = SHED.bay("narrow").dock
    farm = Farm(site=SITE, config=flat(), vehicle=vehicle, start=dock, is_folded=True)
    scan = [m for t, m in farm.drive(0.2) if t == "lidar/front"][-1]
    farm.close()
    mount = vehicle.sensors.lidar["front"].mount.T_base_sensor
    points = apply(farm.machine.T_map_base @ mount, scan.points_m.astype(float))
    upright = points[(points[:, 2] > 0.5) & (points[:, 2] < 3.0)]
    south = upright[(np.abs(upright[:, 1] + 46.0) < 0.4) & (upright[:, 0] < -1.0)]
    assert len(south) > 300
    assert np.median(south[:, 1]) == pytest.approx(-46.0 + 0.075, abs=0.02)
    post = upright[np.hypot(upright[:, 0] - 0.8, upright[:, 1] + 41.96) < 0.3]
    assert len(post) > 10
    assert math.dist(np.median(post[:, :2], axis=0), (0.8, -41.96)) < 0.16
    assert IMPLEMENT.fold is not None
