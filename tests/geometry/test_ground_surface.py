"""Heights of returns above the ground under them."""

import math

import numpy as np
import pytest

from geometry.ground_surface import (
    above_cells,
    broad_tops,
    cells_in_grid,
    envelope,
    heights_above_ground,
    heights_above_planes,
    low_levels,
    lowest_of_cells,
    plane_sums,
    plant_heights,
    stand_out_of_cell,
    typical_of_blocks,
)

SHAPE, CELL_M = (16, 24), 0.5


def heights(xyz: np.ndarray) -> np.ndarray:
    return heights_above_ground(xyz.astype(np.float32), (0.0, -6.0), SHAPE, CELL_M, 0.1, 0.10, 0.05, 0.3)[0]


def ground(rng: np.random.Generator, count: int = 4000) -> np.ndarray:
    return np.stack([rng.uniform(0.0, 8.0, count), rng.uniform(-6.0, 6.0, count), np.zeros(count)])


@pytest.mark.parametrize("slope", [0.0, 0.08, -0.08])
def test_a_slope_is_ground(slope: float) -> None:
    xyz = ground(np.random.default_rng(1))
    xyz[2] = slope * xyz[0] + 0.03 * xyz[1]
    assert np.abs(heights(xyz)).max() < 0.06


def test_waves_are_ground() -> None:
    xyz = ground(np.random.default_rng(2))
    xyz[2] = 0.05 * np.sin(2.0 * np.pi * xyz[0] / 6.0)
    assert np.abs(heights(xyz)).max() < 0.08


def test_a_body_that_fills_its_cells_stands_out() -> None:
    xyz = ground(np.random.default_rng(3))
    is_body = (np.abs(xyz[0] - 4.0) < 0.9) & (np.abs(xyz[1]) < 0.25)
    xyz[2, is_body] = 0.2
    found = heights(xyz)
    assert found[is_body].min() > 0.12
    assert found[~is_body].max() < 0.03


def test_single_returns_and_returns_beyond_the_grid() -> None:
    xyz = np.array([[4.0, -3.0, 50.0], [0.0, 0.0, 50.0], [0.3, 0.0, 0.0]])
    assert np.isfinite(heights(xyz)).all()
    assert heights(xyz[:, :1]) == pytest.approx([0.0], abs=1e-6)  # nothing lower is known


def test_few_returns_below_the_ground_do_not_lower_it() -> None:
    xyz = ground(np.random.default_rng(4), 12_000)
    xyz[2, ::200] = -0.5
    assert np.median(heights(xyz)) < 0.01


def test_second_largest_height_of_each_cell_with_three_returns() -> None:
    xyz = np.array([[1.1, 1.2, 1.3, 1.4, 3.1, 3.2], [0.1] * 6, [0.0, 0.05, 0.07, 0.9, 0.0, 0.2]]).astype(np.float32)
    xyz[2] += 0.2
    _, tops = heights_above_ground(xyz, (0.0, -6.0), SHAPE, CELL_M, 0.1, 0.10, 0.05, 0.3)
    assert tops[:, 2, 12] == pytest.approx([0.27, 0.07, 0.05], abs=0.02)  # the last of the heights below 0.3 m
    assert np.isfinite(tops).sum() == 3


def test_a_cell_is_measured_from_its_quantile() -> None:
    """Few returns and many, which are sorted, give the same quantile."""
    for count in (1, 9, 310, 330, 2000):
        z = np.random.default_rng(count).normal(0.0, 0.05, count)
        xyz = np.stack([np.full(count, 0.5), np.full(count, 0.5), z]).astype(np.float32)
        height = heights_above_ground(xyz, (0.0, 0.0), (2, 2), CELL_M, 0.1, 0.10, 0.05, 0.3)[0]
        z = xyz[2].astype(np.float64)
        assert height == pytest.approx(z - np.sort(z)[int(0.1 * count)], abs=1e-9), count


def test_envelope_is_the_lowest_of_the_bounds_within_reach() -> None:
    random = np.random.default_rng(5)
    low = np.where(random.random((12, 9)) < 0.4, random.normal(0.0, 1.0, (12, 9)), np.inf)
    found = envelope(low, 0.3, 2)
    for row, column in np.ndindex(low.shape):
        bounds = [
            low[i, j] + 0.3 * math.hypot(i - row, j - column)
            for i in range(max(row - 2, 0), min(row + 3, 12))
            for j in range(max(column - 2, 0), min(column + 3, 9))
        ]
        assert found[row, column] == pytest.approx(min(bounds))


