"""Plants that cover the ground, and who stands in them."""

import numpy as np
import pytest

from perception.lidar.grid import build_grid
from perception.lidar.ground import find_ground
from tests.perception.lidar_scenes import LIDAR_CONFIG

CONFIG = LIDAR_CONFIG.ground
GRID = build_grid(CONFIG.sector_deg, CONFIG.first_bin_m, CONFIG.bin_growth, CONFIG.max_range_m)


def crop(height_m: float, seed: int, left_only: bool = False) -> np.ndarray:
    """Returns (N, 3): ground within 30 m, and plants of which half of the returns are."""
    rng = np.random.default_rng(seed)
    range_m, azimuth = 2.0 + 28.0 * rng.random(60_000) ** 2, rng.uniform(-np.pi, np.pi, 60_000)
    xyz = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), rng.normal(0.0, 0.01, 60_000)], axis=1)
    is_plant = (rng.random(60_000) < 0.5) & ((xyz[:, 1] > 0.0) | (not left_only))
    xyz[is_plant, 2] = rng.uniform(0.3, 1.0, is_plant.sum()) * height_m
    return xyz.astype(np.float32)


def plants_of(xyz: np.ndarray) -> np.ndarray:
    return find_ground(xyz, np.ones(len(xyz), np.uint8), np.zeros(2), GRID, CONFIG).is_plant


@pytest.mark.parametrize("left_only", [False, True])
def test_plants_are_found_and_who_stands_in_them_stands_out(left_only: bool) -> None:
    for seed in range(3):
        xyz = crop(0.35, seed, left_only)
        near = np.hypot(*xyz[:, :2].T) < 14.0
        is_person = np.abs(xyz[:, :2] - [6.0, 3.0]).max(axis=1) < 0.2
        xyz[is_person, 2] = np.linspace(0.1, 1.7, is_person.sum())
        found = plants_of(xyz)
        assert found[near & ~is_person & (xyz[:, 2] > 0.2)].mean() > 0.98
        assert not found[is_person & (xyz[:, 2] > 0.5)].any()
        is_bare = xyz[:, 1] < -1.0 - 0.3 * np.abs(xyz[:, 0])
        assert found[is_bare & (xyz[:, 2] > 0.1)].any() != left_only


def test_bare_ground_low_plants_and_walls_are_no_plants() -> None:
    assert not plants_of(crop(0.05, 1)).any()
    assert not plants_of(crop(2.0, 1)).any()
    lying = crop(0.0, 2)
    is_body = (np.abs(lying[:, 0] - 6.0) < 0.9) & (np.abs(lying[:, 1]) < 0.25)
    lying[is_body, 2] = 0.25
    assert not plants_of(lying).any()


@pytest.mark.parametrize("distance_m", [4.0, 4.7, 8.0, 12.0])
def test_a_body_that_hides_the_ground_behind_it_is_no_plant(distance_m: float) -> None:
    """Bodies 0.5 m high, 1.8 and 0.5 m long, beside plants: most of the cells that are seen near them are theirs."""
    for length_m in (0.5, 1.8):
        xyz = crop(0.35, 4, left_only=True)
        along, across = -xyz[:, 1], xyz[:, 0]
        is_behind = (along > distance_m) & (np.abs(across) < 0.5 * length_m * along / distance_m)
        is_body = is_behind & (along < distance_m + 0.6)
        xyz[is_body, 2] = np.linspace(0.05, 0.5, is_body.sum())
        xyz = xyz[is_body | ~is_behind]
        is_body = is_body[is_body | ~is_behind]
        found = plants_of(xyz)
        assert found.any()
        assert not found[is_body].any()
