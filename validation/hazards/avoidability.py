"""Whether a contact could have been avoided, from truth alone.

What could be known: from the first moment at which an object is visible from a point of the machine's outline and is in
the path, or heads into it at its present velocity. From then on the closed form of a stop is driven
along the true path while the object moves as it did. Crop, dust, fog and the machine itself hide nothing.

there before the machine set off, and does not move or is in reach? ──yes──► avoidable
known in time for the closed form to stop before contact? ──yes──► avoidable, unless the PTO still runs down
hidden by something solid until then, and a stop possible from a lower speed, at least 3 km/h? ──yes──► avoidable
contact faster than the closed form? ──yes──► avoidable        else ──► unavoidable
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely

from geometry.arrays import Float64
from geometry.pose2 import to_frame
from geometry.prism import Solids
from validation.hazards.braking import MIN_SPEED_MPS, PTO_S, speed_after, stopping_time, travel_after
from validation.hazards.contacts import TOUCH_M, Contact
from validation.hazards.tracks import Drive, MachineState, ObjectTrack
from validation.obstacle_stop.visibility import MIN_SHARE, SolidBox, View, visible_share

STEP_S, PATH_STEP_M = 0.05, 0.5
BEYOND_S = 1.0  # beyond the stop
AT_START_M = 2.0  # in reach before start or resume
EYE_HEIGHTS_M = (0.5, 1.5, 2.9)  # at most 3 m
HIDDEN_BEFORE_S = 1.0
SPEED_TOLERANCE_MPS = 0.1
ALL_AROUND = math.pi


@dataclass(frozen=True)
class Avoidability:
    """Result for one contact, with its reason; `closed_form_mps` is the machine's speed at contact by the closed form.

    `known_s` is the time from which the object could be known (NaN: not before the contact).
    """

    is_unavoidable: bool
    reason: str
    known_s: float = math.nan
    closed_form_mps: float = 0.0


def avoidability_of(drive: Drive, one: ObjectTrack, contact: Contact) -> Avoidability:
    """Avoidability of a contact with a moving machine."""
    set_off_s = drive.machine.set_off_s(contact.t_s)
    was_there = one.is_static or one.is_present(set_off_s)
    if was_there and not one.moves:
        return Avoidability(False, "does not move")
    if was_there and _distance(drive, one, set_off_s) <= AT_START_M:
        return Avoidability(False, "in reach before the machine set off")
    since_s = max(set_off_s, float(one.t_s[0]))
    times = np.arange(since_s, contact.t_s, STEP_S)
    sees = Eyes(drive, one)
    known_s = known_from_s(drive, one, contact, times, sees)
    before = times[(times >= known_s - HIDDEN_BEFORE_S) & (times < known_s)]
    was_hidden = any(not sees.visible(t) for t in before.tolist())
    top_mps = abs(drive.machine.at(known_s).speed_mps)
    impact = closed_form_contact_mps(drive, one, known_s, top_mps)
    if impact is None:
        if meets_pto_as_it_runs_down(drive, one, contact, times, sees):
            return Avoidability(True, "entered a PTO that could not stand yet", known_s)
        return Avoidability(False, "visible in time to stop", known_s)
    if was_hidden:
        impact = closed_form_contact_mps(drive, one, known_s, min(top_mps, MIN_SPEED_MPS))
        if impact is None:
            return Avoidability(False, "too fast past an occlusion", known_s)
    if contact.machine_mps > impact + SPEED_TOLERANCE_MPS:
        return Avoidability(False, "contact faster than a stop would have left it", known_s, impact)
    reason = "hidden until too near" if was_hidden else "entered the path too near"
    return Avoidability(True, reason, known_s, impact)


def meets_pto_as_it_runs_down(
    drive: Drive, one: ObjectTrack, contact: Contact, times: Float64, sees: "Eyes"
) -> bool:  # fmt: skip
    """Whether only the PTO moves at contact, and would not stand if stopped when the object headed for the machine."""
    k = drive.machine.index(contact.t_s)
    if drive.machine.is_driving[k] or not drive.machine.is_running[k]:
        return False
    return contact.t_s < known_from_s(drive, one, contact, times, sees, PTO_S + BEYOND_S) + PTO_S


def known_from_s(
    drive: Drive, one: ObjectTrack, contact: Contact, times: Float64, sees: "Eyes", least_s: float = 0.0
) -> float:  # fmt: skip
    """First of the times at which the object is critical (`least_s` as there) and visible, else that of the contact."""
    known = (t for t in times.tolist() if is_critical(drive, one, t, least_s) and sees.visible(t))
    return next(known, contact.t_s)


def is_critical(drive: Drive, one: ObjectTrack, t_s: float, least_s: float = 0.0) -> bool:
    """Whether the object is in the path that the machine sweeps within its stopping distance, or heads into it.

    The path goes on for another `BEYOND_S`; the object keeps its velocity over the same time, at least `least_s`.
    """
    speed = abs(drive.machine.at(t_s).speed_mps)
    seconds = max(stopping_time(speed) + BEYOND_S, least_s)
    reach = travel_after(speed, seconds) + speed * BEYOND_S
    shape = one.shape_at(t_s)
    shift = one.velocity_at(t_s) * seconds
    hull = shapely.union_all(list(shape.polygons)).convex_hull
    swept = shapely.union(hull, shapely.transform(hull, lambda p: p + shift)).convex_hull
    moved = Solids(np.array([swept], object), np.array([[shape.z_m[:, 0].min(), shape.z_m[:, 1].max()]]), ("",))
    return any(drive.gap(along_path(drive, t_s, s), moved).distance_m <= TOUCH_M
               for s in np.arange(0.0, reach + PATH_STEP_M, PATH_STEP_M).tolist())  # fmt: skip


def along_path(drive: Drive, t_s: float, ahead_m: float) -> MachineState:
    """The machine `ahead_m` further along the path that it drove, straight on beyond its end."""
    machine = drive.machine
    s = float(np.interp(t_s, machine.t_s, machine.path_m)) + ahead_m
    total = float(machine.path_m[-1])
    if s <= total:
        k = max(0, int(np.searchsorted(machine.path_m, s, side="right")) - 1)
        n = min(k + 1, len(machine.t_s) - 1)
        gap = machine.path_m[n] - machine.path_m[k]
        share = (s - machine.path_m[k]) / gap if gap > 0.0 else 0.0
        return machine.at(float(machine.t_s[k] + share * (machine.t_s[n] - machine.t_s[k])))
    end, sign = machine.at(float(machine.t_s[-1])), -1.0 if machine.at(t_s).speed_mps < 0.0 else 1.0
    over = sign * (s - total)
    x, y, _ = end.pose.ahead(over)
    return replace(end, x_m=x, y_m=y, yaw_rate_radps=0.0)


def closed_form_contact_mps(drive: Drive, one: ObjectTrack, known_s: float, speed_mps: float) -> float | None:
    """Speed at contact of a machine that brakes from `known_s` on by the closed form; None: it stands before."""
    for dt in np.arange(0.0, stopping_time(speed_mps) + STEP_S, 0.5 * STEP_S).tolist():
        speed = speed_after(speed_mps, dt)
        state = along_path(drive, known_s, travel_after(speed_mps, dt))
        t_s = min(known_s + dt, float(one.t_s[-1]))
        if speed > 0.0 and drive.gap(state, one.shape_at(t_s)).distance_m <= TOUCH_M:
            return speed
    return None


def _distance(drive: Drive, one: ObjectTrack, t_s: float) -> float:
    return drive.gap(drive.machine.at(t_s), one.shape_at(t_s)).distance_m


class Eyes:
    """Visibility of one object from the machine's outline, past all other solids."""

    def __init__(self, drive: Drive, one: ObjectTrack) -> None:
        self._drive, self._one = drive, one
        self._static = [(o, boxes_of(o.shapes[0])) for o in drive.objects if o.is_static]
        self._others = [o for o in drive.objects if not o.is_static and o is not one]
        self._seen: dict[float, bool] = {}

    def visible(self, t_s: float) -> bool:
        """Whether at least `MIN_SHARE` of it is visible from one point."""
        if t_s not in self._seen:
            self._seen[t_s] = self._visible(t_s)
        return self._seen[t_s]

    def _visible(self, t_s: float) -> bool:
        box = bounding_box(self._one.shape_at(t_s))
        state = self._drive.machine.at(t_s)
        views = [_view(p) for p in self._eyes(state)]
        hiding = [b for o in self._others if o.is_present(t_s) for b in boxes_of(o.shape_at(t_s))]
        there, here = box.center_m[:2], np.array([state.x_m, state.y_m])
        middle, reach = 0.5 * (there + here), 0.5 * float(np.hypot(*(there - here))) + 6.0
        near = [b for _, boxes in self._static for b in boxes if np.hypot(*(b.center_m[:2] - middle)) < reach]
        return visible_share(box, views, [*hiding, *near]) >= MIN_SHARE

    def _eyes(self, state: MachineState) -> Float64:
        """Points (N, 3) on the outlines of machine and implement, in `map`."""
        body = self._drive.body_at(state)
        count = len(self._drive.shapes.machine.names)
        points = []
        for part in (slice(0, count), slice(count, None)):
            if len(body.polygons[part]):
                x0, y0, x1, y1 = shapely.total_bounds(body.polygons[part]).tolist()
                top = float(body.z_m[part, 1].max()) - state.z_m
                grid = [(x, y) for x in (x0, 0.5 * (x0 + x1), x1) for y in (y0, 0.5 * (y0 + y1), y1)]
                ring = to_frame(state.pose, np.array(grid)).tolist()
                points += [(x, y, state.z_m + min(h, top)) for x, y in ring for h in EYE_HEIGHTS_M]
        return np.array(points)


def _view(point_m: Float64) -> View:
    T = np.eye(4)
    T[:3, 3] = point_m
    return View(T, ALL_AROUND, (-ALL_AROUND, ALL_AROUND), 1e3)


def bounding_box(shape: Solids) -> SolidBox:
    """Smallest upright box around solids."""
    return _box(shapely.union_all(list(shape.polygons)), float(shape.z_m[:, 0].min()), float(shape.z_m[:, 1].max()))


def boxes_of(shape: Solids) -> list[SolidBox]:
    """Smallest upright box around each solid."""
    return [_box(p, float(low), float(high)) for p, (low, high) in zip(shape.polygons, shape.z_m, strict=True)]


def _box(outline: shapely.Geometry, low_m: float, high_m: float) -> SolidBox:
    corners = shapely.get_coordinates(shapely.oriented_envelope(outline))
    along, across = corners[1] - corners[0], corners[2] - corners[1]
    middle = 0.5 * (corners[0] + corners[2])
    size = np.array([np.hypot(*along), np.hypot(*across), high_m - low_m])
    return SolidBox(np.array([*middle, 0.5 * (low_m + high_m)]), size, math.atan2(along[1], along[0]))
