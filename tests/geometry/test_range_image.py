"""Range images: dust is isolated and bodies are not; birds float, and bodies on the ground do not."""

import math

import numpy as np
import pytest

from configs.vehicle import Lidar
from geometry.range_image import (
    ScatterMemory,
    chance_neighbours,
    clear_beneath,
    floating,
    isolated,
    range_image,
    scattered,
)
from geometry.range_image import points_of as returns_of
from tests.perception.lidar_scenes import FRONT, VEHICLE, box, cast

SIDE = VEHICLE.sensors.lidar["front_left"]
GROUND_M, GROUND_SLOPE, CLEAR_M = 0.25, 0.02, 0.25


def image_of(scan):
    return range_image(scan.ranges_mm, scan.elevation_rad, scan.azimuth_rad)


def points_of(scan, lidar: Lidar):
    """Returns (N, 3) in base."""
    T = lidar.mount.T_base_sensor
    return scan.points_m @ T[:3, :3].T + T[:3, 3]


def within(scan, lidar: Lidar, corners):
    """Places in the image of the returns in a box (2, 3)."""
    p = points_of(scan, lidar)
    return scan.pixels[((p > corners[0] - 0.1) & (p < corners[1] + 0.1)).all(axis=1) & (p[:, 2] > 0.1)]


def floating_share(scan, lidar: Lidar, corners):
    """Share of the returns in a box that float, and their number."""
    pixels = within(scan, lidar, corners)
    found, _ = floating(image_of(scan), pixels, lidar.mount.T_base_sensor, GROUND_M, GROUND_SLOPE, CLEAR_M)
    return float(found.mean()) if len(found) else 0.0, len(found)


def test_points_of_an_image() -> None:
    mm = np.array([[0, 2000], [5000, 1000]], np.uint16)
    elevation, azimuth = np.radians([-30.0, 0.0]), np.radians([90.0, 0.0])
    found = returns_of(mm, elevation, azimuth)
    expected = [(2.0 * math.cos(math.radians(30.0)), 0.0, -1.0), (0.0, 5.0, 0.0), (1.0, 0.0, 0.0)]
    assert found == pytest.approx(np.array(expected), abs=1e-6)
    with pytest.raises(ValueError, match="2 elevations and 3 azimuths"):
        returns_of(mm, elevation, np.zeros(3))


def dust(share: float):
    """Isolated returns 0.8 to 8 m off on a share of the beams."""

    def add(mm, rng):
        is_dust = rng.random(mm.shape) < share
        found_mm = rng.uniform(800.0, 8000.0, mm.shape).astype(np.uint16)
        return np.where(is_dust & ((mm == 0) | (found_mm < mm)), found_mm, mm)

    return add


@pytest.mark.parametrize("lidar", [FRONT, SIDE], ids=["front", "side"])
@pytest.mark.parametrize(("share", "left"), [(0.001, 0.05), (0.01, 0.02), (0.02, 0.03)])
def test_dust_is_isolated(lidar: Lidar, share: float, left: float) -> None:
    """Most of what is not lies within a hand of the ground."""
    clean = cast(lidar=lidar, noise_m=0.0)
    dusty = cast(lidar=lidar, noise_m=0.0, extra=dust(share))
    is_dust = np.flatnonzero(dusty.ranges_mm.ravel() != clean.ranges_mm.ravel())
    above = is_dust[np.isin(is_dust, dusty.pixels[points_of(dusty, lidar)[:, 2] > 0.3])]
    assert len(above) > 3
    assert isolated(image_of(dusty), above).mean() >= 1.0 - left


def fog(share: float):
    """Returns of fog on a share of the beams; their ranges as those of a receiver that is focused 10 m off."""
    r = np.linspace(1.0, 20.0, 2000)
    share_below = np.cumsum(np.minimum((r - 1.0) / 9.0, 1.0) / r**2 * np.exp(-0.1 * r))

    def add(mm, rng):
        found_mm = (1000.0 * np.interp(rng.random(mm.shape), share_below / share_below[-1], r)).astype(np.uint16)
        return np.where((rng.random(mm.shape) < share) & ((mm == 0) | (found_mm < mm)), found_mm, mm)

    return add


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_fog_is_scattered_and_bodies_are_not(share: float) -> None:
    corners = box(4.0, 1.0, 0.5, 0.4, 1.2)
    clean, foggy = cast([corners], noise_m=0.0), cast([corners], noise_m=0.0, extra=fog(share))
    pixels, found = foggy.pixels, scattered(image_of(foggy), foggy.pixels)
    is_fog = foggy.ranges_mm.ravel()[pixels] != clean.ranges_mm.ravel()[pixels]
    is_above = points_of(foggy, FRONT)[:, 2] > 0.3
    assert found[is_fog & is_above].mean() > 0.96
    assert found[~is_fog & np.isin(pixels, within(clean, FRONT, corners))].mean() < 0.1
    assert not scattered(image_of(clean), clean.pixels).any()


