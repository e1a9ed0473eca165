"""Self filter: outline of machine and implement, inside which measurements are no obstacles."""

import numpy as np

from configs.vehicle import FOLDED, Implement, Vehicle, outlines
from geometry.arrays import Bool, Float64
from messages.command import MachineState


def is_folded(machine: MachineState | None) -> bool:
    """Whether the implement is known to be folded; unknown counts as unfolded (wide)."""
    return machine is not None and machine.fold_position >= FOLDED


def own_outlines(vehicle: Vehicle, implement: Implement | None) -> tuple[Float64, Float64]:
    """`own_outline` with the implement unfolded and folded, indexed by `is_folded`."""
    return own_outline(vehicle, implement), own_outline(vehicle, implement and implement.folded)


def own_outline(vehicle: Vehicle, implement: Implement | None, margin_m: float = 0.0) -> Float64:
    """Machine and implement as rectangles in the plane of `base`, (K, 2, 2): lowest and highest corner."""
    m = margin_m
    corners = [
        [[r.rear_m - m, -(r.half_width_m + m)], [r.front_m + m, r.half_width_m + m]]
        for r in outlines(vehicle.body, implement)
    ]
    return np.array(corners, np.float64)


def is_inside(p_base_m: Float64, corners: Float64) -> Bool:
    """Whether points (N, 2) lie in any of the rectangles (K, 2, 2)."""
    p = p_base_m[:, None, :2]
    within = np.logical_and(p > corners[:, 0], p < corners[:, 1])
    return np.asarray(np.any(np.all(within, axis=2), axis=1))
