"""Multiple evaluation: cells, hits in one or two scans, thinning."""

import numpy as np

from safety.sources.multiple_evaluation import Streaks, by_cell, cell_keys, evaluate, floats_as_a_whole, thin

NONE = np.empty(0, np.int64)


def stands(keys: np.ndarray) -> np.ndarray:
    """No return floats."""
    return np.zeros(len(keys), bool)


def before(*cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells of the previous scan; there was none before it."""
    return np.array(cells, np.int64), NONE


def test_cell_keys() -> None:
    zero = 1 << 20
    places = np.array([(0.0, 0.0, 0.0), (0.5, -0.5, 1.0), (0.99, -0.01, 1.49), (-1.0, 2.0, -0.1)])
    cells = [(0, 0, 0), (1, -1, 2), (1, -1, 2), (-2, 4, -1)]
    expected = [((zero + x) << 42) + ((zero + y) << 21) + zero + z for x, y, z in cells]
    assert cell_keys(places, 0.5).tolist() == expected


def test_evaluate() -> None:
    keys = np.array([9, 5, 9, 7, 9, 9, 5, 4])
    high = np.ones(len(keys), bool)
    hits, cells = evaluate(by_cell(keys), high, stands(keys), before(4, 5, 11), 4, 2)
    assert hits.tolist() == [True, True, True, False, True, True, True, False]
    assert cells.tolist() == [5, 9]


def test_low_returns_need_two_scans() -> None:
    keys = np.full(6, 9)
    low, mixed = np.zeros(6, bool), np.array([True, True, True, False, False, False])
    hits, cells = evaluate(by_cell(keys), low, stands(keys), before(), 4, 2)
    assert not hits.any()
    assert evaluate(by_cell(keys), low, stands(keys), (cells, NONE), 4, 2)[0].all()
    assert not evaluate(by_cell(keys), mixed, stands(keys), before(7), 4, 2)[0].any()
    assert evaluate(by_cell(keys), mixed, stands(keys), before(7), 3, 2)[0].all()


def test_floating_returns_need_three_scans() -> None:
    keys, high, cells = np.full(8, 7), np.ones(8, bool), np.array([7])
    for floats, states in ((8, (False, False, True)), (6, (False, False, True)), (5, (True, True, True))):
        is_floating = np.arange(8) < floats
        found = [
            evaluate(by_cell(keys), high, is_floating, seen, 4, 2)[0]
            for seen in ((NONE, cells), (cells, NONE), (cells, cells))
        ]
        assert [one.all() for one in found] == [one.any() for one in found] == list(states), floats


def test_thin_keeps_the_lowest() -> None:
    grid = np.array([(x, y, z) for x in (-0.3, 0.1, 0.6) for y in (-0.3, 0.1, 0.6) for z in (2.0, 1.0)])
    assert thin(grid, 0.5).tolist() == grid[1::2].tolist()
    assert thin(grid[:, :2], 0.5).tolist() == grid[::2, :2].tolist()
    assert len(thin(np.array([(0.0, 0.0, 0.0), (0.499, 0.499, 3.0), (0.5, 0.0, 0.0)]), 0.5)) == 2


def test_min_returns_per_cell() -> None:
    for count in range(1, 8):
        keys = cell_keys(np.tile([[10.1, 0.1, 0.6]], (count, 1)), 0.5)
        hits, cells = evaluate(by_cell(keys), np.ones(count, bool), stands(keys), before(), 4, 2)
        assert hits.all() == (count >= 4)
        assert len(cells) == (1 if count >= 2 else 0)
        again, _ = evaluate(by_cell(keys), np.ones(count, bool), stands(keys), (cells, NONE), 4, 2)
        assert again.all() == (count >= 2)
    apart = [[10.1, 0.1, 0.6], [10.6, 0.1, 0.6], [10.1, 0.6, 0.6], [10.1, 0.1, 1.1], [-0.1, 0, 0]]
    spread = cell_keys(np.array(apart), 0.5)
    assert len(set(spread.tolist())) == 5
    assert not evaluate(by_cell(spread), np.ones(5, bool), stands(spread), before(), 2, 2)[0].any()
    hits, cells = evaluate(by_cell(NONE), np.empty(0, bool), stands(NONE), before(), 4, 2)
    assert len(hits) == len(cells) == 0


def test_thin() -> None:
    points = np.array([[1.01, 0.0, z] for z in (0.3, 0.6, 0.9)] + [[1.2, 0.0, 0.5]])
    assert len(thin(points, 0.05)) == 2
    assert len(thin(np.empty((0, 3)), 0.05)) == 0


def test_a_body_floats_as_a_whole_by_the_cells_around() -> None:
    """Ten returns in each of two cells side by side, and ten of another body 5 m off."""
    x_m = np.repeat([0.1, 0.6, 5.0], 10)
    returns = by_cell(cell_keys(np.column_stack([x_m, np.zeros(30), np.ones(30)]), 0.5))

    def whole(floating: slice, standing: slice) -> list[bool]:
        is_floating, is_standing = np.zeros((2, 30), bool)
        is_floating[floating], is_standing[standing] = True, True
        found = floats_as_a_whole(returns, is_floating, is_standing)
        return [bool(found[k]) for k in (0, 10, 20)]

    none = slice(0, 0)
    assert whole(none, none) == [False, False, False]
    assert whole(slice(0, 5), none) == [True, True, False]
    assert whole(slice(0, 4), none) == [False, False, False]  # a fifth of the returns of both
    assert whole(slice(0, 10), none) == [False, True, False]  # the first are marked by themselves
    assert whole(slice(0, 6), slice(6, 8)) == [True, True, False]
    assert whole(slice(0, 6), slice(6, 10)) == [False, False, False]
    assert whole(slice(0, 6), slice(10, 14)) == [False, False, False]  # who stands beside it
    assert whole(slice(20, 30), none) == [False, False, False]


def test_streaks() -> None:
    streaks = Streaks(NONE, NONE)
    for cells, scans in (((3, 5), (1, 1)), ((3, 7), (2, 1)), ((3, 5, 7), (3, 1, 2))):
        streaks = streaks.continued(np.array(cells))
        assert (tuple(streaks.cells), tuple(streaks.scans)) == (cells, scans)
    assert streaks.longer_than(2).tolist() == [3, 7]
    assert len(streaks.continued(NONE).cells) == 0
