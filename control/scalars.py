"""Plain floats: faster than arrays where single numbers are used at 50 Hz."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from geometry.arrays import Float64


def as_floats(values: Float64) -> Sequence[float]:
    """The same numbers, read one by one as plain floats: no copy, and nearly as fast as a list."""
    return cast(Sequence[float], np.ascontiguousarray(values).data)


def clamp(value: float, limit: float) -> float:
    """`value` limited to ±`limit`."""
    return max(-limit, min(limit, value))
