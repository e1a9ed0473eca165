"""Near points and groups, against all distances at once."""

import numpy as np
import pytest

from geometry.near_points import groups_of, is_near

NONE = np.empty((0, 2))


def test_near_a_point() -> None:
    assert is_near(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 1.0]]), 1.0).tolist() == [True, False]
    assert is_near(NONE, np.array([[0.0, 1.0]]), 1.0).tolist() == []


def test_groups() -> None:
    points = np.array([(0.0, 0.0), (0.4, 0.0), (0.9, 0.3), (4.0, 0.0), (-3.0, 0.2), (4.0, 0.4)])
    assert [np.flatnonzero(group).tolist() for group in groups_of(points, 1.0)] == [[4], [0, 1, 2], [3, 5]]
    assert groups_of(NONE, 1.0) == []


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("spread_m", [1.0, 5.0, 40.0])
def test_near_as_by_all_distances(dimensions: int, spread_m: float) -> None:
    random = np.random.default_rng(3)
    for n in (1, 40, 400):
        points, others = (random.normal(0.0, spread_m, (count, dimensions)).round(1) for count in (n, 200))
        apart = points[:, None] - others[None]
        expected = ((apart**2).sum(axis=2) <= 0.5**2).any(axis=1)
        assert (is_near(points, others, 0.5) == expected).all()


@pytest.mark.parametrize("spread_m", [1.0, 3.0, 8.0, 30.0])
def test_groups_as_by_all_distances(spread_m: float) -> None:
    random = np.random.default_rng(4)
    for n in (2, 30, 300):
        points = random.normal(0.0, spread_m, (n, 2))
        cell = np.floor(2.0 * points)
        is_next = np.abs(cell[:, None] - cell[None]).max(axis=2) <= 1.0
        part = np.arange(n)
        while (part != (lowest := np.where(is_next, part, n).min(axis=1))).any():
            part = lowest
        found = {tuple(np.flatnonzero(group)) for group in groups_of(points, 1.0)}
        assert found == {tuple(np.flatnonzero(part == number)) for number in np.unique(part)}
