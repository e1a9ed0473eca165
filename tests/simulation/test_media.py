"""Plants, fog, rain, dust and beams of finite width against closed forms."""

import math

import numpy as np
import pytest

from configs.strict import parse
from geometry.transforms import apply
from simulation.environment.air import FOG_BACKSCATTER, PULSE_M, draw_air, fog_ranges_m
from simulation.environment.canopy import Canopy
from simulation.environment.dust import IMPLEMENT_SIGMA_M, SPACING_M, DustClouds
from simulation.environment.media import Media
from simulation.environment.terrain import Terrain
from simulation.scenario import Scenario
from simulation.scenario_environment import Environment, Vegetation
from simulation.sensors.beams import DRAWS, PARTS, parts_of, strongest_returns
from tests.simulation.simulated_farm import SITE, Farm, flat, machine_file

TERRAIN = Terrain(SITE, flat().terrain, 1)
N = 40_000
NO_FOG, NO_PUFFS = np.zeros(0, np.float32), np.zeros((0, 5))


def rays_at(elevation_deg, origin=(0.0, 0.0, 2.0), n=N):
    el = math.radians(elevation_deg)
    ray = [*origin, math.cos(el), 0.0, math.sin(el)]
    return np.tile(np.array(ray, np.float32), (n, 1))


def canopy_of(**stand):
    return Canopy(SITE, TERRAIN, (parse(Vegetation, stand, "test"),), 1)


def media_of(**environment):
    return Media(parse(Environment, environment, "test"), SITE, machine_file(), TERRAIN, 1)


def share_bound(share, n=N):
    return 4.0 * math.sqrt(max(share * (1.0 - share), 1e-4) / n)


@pytest.mark.parametrize("elevation_deg", [-30.0, -10.0, -4.0])
@pytest.mark.parametrize(
    ("kind", "height_m", "density"), [("crop", 0.35, 4.0), ("grass", 0.1, 2.0), ("stubble", 0.2, 1.5)]
)
def test_transmission_of_plants(elevation_deg, kind, height_m, density):
    """exp(-k s): k = 0.5 density for leaves, density times the horizontal part for stems; s the path below the tops."""
    canopy = canopy_of(kind=kind, height_m=height_m, density_m2pm3=density)
    el = math.radians(-elevation_deg)
    k = density * (math.cos(el) if kind == "stubble" else 0.5)
    expected = math.exp(-k * height_m / math.sin(el))
    rays, ground_m = rays_at(elevation_deg), 2.0 / math.sin(el)
    until = np.full((N, 1), ground_m, np.float32)
    depths = np.random.default_rng(1).standard_exponential((N, 1), np.float32)
    found, stand = canopy.hits(rays, until, depths, 3e-3)
    assert (stand == 0).mean() == pytest.approx(expected, abs=share_bound(expected) + 0.01)
    below = 2.0 - found[stand[:, 0] == 1, 0] * math.sin(el)
    assert below.max() <= height_m + 1e-3
    assert below.min() >= -1e-3
    assert canopy.optical_depth(rays[:1], until[:1, 0])[0] == pytest.approx(-math.log(expected), rel=0.05, abs=0.02)


def test_plants_on_the_field_alone_and_below_the_sensor():
    canopy = canopy_of(kind="crop", height_m=0.3)
    random = np.random.default_rng(1)
    outside = rays_at(-30.0, (-40.0, 0.0, 2.0), 100)
    _, is_plant = canopy.first(outside, np.full(100, 4.0, np.float32), random)
    assert not is_plant.any()
    _, is_plant = canopy.first(rays_at(0.5, n=100), np.full(100, np.inf, np.float32), random)
    assert not is_plant.any()
    inside, is_plant = canopy.first(rays_at(0.0, (0.0, 0.0, 0.2), 4000), np.full(4000, np.inf, np.float32), random)
    assert is_plant.all()
    assert inside.mean() == pytest.approx(1.0 / (0.5 * 4.0), rel=0.05)  # mean free path