def test_a_body_beside_a_fence_in_fog_is_not_scattered() -> None:
    """Gaps between the slats give many returns with one neighbour in the same band of ranges."""
    slats = [box(8.0, y, 0.05, 0.05, 2.0) for y in np.arange(-4.0, 4.0, 0.12)]
    corners = box(7.2, 1.0, 0.5, 0.5, 1.7)
    clean, foggy = cast([corners, *slats], noise_m=0.0), cast([corners, *slats], noise_m=0.0, extra=fog(0.1))
    found = scattered(image_of(foggy), foggy.pixels)
    is_same = foggy.ranges_mm.ravel()[foggy.pixels] == clean.ranges_mm.ravel()[foggy.pixels]
    own = is_same & np.isin(foggy.pixels, within(clean, FRONT, corners))
    assert own.sum() > 50
    assert found[own].mean() < 0.2


def test_the_ground_of_rings_that_are_far_apart_is_not_scattered() -> None:
    """Each of its returns has others in its ring alone, four at most: as many as fog gives by chance."""
    rear = VEHICLE.sensors.lidar["rear"]
    for seed in range(5):
        clean, foggy = (cast(lidar=rear, noise_m=0.0, extra=extra, seed=seed) for extra in (None, fog(0.25)))
        found = scattered(image_of(foggy), foggy.pixels)
        is_same = foggy.ranges_mm.ravel()[foggy.pixels] == clean.ranges_mm.ravel()[foggy.pixels]
        range_m = 1e-3 * foggy.ranges_mm.ravel()[foggy.pixels]
        assert found[~is_same & (range_m < 7.0)].mean() > 0.85
        for low_m, high_m in ((3.0, 5.0), (5.0, 7.0), (7.0, 10.0), (10.0, 14.0)):
            own = is_same & (range_m > low_m) & (range_m < high_m)
            assert own.sum() == 0 or found[own].mean() < 0.2, (low_m, found[own].mean())


def test_thin_fog_shows_to_a_small_lidar_in_some_scans() -> None:
    """Of one scan it has too few returns; a body of the same few returns in each scan is none."""
    corners = box(2.5, 3.0, 0.4, 0.4, 1.7)
    memory, alone, found = ScatterMemory(), [], []
    clean = cast([corners], lidar=SIDE, noise_m=0.0)
    for seed in range(30):
        foggy = cast([corners], lidar=SIDE, noise_m=0.005, extra=fog(0.012), seed=seed)
        pixels, image = foggy.pixels, image_of(foggy)
        is_fog = np.abs(foggy.ranges_mm.ravel()[pixels] - clean.ranges_mm.ravel()[pixels].astype(int)) > 200
        is_fog &= (points_of(foggy, SIDE)[:, 2] > 0.3) & (1e-3 * foggy.ranges_mm.ravel()[pixels] < 5.0)
        marked, own = scattered(image, pixels, memory), np.isin(pixels, within(clean, SIDE, corners)) & ~is_fog
        if seed >= 15:
            alone.append(scattered(image, pixels)[is_fog].mean())
            found.append(marked[is_fog].mean())
            assert marked[own].mean() < 0.1
    assert np.median(alone) < 0.5
    assert np.median(found) > 0.9


def test_single_returns_that_stay_are_no_fog() -> None:
    """Twigs and posts give isolated returns at the same places in each scan of a machine that stands."""
    rng = np.random.default_rng(6)
    twigs = rng.random((len(SIDE.elevation_deg), SIDE.columns)) < 0.003
    far_mm = rng.uniform(1500.0, 2900.0, twigs.shape)
    memory = ScatterMemory()
    for seed in range(30):

        def stay(mm, noise):
            found_mm = (far_mm + noise.normal(0.0, 10.0, mm.shape)).astype(np.uint16)
            return np.where(twigs & ((mm == 0) | (found_mm < mm)), found_mm, mm)

        scan = cast(lidar=SIDE, noise_m=0.01, extra=stay, seed=seed)
        marked = scattered(image_of(scan), scan.pixels, memory)
    assert 10 < twigs.sum() < 32  # of more one scan would be taken for fog
    assert not marked[points_of(scan, SIDE)[:, 2] > 0.5].any()


def test_returns_of_plants_are_not_scattered() -> None:
    """Leaves and stems next to each other return from like ranges, with gaps between them."""
    rng = np.random.default_rng(4)
    scan = cast(noise_m=0.0, extra=lambda mm, _: np.where(rng.random(mm.shape) < 0.5, 0, mm))
    assert not scattered(image_of(scan), scan.pixels).any()


