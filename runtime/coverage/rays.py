"""Rays of a lidar in `base`, and how far machine and implement let them through."""

import numpy as np

from configs.vehicle import Implement, Lidar, MountedImplement, Vehicle
from geometry.arrays import Float64


def rays_of(lidar: Lidar, hitch: float) -> Float64:
    """Origin and direction in base (N, 6) of every ray of one scan at a hitch position (0 lowest, 1 highest)."""
    fov = np.radians(lidar.field_of_view_deg)
    azimuth = fov * ((np.arange(lidar.columns) + 0.5) / lidar.columns - 0.5)
    elevation, azimuth = (a.ravel() for a in np.meshgrid(np.radians(lidar.elevation_deg), azimuth, indexing="ij"))
    local = np.column_stack([
        np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    ])  # fmt: skip
    T = lidar.mount.at_hitch(hitch)
    return np.column_stack([np.broadcast_to(T[:3, 3], local.shape), local @ T[:3, :3].T])


def solids_of(vehicle: Vehicle, implement: Implement | None, is_raised: bool, is_folded: bool) -> Float64:
    """Boxes (K, 2, 3: lowest and highest corner) in base of machine and implement, a trailed one straight behind.

    A machine without `body.solids` is one box; a lowered implement reaches down to the ground. A trailed one, whose
    height no file states, hides everything up to the machine's height.
    """
    body = vehicle.body
    boxes = [np.transpose([one.x_m, one.y_m, one.z_m]) for one in body.solids.values()]
    if not boxes:
        half = 0.5 * body.width_m
        boxes = [np.array([[-body.rear_m, -half, 0.0], [body.front_m, half, body.height_m]])]
    if implement is not None:
        shape = implement.folded if is_folded else implement
        (front_m, rear_m), half = shape.ends_m, 0.5 * shape.width_m
        low_m, high_m = 0.0, body.height_m
        if isinstance(shape, MountedImplement):
            low_m = shape.lift_m if is_raised else 0.0
            high_m = low_m + shape.height_m
        boxes.append(np.array([[rear_m, -half, low_m], [front_m, half, high_m]]))
    return np.array(boxes, np.float64)


def free_range_m(rays: Float64, boxes: Float64) -> Float64:
    """Range (N,) up to which each ray (N, 6) meets none of the boxes (K, 2, 3); 0 for one that begins in a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        free = np.full(len(rays), np.inf)
        for low, high in boxes:
            bounds = (np.stack([low, high])[:, None, :] - rays[:, :3]) / rays[:, 3:]
            # parallel to a face and on it: outside
            near, far = np.nan_to_num(np.sort(bounds, axis=0), nan=np.inf, posinf=np.inf, neginf=-np.inf)
            enter, leave = near.max(axis=1), far.min(axis=1)
            is_met = (enter < leave) & (leave > 0.0)
            free = np.where(is_met, np.minimum(free, np.maximum(enter, 0.0)), free)
    return free
