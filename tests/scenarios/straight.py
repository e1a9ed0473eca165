"""One straight path in the demo's field instead of its plan."""

from dataclasses import replace

import numpy as np

from configs.site import PoseConfig
from messages.plan import Path, PathSection, PathSectionType
from runtime.setup import Setup


def on_a_line(setup: Setup, length_m: float, speed_kmh: float) -> Setup:
    """The setup with one straight eastward swath from the start."""
    s = np.arange(0.0, length_m + 0.05, 0.1)
    n = len(s)
    path = Path(
        0, 0, 1, np.column_stack([15.0 + s, np.full(n, 25.0)]), np.zeros(n), np.zeros(n), s,
        np.append(np.full(n - 1, speed_kmh / 3.6), 0.0), np.ones(n, np.uint8), (PathSection(PathSectionType.SWATH, 0,
        0, n - 1),),
        np.zeros(n, np.int32), True,
    )  # fmt: skip
    plan = replace(setup.plan, paths=(path,), length_m=length_m)
    return replace(setup, plan=plan, start=PoseConfig(x_m=15.0, y_m=25.0, heading_deg=0.0))