@pytest.mark.parametrize(("mean", "none", "most"), [(0.0, 10_000, 1), (0.45, 400, 4), (0.83, 860, 5), (0.1, 100, 2)])
def test_neighbours_by_chance(mean: float, none: int, most: int) -> None:
    """Of random returns fewer than one has more neighbours than by chance."""
    found = chance_neighbours(none, mean)
    assert found == most
    drawn = np.random.default_rng(1).poisson(mean, round(1000 * none * math.exp(mean)))
    assert np.count_nonzero(drawn > found) / 1000.0 < 0.6
    assert found == 1 or np.count_nonzero(drawn > found - 1) / 1000.0 > 0.4


@pytest.mark.parametrize(
    ("name", "corners"),
    [
        ("lying adult", box(8.0, 1.0, 0.45, 1.7, 0.25)), ("lying adult end-on", box(8.0, 0.0, 1.7, 0.45, 0.25)),
        ("lying child end-on", box(7.0, 0.5, 1.0, 0.3, 0.2)), ("fawn", box(6.0, -0.5, 0.4, 0.3, 0.3)),
        ("child", box(9.0, -1.0, 0.25, 0.3, 1.05)), ("post", box(8.0, 1.0, 0.06, 0.06, 1.2)),
    ],
)  # fmt: skip
def test_bodies_in_dust_are_not_isolated(name: str, corners: np.ndarray) -> None:
    scan = cast([corners], extra=dust(0.01))
    own = within(scan, FRONT, corners)
    assert len(own) >= 3
    assert isolated(image_of(scan), own).mean() <= 0.34, name


def test_three_returns_next_to_each_other_are_no_dust() -> None:
    mm = np.zeros((4, 8), np.uint16)
    chain = [(1, 3), (1, 4), (2, 5)]
    for k, (row, column) in enumerate(chain):
        mm[row, column] = 3000 + 20 * k
    image = range_image(mm, np.radians([-3.0, -2.0, -1.0, 0.0]), np.radians(np.linspace(-4, 4, 8)))
    places = np.array([row * 8 + column for row, column in chain])
    assert not isolated(image, places).any()
    mm[2, 5] = 0
    assert isolated(image, places[:2]).all()  # two are isolated
    mm[2, 5] = 4500
    assert isolated(image, places).all()  # the third is at another distance


def test_first_and_last_column_of_a_full_turn_are_neighbours() -> None:
    for field_of_view_deg, expected in ((360.0, False), (180.0, True)):
        columns = 90
        azimuth = np.radians(field_of_view_deg) * ((np.arange(columns) + 0.5) / columns - 0.5)
        mm = np.zeros((3, columns), np.uint16)
        mm[1, [0, 1, columns - 1]] = 2000
        image = range_image(mm, np.radians([-1.0, 0.0, 1.0]), azimuth)
        assert isolated(image, np.array([2 * columns - 1]))[0] == expected


BIRD = (0.4, 1.2, 0.15)  # length, width and height of body and wings


@pytest.mark.parametrize("lidar", [FRONT, SIDE], ids=["front", "side"])
@pytest.mark.parametrize(("x", "low_m"), [(5.5, 1.1), (6.0, 0.9), (7.0, 1.0), (8.0, 1.4)])
def test_birds_float(lidar: Lidar, x: float, low_m: float) -> None:
    corners = box(x, 0.5, *BIRD, low=low_m)
    share, count = floating_share(cast([corners], lidar=lidar), lidar, corners)
    assert count > 2
    assert share > 0.9


@pytest.mark.parametrize("lidar", [FRONT, SIDE], ids=["front", "side"])
@pytest.mark.parametrize("x", [5.0, 6.0, 7.0])
def test_who_stands_on_the_ground_does_not_float(lidar: Lidar, x: float) -> None:
    legs = [box(x, 0.5 + side, 0.15, 0.15, 0.85) for side in (-0.15, 0.15)]
    person = [*legs, box(x, 0.5, 0.3, 0.5, 0.7, low=0.85)]
    arms = box(x, 0.5, 0.15, 1.6, 0.12, low=1.35)
    child, hood = box(x, 0.5, 0.25, 0.3, 1.05), box(x - 1.5, 0.5, 0.5, 1.5, 0.9)
    dog = [box(x + dx, 0.5 + dy, 0.06, 0.06, 0.4) for dx in (-0.3, 0.3) for dy in (-0.1, 0.1)]
    whole = box(x, 0.5, 0.4, 0.6, 1.6)
    for bodies, limit in (((person), 0.35), ([*person, arms], 0.5), ([child], 0.05), ([hood, *person], 0.35),
                          ([*dog, box(x, 0.5, 0.8, 0.25, 0.3, low=0.4)], 0.75)):  # fmt: skip
        share, count = floating_share(cast(bodies, lidar=lidar), lidar, whole)
        assert count > 2
        assert share <= limit, (bodies, share)


