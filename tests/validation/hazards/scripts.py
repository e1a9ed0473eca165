"""Truth scripts: a machine of boxes, motions and objects with closed-form results."""

import numpy as np

from geometry.prism import Prism, Solids
from validation.hazards.tracks import Drive, MachineTrack, ObjectTrack, Shapes

FRONT_M, REAR_M, HALF_M, TOP_M = 3.5, -1.0, 1.15, 2.9
TOOL_FRONT_M, TOOL_REAR_M, TOOL_HALF_M, TOOL_LOW_M, TOOL_TOP_M, LIFT_M = -1.1, -2.4, 3.0, 0.05, 0.95, 0.6
DT_S = 0.05


def box(name, x0, y0, z0, x1, y1, z1):
    """One upright box as a prism."""
    return Prism(name, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float), z0, z1)


def shapes():
    """A machine of one box above 0.4 m, and an implement of half-metre pieces."""
    ys = np.arange(-TOOL_HALF_M, TOOL_HALF_M, 0.5)
    tool = [box("implement", TOOL_REAR_M, y, TOOL_LOW_M, TOOL_FRONT_M, y + 0.5, TOOL_TOP_M) for y in ys]
    body = box("body", REAR_M, -HALF_M, 0.4, FRONT_M, HALF_M, TOP_M)
    return Shapes(Solids.of([body]), Solids.of(tool), 2.0 * HALF_M, 0.0, LIFT_M, (6.0, 6.0))


def machine(speed, seconds=8.0, yaw_rate=0.0, hitch=1.0, pto=0.0):
    """Motion from the origin along x with a speed (number or function of time), constant yaw rate, hitch and PTO."""
    t = np.arange(0.0, seconds + 1e-9, DT_S)
    v = np.array([speed(x) if callable(speed) else speed for x in t], float)
    yaw = yaw_rate * t
    if yaw_rate:
        r = v / yaw_rate
        x, y = r * np.sin(yaw), r * (1.0 - np.cos(yaw))
    else:
        x, y = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * DT_S)]), np.zeros_like(t)
    lift = np.array([hitch(x) if callable(hitch) else hitch for x in t], float)
    pose = np.column_stack([x, y, np.zeros_like(t), yaw])
    still = np.zeros_like(t)
    return MachineTrack(t, pose, v, np.zeros((len(t), 2)), yaw, lift, still, still + pto)


def still_object(x, y, z=(0.0, 1.0), half=0.25, **more):
    """A box that stands from the beginning."""
    return moving_object([(0.0, x, y)], z, half, seconds=20.0, **more)


def moving_object(knots, z=(0.0, 1.7), half=0.25, seconds=8.0, name="object", kind="adult", **more):
    """A box through (time, x, y), standing before the first and after the last knot; sampled with 10 Hz."""
    t = np.arange(0.0, seconds + 1e-9, 0.1)
    kt, kx, ky = (np.array(column, float) for column in zip(*knots, strict=True))
    x, y = np.interp(t, kt, kx), np.interp(t, kt, ky)
    after = t + 1e-3
    velocity = np.column_stack([np.interp(after, kt, kx) - x, np.interp(after, kt, ky) - y]) / 1e-3
    solids = tuple(Solids.of([box("", a - half, b - half, z[0], a + half, b + half, z[1])])
                   for a, b in zip(x, y, strict=True))  # fmt: skip
    return ObjectTrack(name, kind, t, np.column_stack([x, y]), velocity, solids, **more)


def wall(x0, y0, x1, y1, top=2.5):
    """A solid of the site."""
    still = np.zeros((1, 2))
    return ObjectTrack("site", "wall", np.zeros(1), still, still,
                       (Solids.of([box("wall", x0, y0, 0.0, x1, y1, top)]),), is_static=True)  # fmt: skip


def drive(track, *objects):
    """Truth of a drive of this machine."""
    return Drive(track, shapes(), tuple(objects))
