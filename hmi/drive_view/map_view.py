"""Map: what does not move once, then only what has changed; coordinates in `map`, m, east and north."""

from typing import Any

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import simplified
from geometry.pose2 import Pose2, to_frame
from hmi.drive_view.sensing import near_tracks, track_text
from hmi.page_state import PageState
from hmi.scene import Scene, placed_outlines
from hmi.texts import Texts
from messages.command import MachineState, SupervisorState
from messages.motion import MapPose

MAX_POINTS = 60


def static_map(scene: Scene) -> dict[str, Any]:
    """Boundary, no-go areas, lanes, yard, shed walls and planned lines."""
    site = scene.site
    walls = [] if site.shed is None else [_listed(np.array(wall)) for wall in site.shed.walls_m]
    return {
        "boundary": _listed(np.array(site.boundary_m)), "yard": _listed(np.array(site.yard.outline_m)),
        "no_go": [_listed(np.array(area.outline_m)) for area in site.no_go],
        "lanes": [_listed(np.array(lane.center_m)) for lane in site.lanes],
        "gates": [_listed(np.array(gate.posts_m)) for gate in site.gates],
        "walls": walls, "plan": [_listed(line) for line in scene.planned_map_m],
    }  # fmt: skip


def moving_map(state: PageState, texts: Texts) -> dict[str, Any]:
    """Outlines of machine and implement, protective field, triggering points and tracks at this moment."""
    pose = state.pose
    if pose is None:
        return {"pose": None}
    machine, supervisor = state.newest("machine", MachineState), state.fresh("supervisor", SupervisorState)
    is_folded = machine is not None and machine.fold_position > 0.5
    implement = state.scene.implement.folded if is_folded else state.scene.implement
    placed = placed_outlines(state.scene.vehicle.body, implement, state.hitch_rad)
    bodies = [_listed(to_frame(pose, to_frame(carrier, rectangle.corners_m))) for rectangle, carrier in placed]
    shown = {"pose": [round(pose.x_m, 2), round(pose.y_m, 2), round(pose.yaw_rad, 4)], "bodies": bodies}
    shown["tracks"] = _tracks(state, pose, texts)
    if supervisor is not None:
        points = supervisor.triggering_points_base_m[:, :2].astype(np.float64)
        shown["field"] = _placed(pose, supervisor.protective_field_base_m)
        shown["points"] = _placed(pose, points[:: max(1, len(points) // MAX_POINTS)])
    return shown


def path_map(state: PageState) -> list[list[list[float]]]:
    """The paths published so far."""
    return [_listed(simplified(path.p_map_m)) for path in state.paths.values()]


def _tracks(state: PageState, pose: Pose2, texts: Texts) -> list[dict[str, Any]]:
    map_pose = state.newest("map_pose", MapPose)
    turn_rad = 0.0 if map_pose is None else Pose2.of(map_pose.T_map_odom).yaw_rad
    found = []
    for track, x_m, y_m in near_tracks(state):
        at = to_frame(pose, np.array([[x_m, y_m]]))[0]
        velocity = to_frame(Pose2(0.0, 0.0, turn_rad), track.velocity_mps[None, :2])[0]
        found.append({
            "at": _listed(at[None])[0], "size": [round(float(v), 2) for v in track.size_m[:2]],
            "yaw": round(float(track.yaw_rad) + turn_rad, 3), "velocity": _listed(velocity[None])[0],
            "class": str(track.label), "text": track_text(track, texts),
        })  # fmt: skip
    return found


def _placed(pose: Pose2, points_base_m: Float64) -> list[list[float]]:
    """Finite ones of points (N, 2) of `base` in `map`."""
    return _listed(to_frame(pose, points_base_m[np.isfinite(points_base_m).all(axis=1)]))


def _listed(points_m: Float64) -> list[list[float]]:
    """Points (N, 2) to centimetres."""
    return [[round(x, 2), round(y, 2)] for x, y in points_m.tolist()]
