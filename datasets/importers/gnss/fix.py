"""GnssFix from the values that a receiver states; all others are unknown."""

import math
from typing import Any

import numpy as np

from messages.sensors import GnssFix, GnssSolution

NAN3 = np.full(3, np.nan)


def fix_of(values: dict[str, Any], stamp_ns: int) -> GnssFix:
    """A fix of values by the names of GnssFix; without a stated solution it has none."""
    known: dict[str, Any] = {
        "latitude_rad": math.nan,
        "longitude_rad": math.nan,
        "height_m": math.nan,
        "sigma_enu_m": NAN3.copy(),
        "velocity_enu_mps": NAN3.copy(),
        "sigma_velocity_mps": math.nan,
        "heading_rad": math.nan,
        "sigma_heading_rad": math.nan,
        "solution": GnssSolution.NONE,
        "satellites": None,
        "hdop": math.nan,
        "correction_age_s": math.nan,
        "constellations": "",
    }
    return GnssFix(stamp_ns, **{name: values.get(name, unknown) for name, unknown in known.items()})
