"""Set-up of a mission that was interrupted: the rest of its plan, from where the machine stands."""

from dataclasses import replace

import numpy as np

from hmi.plan_view.progress import BEHIND_M, Progress, place_on
from messages.errors import HeadlandError
from messages.plan import Path
from planning.path import rest_of, spliced
from planning.profile import limit_acceleration
from planning.rig import Rig
from runtime.setup import Setup

LEAD_M = 10.0  # of the rest, within which the offset of the machine from the line fades
LEFT_M = 1.0  # a path with less left is done


def resumed_setup(setup: Setup, progress: Progress) -> Setup:
    """The set-up with the rest of the plan and the machine at `progress.at`.

    Raises HeadlandError when the path is not in the plan, or the machine does not stand on it.
    """
    paths = {path.path_id: path for path in setup.plan.fixed_paths}
    path = paths.get(progress.path_id)
    if path is None:
        raise HeadlandError(f"progress: path {progress.path_id} is not in the plan, which has other settings now")
    at, pose = progress.at, progress.at.pose
    s_m = place_on(path, pose, progress.path_s_m - BEHIND_M, progress.path_s_m + BEHIND_M)
    if s_m is None:
        raise HeadlandError(
            f"progress: the machine at x {at.x_m:.1f} m, y {at.y_m:.1f} m is not on path {progress.path_id} at "
            f"{progress.path_s_m:.1f} m, it was driving around an obstacle; start the mission from its beginning"
        )
    later = tuple(one for one in setup.plan.fixed_paths if one.path_id > path.path_id)
    if path.s_m[-1] - s_m >= LEFT_M:
        later = (rest_from(path, s_m, (at.x_m, at.y_m), setup.plan.rig), *later)
    left = (*later, *setup.plan.docking_paths)
    if not left:
        raise HeadlandError(f"progress: path {progress.path_id} is the last one, and nothing of it is left")
    plan = replace(setup.plan, paths=left, length_m=sum(float(one.s_m[-1]) for one in left))
    mission = setup.mission.model_copy(update={"start": at, "spread": None})
    return replace(
        setup, mission=mission, plan=plan, start=at, is_folded=progress.is_folded, hitch=progress.hitch,
    )  # fmt: skip


def rest_from(path: Path, from_m: float, p_map_m: tuple[float, float], rig: Rig) -> Path:
    """Rest of a path from an arc length, under its number, beginning at a position (m) in `map` from standstill.

    Only the next `LEAD_M` are fitted to the position: a path may cross itself there later.
    """
    first = int(np.searchsorted(path.s_m, from_m))
    lead = min(int(np.searchsorted(path.s_m, from_m + LEAD_M)) + 1, len(path.s_m))
    head = rest_of(spliced([(path, first, lead)], path.path_id), 0.0, np.array(p_map_m), path.path_id, rig)
    rest = spliced([(head, 0, len(head.s_m)), (path, lead, len(path.s_m))], path.path_id)
    speed_mps = limit_acceleration(rest.speed_mps, rest.s_m, rig)
    return replace(rest, speed_mps=speed_mps, is_last=path.is_last, is_transport=path.is_transport)