def test_low_levels_are_those_of_sorted_returns() -> None:
    random = np.random.default_rng(6)
    cell, level = random.integers(0, 40, 3000), random.integers(0, 30, 3000).astype(np.int32)
    for order, share in ((1, 0.0), (2, 0.0), (90, 0.0), (3, 0.1), (3, 1.0)):
        found = low_levels(cell, level, (41, 30), order, share)
        for here in range(41):
            some = np.sort(level[cell == here])
            place = max(order, math.ceil(share * len(some) - 1e-9))
            assert found[here] == (some[place - 1] if len(some) >= order else -1), (order, share, here)


def test_plants_are_as_high_as_many_cells_around() -> None:
    tops = np.full((20, 20), 0.02)
    tops[:, :8] = np.random.default_rng(1).uniform(0.28, 0.34, (20, 8))
    tops[10:14, 14:16], tops[3, 3], tops[5, 5] = 0.3, 1.7, np.inf  # a low body, a person in the plants, an empty cell
    steps = np.ones(20, np.int64)
    found = plant_heights(tops, 3, steps, 0.15, 0.4, 0.4)
    assert found[:, :8].min() > 0.3
    assert found[:, :8].max() <= 0.34
    assert (found[:, 9:] == 0.0).all()
    assert (plant_heights(tops, 3, steps, 0.15, 0.25, 0.4) == 0.0).all()
    assert (plant_heights(np.full((4, 4), np.inf), 3, steps[:4], 0.15, 0.4, 0.4) == 0.0).all()


def test_cells_of_returns_and_of_those_beyond_the_grid() -> None:
    xyz = np.array([[2.1, 3.9, -7.0, 90.0], [-1.9, 0.1, 90.0, -7.0], [0.0] * 4], np.float32)
    assert cells_in_grid(xyz, (1.0, -1.0), (3, 4), 2.0).tolist() == [0, 1, 3, 8]


def test_sums_of_known_cells_over_a_square() -> None:
    random = np.random.default_rng(7)
    low, is_known = random.normal(0.0, 1.0, (6, 5)), random.random((6, 5)) < 0.7
    low[~is_known] = np.inf
    found = plane_sums(low, is_known, 1)
    for row, column in np.ndindex(low.shape):
        terms = [
            (1.0, i, j, i * i, i * j, j * j, low[i, j], low[i, j] * i, low[i, j] * j)
            for i in range(max(row - 1, 0), min(row + 2, 6))
            for j in range(max(column - 1, 0), min(column + 2, 5))
            if is_known[i, j]
        ]
        assert found[row, column] == pytest.approx(np.sum([[0.0] * 9, *terms], axis=0))


def test_heights_above_the_planes_of_cells() -> None:
    planes = np.array([[0.5, 0.1, -0.2], [1.0, 0.0, 0.0]])
    xyz = np.array([[3.0, 3.0], [-4.0, 9.0], [2.0, 2.0]], np.float32)
    found = heights_above_planes(xyz, np.array([0, 1]), planes, (1.0, -1.0), 2.0)
    assert found == pytest.approx([2.0 - (0.5 + 0.1 * 1.0 - 0.2 * -1.5), 1.0])


@pytest.mark.parametrize(
    ("heights", "plant_m", "counts"),
    [
        ([0.2, 0.1, 0.0, 0.0], 0.0, [True, False, False, False]),
        ([0.2] + [0.0] * 30, 0.0, [False] * 31),  # a share of 0.05 is needed
        ([0.12, 0.12, 0.0], 0.0, [True, True, False]),  # below the least height, but two of three
        ([0.12] + [0.0] * 2, 0.0, [False] * 3),  # one is not many
        ([0.3, 0.5, 0.39, 0.12, 0.12], 0.35, [False, True, False, False, False]),  # above the plants and the margin
    ],
)
def test_returns_stand_out_with_others_of_their_cell(heights: list[float], plant_m: float, counts: list[bool]) -> None:
    n = len(heights)
    xyz, plants_m = np.zeros((3, n + 1), np.float32), np.zeros((2, 2))
    xyz[0, :n], xyz[1, :n], plants_m[1, 0] = 1.7, 0.2, plant_m
    height_m = np.array([*heights, 0.3])  # the last one is alone in its cell, without plants
    is_above, is_plant = stand_out_of_cell(
        xyz, height_m, plants_m, (0.0, -0.1), 1.0, np.full(n + 1, 0.15), np.full(n + 1, 0.11), 0.05, (0.05, 0.5), 2, 0.0
    )
    assert is_above.tolist() == [*counts, True]
    assert is_plant.tolist() == [plant_m > 0.0 and h <= plant_m + 0.05 for h in heights] + [False]


