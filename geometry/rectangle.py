"""Rectangle in `base`: outline of a rigid body of the machine. Only numpy, since safety uses it."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.arrays import Float64


@dataclass(frozen=True)
class Rectangle:
    """Extent along x from `rear_m` to `front_m`, `width_m` across, centred on the x axis."""

    rear_m: float
    front_m: float
    width_m: float

    @property
    def half_width_m(self) -> float:
        """Extent to either side."""
        return 0.5 * self.width_m

    @property
    def corners_m(self) -> Float64:
        """(4, 2), counter-clockwise from the rear right."""
        h = self.width_m / 2.0
        return np.array([[self.rear_m, -h], [self.front_m, -h], [self.front_m, h], [self.rear_m, h]])

    def outline_m(self, step_m: float) -> Float64:
        """Points (K, 2) on the outline, at most `step_m` apart."""
        c = np.vstack([self.corners_m, self.corners_m[:1]])
        sides = [np.linspace(a, b, max(2, int(np.ceil(np.hypot(*(b - a)) / step_m)) + 1))[:-1] for a, b in pairwise(c)]
        return np.vstack(sides)
