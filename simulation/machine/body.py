"""Shape of machine and implement: meshes for sensors, outlines on the ground.

Own geometry instead of `configs.vehicle.outlines`: simulation shares no machine model with control.
"""

import math

from shapely import Polygon

from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.arrays import Float64
from geometry.transforms import planar
from simulation.environment.meshes import Mesh, box, join, limb
from simulation.machine.implement import extent_m, origin_m

LIFT_M, FRAME_M = 0.6, 0.9  # stroke of the hitch; height of the lowered implement's frame


def machine_parts(vehicle: Vehicle) -> dict[str, Mesh]:
    """Frame, hood, ballast, cab, mudguards and wheels within the body's extent, in `base`."""
    b, d = vehicle.body, vehicle.drivetrain
    wheel, front = d.wheel_radius_m, 0.62 * d.wheel_radius_m
    half = 0.5 * b.width_m
    cab_front = 0.45 * d.wheelbase_m
    parts = {
        "frame": box((-b.rear_m, -0.35, 0.4), (b.front_m - 0.3, 0.35, 0.9)),
        "hood": box((cab_front, -0.42, 0.9), (b.front_m - 0.25, 0.42, 0.57 * b.height_m)),
        "ballast": box((b.front_m - 0.25, -0.4, 0.55), (b.front_m, 0.4, 1.0)),
        "cab": box((-0.8, -0.75, 1.0), (cab_front, 0.75, b.height_m)),
    }
    sides = {"left": 1.0, "right": -1.0}
    for name, s in sides.items():
        low, high = s * half - 0.25 * (1 + s), s * half + 0.25 * (1 - s)
        parts[f"mudguard_{name}"] = box((-0.8, low, 2.0 * wheel), (0.7, high, 2.0 * wheel + 0.06))
    for name, s in sides.items():
        parts[f"wheel_rear_{name}"] = limb((0.0, s * half, wheel), (0.0, s * (half - 0.45), wheel), wheel, 16)
        x = d.wheelbase_m
        ends = (x, s * 0.5 * d.track_m, front), (x, s * (0.5 * d.track_m - 0.35), front)
        parts[f"wheel_front_{name}"] = limb(*ends, front, 16)
    return parts


def machine_mesh(vehicle: Vehicle) -> Mesh:
    """All of the machine's parts as one mesh, in `base`."""
    return join(list(machine_parts(vehicle).values()))


def implement_parts(implement: MountedImplement | TrailedImplement, hitch: float) -> dict[str, Mesh]:
    """Its frame as a box, raised by the hitch, and its linkage, about its origin."""
    (ahead, behind), half = extent_m(implement), 0.5 * implement.width_m
    low = 0.05 + LIFT_M * hitch
    frame = box((behind, -half, low), (ahead, half, low + FRAME_M))
    return {"implement": frame, "linkage": box((ahead, -0.25, 0.4), (0.0, 0.25, 0.6))}


def implement_mesh(implement: MountedImplement | TrailedImplement, hitch: float) -> Mesh:
    """All of the implement's parts as one mesh, about its origin."""
    return join(list(implement_parts(implement, hitch).values()))


def machine_outline_m(vehicle: Vehicle, base: tuple[float, float, float]) -> Polygon:
    """Ground covered by the machine alone at (x, y, yaw)."""
    half = 0.5 * vehicle.body.width_m
    return _rectangle(base, vehicle.body.front_m, -vehicle.body.rear_m, half)


def implement_outline_m(
    implement: MountedImplement | TrailedImplement, base: tuple[float, float, float], yaw_rad: float
) -> Polygon:
    """Ground covered by the implement at its own heading."""
    origin = origin_m(implement, base)
    ahead, behind = extent_m(implement)
    return _rectangle((float(origin[0]), float(origin[1]), yaw_rad), ahead, behind, 0.5 * implement.width_m)


def _rectangle(pose: tuple[float, float, float], ahead_m: float, behind_m: float, half_m: float) -> Polygon:
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    corners = [(ahead_m, half_m), (behind_m, half_m), (behind_m, -half_m), (ahead_m, -half_m)]
    return Polygon([(x + u * c - v * s, y + u * s + v * c) for u, v in corners])


def T_base_implement(implement: MountedImplement | TrailedImplement, articulation_rad: float) -> Float64:
    """Pose of the implement's origin in `base`, (4, 4); `articulation_rad`: its heading against the machine's."""
    offset = 0.0 if isinstance(implement, MountedImplement) else implement.hitch_m
    return planar(offset, 0.0, articulation_rad)
