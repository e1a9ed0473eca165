"""Multiple evaluation: cells, hits in one or two scans, thinning."""

import numpy as np

from safety.sources.multiple_evaluation import cell_keys, evaluate, thin


def test_cell_keys() -> None:
    zero = 1 << 20
    places = np.array([(0.0, 0.0, 0.0), (0.5, -0.5, 1.0), (0.99, -0.01, 1.49), (-1.0, 2.0, -0.1)])
    cells = [(0, 0, 0), (1, -1, 2), (1, -1, 2), (-2, 4, -1)]
    expected = [((zero + x) << 42) + ((zero + y) << 21) + zero + z for x, y, z in cells]
    assert cell_keys(places, 0.5).tolist() == expected


def test_evaluate() -> None:
    keys = np.array([9, 5, 9, 7, 9, 9, 5, 4])
    high = np.ones(len(keys), bool)
    hits, cells = evaluate(keys, high, np.array([4, 5, 11]), 4, 2)
    assert hits.tolist() == [True, True, True, False, True, True, True, False]
    assert cells.tolist() == [5, 9]


def test_low_returns_need_two_scans() -> None:
    keys = np.full(6, 9)
    low, mixed = np.zeros(6, bool), np.array([True, True, True, False, False, False])
    hits, cells = evaluate(keys, low, np.empty(0, np.int64), 4, 2)
    assert not hits.any()
    assert evaluate(keys, low, cells, 4, 2)[0].all()
    assert not evaluate(keys, mixed, np.array([7]), 4, 2)[0].any()
    assert evaluate(keys, mixed, np.array([7]), 3, 2)[0].all()


def test_thin_keeps_order() -> None:
    grid = np.array([(x, y, z) for x in (-0.3, 0.1, 0.6) for y in (-0.3, 0.1, 0.6) for z in (2.0, 1.0)])
    assert thin(grid, 0.5).tolist() == grid[::2].tolist()
    assert len(thin(np.array([(0.0, 0.0, 0.0), (0.499, 0.499, 3.0), (0.5, 0.0, 0.0)]), 0.5)) == 2


def test_min_returns_per_cell() -> None:
    none = np.empty(0, np.int64)
    for count in range(1, 8):
        keys = cell_keys(np.tile([[10.1, 0.1, 0.6]], (count, 1)), 0.5)
        hits, cells = evaluate(keys, np.ones(count, bool), none, 4, 2)
        assert hits.all() == (count >= 4)
        assert len(cells) == (1 if count >= 2 else 0)
        again, _ = evaluate(keys, np.ones(count, bool), cells, 4, 2)
        assert again.all() == (count >= 2)
    apart = [[10.1, 0.1, 0.6], [10.6, 0.1, 0.6], [10.1, 0.6, 0.6], [10.1, 0.1, 1.1], [-0.1, 0, 0]]
    spread = cell_keys(np.array(apart), 0.5)
    assert len(set(spread.tolist())) == 5
    assert not evaluate(spread, np.ones(5, bool), none, 2, 2)[0].any()
    hits, cells = evaluate(none, np.empty(0, bool), none, 4, 2)
    assert len(hits) == len(cells) == 0


def test_thin() -> None:
    points = np.array([[1.01, 0.0, z] for z in (0.3, 0.6, 0.9)] + [[1.2, 0.0, 0.5]])
    assert len(thin(points, 0.05)) == 2
    assert len(thin(np.empty((0, 3)), 0.05)) == 0