@pytest.mark.parametrize("x", [6.0, 8.0, 11.0])
def test_who_is_seen_down_to_the_ground_stands(x: float) -> None:
    person, bird = box(x, 0.5, 0.3, 0.5, 1.75), box(x, 0.5, *BIRD, low=1.2)
    behind = [person, box(x - 1.5, 0.5, 0.4, 1.2, 1.4)]
    for bodies, corners, most in (([person], person, True), ([bird], bird, False), (behind, person, False)):
        scan = cast(bodies)
        found = floating(image_of(scan), within(scan, FRONT, corners), FRONT.mount.T_base_sensor, 0.25, 0.02, CLEAR_M)
        assert (found[1].mean() > 0.9) == most
        assert found[1].any() == most
        assert not (found[0] & found[1]).any()


def test_what_is_seen_steeply_from_above_shows_nothing() -> None:
    """The beam beneath a bird close to the lidar meets the ground beneath it, as it does beside a head."""
    x_m, y_m = SIDE.mount.T_base_sensor[:2, 3]
    for low_m, height_m in ((0.9, 0.15), (0.0, 0.3)):
        body = box(float(x_m) + 0.4, float(y_m), 0.4, 0.6, height_m, low=low_m)
        scan = cast([body], lidar=SIDE)
        found = floating(image_of(scan), within(scan, SIDE, body), SIDE.mount.T_base_sensor, 0.25, 0.02, CLEAR_M)
        assert len(found[1]) > 20
        assert found[1].any() == (low_m == 0.0)


def test_what_hides_or_swallows_the_beams_below_proves_nothing() -> None:
    corners = box(8.0, 0.5, *BIRD, low=1.2)
    hidden = cast([corners, box(6.0, 0.5, 0.2, 3.0, 1.6)])
    assert floating_share(hidden, FRONT, corners)[0] < 0.2

    def swallow(mm, rng):
        """Black clothes: no return from below the body, and within 0.6 m of it."""
        T = FRONT.mount.T_base_sensor
        el = np.radians(np.array(FRONT.elevation_deg))[:, None]
        half = math.pi
        az = np.linspace(half, -half, FRONT.columns, endpoint=False)[None, :]
        at = 8.0 - T[0, 3]
        is_dark = (np.abs(at * np.tan(az) - 0.5) < 0.8) & (np.abs(az) < 0.5 * half) & (T[2, 3] + at * np.tan(el) < 1.15)
        return np.where(is_dark, 0, mm).astype(np.uint16)

    assert floating_share(cast([corners], extra=swallow), FRONT, corners)[0] == 0.0


def test_another_lidar_shows_clear_space_beneath() -> None:
    """Before the bumper the front lidar sees no ground; the one beside it does."""
    x, y = 4.3, 0.3
    bird, person = box(x, y, *BIRD, low=1.2), box(x, y, 0.3, 0.5, 1.35)
    place = np.array([[x, y, 1.25]])
    own = cast([box(4.2, 0.2, 0.3, 0.3, 0.15, low=1.2)])
    assert floating_share(own, FRONT, box(4.2, 0.2, 0.3, 0.3, 0.15, low=1.2))[0] < 0.75
    for bodies, expected in (([bird], True), ([person], False), ([], True), ([box(x, y, 0.2, 0.2, 0.6)], False)):
        scan = cast(bodies, lidar=SIDE)
        found = clear_beneath(image_of(scan), place, SIDE.mount.T_base_sensor, GROUND_M, GROUND_SLOPE)
        assert found.tolist() == [expected], bodies
    aside = [box(x, y + 0.28, 0.1, 0.1, 1.0)]  # a leg within reach of it
    assert not clear_beneath(image_of(cast(aside, lidar=SIDE)), place, SIDE.mount.T_base_sensor, 0.25, 0.02)[0]
    behind = np.array([[-6.0, -6.0, 1.25]])  # outside of its field of view
    assert not clear_beneath(image_of(cast(lidar=SIDE)), behind, SIDE.mount.T_base_sensor, 0.25, 0.02)[0]
    hidden = cast([box(3.6, 0.7, 0.2, 1.2, 1.4)], lidar=SIDE)
    assert not clear_beneath(image_of(hidden), place, SIDE.mount.T_base_sensor, 0.25, 0.02)[0]
