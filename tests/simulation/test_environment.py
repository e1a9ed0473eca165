"""Environment of a scenario: files, ground under wheels and in scans against formulas, background, determinism."""

import json
import math

import numpy as np
import pytest
import shapely
import yaml
from scipy.special import j1
from shapely import Polygon

from configs.strict import CONFIGS, load, parse
from configs.vehicle import outlines
from messages.errors import ConfigError
from simulation.environment.terrain import Terrain
from simulation.rendering.light import draw_light, in_fog
from simulation.rendering.skybox import BELOW, render_panorama
from simulation.rendering.textures import textures
from simulation.scenario import Scenario
from simulation.scenario_environment import Environment, Ground
from tests.simulation.simulated_farm import CONFIG, SITE, Farm, flat, machine_file

FILES = sorted((CONFIGS / "scenarios/environments").glob("*.yaml"))
CREST = {"height_m": 1.0, "length_m": 20.0, "x_m": 40.0, "y_m": 0.0}
BAD = [  # environment, texts of the error: key and value
    ({"snow": 1.0}, ("environment.snow", "1.0")),
    ({"wind_mps": -1.0}, ("wind_mps", "-1.0")),
    ({"wind_mps": "strong"}, ("wind_mps", "'strong'")),
    ({"beam_divergence_mrad": 50.0}, ("beam_divergence_mrad", "50.0")),
    ({"fog": {}}, ("fog.visibility_m",)),
    ({"fog": {"visibility_m": 1.0}}, ("fog.visibility_m", "1.0")),
    ({"fog": {"visibility_m": [200.0, 100.0]}}, ("fog.visibility_m", "200.0")),
    ({"rain": {"rate_mmph": 5.0}}, ("rain.rate_mmph", "5.0")),
    ({"rain": {"visibility_m": math.nan}}, ("rain.visibility_m", "nan")),
    ({"dust": {"ray_share": 0.5}}, ("dust.ray_share", "0.5")),
    ({"dust": {"visibility_m": 0.0}}, ("dust.visibility_m", "0.0")),
    ({"birds": {"gulls": 0}}, ("birds.gulls", "0")),
    ({"birds": {"gulls": 2.5}}, ("birds.gulls", "2.5")),
    ({"boundary": {}}, ("boundary", "hedge_height_m or trees")),
    ({"boundary": {"trees": -1}}, ("boundary.trees", "-1")),
    ({"neighbour": {"speed_mps": 50.0}}, ("neighbour.speed_mps", "50.0")),
    ({"vegetation": {"kind": "crop"}}, ("environment.vegetation", "'crop'")),
    ({"vegetation": [{"kind": "maize", "height_m": 1.0}]}, ("vegetation.0.kind", "'maize'")),
    ({"vegetation": [{"kind": "crop", "height_m": 2.0}]}, ("vegetation.0.height_m", "2.0")),
    ({"vegetation": [{"kind": "crop", "height_m": 0.3, "density_m2pm3": -1}]}, ("density_m2pm3", "-1")),
    ({"vegetation": [{"kind": "crop", "height_m": 0.3, "area": "yard"}]}, ("vegetation.0.area", "'yard'")),
    ({"vegetation": [{"kind": k, "height_m": 0.3} for k in ("crop", "grass")]}, ("areas field, field",)),
    ({"ground": {"waves": {"height_m": 0.05}}}, ("ground.waves.length_m",)),
    ({"ground": {"waves": {"height_m": 0.9, "length_m": 8.0}}}, ("ground.waves.height_m", "0.9")),
    ({"ground": {"waves": {"height_m": 0.05, "length_m": 0.5}}}, ("ground.waves.length_m", "0.5")),
    ({"ground": {"crest": CREST | {"height_m": 9.0}}}, ("ground.crest.height_m", "9.0")),
    ({"ground": {"ditch": CREST}}, ("ground.ditch.height_m", "1.0")),
    ({"ground": {"clods": {"height_m": 0.1, "per_m2": 99}}}, ("ground.clods.per_m2", "99")),
    ({"ground": {"ruts": {"depth_m": [0.1, 0.2, 0.3]}}}, ("ground.ruts.depth_m", "0.3")),
    ({"ground": {"side_slope_deg": 45}}, ("ground.side_slope_deg", "45")),
]  # fmt: skip


