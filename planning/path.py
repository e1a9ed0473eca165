"""Path messages from pieces: with headings, curvature, speeds and sections."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from configs.vehicle import kmh
from geometry.arrays import Float64, Int32, UInt8
from geometry.polyline import arc_length, at_length, curvatures, extend, headings, project, smooth
from messages.plan import Path, PathSection, PathSectionType
from planning.profile import limit_acceleration, speed_profile
from planning.rig import Rig
from planning.turns.connector import RoutePiece
from planning.turns.turn import STEP_M

FADE_M = 5.0  # length over which the initial offset from a path fades
MIN_SPACING_M = 0.02
BEFORE_M = 0.5
STEP_RADPM = 0.03  # of curvature from point to point
EASED_M, FADING_M = 1.0, 4.0  # a shorter transition would itself add curvature


@dataclass(frozen=True)
class RawPiece:
    """Part of a path: points of `base` (N, 2) before smoothing; `is_working`: the implement works on all of it."""

    section_type: PathSectionType
    line: int
    points_m: Float64
    is_working: bool


def paths_of(
    pieces: Sequence[RoutePiece], rig: Rig, first_id: int, is_free: Callable[[Float64, Float64, bool], bool]
) -> tuple[Path, ...]:
    """Paths of a route, one for each run of pieces in the same direction and width, from standstill to standstill.

    `is_free` tests points (N, 2) and headings (N,), in transport width or not.
    """
    groups = [list(group) for _, group in groupby(pieces, key=lambda p: (p.leg.direction, p.is_transport))]
    found = [_path(group, rig, first_id + k, is_free) for k, group in enumerate(groups)]
    return (*found[:-1], replace(found[-1], is_last=True))


def _path(
    pieces: Sequence[RoutePiece], rig: Rig, path_id: int, is_free: Callable[[Float64, Float64, bool], bool]
) -> Path:
    direction = pieces[0].leg.direction
    points = np.vstack([p.leg.p_map_m for p in pieces])
    heading = np.unwrap(np.concatenate([p.leg.heading_rad for p in pieces]))
    curvature = np.concatenate([p.leg.curvature_radpm for p in pieces])
    owner = np.concatenate([np.full(len(p.leg.p_map_m), k, np.int32) for k, p in enumerate(pieces)])
    keep = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-3])
    points, heading, curvature, owner = points[keep], heading[keep], curvature[keep], owner[keep]
    raw_s = arc_length(points)
    s = np.linspace(0.0, raw_s[-1], max(2, int(np.ceil(raw_s[-1] / STEP_M)) + 1))
    p = np.column_stack([np.interp(s, raw_s, points[:, k]) for k in range(2)])
    heading, curvature = np.interp(s, raw_s, heading), np.interp(s, raw_s, curvature)
    owner = owner[np.clip(np.searchsorted(raw_s, s - 1e-9), 0, len(owner) - 1)]
    eased = _eased(p, heading, curvature, direction)
    if eased[0] is not p and is_free(*eased[:2], pieces[0].is_transport):
        p, heading, curvature = eased
    top_mps = np.inf if direction > 0 else kmh(rig.config.reverse_kmh)
    section_speed = np.array([min(_section_speed(piece.section_type, rig), top_mps) for piece in pieces])[owner]
    s = arc_length(p)
    speed = speed_profile(s, curvature, section_speed, rig)
    index, sections = _sections(owner, pieces)
    return Path(
        0, path_id, direction, p, _wrap(heading), curvature, s, speed, _working(owner, pieces), sections, index, False,
        pieces[0].is_transport,
    )  # fmt: skip


def _eased(p: Float64, heading: Float64, curvature: Float64, direction: int) -> tuple[Float64, Float64, Float64]:
    """The points with steps of curvature at joints spread over `EASED_M`; they move by some millimetres."""
    steps = np.flatnonzero(np.abs(np.diff(curvature)) > STEP_RADPM)
    if not len(steps):
        return p, heading, curvature
    near = np.zeros(len(p))
    for k in steps:
        at = np.abs(np.arange(len(p)) - (k + 0.5)) * STEP_M
        fading = np.clip((at - EASED_M) / FADING_M, 0.0, 1.0)
        near = np.maximum(near, 0.5 + 0.5 * np.cos(np.pi * fading))
    near[[0, -1]] = 0.0
    eased = p + near[:, None] * (smooth(p, EASED_M) - p)
    turned = headings(eased) if direction > 0 else headings(eased) + np.pi
    turned += 2.0 * np.pi * np.round((heading[0] - turned[0]) / (2.0 * np.pi))
    bent = direction * curvatures(turned, arc_length(eased))
    return eased, heading + near * (turned - heading), curvature + near * (bent - curvature)


def path_of(
    pieces: Sequence[RawPiece], rig: Rig, path_id: int, is_last: bool, direction: int = 1, top_mps: float = np.inf
) -> Path:
    """One smoothed path in one direction, from standstill to standstill, at most `top_mps`.

    Reverse paths are not smoothed: they follow smoothed points, and a second smoothing would turn their ends.
    """
    points, owner = _concatenated(pieces)
    raw_s = arc_length(points)
    spaced = np.linspace(0.0, raw_s[-1], max(2, int(np.ceil(raw_s[-1] / STEP_M)) + 1))
    owner = owner[np.clip(np.searchsorted(raw_s, spaced - 1e-9), 0, len(owner) - 1)]
    spread = at_length(points, spaced)
    p, owner = _equally_spaced(smooth(spread, rig.config.smoothing_m) if direction > 0 else spread, owner)
    s, travel = arc_length(p), headings(p)
    heading = travel if direction > 0 else travel + np.pi
    curvature = curvatures(heading, s) * direction
    index, sections = _sections(owner, pieces)
    section_speed = np.array([min(_section_speed(piece.section_type, rig), top_mps) for piece in pieces])[owner]
    speed = speed_profile(s, curvature, section_speed, rig)
    return Path(
        0,
        path_id,
        direction,
        p,
        _wrap(heading),
        curvature,
        s,
        speed,
        _working(owner, pieces),
        sections,
        index,
        is_last,
    )


def rest_of(path: Path, from_m: float, p_map_m: Float64, path_id: int, rig: Rig) -> Path:
    """Remainder of a path from the arc length `from_m`, starting at the present position and from standstill."""
    first = min(int(np.searchsorted(path.s_m, from_m - STEP_M / 2.0)), len(path.s_m) - 3)
    rest = spliced([(path, first, len(path.s_m))], path_id)
    points = started_at(rest.p_map_m, p_map_m)
    first = len(rest.s_m) - len(points)
    rest = spliced([(rest, first, len(rest.s_m))], path_id)
    s = arc_length(points)
    return replace(rest, p_map_m=points, s_m=s, speed_mps=limit_acceleration(rest.speed_mps, s, rig))


def spliced(parts: Sequence[tuple[Path, int, int]], path_id: int) -> Path:
    """Points `first` to `end` (exclusive) of each path, concatenated to one path."""
    last = parts[-1][0]

    def column(name: str) -> Any:
        return np.concatenate([getattr(path, name)[first:end] for path, first, end in parts])

    points = column("p_map_m")
    labels = [path.sections[k] for path, first, end in parts for k in path.section_index[first:end]]
    starts = [k for k, t in enumerate(labels) if k == 0 or t is not labels[k - 1]]
    ends = [*starts[1:], len(labels)]
    sections = tuple(
        PathSection(labels[a].section_type, labels[a].line, a, b - 1) for a, b in zip(starts, ends, strict=True)
    )
    index = np.repeat(np.arange(len(starts), dtype=np.int32), np.diff([*starts, len(labels)])).astype(np.int32)
    return Path(
        0, path_id, parts[0][0].direction, points, column("heading_rad"), column("curvature_radpm"), arc_length(points),
        column("speed_mps"), column("is_working"), sections, index, last.is_last,
    )  # fmt: skip


def started_at(points_m: Float64, p_map_m: Float64) -> Float64:
    """The points (N, 2) from the one nearest to `p_map_m`, shifted to start there; the offset fades over `FADE_M`.

    The start may also lie up to `BEFORE_M` before the first point.
    """
    extended = extend(points_m, BEFORE_M, 0.0)
    s, offset = project(extended, p_map_m)
    following = int(np.searchsorted(arc_length(extended), s + MIN_SPACING_M))
    first = min(max(following - 2, 0), len(points_m) - 3)
    kept = points_m[first:].copy()
    kept[0] = at_length(extended, np.array([s]))[0]
    s_kept, heading = arc_length(kept), headings(kept)
    share = np.clip(s_kept / min(FADE_M, max(float(s_kept[-1]), 1e-6)), 0.0, 1.0)
    push = offset * (0.5 + 0.5 * np.cos(np.pi * share))
    return np.asarray(kept + push[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)]), np.float64)


def _concatenated(pieces: Sequence[RawPiece]) -> tuple[Float64, Int32]:
    points = np.vstack([p.points_m for p in pieces])
    owner = np.concatenate([np.full(len(p.points_m), k, np.int32) for k, p in enumerate(pieces)])
    keep = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    return points[keep], owner[keep]


def _equally_spaced(points: Float64, owner: Int32) -> tuple[Float64, Int32]:
    s = arc_length(points)
    spaced = np.linspace(0.0, s[-1], len(points))
    nearest = np.clip(np.searchsorted(s, spaced - STEP_M / 2.0), 0, len(owner) - 1)
    return at_length(points, spaced), owner[nearest]


def _sections(owner: Int32, pieces: Sequence[RawPiece] | Sequence[RoutePiece]) -> tuple[Int32, tuple[PathSection, ...]]:
    starts = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
    sections = []
    for first, end in pairwise(starts):
        piece = pieces[owner[first]]
        sections.append(PathSection(piece.section_type, piece.line, int(first), int(end) - 1))
    return np.repeat(np.arange(len(sections), dtype=np.int32), np.diff(starts)).astype(np.int32), tuple(sections)


def _working(owner: Int32, pieces: Sequence[RawPiece] | Sequence[RoutePiece]) -> UInt8:
    """1 from the last point before work to the first after it, else 0, (N,)."""
    working = np.array([p.is_working for p in pieces], np.uint8)[owner]
    wider = working.copy()
    wider[:-1] |= working[1:]
    wider[1:] |= working[:-1]
    return wider


def _section_speed(section_type: PathSectionType, rig: Rig) -> float:
    """Turns get the working speed for their straight ends; the profile slows their curves."""
    if section_type in (PathSectionType.SWATH, PathSectionType.HEADLAND, PathSectionType.TURN):
        return rig.work_mps
    return rig.lane_mps if section_type is PathSectionType.LANE else rig.turn_mps


def _wrap(angle: Float64) -> Float64:
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi), np.float64)
