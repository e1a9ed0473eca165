"""Paths of a mission that only drives a line of straight and curved legs."""

from itertools import groupby

import numpy as np

from configs.mission import Leg, Line
from configs.vehicle import kmh
from geometry.arrays import Float64
from geometry.pose2 import Pose2
from messages.plan import Path, PathSectionType
from planning.path import RawPiece, path_of
from planning.rig import Rig
from planning.turns.turn import STEP_M


def line_paths(line: Line, rig: Rig, start: Pose2) -> tuple[Path, ...]:
    """One path for each run of legs in the same direction, from `start` on."""
    pose, paths = start, list[Path]()
    for is_reverse, group in groupby(line.legs, key=lambda leg: leg.is_reverse):
        pieces = []
        for number, leg in enumerate(group):
            points, pose = _drive(leg, pose)
            pieces.append(RawPiece(PathSectionType(leg.section), number, points, leg.is_working))
        top_mps = kmh(line.reverse_kmh if is_reverse else line.speed_kmh)
        paths.append(path_of(pieces, rig, len(paths) + 1, False, -1 if is_reverse else 1, top_mps))
    return tuple(paths)


def _drive(leg: Leg, pose: Pose2) -> tuple[Float64, Pose2]:
    """Points (N, 2) of a leg and the pose of the machine at its end."""
    sign = -1.0 if leg.is_reverse else 1.0
    s = sign * np.linspace(0.0, leg.length_m, max(2, int(np.ceil(leg.length_m / STEP_M)) + 1))
    turn = leg.curvature_radpm * s
    chord = s * np.sinc(turn / (2.0 * np.pi))
    x, y = pose.x_m + chord * np.cos(pose.yaw_rad + 0.5 * turn), pose.y_m + chord * np.sin(pose.yaw_rad + 0.5 * turn)
    return np.column_stack([x, y]), Pose2(float(x[-1]), float(y[-1]), pose.yaw_rad + float(turn[-1]))