def terrain_of(seed=1, site=SITE, **ground):
    return Terrain(site, flat().terrain, seed, parse(Ground, ground, "test"))


def scenario_of(**environment):
    values = {"name": "test", "operator_commands": [], "environment": environment}
    return parse(Scenario, values, "test")


@pytest.mark.parametrize(("environment", "texts"), BAD)
def test_bad_environment_files(tmp_path, environment, texts):
    """One line that names file, key and value."""
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump({"name": "bad", "operator_commands": [], "environment": environment}))
    with pytest.raises(ConfigError) as caught:
        load(Scenario, path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    for text in texts:
        assert text in message


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_environment_files_load(path):
    assert load(Scenario, path).environment is not None


def test_waves_have_height_and_length():
    """Fundamental of the height over three periods: half the height from trough to crest, and nothing else."""
    terrain = terrain_of(waves={"height_m": 0.05, "length_m": 8.0})
    x = np.linspace(0.0, 24.0, 240, endpoint=False)
    spectrum = 2.0 * np.fft.rfft(terrain.heights_m(np.column_stack([x, np.full(240, 3.0)]))) / 240
    assert abs(spectrum[3]) == pytest.approx(0.025, abs=1e-6)
    assert np.abs(np.delete(spectrum, [0, 3])).max() < 1e-9
    other = terrain_of(seed=2, waves={"height_m": 0.05, "length_m": 8.0})
    assert other.height_m(1.0, 0.0) != terrain.height_m(1.0, 0.0)  # the phase is drawn


@pytest.mark.parametrize(("off_m", "expected_m"), [(0.0, 1.0), (5.0, 0.5), (-5.0, 0.5), (10.0, 0.0), (30.0, 0.0)])
def test_crest_section(off_m, expected_m):
    terrain = terrain_of(crest=CREST | {"heading_deg": 60.0})
    across = math.radians(150.0)
    xy = 40.0 + 3.0 + off_m * math.cos(across), 3.0 * math.tan(math.radians(60.0)) + off_m * math.sin(across)
    assert terrain.height_m(*xy) == pytest.approx(expected_m, abs=1e-9)


def test_ditch_ruts_furrows_side_slope():
    ditch = terrain_of(ditch={"depth_m": 0.6, "width_m": 1.5, "x_m": 40.0, "y_m": 0.0, "heading_deg": 90.0})
    assert [ditch.height_m(x, 9.0) for x in (40.0, 40.375, 40.75)] == pytest.approx([-0.6, -0.3, 0.0])
    ((kind, area),) = ditch.features.negative
    assert (kind, *area.bounds[::2]) == ("ditch", pytest.approx(39.45, abs=0.01), pytest.approx(40.55, abs=0.01))
    bank = terrain_of(bank={"height_m": 1.0, "width_m": 0.4, "x_m": 40.0, "y_m": 0.0, "heading_deg": 90.0})
    assert [bank.height_m(x, 9.0) for x in (39.9, 40.2, 40.4, 70.0)] == pytest.approx([0.0, -0.5, -1.0, -1.0])
    ((kind, area),) = bank.features.negative
    assert (kind, area.bounds[0]) == ("bank", pytest.approx(40.1, abs=0.05))
    ruts = terrain_of(ruts={"depth_m": 0.1, "width_m": 0.4})  # the middle of the field is at y = 0
    assert [ruts.height_m(40.0, y) for y in (0.95, -0.95, 1.05, 0.0, 12.95)] == pytest.approx(
        [-0.1, -0.1, -0.05, 0.0, -0.1]
    )
    assert ruts.height_m(-25.0, 0.95) == 0.0  # outside of the field
    rear_m = [ruts.pose_on_ground(40.0, y, 0.0, 2.55, 1.9)[2, 3] for y in (0.0, 1.9)]  # both wheels, one
    assert rear_m == pytest.approx([-0.05, -0.025], abs=1e-3)  # a tyre rests on the mean of its contact area
    slope = terrain_of(side_slope_deg=5.0)
    assert slope.height_m(10.0, 25.0) - slope.height_m(10.0, 15.0) == pytest.approx(10.0 * math.tan(math.radians(5.0)))
    furrows = terrain_of(furrows={"depth_m": 0.2, "spacing_m": 1.0})
    k = 2.0 * math.pi * 0.25
    tyre = 0.1 * 2.0 * j1(k) / k
    start = furrows.height_m(40.0, 0.0)
    assert furrows.height_m(40.0, 0.25) - start == pytest.approx(tyre)
    seen = furrows.height_m(40.0, 0.25) + furrows.furrows_m(np.array([[40.0, 0.25]]))[0] - start
    assert seen == pytest.approx(0.1)


def test_wheels_stand_on_the_waves():
    """Rear wheels and the middle of the front axle, while it drives over waves along its way."""
    farm = Farm(config=flat(), scenario=scenario_of(ground={"waves": {"height_m": 0.2, "length_m": 6.0}}))
    terrain, d = farm.world._terrain, farm.vehicle.drivetrain
    errors, heights = [], []

    def check(now):
        T = now.machine.T_map_base
        half = 0.5 * d.track_m
        wheels = [T @ np.array([0.0, s * half, 0.0, 1.0]) for s in (1.0, -1.0)] + [T @ [d.wheelbase_m, 0.0, 0.0, 1.0]]
        errors.extend(abs(w[2] - terrain.height_m(w[0], w[1])) for w in wheels)
        heights.append(T[2, 3])

    farm.is_drive_enabled, farm.speed_mps = True, 2.5
    farm.drive(12.0, check)
    farm.close()
    assert max(errors) < 0.003
    assert np.ptp(heights) == pytest.approx(0.2, abs=0.01)


def test_crest_hides_the_ground_behind_it():
    """A ray at the height of the lidar meets the crest where the formula says, and none sees the foot behind it."""
    crest = {"height_m": 3.0, "length_m": 20.0, "x_m": 40.0, "y_m": 0.0}
    config = flat(scenery={"crop_height_m": 0.0, "trees": 0})
    farm = Farm(vehicle=machine_file(sensors=("lidar",)), config=config, scenario=scenario_of(ground={"crest": crest}))
    scans = [m for topic, m in farm.drive(0.3) if topic == "lidar/front"]
    sensor = farm.machine.T_map_base @ farm.vehicle.sensors.lidar["front"].mount.T_base_sensor
    farm.close()
    p = scans[-1].points_m.astype(float) @ sensor[:3, :3].T + sensor[:3, 3]
    ahead = (np.abs(p[:, 1]) < 3.0) & (p[:, 0] > 5.0)
    meets = 40.0 - 10.0 + 20.0 / (2.0 * math.pi) * math.acos(1.0 - 2.0 * sensor[2, 3] / 3.0)
    level = ahead & (np.abs(p[:, 2] - sensor[2, 3]) < 0.05)
    assert np.median(p[level, 0]) == pytest.approx(meets, abs=0.15)
    assert not (ahead & (p[:, 0] > 42.0) & (p[:, 0] < 60.0)).any()


def test_gulls_circle_around_the_implement():
    birds = {"gulls": 6, "height_m": [1.0, 4.0], "radius_m": [3.0, 12.0], "speed_mps": 8.0}
    farm = Farm(scenario=scenario_of(birds=birds, neighbour={}))
    farm.drive(1.0)
    before = {a.role: a for a in farm.world._scene.actors}
    farm.drive(0.01)
    after = {a.role: a for a in farm.world._scene.actors}
    farm.close()
    assert sum(name.startswith("gull") for name in after) == 6
    for name in [n for n in after if n.startswith("gull")]:
        gull = after[name]
        moved = (np.array(gull.p_map_m) - before[name].p_map_m)[:2] / 0.01
        assert moved == pytest.approx(gull.velocity_mps, abs=0.2)
        assert np.hypot(*moved) == pytest.approx(8.0, rel=0.01)
        height = gull.vertices_map_m[:, 2].mean()
        assert 0.5 < height < 4.7
        assert not gull.solid.must_avoid
    assert abs(after["neighbour"].p_map_m[1]) > 30.0  # the field ends at 30 m
    assert np.hypot(*after["neighbour"].velocity_mps) >= 2.0


def test_gulls_pass_over_machine_and_implement():
    """Before, they flew through them, and came out of the self filter right beside the hood."""
    birds = {"gulls": 12, "height_m": 1.0, "radius_m": [1.0, 5.0], "speed_mps": 6.0}
    farm = Farm(scenario=scenario_of(birds=birds))
    over = 0
    for _ in range(30):
        farm.drive(0.05)
        machine = farm.world.machine
        c, s = np.cos(machine.yaw_rad), np.sin(machine.yaw_rad)
        shapes = zip(outlines(machine.vehicle.body, machine.attached.implement), (3.0, 1.0), strict=True)
        for outline, top_m in shapes:
            for gull in (a for a in farm.world._scene.actors if a.role.startswith("gull")):
                away = gull.vertices_map_m[:, :2] - (machine.x_m, machine.y_m)
                x, y = away @ (c, s), away @ (-s, c)
                inside = (x > outline.rear_m) & (x < outline.front_m) & (np.abs(y) < outline.half_width_m)
                over += np.count_nonzero(inside)
                assert (gull.vertices_map_m[inside, 2] > min(top_m, machine.vehicle.body.height_m)).all()
    farm.close()
    assert over > 100


def test_hedge_and_trees_are_solid_outside_of_the_field_alone():
    """True shapes of the site: a hedge along the boundary, and nothing on the field."""
    farm = Farm(config=flat(scenery={"trees": 0}), scenario=scenario_of(boundary={"hedge_height_m": 2.0, "trees": 9}))
    static = [p for p in json.loads(farm.world.shapes_text())["static"] if p["name"] == "trees"]
    farm.close()
    field = Polygon(SITE.boundary_m)
    hedge = [Polygon(p["outline_m"]) for p in static]
    crowns = [p for p in static if p["z_m"][1] > 4.0]
    assert (
        min(field.buffer(-0.1).distance(p) for p, one in zip(hedge, static, strict=True) if one["z_m"][1] < 2.1) > 0.5
    )
    assert shapely.union_all(hedge).buffer(0.5).length > 1.5 * field.length  # its outline, outside and inside
    assert crowns


def test_same_seed_same_scans():
    environment = {"vegetation": [{"kind": "grass", "height_m": 0.4}], "fog": {"visibility_m": [50.0, 100.0]},
                   "dust": {"visibility_m": 5.0}, "birds": {"gulls": 2}}  # fmt: skip

    def ranges(seed):
        farm = Farm(vehicle=machine_file(sensors=("lidar",)), scenario=scenario_of(**environment), seed=seed)
        farm.is_drive_enabled, farm.speed_mps = True, 2.0
        out = [m.ranges_mm for topic, m in farm.drive(1.0) if topic == "lidar/front"]
        farm.close()
        return np.stack(out)

    first, again, other = ranges(1), ranges(1), ranges(2)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_no_environment_no_media():
    """Without the key nothing of the environment is built; with it the other sensors draw the same noise."""
    plain, empty = Farm(), Farm(scenario=scenario_of())
    assert plain.world._scene.media is None
    assert empty.world._scene.media is not None
    imu = [[m.acceleration_mps2 for topic, m in farm.drive(0.5) if topic == "imu"] for farm in (plain, empty)]
    plain.close()
    empty.close()
    assert np.array_equal(*imu)


def test_fog_leaves_five_percent_of_contrast_at_the_visibility():
    light = in_fog(draw_light(CONFIG.camera.sky, np.random.default_rng(1)), 80.0)
    x = 80.0 / light.haze_length_m
    assert 1.0 / (1.0 + x + 0.5 * x * x) == pytest.approx(0.05)
    assert not light.sun.any()
    panorama = render_panorama(light.packed(), light.skyline, textures().values)
    assert np.abs(panorama[BELOW:] - 0.8 * light.horizon).max() < 1e-3  # the veil of the shading kernel


def test_defaults_are_an_environment():
    assert parse(Environment, {}, "test").ground == Ground()
