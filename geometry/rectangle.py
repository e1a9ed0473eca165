"""Rectangle in `base`: outline of a rigid body of the machine. Only numpy, since safety uses it."""

from dataclasses import dataclass

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
