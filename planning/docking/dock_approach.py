"""Whether and how to dock, by where the machine really stands and what it hears and sees."""

import math
from collections.abc import Sequence

from shapely.geometry import Polygon

from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.motion import MapPose
from messages.plan import Path
from planning.docking.dock import Docking, plan_docking


def silence(pose: MapPose, longest_s: float) -> str | None:
    """Why the machine does not dock, when the last UWB range is older than that."""
    if pose.uwb_age_s <= longest_s:
        return None
    heard = f"for {pose.uwb_age_s:.1f} s" if math.isfinite(pose.uwb_age_s) else "yet"
    return f"no UWB range {heard}: the machine does not dock without"


def way_in(pose: MapPose, docking: Docking, first_id: int, outlines: Sequence[Polygon]) -> tuple[Path, ...]:
    """The way past all that stands or, where there is none, as if it were gone by then; raises FieldError.

    Whether it is gone is for the supervisor to see.
    """
    start = Pose2.of(pose.T_map_base)
    try:
        return plan_docking(start, docking, first_id, outlines)
    except FieldError:
        if not outlines:
            raise
        return plan_docking(start, docking, first_id)