@pytest.mark.parametrize(
    ("heading_deg", "across_m", "counts"),
    [(0.0, 0.01, False), (0.0, 0.03, True), (3.0, 0.01, False), (30.0, 0.01, True), (90.0, 0.0, True)],
)
def test_many_returns_of_a_line_along_the_machine_do_not_stand_out(
    heading_deg: float, across_m: float, counts: bool
) -> None:  # fmt: skip
    """A ring along the top of a row of plants does not count; one across a body does."""
    along, c, s = np.linspace(-0.2, 0.2, 16), np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))
    across = across_m * np.where(np.arange(16) % 2 == 0, 1.0, -1.0)
    xyz = np.array([40.5 + c * along - s * across, 0.5 + s * along + c * across, np.zeros(16)], np.float32)
    limits = (np.full(16, 0.2), np.full(16, 0.11), 0.05, (0.05, 0.5), 6, 0.016)
    is_above, _ = stand_out_of_cell(xyz, np.full(16, 0.15), np.zeros((2, 2)), (40.0, 0.0), 1.0, *limits)
    assert is_above.all() == is_above.any() == counts


def test_typical_of_blocks_ignores_few_blocks_and_follows_many() -> None:
    """Blocks of 2 by 2 cells: a rough one, a column of rough ones at the edge, a rough half; and one without tops."""
    tops = np.full((8, 12), 0.01)
    assert typical_of_blocks(tops, 2, 0.95, 2).tolist() == tops.tolist()
    one, edge, half = tops.copy(), tops.copy(), tops.copy()
    one[2:4, 4:6], edge[:, :2], half[:, :6] = 0.3, 0.3, 0.3
    assert (typical_of_blocks(one, 2, 0.95, 2) == 0.01).all()
    assert (typical_of_blocks(edge, 2, 0.95, 2)[:, 2:] == 0.01).all()
    assert (typical_of_blocks(half, 2, 0.95, 2)[:, :4] == 0.3).all()
    assert (typical_of_blocks(half, 2, 0.95, 2)[:, 8:] == 0.01).all()
    none = np.full((2, 2), np.inf)
    none[0, 0] = 0.1
    assert np.isinf(typical_of_blocks(none, 2, 0.95, 2)).all()


def test_broad_tops_are_those_of_three_cells_and_more() -> None:
    """A block of 3 by 3 cells stays, a strip of two cells does not, and cells without tops do not count."""
    tops = np.full((9, 12), 0.02)
    tops[1:4, 1:4], tops[:, 7:9], tops[6:, :3] = 0.2, 0.3, np.inf
    broad = broad_tops(tops)
    assert (broad[1:4, 1:4] == 0.2).all()
    assert (broad[:, 5:] == 0.02).all()
    assert broad.max() == 0.2
    assert (broad_tops(np.full((2, 2), np.inf)) == 0.0).all()


def test_lowest_of_each_cell_is_the_first_of_equal_ones() -> None:
    random = np.random.default_rng(8)
    cell, z = random.integers(-5, 5, 200), random.integers(0, 4, 200).astype(float)
    found = lowest_of_cells(np.argsort(cell), cell, z)
    assert found.tolist() == [min(np.flatnonzero(cell == here), key=lambda k: z[k]) for here in np.unique(cell)]
    assert len(lowest_of_cells(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))) == 0


def test_returns_above_the_ground_of_their_cells() -> None:
    xyz = np.array([[3.0] * 4, [4.0] * 4, [0.4, 0.3, 1.4, 1.3]], np.float32)  # 5 m away
    ground_m = np.array([0.0, 1.0], np.float32)
    found = above_cells(xyz, np.array([0, 0, 1, 1]), ground_m, np.float32(0.25), np.float32(0.02))
    assert found.tolist() == [True, False, True, False]


def test_reflections_below_the_ground_do_not_lower_it() -> None:
    """Two cells of returns 0.6 m below a level field; a step down beside it, broader than that, is ground."""
    rng = np.random.default_rng(1)
    xyz = np.stack([rng.uniform(0.0, 10.0, 8000), rng.uniform(0.0, 8.0, 8000), rng.normal(0.0, 0.01, 8000)])
    is_below = (np.abs(xyz[0] - 5.0) < 0.5) & (np.abs(xyz[1] - 4.25) < 0.25)
    xyz[2, is_below] -= 0.6
    is_lower = xyz[0] > 7.0
    xyz[2, is_lower] -= 0.6
    height, _ = heights_above_ground(xyz.astype(np.float32), (0.0, 0.0), (20, 16), 0.5, 0.1, 0.1, 0.05, 0.3)
    assert np.abs(height[~is_below & (xyz[0] < 5.0)]).max() < 0.1
    assert np.abs(height[xyz[0] > 7.5]).max() < 0.1