def test_parts_smaller_than_a_leaf_share_its_hit():
    canopy = canopy_of(kind="crop", height_m=0.5)
    rays = rays_at(-45.0, (0.0, 0.0, 1.0), 2000)
    depths = np.random.default_rng(1).standard_exponential((2000, PARTS), np.float32)
    until = np.full((2000, PARTS), math.sqrt(2.0), np.float32)
    together, _ = canopy.hits(rays, until, depths, 3e-3)
    apart, _ = canopy.hits(rays, until, depths, 0.1)
    assert np.array_equal(together, np.repeat(together[:, :1], PARTS, axis=1))
    assert not np.array_equal(apart, np.repeat(apart[:, :1], PARTS, axis=1))


def test_a_lying_person_is_hidden_by_the_crop():
    """Returns on a lying adult 8 m ahead: as many as the crop lets through, the mean over its surface."""
    adult = {"name": "adult", "object": "adult", "posture": "lying_across", "height_m": 1.75,
             "place": {"frame": "map", "x_m": 12.0, "y_m": 0.0}}  # fmt: skip

    def returns(environment):
        values = {"name": "t", "operator_commands": [], "objects": [adult], "environment": environment}
        farm = Farm(vehicle=machine_file(sensors=("lidar",)), scenario=parse(Scenario, values, "t"),
                    config=flat(scenery={"crop_height_m": 0.0}))  # fmt: skip
        scans = [m for topic, m in farm.drive(1.0) if topic == "lidar/front"]
        T = farm.machine.T_map_base @ farm.vehicle.sensors.lidar["front"].mount.T_base_sensor
        (actor,) = farm.world._scene.actors
        low, high = actor.vertices_map_m.min(axis=0), actor.vertices_map_m.max(axis=0)
        farm.close()
        p = np.concatenate([apply(T, s.points_m.astype(float)) for s in scans])
        return ((p > low - 0.02) & (p < high + 0.02) & (p[:, 2:] > 0.06)).all(axis=1).sum()

    bare, dense = returns({}), returns({"vegetation": [{"kind": "crop", "height_m": 0.5, "density_m2pm3": 12.0}]})
    assert bare > 80
    assert dense < 0.5 * bare


def packed(media):
    return media.packed_air(), media.air.fog_ranges_m


def returns_of(media, range_m, signal, n=N, puffs=NO_PUFFS, origin=(0.0, 0.0, 2.0)):
    random = np.random.default_rng(3)
    draws = np.empty((n, DRAWS), np.float32)
    draws[:, [0, 4]] = random.random((n, 2))
    draws[:, [1, 2, 3, 5]] = random.standard_exponential((n, 4))
    draws[:, 6] = random.standard_normal(n)
    distance, strength = np.full((n, 1), range_m, np.float32), np.full((n, 1), signal, np.float32)
    return strongest_returns(rays_at(0.0, origin, n), distance, strength, draws, *packed(media), puffs)


@pytest.mark.parametrize("visibility_m", [50.0, 200.0])
def test_extinction_by_visibility(visibility_m):
    """Two ways through the visibility: 5 % squared; a bright target outshines the fog."""
    range_m, signal = returns_of(media_of(fog={"visibility_m": visibility_m}), 0.5 * visibility_m, 1e4, 10)
    assert range_m == pytest.approx(0.5 * visibility_m)
    assert signal / 1e4 == pytest.approx(0.05, rel=1e-4)


@pytest.mark.parametrize(
    ("visibility_m", "target_m", "reflectivity"), [(50.0, 10.0, 0.02), (50.0, 25.0, 0.3), (100.0, 20.0, 0.1)]
)
def test_share_of_fog_returns(visibility_m, target_m, reflectivity):
    """The mean over ranges (their density ~ mean power) of exp(-target / fog), its strength being exponential."""
    media = media_of(fog={"visibility_m": visibility_m})
    alpha, beta = math.log(20.0) / visibility_m, FOG_BACKSCATTER / visibility_m
    r = np.linspace(1.0, 60.0, 200_001)
    power = np.clip((r - 1.0) / 9.0, 0.0, 1.0) * np.exp(-2.0 * alpha * r) / r**2
    target = reflectivity / math.pi * math.exp(-2.0 * alpha * target_m) / target_m**2
    with np.errstate(divide="ignore"):
        chance = np.exp(-target / (beta * PULSE_M * power))
    apart = np.abs(r - target_m) > PULSE_M
    expected = (power * chance * apart).sum() / power.sum()
    range_m, _ = returns_of(media, target_m, reflectivity)
    assert 0.01 < expected < 0.99
    assert (np.abs(range_m - target_m) > PULSE_M).mean() == pytest.approx(expected, abs=share_bound(expected) + 0.01)


