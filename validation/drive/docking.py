"""Docking error: true pose at the end against the surveyed dock pose."""

import math
from dataclasses import dataclass

import numpy as np

from configs.site import Bay
from configs.vehicle import Implement, Vehicle, outlines
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.footprint import Bodies
from messages.plan import MissionState, PathSectionType
from validation.drive.record import DriveRecord, true_poses


@dataclass(frozen=True)
class Docking:
    """Distance from the dock pose, its parts along and to the left of the dock axis, and heading error."""

    error_m: float
    along_m: float
    across_m: float
    error_rad: float


def measure_docking(record: DriveRecord, bay: Bay | None) -> Docking | None:
    """Docking error; None without a bay or when the mission did not finish."""
    mission, truth = record.mission, record.truth
    if bay is None or not truth or not mission or mission[-1].state is not MissionState.FINISHED:
        return None
    x, y, yaw = true_poses(truth[-1:])[0]
    heading = math.radians(bay.dock.heading_deg)
    c, s, dx, dy = math.cos(heading), math.sin(heading), x - bay.dock.x_m, y - bay.dock.y_m
    return Docking(math.hypot(dx, dy), c * dx + s * dy, c * dy - s * dx, wrap(yaw - heading))


def docking_drive(record: DriveRecord) -> tuple[Float64, Float64]:
    """True poses (N, 3) and speeds (N,) since the first path of the last docking; empty without one."""
    paths = [p for p in record.paths.values() if p.sections and p.sections[0].section_type is PathSectionType.DOCK]
    last = record.mission[-1].stamp_ns if record.mission else 0
    others = [p.stamp_ns for p in record.paths.values() if p not in paths]
    begin_ns = min((p.stamp_ns for p in paths if p.stamp_ns > max(others, default=-1)), default=last + 1)
    truth = [m for m in record.truth if m.stamp_ns >= begin_ns]
    return true_poses(truth), np.array([m.speed_mps for m in truth])


def bodies_of(vehicle: Vehicle, implement: Implement) -> Bodies:
    """Outlines of machine and folded implement in base."""
    return outlines(vehicle.body, implement.folded)
