"""Machine, ground, implement and meshes of scenery and actors."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, MultiPolygon, Point, Polygon

from configs.site import Gate, Lane
from configs.vehicle import TrailedImplement
from geometry.transforms import rpy_of
from messages.perception import ObstacleClass
from simulation.environment.meshes import box, ellipsoid, join, limb
from simulation.environment.scenery import build_scenery, fence_line
from simulation.environment.terrain import Terrain
from simulation.ground_truth import allowed_area
from simulation.kernels import rays_near_ball
from simulation.machine.body import implement_mesh, implement_outline_m, machine_mesh, machine_outline_m
from simulation.machine.implement import step_hitch, working_point_m
from simulation.objects.encountered import ENCOUNTERED, PERSON
from simulation.objects.solid import GAIT_STEPS
from simulation.sensors.imu import small_turn_rad
from tests.simulation.simulated_farm import CONFIG, IMPLEMENT, SITE, Farm, flat, machine_file

TRAILER = TrailedImplement(
    kind="trailed", name="drill", working_width_m=3.0, width_m=3.1, lift_s=1.0, lower_s=1.0, uses_pto=False,
    hitch_m=-1.0, axle_length_m=4.0, working_length_m=4.5, total_length_m=5.5,
)  # fmt: skip


def volume_m3(mesh):
    """Signed volume of a closed mesh; wrong for a missing or reversed face."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_solids_are_closed():
    assert volume_m3(box((0, 0, 0), (1, 2, 3))) == pytest.approx(6.0)
    hexagon = 6 * 0.5 * 0.2**2 * math.sin(math.pi / 3)
    assert abs(volume_m3(limb((0, 0, 1), (0, 0, 0), 0.2))) == pytest.approx(hexagon, rel=1e-5)
    ball = volume_m3(ellipsoid((3, 4, 5), (2, 2, 2), 32))
    assert abs(ball) == pytest.approx(4 / 3 * math.pi, rel=0.03)
    both = join([box((0, 0, 0), (1, 1, 1)), box((5, 0, 0), (6, 1, 1))])
    assert volume_m3(both) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("label", "low", "high"),
    [(ObstacleClass.PERSON, (0.2, 0.4, 1.6), (1.0, 0.7, 1.85)),
     (ObstacleClass.ANIMAL, (1.2, 0.25, 1.1), (1.7, 0.5, 1.4)),
     (ObstacleClass.VEHICLE, (3.7, 1.6, 1.6), (3.9, 1.7, 1.7))],
)  # fmt: skip
@pytest.mark.parametrize("gait", [-1.0, *(k / GAIT_STEPS for k in range(GAIT_STEPS))])
def test_actor_mesh_dimensions(label, low, high, gait):
    vertices = ENCOUNTERED[label].mesh(gait).vertices_m
    size = np.ptp(vertices, axis=0)
    assert np.all(size >= low)
    assert np.all(size <= high)
    assert -0.05 < vertices[:, 2].min() < 0.15


def test_gait_changes_mesh():
    shapes = {PERSON.mesh(k / GAIT_STEPS).vertices_m.tobytes() for k in range(GAIT_STEPS)}
    assert len(shapes) > GAIT_STEPS / 2


def test_machine_mesh_within_body():
    vehicle = machine_file()
    vertices, b = machine_mesh(vehicle).vertices_m, vehicle.body
    assert vertices[:, 0].max() == pytest.approx(b.front_m)
    assert vertices[:, 0].min() >= -b.rear_m - 1e-6
    assert np.abs(vertices[:, 1]).max() == pytest.approx(0.5 * b.width_m)
    assert vertices[:, 2].max() == pytest.approx(b.height_m)
    assert vertices[:, 2].min() >= -0.02


def test_implement_mesh_by_hitch():
    low, high = (implement_mesh(IMPLEMENT, h).vertices_m[:8, 2].min() for h in (0.0, 1.0))
    assert low < 0.1
    assert high > 0.5


def test_outlines():
    vehicle = machine_file()
    body = machine_outline_m(vehicle, (10.0, 5.0, math.pi / 2))
    assert body.bounds == pytest.approx((10 - 1.15, 4.0, 10 + 1.15, 8.5))
    tool = implement_outline_m(IMPLEMENT, (10.0, 5.0, math.pi / 2), math.pi / 2)
    assert tool.bounds == pytest.approx((10 - 3.05, 2.6, 10 + 3.05, 3.9))
    assert working_point_m(IMPLEMENT, (10.0, 5.0, math.pi / 2), math.pi / 2) == pytest.approx([10.0, 3.3])


@given(st.floats(0, 1), st.floats(0, 1))
@settings(derandomize=True, max_examples=100)
def test_hitch_rate_limit(hitch, target):
    after = step_hitch(hitch, target, 1.2, 1.0, 0.005)
    assert -0.005 / 1.0 - 1e-12 <= after - hitch <= 0.005 / 1.2 + 1e-12
    assert abs(target - after) <= abs(target - hitch)


