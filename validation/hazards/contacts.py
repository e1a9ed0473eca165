"""Contact of machine and objects in 3-D, and the smallest distance, from truth."""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from geometry.prism import Nearest, Solids
from validation.hazards.tracks import REACH_M, Drive, MachineState, ObjectTrack, to_map

TOUCH_M = 1e-4
MIN_STEP_S, MAX_STEP_S = 0.01, 0.2
RESOLUTION_S = 1e-3
NEAR_MISS_M = 0.5


@dataclass(frozen=True)
class Contact:
    """First contact: time, part, point in `map`, speed of both against each other and of the machine alone.

    `is_walked_into`: the part stood still: wheels, hitch and PTO, or the wheels and it is none of the implement's.
    """

    t_s: float
    part: str
    point_map_m: tuple[float, float, float]
    relative_mps: float
    machine_mps: float
    is_walked_into: bool


@dataclass(frozen=True)
class Approach:
    """How near an object came: smallest distance to any part, and to a moving one, with time and part; contacts."""

    margin_m: float
    margin_s: float
    part: str
    moving_margin_m: float
    contact: Contact | None
    walked_into: Contact | None

    @property
    def is_near_miss(self) -> bool:
        """Whether a moving part came near without contact."""
        return self.contact is None and self.moving_margin_m < NEAR_MISS_M


def approach_of(drive: Drive, one: ObjectTrack) -> Approach:
    """Smallest distances and first contacts of an object over the drive.

    Who has walked into a part that stands still is held up by it: scripted objects go on through the machine.
    """
    machine = drive.machine
    t, end = (float(machine.t_s[0] if one.is_static else max(machine.t_s[0], one.t_s[0]))), float(machine.t_s[-1])
    best, best_s, part, moving_m = math.inf, t, "", math.inf
    contact = walked = None
    before, is_held = t, False
    while t <= end and one.is_present(t):
        state = machine.at(t)
        found, speed = _gap(drive, one, state)
        k = machine.index(t)
        moving = _moving_gap(drive, one, state, k, found)
        if found.distance_m < best:
            best, best_s, part = found.distance_m, t, found.part
        moving_m = min(moving_m, moving)
        if moving <= TOUCH_M and (machine.is_driving[k] or not is_held):
            contact = _contact(drive, one, (before, t), not machine.is_driving[k])
            break
        is_held = found.distance_m <= TOUCH_M
        if is_held:
            walked = walked or _contact(drive, one, (before, t), False, is_walked_into=True)
        before = t
        t += float(np.clip(0.5 * found.distance_m / max(speed, 0.1), MIN_STEP_S, MAX_STEP_S))
    return Approach(best, best_s, part, moving_m, contact, walked)


def _gap(
    drive: Drive, one: ObjectTrack, state: MachineState, only_implement: bool = False
) -> tuple[Nearest, float]:  # fmt: skip
    """Distance now, and a bound of the speed at which it can shrink."""
    shape = _near(one.shape_at(state.t_s), state) if one.is_static else one.shape_at(state.t_s)
    speed = abs(state.speed_mps) + 4.0 * abs(state.yaw_rate_radps) + float(np.hypot(*one.velocity_at(state.t_s)))
    if not len(shape.polygons):
        return Nearest(REACH_M - 4.0, "", (math.nan,) * 3), speed
    return drive.gap(state, shape, only_implement), speed


def _near(shape: Solids, state: MachineState) -> Solids:
    """The solids around the machine."""
    low, high = np.split(shapely.bounds(shape.polygons), 2, axis=1)
    here = np.array([state.x_m, state.y_m])
    mine = np.flatnonzero(((low - here < REACH_M) & (here - high < REACH_M)).all(axis=1))
    return Solids(shape.polygons[mine], shape.z_m[mine], tuple(shape.names[k] for k in mine))


def _moving_gap(drive: Drive, one: ObjectTrack, state: MachineState, k: int, found: Nearest) -> float:
    """Distance to a moving part: all of them while driving, the implement while only it moves."""
    machine = drive.machine
    if machine.is_driving[k]:
        return found.distance_m
    if not machine.is_moving[k] or found.distance_m > NEAR_MISS_M:
        return math.inf
    return _gap(drive, one, state, only_implement=True)[0].distance_m


def _contact(
    drive: Drive, one: ObjectTrack, between_s: tuple[float, float], only_implement: bool, is_walked_into: bool = False
) -> Contact:  # fmt: skip
    """First contact, of the implement alone or of any part, between a moment without and one with it."""
    free_s, touch_s = between_s

    def gap(t_s: float) -> Nearest:
        return _gap(drive, one, drive.machine.at(t_s), only_implement)[0]

    while touch_s - free_s > RESOLUTION_S:
        middle = 0.5 * (free_s + touch_s)
        if gap(middle).distance_m <= TOUCH_M:
            touch_s = middle
        else:
            free_s = middle
    state, found = drive.machine.at(touch_s), gap(touch_s)
    own = drive.velocity_of_point(state, found.point_m)
    relative = float(np.hypot(*(own - one.velocity_at(touch_s))))
    at_m = to_map(state, found.point_m)
    return Contact(touch_s, found.part, at_m, relative, abs(state.speed_mps), is_walked_into)
