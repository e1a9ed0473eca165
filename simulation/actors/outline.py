r"""Sides of machine and implement on the ground, for placing objects beside them.

          wing_left ┌──┐ left  wheel_front_left
wing_rear_left      │  │ wing_front_left
               rear │  ├────────────────┐ front      each side has a middle and an outward direction;
                    │  ├────────────────┘            wings are what protrudes beyond the machine's width
wing_rear_right     │  │ wing_front_right
         wing_right └──┘ right  wheel_front_right
"""

import math
from dataclasses import dataclass
from functools import partial

from shapely import MultiPoint, transform
from shapely.geometry.base import BaseGeometry

from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.arrays import Float32
from geometry.pose2 import Pose2, to_frame
from simulation.machine.body import implement_outline_m, machine_outline_m
from simulation.machine.implement import extent_m, origin_m
from simulation.machine.machine import Machine

CLEAR_STEP_M, TOUCH_M2 = 0.05, 1e-4


@dataclass(frozen=True)
class Outline:
    """Machine and implement at one instant: pose of base, heading of the implement, its present width."""

    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement
    base: Pose2
    implement_yaw_rad: float

    @staticmethod
    def of(machine: Machine, vehicle: Vehicle) -> "Outline":
        """The outline now."""
        base = Pose2(machine.x_m, machine.y_m, machine.yaw_rad)
        return Outline(vehicle, machine.attached.current, base, machine.attached.yaw_rad)

    @property
    def ground(self) -> BaseGeometry:
        """Ground covered, in `map`."""
        tool = implement_outline_m(self.implement, self.base, self.implement_yaw_rad)
        return machine_outline_m(self.vehicle, self.base).union(tool)

    @property
    def ends_m(self) -> tuple[float, float]:
        """x of the front and rear end in `base`; a trailed implement counts as straight behind."""
        offset = 0.0 if isinstance(self.implement, MountedImplement) else self.implement.hitch_m
        return self.vehicle.body.front_m, min(-self.vehicle.body.rear_m, offset + extent_m(self.implement)[1])

    def side(self, name: str) -> Pose2:
        """Middle of a side in `map` and its outward direction."""
        body, (ahead, behind), half = self.vehicle.body, extent_m(self.implement), 0.5 * self.implement.width_m
        is_left = name.endswith("left")
        sign, across = (1.0, 0.5 * math.pi) if is_left else (-1.0, -0.5 * math.pi)
        wing = 0.5 * (0.5 * body.width_m + half)
        d = self.vehicle.drivetrain
        origin = origin_m(self.implement, self.base)
        tool = Pose2(float(origin[0]), float(origin[1]), self.implement_yaw_rad)
        places: dict[str, tuple[Pose2, tuple[float, float, float]]] = {
            "front": (self.base, (body.front_m, 0.0, 0.0)),
            "rear": (tool, (behind, 0.0, math.pi)),
            "side": (self.base, (0.5 * (body.front_m - body.rear_m), 0.5 * sign * body.width_m, across)),
            "wing_front": (tool, (ahead, sign * wing, 0.0)),
            "wing_rear": (tool, (behind, sign * wing, math.pi)),
            "wing": (tool, (0.5 * (ahead + behind), sign * half, across)),
            "wheel_front": (self.base, (d.wheelbase_m, 0.5 * sign * d.track_m, across)),
            "wheel_rear": (self.base, (0.0, 0.5 * sign * body.width_m, across)),
        }
        key = name if name in ("front", "rear") else name.removesuffix("left").removesuffix("right").rstrip("_")
        frame, place = places[key or "side"]
        return frame @ Pose2(*place)

    def beside(
        self, name: str, gap_m: float, along_m: float, vertices_m: Float32, yaw_rad: float
    ) -> tuple[float, float]:
        """Origin in `map` of a body of these vertices and heading, `gap_m` outside a side and `along_m` along it.

        `along_m` is forward on the left and right and to the left in front and behind.
        """
        middle = self.side(name)
        u, v = (
            math.cos(middle.yaw_rad - yaw_rad),
            math.sin(middle.yaw_rad - yaw_rad),
        )  # outward, in the frame of the body
        away = gap_m - float((vertices_m[:, 0] * u + vertices_m[:, 1] * v).min())
        is_across = name in ("left", "right", "wing_left", "wing_right") or name.startswith("wheel")
        turns_left = name.endswith("right") if is_across else "front" in name
        return middle.ahead(away).beside(along_m if turns_left else -along_m)[:2]

    def cleared(
        self, name: str, place_m: tuple[float, float], vertices_m: Float32, yaw_rad: float
    ) -> tuple[float, float]:
        """`place_m` moved until a body there overlaps no part of machine and implement.

        It moves outward or, before and behind a wing, away from the middle, whichever is less: a long body before a
        wing, and any before a folded one, would begin within the rear wheel.
        """
        ground, hull, outward_rad = self.ground, MultiPoint(vertices_m[:, :2]).convex_hull, self.side(name).yaw_rad
        aside_rad = self.base.yaw_rad + (0.5 * math.pi if name.endswith("left") else -0.5 * math.pi)
        ways = [Pose2(*place_m, direction) for direction in (aside_rad, outward_rad)[0 if "wing" in name else 1 :]]
        while True:
            for way in ways:
                body = transform(hull, partial(to_frame, Pose2(way.x_m, way.y_m, yaw_rad)))
                if body.intersection(ground).area < TOUCH_M2:
                    return way.x_m, way.y_m
            ways = [way.ahead(CLEAR_STEP_M) for way in ways]
