"""Implement on a drawbar: its heading follows the motion of the hitch (tractrix).

While the hitch moves straight by d, tan(β/2) of the angle β between its direction of motion and the heading of the
implement becomes tan(β/2)·exp(−d/L), L the distance of the axle behind the hitch. That is exact along a polyline, for
any step, forwards and in reverse, where the angle grows.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.jit import kernel
from geometry.rectangle import Rectangle

JUMP_M = 2.0  # between two poses of a display: the path between them is unknown


@dataclass(frozen=True)
class Drawbar:
    """Hitch of a trailed implement along x of base, and distance of its axle behind the hitch."""

    hitch_m: float
    axle_m: float


@dataclass(frozen=True)
class Trailer:
    """A trailed implement: its rectangle in the frame of the hitch (x along its own heading), on its drawbar."""

    body: Rectangle
    drawbar: Drawbar


@kernel
def follow(yaw_rad: float, dx_m: float, dy_m: float, axle_m: float) -> float:
    """Heading of a trailed implement after its hitch has moved straight by (dx, dy)."""
    distance = math.hypot(dx_m, dy_m)
    if distance < 1e-12:
        return yaw_rad
    beta = math.atan2(dy_m, dx_m) - yaw_rad
    beta -= 2.0 * math.pi * math.floor((beta + math.pi) / (2.0 * math.pi))
    return float(yaw_rad + beta - 2.0 * math.atan(math.tan(0.5 * beta) * math.exp(-distance / axle_m)))


@kernel
def trail(p_m: Float64, heading_rad: Float64, hitch_rad: float, hitch_m: float, axle_m: float) -> Float64:
    """Poses (N, 3) of the hitch with the implement's heading, for poses (N, 2), (N,) of base in driving order."""
    found = np.empty((len(p_m), 3))
    for k in range(len(p_m)):
        found[k, 0] = p_m[k, 0] + hitch_m * math.cos(heading_rad[k])
        found[k, 1] = p_m[k, 1] + hitch_m * math.sin(heading_rad[k])
        if k == 0:
            found[k, 2] = heading_rad[k] + hitch_rad
        else:
            dx, dy = found[k, 0] - found[k - 1, 0], found[k, 1] - found[k - 1, 1]
            found[k, 2] = follow(found[k - 1, 2], dx, dy, axle_m)
    return found


def hitch_poses(
    drawbar: Drawbar, p_m: Float64, heading_rad: Float64, hitch_rad: float = 0.0, is_closed: bool = False
) -> Float64:
    """Poses (N, 3) of the hitch with the implement's heading, for poses (N, 2), (N,) of base in driving order.

    `hitch_rad` is the heading of the implement relative to the machine at the first pose; on a closed line, whose last
    pose is its first, it is that after driving around it once.
    """
    p_m, heading_rad = np.ascontiguousarray(p_m, np.float64), np.ascontiguousarray(heading_rad, np.float64)
    found = trail(p_m, heading_rad, hitch_rad, drawbar.hitch_m, drawbar.axle_m)
    if is_closed:
        again = float(found[-1, 2] - heading_rad[-1])
        found = trail(p_m, heading_rad, again, drawbar.hitch_m, drawbar.axle_m)
    return found


def steady_angle(drawbar: Drawbar, curvature_radpm: float) -> float:
    """Heading of a trailed implement relative to the machine in steady driving on a curvature."""
    swing = math.atan(curvature_radpm * drawbar.hitch_m)
    return swing - math.asin(max(-1.0, min(1.0, drawbar.axle_m * curvature_radpm * math.cos(swing))))


def curvature_of(drawbar: Drawbar, hitch_rad: float) -> float:
    """Curvature on which the steady hitch angle has this magnitude: driving forwards on less never exceeds it."""
    return math.sin(hitch_rad) / (drawbar.axle_m - drawbar.hitch_m * math.cos(hitch_rad))


def run_in_m(drawbar: Drawbar, first_rad: float, last_rad: float) -> float:
    """Straight distance in which the hitch angle decays from one magnitude to a smaller one."""
    return drawbar.axle_m * math.log(math.tan(0.5 * first_rad) / math.tan(0.5 * last_rad))


class Follower:
    """Hitch angle of a trailed implement along the poses (x, y, yaw) of base: in line at first, and after a jump."""

    def __init__(self, hitch_m: float, axle_m: float) -> None:
        self.hitch_rad = 0.0
        self._drawbar = Drawbar(hitch_m, axle_m)
        self._pose: tuple[float, float, float] | None = None

    def move(self, pose: tuple[float, float, float]) -> None:
        """Follows the hitch to the next pose; one that is not finite is left out."""
        if not all(map(math.isfinite, pose)):
            return
        before, self._pose = self._pose, pose
        if before is None or math.hypot(pose[0] - before[0], pose[1] - before[1]) > JUMP_M:
            self.hitch_rad = 0.0
            return
        (x, y), (to_x, to_y) = (self._hitch(p) for p in (before, pose))
        yaw = follow(before[2] + self.hitch_rad, to_x - x, to_y - y, self._drawbar.axle_m)
        self.hitch_rad = math.remainder(yaw - pose[2], 2.0 * math.pi)

    def _hitch(self, pose: tuple[float, float, float]) -> tuple[float, float]:
        return (
            pose[0] + self._drawbar.hitch_m * math.cos(pose[2]),
            pose[1] + self._drawbar.hitch_m * math.sin(pose[2]),
        )
