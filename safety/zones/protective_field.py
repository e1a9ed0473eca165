"""Raw protective field (cf. IEC 61496-3): the area that machine and implement will sweep, and the clearance in it.

Two swept areas: the planned path over the required range, and the arc of the measured steering over the stopping
distance (the area swept if the steering stays as it is). Without a plan at this position the arc replaces the plan.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import from_frame
from messages.command import ControlCommand
from messages.plan import Path, PathSectionType
from safety.config import FieldConfig
from safety.stopping_distance import Braking, required_range, stopping_distance
from safety.zones.footprint import Box, Footprint, enclosing
from safety.zones.swept_area import SweptArea, arc_poses, distance_to_contact_m, path_poses, spaced, sweep_along

NOTHING = np.empty((0, 3))


@dataclass(frozen=True)
class SweptField:
    """Swept area of the plan (`main`; of the arc without a plan), and of the arc beside a plan."""

    main: SweptArea
    arc: SweptArea | None
    is_planned: bool


@dataclass(frozen=True)
class Clearance:
    """Free distance in the main swept area and on the arc, with the points (N, 3) in base that are touched."""

    main_m: float
    arc_m: float
    triggering_points_base_m: Float64


FREE = Clearance(math.inf, math.inf, NOTHING)


@dataclass(frozen=True)
class PathPosition:
    """A path and the reference position on it."""

    path: Path
    s_m: float


def position_on_path(path: Path | None, control_command: ControlCommand | None) -> PathPosition | None:
    """Position of the control command on its path; start of the path when control does not follow it yet."""
    if path is None or len(path.s_m) < 2:
        return None
    is_followed = (
        control_command is not None
        and control_command.path_id == path.path_id
        and math.isfinite(control_command.path_s_m)
    )
    return PathPosition(
        path, control_command.path_s_m if is_followed and control_command is not None else float(path.s_m[0])
    )


def section_type_at(position: PathPosition) -> PathSectionType:
    """Type of the path section at a position."""
    return position.path.section_at(position.s_m).section_type


def is_at(position: PathPosition, pose_map: Float64, config: FieldConfig) -> bool:
    """Whether the pose lies within the configured deviation (distance and heading) of the position."""
    path, s = position.path, position.s_m
    x, y = np.interp(s, path.s_m, path.p_map_m[:, 0]), np.interp(s, path.s_m, path.p_map_m[:, 1])
    turn = math.remainder(float(path.heading_rad[path.index_at(s)]) - float(pose_map[2]), 2.0 * math.pi)
    is_near = math.hypot(x - pose_map[0], y - pose_map[1]) <= config.max_path_deviation_m
    return is_near and abs(turn) <= math.radians(config.max_path_deviation_deg)


def look_ahead_m(speed_mps: float, braking: Braking, config: FieldConfig, allowance_m: float) -> float:
    """Length of the field: range required at 0.5 m/s above the present speed, with a minimum."""
    needed = required_range(speed_mps + 0.5, braking, allowance_m)
    return max(config.min_length_m, min(needed, 100.0) + 1.0)


def sweep_field(
    position: PathPosition | None,
    pose_map: Float64 | None,
    curvature_radpm: float,
    direction: int,
    length_m: float,
    arc_length_m: float,
    footprint: Footprint,
    config: FieldConfig,
) -> SweptField:
    """Swept areas from the present pose; `pose_map` (3,), None: unknown."""
    arc_s = spaced(arc_length_m, 0.25 * config.step_m)
    arc = arc_poses(curvature_radpm, direction, arc_s)
    if position is not None and pose_map is not None and is_at(position, pose_map, config):
        lead_m = max(footprint.leads_m(direction))
        rest_m = max(config.step_m, min(length_m + lead_m, float(position.path.s_m[-1]) - position.s_m))
        s = spaced(rest_m, config.step_m)
        poses = path_poses(position.path, position.s_m, pose_map, s, config.blend_m)
        main = sweep_along(footprint, direction, s, poses, curvature_radpm, config, is_from_foremost=True)
        return SweptField(main, sweep_along(footprint, direction, arc_s, arc, curvature_radpm, config, False), True)
    s = spaced(length_m + max(footprint.leads_m(direction)), config.step_m)
    poses = arc_poses(curvature_radpm, direction, s)
    return SweptField(sweep_along(footprint, direction, s, poses, curvature_radpm, config, True), None, False)


def arc_length_m(speed_mps: float, braking: Braking, config: FieldConfig) -> float:
    """Length of the arc beside a plan: stopping distance and margin of the arc."""
    return min(stopping_distance(speed_mps, braking), 60.0) + config.arc_margin_m + 0.5


def box_of(swept_field: SweptField, slack_m: float) -> Box:
    """Box of base about all swept areas, enlarged by `slack_m`."""
    main, arc = swept_field.main, swept_field.arc
    return (main.box if arc is None else enclosing(main.box, arc.box)).enlarged(slack_m)


def clearance_to(
    swept_field: SweptField, hits_odom_m: Float64, pose_odom: Float64, aside_m: Float64 | float = 0.0
) -> Clearance:
    """Clearance to hits (N, 3) in odom for base at `pose_odom` (3,); `aside_m` as in `distance_to_contact_m`."""
    if len(hits_odom_m) == 0:
        return FREE
    xy = from_frame(pose_odom, hits_odom_m[:, :2])
    height_m = hits_odom_m[:, 2]
    main = distance_to_contact_m(xy, swept_field.main, 0.0, aside_m, height_m)
    arc = (
        distance_to_contact_m(xy, swept_field.arc, 0.0, aside_m, height_m)
        if swept_field.arc is not None
        else np.full(len(xy), np.inf)
    )
    cause = np.minimum(main, arc) < np.inf
    hits = np.column_stack([xy, hits_odom_m[:, 2]])[cause]
    return Clearance(float(main.min()), float(arc.min()), hits)