def test_ranges_of_fog_returns():
    ranges = fog_ranges_m(0.06)
    assert ranges[0] >= 1.0
    assert 3.0 < np.median(ranges) < 8.0
    assert (np.diff(ranges) >= 0.0).all()


def test_drops_in_the_beam():
    """The first drop is within r with 1 - exp(-drops per m³ × volume of the beam), where it alone can return."""
    environment = parse(Environment, {"rain": {"visibility_m": 100.0}, "beam_divergence_mrad": 3.0}, "test")
    air = draw_air(environment, 1)
    assert air.rain_mmph == pytest.approx((math.log(20.0) / 100.0 / 0.01) ** (1.0 / 0.6))
    diameters = np.linspace(0.5, 10.0, 100_001)  # mm, Marshall and Palmer
    count = 8000.0 * np.exp(-4.1 * air.rain_mmph**-0.21 * diameters).sum() * (diameters[1] - diameters[0])
    assert air.drops_per_m3 == pytest.approx(count, rel=1e-3)
    media = media_of(rain={"visibility_m": 100.0})
    found, signal = returns_of(media, math.inf, 0.0)
    for r in (2.0, 5.0, 10.0):
        wide = 0.012 + 3e-3 * r
        volume = math.pi / 12.0 * (wide**3 - 0.012**3) / 3e-3
        near = 1.0 - math.exp(-count * math.pi / 12.0 * ((0.012 + 3e-3) ** 3 - 0.012**3) / 3e-3)  # before the overlap
        expected = 1.0 - math.exp(-count * volume) - near
        assert ((found > 1.0) & (found < r) & (signal > 0.0)).mean() == pytest.approx(
            expected, abs=share_bound(expected) + 0.01
        )


@pytest.mark.parametrize("thickness_share", [0.05, 0.2, 0.6])
def test_share_of_the_beam_on_a_wire(thickness_share):
    """A wire through the middle of a round beam covers 2/pi (asin a + a sqrt(1 - a²)), a = thickness / diameter."""
    a, divergence, range_m = thickness_share, 3e-3, 20.0
    turns = np.random.default_rng(1).random((N, 2), np.float32)
    parts = parts_of(rays_at(0.0), turns, divergence).reshape(N, PARTS, 6)
    off = np.abs(parts[..., 5]) * range_m
    expected = 2.0 / math.pi * (math.asin(a) + a * math.sqrt(1.0 - a * a))
    assert (off < 0.5 * a * divergence * range_m).mean() == pytest.approx(expected, abs=0.005)
    assert np.hypot(parts[..., 4], parts[..., 5]).max() <= 0.5 * divergence * (1.0 + 1e-4)


def mixed(near_m, far_m, near_parts, near_signal=0.3, far_signal=0.3):
    distance = np.full((1, PARTS), far_m, np.float32)
    signal = np.full((1, PARTS), far_signal, np.float32)
    distance[0, :near_parts], signal[0, :near_parts] = near_m, near_signal
    range_m, strength = strongest_returns(
        rays_at(0.0, n=1), distance, signal, np.zeros((1, DRAWS), np.float32), *packed(media_of()), NO_PUFFS
    )
    return float(range_m[0]), float(strength[0])


def test_mixed_returns():
    """Within a pulse the mean by power; farther apart the stronger; against the sky the share of the signal."""
    weights = np.array([4 / 10.0**2, 4 / 10.4**2])
    assert mixed(10.0, 10.4, 4)[0] == pytest.approx(np.average([10.0, 10.4], weights=weights), abs=1e-4)
    assert mixed(10.0, 20.0, 1) == pytest.approx((20.0, 0.3 * 7 / 8))  # 7 / 20² > 1 / 10²
    assert mixed(10.0, 20.0, 2) == pytest.approx((10.0, 0.3 * 2 / 8))
    assert mixed(10.0, math.inf, 1) == pytest.approx((10.0, 0.3 / 8))


