"""Quantile and median equal those of numpy."""

import numpy as np
import pytest

from geometry.arrays import median, quantile


@pytest.mark.parametrize("count", [1, 2, 3, 10, 257])
def test_quantile_and_median_are_those_of_numpy(count: int) -> None:
    random = np.random.default_rng(count)
    for _ in range(50):
        values = random.normal(0.0, 1.0, count)
        assert median(values) == np.median(values)
        for share in (0.0, 0.25, 0.6, 0.9, 1.0, random.random()):
            assert quantile(values, share) == np.quantile(values, share)