def test_trailer_articulation_in_turn():
    farm = Farm(implement=TRAILER, config=flat(machine={"tyres": {"soil_lateral_sigma_mps2": 0.0}}))
    farm.curvature_radpm = 0.1
    farm.drive_at(1.5, seconds=25.0)
    m = farm.machine
    farm.close()
    radius = m.speed_mps / m.yaw_rate_radps
    hitch = math.hypot(radius, 1.0)
    expected = math.asin(4.0 / hitch) + math.asin(1.0 / hitch)
    assert m.yaw_rad - m.attached.yaw_rad == pytest.approx(expected, abs=0.03)


def test_reversing_trailer_jackknifes():
    farm = Farm(implement=TRAILER)
    farm.machine.attached.yaw_rad = -0.05
    farm.drive_at(-1.0, seconds=12.0)
    assert abs(farm.machine.yaw_rad - farm.machine.attached.yaw_rad) > 0.3
    farm.close()


def test_crab_angle_on_side_slope():
    site = SITE.model_copy(update={"boundary_m": ((-20.0, -30.0), (-20.0, 120.0), (100.0, 120.0), (100.0, -30.0))})
    config = flat(
        terrain={"grade": 0.0524, "grade_length_m": 400.0, "flat_m": 0.0},
        machine={"tyres": {"soil_lateral_sigma_mps2": 0.0}},
    )
    yard = site.yard.model_copy(update={"outline_m": ((-5.0, -105.0), (5.0, -105.0), (5.0, -95.0), (-5.0, -95.0))})
    farm = Farm(site=site.model_copy(update={"yard": yard}), config=config)
    farm.drive_at(2.0)
    m = farm.machine
    farm.close()
    roll = rpy_of(m.T_map_base)[0]
    assert abs(math.degrees(roll)) == pytest.approx(3.0, abs=0.2)
    slip = -m.lateral_mps / m.speed_mps
    assert slip == pytest.approx(math.sin(roll) / CONFIG.machine.tyres.rear_stiffness, rel=0.2)


def test_terrain_grade_and_curvature_limits():
    """Grade at most 8 % plus waves; no rise into a protective field 10 m ahead."""
    terrain = Terrain(SITE, CONFIG.terrain, 3)
    x = np.arange(-20.0, 100.0, 0.5)
    for y in (-25.0, 0.0, 25.0):
        z = terrain.heights_m(np.column_stack([x, np.full_like(x, y)]))
        grade = np.diff(z) / 0.5
        assert np.abs(grade).max() < 0.095
        assert np.abs(grade).max() > 0.04
        ahead = z[20:] - z[:-20] - grade[: len(z) - 20] * 10.0
        assert np.abs(ahead).max() < 0.35
    assert terrain.height_m(0.0, 0.0) == pytest.approx(0.0)


def test_terrain_by_seed():
    a, b, c = (Terrain(SITE, CONFIG.terrain, s).height_m(50.0, 10.0) for s in (1, 1, 2))
    assert a == b != c


def test_pose_on_ground():
    terrain = Terrain(SITE, CONFIG.terrain, 3)
    T = terrain.pose_on_ground(60.0, 10.0, 0.7, 2.55, 1.9)
    assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    for side in (0.95, -0.95):
        wheel = T @ np.array([0.0, side, 0.0, 1.0])
        assert wheel[2] == pytest.approx(terrain.height_m(wheel[0], wheel[1]), abs=0.005)
    assert math.atan2(T[1, 0], T[0, 0]) == pytest.approx(0.7)


def test_fence_gap_at_gate():
    gate = Gate(name="gate", posts_m=((10.0, -30.0), (18.0, -30.0)))
    lane = Lane(name="lane", center_m=((14.0, -40.0), (14.0, -20.0)), width_m=7.0)
    site = SITE.model_copy(update={"gates": (gate,), "lanes": (lane,)})
    fence = fence_line(site, 0.5)
    assert min(part.distance(Point(14.0, -30.5)) for part in fence) >= 3.5
    assert min(part.distance(Point(30.0, -30.5)) for part in fence) < 1e-6
    assert sum(part.length for part in fence) == pytest.approx(2 * (121 + 61) - 8.0, abs=1.5)
    pieces = build_scenery(site, Terrain(site, CONFIG.terrain, 1), CONFIG.scenery, 1)
    assert {"ground", "crop", "fence", "gate"} <= {p.name for p in pieces}
    assert sum(len(p.mesh.triangles) for p in pieces) < 400_000


def test_allowed_area_without_no_go():
    pond = SITE.yard.model_copy(
        update={"name": "pond", "outline_m": ((40.0, 0.0), (50.0, 0.0), (50.0, 9.0), (40.0, 9.0))}
    )
    area = allowed_area(SITE.model_copy(update={"no_go": (pond,)}))
    assert isinstance(area, Polygon | MultiPolygon)
    assert not area.contains(Point(45.0, 5.0))
    assert area.contains(LineString([(0, 0), (39, 0)]))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.01, -0.3, 1.2])
def test_small_turn(angle):
    c, s = math.cos(angle), math.sin(angle)
    assert small_turn_rad(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])) == pytest.approx([0, 0, angle], abs=1e-12)


def test_rays_near_ball():
    rays = np.array([[0, 0, 0, 1, 0, 0], [0, 0, 0, -1, 0, 0], [0, 1.1, 0, 1, 0, 0], [0, 0.9, 0, 1, 0, 0]], np.float32)
    assert rays_near_ball(rays, np.array([10.0, 0.0, 0.0]), 1.0).tolist() == [1, 0, 0, 1]
