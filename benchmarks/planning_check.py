"""Independent check of a plan: a second implementation of the sweep, of the worked area, and of the curvature.

It reads the outline of machine and implement, the polygon of the field and the points of the paths, and shares no code
with the planner. A trailed implement is pulled along the paths in steps of a centimetre by its equation of motion.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from messages.plan import Path, PathSectionType

STRAIGHT_RAD = 0.005
PULL_M = 0.01


@dataclass(frozen=True)
class Finding:
    """Distance outside the free area, share of the field worked, greatest curvature and gap, lengths by use.

    Of a trailed implement also the greatest hitch angle, and the distance of its working line from the line of the
    machine where work on swaths begins.
    """

    outside_m: float
    coverage: float
    curvature_radpm: float
    gap_m: float
    length_m: float
    working_m: float
    reverse_m: float
    cusps: int
    uncovered: BaseGeometry
    hitch_rad: float = 0.0
    off_line_m: float = 0.0


def check(
    paths: Sequence[Path], field: BaseGeometry, free: BaseGeometry, vehicle: Vehicle,
    implement: MountedImplement | TrailedImplement,
) -> Finding:  # fmt: skip
    """Checks complete paths; `field` is what is to be worked, `free` where machine and implement may be."""
    machine = -vehicle.body.rear_m, vehicle.body.front_m, vehicle.body.width_m
    drives = [_Drive(path.p_map_m[:, 0] + 1j * path.p_map_m[:, 1], path.heading_rad) for path in paths]
    if isinstance(implement, TrailedImplement):
        carried = _pulled(drives, implement)
        widths, ends, work_m = (
            [implement.width_m] * len(paths),
            (-implement.total_length_m, 0.0),
            -implement.working_length_m,
        )
    else:
        carried, transport_m = drives, implement.width_m if implement.fold is None else implement.fold.width_m
        widths = [transport_m if path.is_transport else implement.width_m for path in paths]
        ends, work_m = (implement.rear_end_m, implement.front_end_m), implement.working_point_m
    works = [path.is_working > 0 for path in paths]
    found = [_hulls(drive, work, *machine) for drive, work in zip(drives, works, strict=True)]
    found += [_hulls(c, w, *ends, width) for c, w, width in zip(carried, works, widths, strict=True)]
    hulls = np.concatenate(found)
    shapely.prepare(free)
    out = hulls[~shapely.covers(free, hulls)]
    outside = max((_depth(h, free) for h in out), default=0.0)
    line = work_m + 0.5j * implement.working_width_m * np.array([1.0, -1.0])
    strips = np.concatenate([_strips(c, w, line) for c, w in zip(carried, works, strict=True)])
    missed = field.difference(shapely.union_all(strips, grid_size=1e-6))
    return Finding(
        outside,
        1.0 - missed.area / field.area,
        max(_curvature(path) for path in paths),
        max((_gap(a, b) for a, b in pairwise(paths)), default=0.0),
        sum(float(np.hypot(*np.diff(p.p_map_m, axis=0).T).sum()) for p in paths),
        sum(float((np.hypot(*np.diff(p.p_map_m, axis=0).T) * (p.is_working[1:] > 0)).sum()) for p in paths),
        sum(float(np.hypot(*np.diff(p.p_map_m, axis=0).T).sum()) for p in paths if p.direction < 0),
        sum(a.direction != b.direction for a, b in pairwise(paths)),
        missed,
        max(float(np.abs(np.angle(np.exp(1j * (c.heading_rad - d.heading_rad)))).max())
            for c, d in zip(carried, drives, strict=True)),
        max((_off_line(p, c, work_m) for p, c in zip(paths, carried, strict=True)), default=0.0),
    )  # fmt: skip


@dataclass(frozen=True)
class _Drive:
    """Places in the complex plane (N,) and headings (N,) of a body, in driving order."""

    z_m: np.ndarray
    heading_rad: np.ndarray


def _pulled(drives: Sequence[_Drive], implement: TrailedImplement) -> list[_Drive]:
    """Hitch and heading of a trailed implement, in line at first: its wheels roll along it, without slip."""
    found, yaw = list[_Drive](), float(drives[0].heading_rad[0])
    for drive in drives:
        heading = np.unwrap(drive.heading_rad)
        count = np.maximum(np.ceil(np.abs(np.diff(drive.z_m)) / PULL_M).astype(int), 1)
        fine = np.concatenate([[0.0], *(k + np.arange(1, n + 1) / n for k, n in enumerate(count))])
        every = np.arange(len(heading))
        z = np.interp(fine, every, drive.z_m.real) + 1j * np.interp(fine, every, drive.z_m.imag)
        hitch = z + implement.hitch_m * np.exp(1j * np.interp(fine, every, heading))
        yaws = [yaw]
        for step in np.diff(hitch):
            half = yaw + 0.5 * (step * np.exp(-1j * yaw)).imag / implement.axle_length_m
            yaw += float((step * np.exp(-1j * half)).imag) / implement.axle_length_m
            yaws.append(yaw)
        at = np.concatenate([[0], np.cumsum(count)])
        found.append(_Drive(hitch[at], np.array(yaws)[at]))
    return found


def _off_line(path: Path, carried: _Drive, work_m: float) -> float:
    """Greatest distance of the middle of the working line from the line of a swath where work on it begins."""
    off = [0.0]
    for section in path.sections:
        if section.section_type is PathSectionType.SWATH:
            k = section.first + 1  # the first point with work
            z, heading = path.p_map_m[k, 0] + 1j * path.p_map_m[k, 1], path.heading_rad[k]
            middle = carried.z_m[k] + work_m * np.exp(1j * carried.heading_rad[k])
            off.append(abs(float(((middle - z) * np.exp(-1j * heading)).imag)))
    return max(off)


def _steps(drive: _Drive, work: np.ndarray) -> np.ndarray:
    """Indices of poses between which a body goes straight or turns by less than `STRAIGHT_RAD`, both ends included."""
    level = np.floor(np.unwrap(drive.heading_rad) / STRAIGHT_RAD)
    changes = np.flatnonzero((np.diff(level) != 0) | (work[1:] != work[:-1]))
    return np.unique(np.concatenate([[0], changes, changes + 1, [len(level) - 1]]))


def _hulls(drive: _Drive, work: np.ndarray, rear: float, front: float, width: float) -> np.ndarray:
    """Hulls of the footprints at both ends of each step."""
    along, across = np.array([rear, front, front, rear]), np.array([-1.0, -1.0, 1.0, 1.0]) * width / 2.0
    at = _steps(drive, work)
    corners = drive.z_m[at, None] + np.exp(1j * drive.heading_rad[at])[:, None] * (along + 1j * across)
    pairs = np.concatenate([corners[:-1], corners[1:]], axis=1)
    return np.asarray(shapely.convex_hull(shapely.multipoints(np.stack([pairs.real, pairs.imag], axis=-1))))


def _depth(hull: BaseGeometry, free: BaseGeometry) -> float:
    """Greatest distance of the part outside from the free area."""
    out = hull.difference(free)
    return max((float(free.distance(shapely.Point(p))) for p in shapely.get_coordinates(out)), default=0.0)


def _strips(drive: _Drive, work: np.ndarray, line_m: np.ndarray) -> np.ndarray:
    """Hulls of the working line (2,), complex in the frame of its carrier, at both ends of each step with work."""
    at = _steps(drive, work)
    ends = drive.z_m[at, None] + np.exp(1j * drive.heading_rad[at])[:, None] * line_m
    work = work[at]
    pairs = np.concatenate([ends[:-1], ends[1:]], axis=1)[work[:-1] & work[1:]]
    return np.asarray(shapely.convex_hull(shapely.multipoints(np.stack([pairs.real, pairs.imag], axis=-1))))


def _curvature(path: Path) -> float:
    """Greatest curvature of the circle through points about 0.5 m apart."""
    p = path.p_map_m[:, 0] + 1j * path.p_map_m[:, 1]
    if len(p) < 11:
        return 0.0
    a, b, c = p[:-10], p[5:-5], p[10:]
    double = np.abs(((b - a).conj() * (c - a)).imag)
    return float((2.0 * double / (abs(b - a) * abs(c - b) * abs(c - a))).max())


def _gap(before: Path, after: Path) -> float:
    turn = math.remainder(float(after.heading_rad[0] - before.heading_rad[-1]), 2.0 * math.pi)
    return float(np.hypot(*(after.p_map_m[0] - before.p_map_m[-1]))) + abs(turn)
