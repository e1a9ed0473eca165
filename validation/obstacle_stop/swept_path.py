"""Swept path: the outlines of a machine along a path, and the distance along it to the first contact with a box.

Numbers only, no messages: the same for a recording, for its ghost and for a simulated machine. Forward, reverse, in
bends and with an implement alike, because the path is a sequence of poses in the order in which they are driven.

The physical outline decides contact. *In the path* is what the outline with the side margin of the conditions would
touch: labels, odometry and steering are not exact to a decimetre, and nobody wants to be passed closer. On a planned
path the margin is 0, because its distance to objects is planned.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import Float64
from geometry.drawbar import Trailer, hitch_poses
from geometry.polyline import arc_length
from geometry.rectangle import Rectangle

STEP_M = 0.1


@dataclass(frozen=True, eq=False)
class Outline:
    """Rectangles of machine and mounted implement in base, and a trailed implement."""

    bodies: tuple[Rectangle, ...]
    trailer: Trailer | None = None

    def widened(self, by_m: float) -> "Outline":
        """The same with a margin on either side."""
        trailer = self.trailer
        if trailer is not None:
            trailer = replace(trailer, body=_wider(trailer.body, by_m))
        return Outline(tuple(_wider(body, by_m) for body in self.bodies), trailer)


def _wider(body: Rectangle, by_m: float) -> Rectangle:
    return Rectangle(body.rear_m, body.front_m, body.width_m + 2.0 * by_m)


@dataclass(frozen=True, eq=False)
class Body:
    """One rectangle along the path: its centres with heading (M, 3) and half extents (2,)."""

    poses: Float64
    half_m: Float64

    @property
    def radius_m(self) -> float:
        """Of the circle about the centre."""
        return float(np.hypot(*self.half_m))


@dataclass(frozen=True, eq=False)
class SweptPath:
    """Poses (M, 3: x, y, unwrapped yaw) of base at the distances `s_m` (M,) in driving order, with the outline."""

    s_m: Float64
    poses: Float64
    bodies: tuple[Body, ...]

    def gap_m(self, s_m: float, box_pose: Float64, box_half_m: Float64, reach_m: float = math.inf) -> float:
        """Distance from `s_m` along the path until the outline touches a box (pose (3,), half size (2,)).

        0 when it touches now, infinite when it does not within `reach_m`.
        """
        first = max(0, int(np.searchsorted(self.s_m, s_m, side="right")) - 1)
        last = int(np.searchsorted(self.s_m, s_m + reach_m)) + 1
        touches = [self._first_touch_m(body, first, last, box_pose, box_half_m) for body in self.bodies]
        return max(0.0, min(touches) - s_m)

    def _first_touch_m(self, body: Body, first: int, last: int, pose: Float64, half_m: Float64) -> float:
        reach = body.radius_m + float(np.hypot(*half_m))
        d = body.poses[first:last, :2] - pose[:2]
        near = np.flatnonzero(d[:, 0] ** 2 + d[:, 1] ** 2 <= reach**2)
        if not len(near):
            return math.inf
        rows = first + near
        apart = separation_m(body.poses[rows], body.half_m, pose, half_m)
        hits = np.flatnonzero(apart < 0.0)
        if not len(hits):
            return math.inf
        k = int(hits[0])
        row = rows[k]
        if row == first or k == 0 or rows[k - 1] != row - 1:
            return float(self.s_m[row])
        share = apart[k - 1] / (apart[k - 1] - apart[k])
        return float(self.s_m[row - 1] + share * (self.s_m[row] - self.s_m[row - 1]))

    def separations_m(self, s_m: Float64, box_poses: Float64, box_half_m: Float64) -> Float64:
        """Separation (N,) of the outline at distances (N,) from a box at poses (N, 3); below 0: contact."""
        apart = [
            separation_m(np.column_stack([np.interp(s_m, self.s_m, body.poses[:, k]) for k in range(3)]),
                         body.half_m, box_poses, box_half_m)
            for body in self.bodies
        ]  # fmt: skip
        return np.asarray(np.min(apart, axis=0))

    def pose_at(self, s_m: float) -> Float64:
        """Pose (3,) of base at a distance."""
        return np.array([np.interp(s_m, self.s_m, self.poses[:, k]) for k in range(3)])


def separation_m(poses: Float64, half_m: Float64, box_poses: Float64, box_half_m: Float64) -> Float64:
    """Greatest gap between rectangles (poses (..., 3), half extents (2,)) along the axes of both; below 0: overlap.

    Separating axis theorem: exact in sign, at most the distance.
    """
    dx, dy = box_poses[..., 0] - poses[..., 0], box_poses[..., 1] - poses[..., 1]
    turn = box_poses[..., 2] - poses[..., 2]
    ct, st = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    (a, b), (p, q) = half_m, box_half_m
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    own = np.maximum(np.abs(c * dx + s * dy) - a - p * ct - q * st, np.abs(c * dy - s * dx) - b - p * st - q * ct)
    c, s = np.cos(box_poses[..., 2]), np.sin(box_poses[..., 2])
    other = np.maximum(np.abs(c * dx + s * dy) - p - a * ct - b * st, np.abs(c * dy - s * dx) - q - a * st - b * ct)
    return np.asarray(np.maximum(own, other))


def swept_path(s_m: Float64, poses: Float64, outline: Outline, is_forward: bool) -> SweptPath:
    """Swept path through poses (N, 3) of base at increasing distances (N,), about `STEP_M` apart.

    A trailed implement follows its hitch when driving forward, starting in line; in reverse it stays in line.
    """
    grid = np.append(np.arange(s_m[0], s_m[-1], STEP_M), s_m[-1])
    yaw = np.unwrap(poses[:, 2])
    dense = np.column_stack([np.interp(grid, s_m, column) for column in (poses[:, 0], poses[:, 1], yaw)])
    bodies = [_body(body, dense) for body in outline.bodies]
    if outline.trailer is not None:
        bodies.append(_body(outline.trailer.body, _hitch_poses(outline.trailer, dense, is_forward)))
    return SweptPath(grid, dense, tuple(bodies))


def _body(body: Rectangle, carrier: Float64) -> Body:
    middle = 0.5 * (body.front_m + body.rear_m)
    x, y = carrier[:, 0] + middle * np.cos(carrier[:, 2]), carrier[:, 1] + middle * np.sin(carrier[:, 2])
    half = np.array([0.5 * (body.front_m - body.rear_m), body.half_width_m])
    return Body(np.column_stack([x, y, carrier[:, 2]]), half)


def _hitch_poses(trailer: Trailer, poses: Float64, is_forward: bool) -> Float64:
    found = hitch_poses(trailer.drawbar, poses[:, :2], poses[:, 2])
    return found if is_forward else np.column_stack([found[:, :2], poses[:, 2]])


def arc(pose: Float64, curvature_radpm: float, distances_m: Float64) -> Float64:
    """Poses (K, 3) on a circle at signed distances (K,) from a pose (3,)."""
    turn = curvature_radpm * distances_m
    chord = distances_m * np.sinc(turn / (2.0 * math.pi))
    x, y = pose[0] + chord * np.cos(pose[2] + 0.5 * turn), pose[1] + chord * np.sin(pose[2] + 0.5 * turn)
    return np.column_stack([x, y, pose[2] + turn])


def joined(poses: Float64, beyond: Float64) -> tuple[Float64, Float64]:
    """Poses with others that follow, and the distance (N,) of each along their line."""
    both = np.vstack([poses, beyond])
    keep = np.concatenate([[True], np.hypot(*np.diff(both[:, :2], axis=0).T) > 1e-6])
    return both[keep], arc_length(both[keep, :2])