def test_dust_dims_what_is_behind_it():
    """Optical depth of the line through the middle of a puff, and half of it up to the middle."""
    puff, media = np.array([[20.0, 0.0, 2.0, 1.0, 3.0]]), media_of()
    depth = 3.0 / (2.0 * math.pi)
    for range_m, share in ((40.0, 1.0), (20.0, 0.5), (10.0, 0.0)):
        _, signal = returns_of(media, range_m, 1e6, 1, puff)
        assert signal[0] / 1e6 == pytest.approx(math.exp(-2.0 * share * depth), rel=1e-3)


def test_dust_returns_come_from_the_cloud():
    found, signal = returns_of(media_of(), math.inf, 0.0, puffs=np.array([[20.0, 0.0, 2.0, 1.0, 3.0]]))
    assert np.mean(found) == pytest.approx(20.0, abs=0.05)
    assert np.std(found) == pytest.approx(1.0, abs=0.05)
    assert (signal > 0.0).all()


class Working:
    """A machine that works along x at 10 km/h."""

    def __init__(self, farm):
        self.attached, self.yaw_rad, self.speed_mps = farm.machine.attached, 0.0, 10.0 / 3.6
        self.attached.hitch = 0.0
        self.T_map_base = np.eye(4)


def test_fresh_cloud_has_its_visibility_and_drifts():
    farm = Farm()
    clouds, machine = DustClouds(10.0, np.array([0.0, 2.0, 0.0]), 1.9), Working(farm)
    for k in range(1000):
        machine.T_map_base = np.eye(4)
        machine.T_map_base[0, 3] = 0.01 * k * machine.speed_mps
        clouds.update(0.01 * k, machine)
    farm.close()
    puffs = clouds.puffs(10.0)
    line = puffs[-1, 4] / (2.0 * math.pi * IMPLEMENT_SIGMA_M**2 * SPACING_M)  # extinction of a line of such puffs
    assert line == pytest.approx(math.log(20.0) / 10.0, rel=0.1)
    oldest = puffs[np.argmax(puffs[:, 3])]
    age = (oldest[3] ** 2 - IMPLEMENT_SIGMA_M**2) / (2.0 * 0.15)
    middle = puffs[np.abs(puffs[:, 3] - oldest[3]) < 1e-9][:, 1].mean()
    assert middle == pytest.approx(2.0 * age, abs=0.1)


def test_radar_loss_in_plants():
    media = media_of(vegetation=[{"kind": "crop", "height_m": 1.0}])
    loss = media.radar_loss_db(rays_at(0.0, (0.0, 0.0, 0.5), 1), np.array([3.0]))
    assert loss[0] == pytest.approx(10.0 * math.log10(math.exp(2.0 * 0.5 * 4.0 * 3.0)), rel=1e-3)
    assert media_of().radar_loss_db(rays_at(0.0, n=1), np.array([3.0]))[0] == 0.0


def test_ultrasonic_echo_of_plants():
    """Plants 0.35 m high reach into the cone of a sensor at 0.6 m; the crop rows of the configuration stay silent."""

    def share_of_echoes(environment):
        values = {"name": "t", "operator_commands": [], "environment": environment}
        farm = Farm(vehicle=machine_file(sensors=("ultrasonic",)), scenario=parse(Scenario, values, "t"))
        found = [m.range_m for topic, m in farm.drive(2.0) if topic == "ultrasonic/front_middle"]
        farm.close()
        return np.isfinite(found).mean()

    assert share_of_echoes({}) < 0.2
    assert share_of_echoes({"vegetation": [{"kind": "crop", "height_m": 0.1}]}) < 0.2
    assert share_of_echoes({"vegetation": [{"kind": "crop", "height_m": 0.35}]}) > 0.8
