"""False stops from truth: nothing solid was where machine and implement would have driven."""

import shapely

from validation.hazards.avoidability import along_path
from validation.hazards.braking import stopping_time, travel_after
from validation.hazards.tracks import Drive, ObjectTrack

BESIDE_M = 1.0  # beside the swept area
BEYOND_M = 4.0  # of the stopping distance, ahead of the front
BEFORE_S = 1.0  # what was there so long before counts
STEP_M = 0.5
STANDING_REACH_M = 4.0
NEGATIVE = ("ditch", "bank")  # what is no solid of the site, beside which paths are planned


def is_justified(drive: Drive, stop_s: float) -> bool:
    """Whether a solid that must be avoided was near the machine's path, or would soon be, at a stop or before it."""
    solid = [one for one in drive.objects if one.must_avoid and (not one.is_static or one.kind in NEGATIVE)]
    times = [max(float(drive.machine.t_s[0]), stop_s - before) for before in (0.0, 0.5 * BEFORE_S, BEFORE_S)]
    return any(_is_cause(drive, one, t) for t in times for one in solid if one.is_present(t))


def _is_cause(drive: Drive, one: ObjectTrack, t_s: float) -> bool:
    state = drive.machine.at(t_s)
    speed = abs(state.speed_mps)
    if drive.gap(state, one.shape_at(t_s)).distance_m <= STANDING_REACH_M:
        return True
    x0, _, x1, _ = shapely.total_bounds(drive.body_at(state).polygons).tolist()  # the wings follow far behind the front
    reach, ahead = travel_after(speed, stopping_time(speed)) + BEYOND_M + x1 - x0, 0.0
    while ahead <= reach:
        dt = ahead / max(speed, 0.5)
        there = along_path(drive, t_s, ahead)
        for shift in (0.0, dt):  # where it is, and where it will be
            if drive.gap(there, one.shape_at(t_s, shift)).distance_m <= BESIDE_M:
                return True
        ahead += STEP_M
    return False
