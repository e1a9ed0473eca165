"""Plans the dock approach from the measured pose; refuses without recent UWB ranges."""

import math
from collections.abc import Sequence

from shapely.geometry import Polygon

from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.motion import MapPose
from messages.plan import Path
from planning.docking.dock import Docking, plan_docking


def uwb_unavailable_reason(pose: MapPose, max_age_s: float) -> str | None:
    """Reason not to dock if the last UWB range is older than `max_age_s`, else None."""
    if pose.uwb_age_s <= max_age_s:
        return None
    age = f"for {pose.uwb_age_s:.1f} s" if math.isfinite(pose.uwb_age_s) else "yet"
    return f"no UWB range {age}: the machine does not dock without UWB"


def plan_approach(pose: MapPose, docking: Docking, first_id: int, outlines: Sequence[Polygon]) -> tuple[Path, ...]:
    """Paths that avoid the obstacle outlines or, where none exist, paths without them; raises FieldError.

    The supervisor stops the machine if an obstacle is still present.
    """
    start = Pose2.of(pose.T_map_base)
    try:
        return plan_docking(start, docking, first_id, outlines)
    except FieldError:
        if not outlines:
            raise
        return plan_docking(start, docking, first_id)
