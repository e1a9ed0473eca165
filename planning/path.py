"""Path messages from pieces: smoothed, with headings, curvature, speeds and stretches."""

from collections.abc import Sequence

import numpy as np

from geometry.polyline import Float64, arc_length, at_length, curvatures, headings, smooth
from messages.message import Int32, UInt8
from messages.plan import Leg, Path, Stretch
from planning.profile import speed_profile
from planning.rig import Rig
from planning.turn import STEP_M
from planning.ways import Piece


def path_of(pieces: Sequence[Piece], rig: Rig, path_id: int, is_last: bool, direction: int = 1) -> Path:
    """One path driven in one direction, from standstill to standstill."""
    points, owner = _joined(pieces)
    raw_s = arc_length(points)
    spaced = np.linspace(0.0, raw_s[-1], max(2, int(np.ceil(raw_s[-1] / STEP_M)) + 1))
    owner = owner[np.clip(np.searchsorted(raw_s, spaced - 1e-9), 0, len(owner) - 1)]
    smoothed = smooth(at_length(points, spaced), rig.config.smoothing_m)
    p, owner = _even(smoothed, owner)
    s, travel = arc_length(p), headings(p)
    heading = travel if direction > 0 else travel + np.pi
    curvature = curvatures(heading, s) * direction
    index, stretches = _stretches(owner, pieces)
    leg_speed = np.array([_leg_speed(piece.leg, rig) for piece in pieces])[owner]
    speed = speed_profile(s, curvature, leg_speed, rig)
    return Path(
        0,
        path_id,
        direction,
        p,
        _wrapped(heading),
        curvature,
        s,
        speed,
        _work(owner, pieces),
        stretches,
        index,
        is_last,
    )


def _joined(pieces: Sequence[Piece]) -> tuple[Float64, Int32]:
    points = np.vstack([p.points_m for p in pieces])
    owner = np.concatenate([np.full(len(p.points_m), k, np.int32) for k, p in enumerate(pieces)])
    keep = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    return points[keep], owner[keep]


def _even(points: Float64, owner: Int32) -> tuple[Float64, Int32]:
    s = arc_length(points)
    spaced = np.linspace(0.0, s[-1], len(points))
    nearest = np.clip(np.searchsorted(s, spaced - STEP_M / 2.0), 0, len(owner) - 1)
    return at_length(points, spaced), owner[nearest]


def _stretches(owner: Int32, pieces: Sequence[Piece]) -> tuple[Int32, tuple[Stretch, ...]]:
    starts = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
    stretches = []
    for first, end in zip(starts[:-1], starts[1:], strict=True):
        piece = pieces[owner[first]]
        stretches.append(Stretch(piece.leg, piece.line, int(first), int(end) - 1))
    return np.repeat(np.arange(len(stretches), dtype=np.int32), np.diff(starts)).astype(np.int32), tuple(stretches)


def _work(owner: Int32, pieces: Sequence[Piece]) -> UInt8:
    """1 where the implement works, from the last point before work to the first after it."""
    work = np.array([p.is_work for p in pieces], np.uint8)[owner]
    wider = work.copy()
    wider[:-1] |= work[1:]
    wider[1:] |= work[:-1]
    return wider


def _leg_speed(leg: Leg, rig: Rig) -> float:
    """A turn's straight ends are driven at working speed: its curves are slower by the profile."""
    if leg in (Leg.SWATH, Leg.HEADLAND, Leg.TURN):
        return rig.work_mps
    return rig.lane_mps if leg is Leg.LANE else rig.turn_mps


def _wrapped(angle: Float64) -> Float64:
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi), np.float64)
