"""Postures of a person as joint angles of the body of `simulation.objects.person`.

Squatting and sitting on the ground: joint ranges of DIN 33402-2 and Kapandji (2006); running: Novacheck (1998).
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.transforms import apply
from simulation.environment.lofting import Part
from simulation.environment.meshes import Mesh
from simulation.objects.person import HIP_M, Arm, Leg, body, gait
from simulation.objects.solid import GAIT_STEPS

STAND_TO_LIE_STEPS = 8  # of a change of posture
HEAD_BASE_M = 1.50  # height above which the head of a child is enlarged


@dataclass(frozen=True)
class Posture:
    """Angles in degrees: lean of the trunk (forward), roll about its axis and turn to the left; joints left, right.

    `centered` 1 puts the middle of the body over the origin, 0 the hips.
    """

    lean: float = 0.0
    roll: float = 0.0
    turn: float = 0.0
    hip: tuple[float, float] = (1.0, 1.0)
    knee: tuple[float, float] = (2.0, 2.0)
    foot: tuple[float, float] = (0.0, 0.0)
    swing: tuple[float, float] = (2.0, 2.0)
    bend: tuple[float, float] = (14.0, 14.0)
    centered: float = 0.0

    @property
    def _numbers(self) -> Float64:
        pairs = [*self.hip, *self.knee, *self.foot, *self.swing, *self.bend]
        return np.array([self.lean, self.roll, self.turn, *pairs, self.centered])


def blend(a: Posture, b: Posture, share: float) -> Posture:
    """Posture between two: a at 0, b at 1."""
    n = [float(v) for v in (1.0 - share) * a._numbers + share * b._numbers]
    return Posture(n[0], n[1], n[2], (n[3], n[4]), (n[5], n[6]), (n[7], n[8]), (n[9], n[10]), (n[11], n[12]), n[13])


_ON_BACK = Posture(lean=-90.0, hip=(4.0, 4.0), knee=(4.0, 4.0), foot=(-50.0, -50.0), swing=(-3.0, -3.0),
                   bend=(8.0, 8.0), centered=1.0)  # fmt: skip
POSTURES: dict[str, Posture] = {
    "standing": Posture(),
    # thighs level, shanks back by 35 degrees, feet flat
    "crouching": Posture(lean=45.0, hip=(140.0, 140.0), knee=(130.0, 130.0), foot=(45.0, 45.0), swing=(75.0, 75.0),
                         bend=(30.0, 30.0)),
    "sitting": Posture(lean=12.0, hip=(137.0, 137.0), knee=(80.0, 80.0), foot=(12.0, 12.0), swing=(50.0, 50.0),
                       bend=(35.0, 35.0)),
    "lying_along": _ON_BACK,
    "lying_across": Posture(**(vars(_ON_BACK) | {"turn": 90.0})),
    # on the right side, thighs and arms drawn up
    "lying_curled": Posture(lean=-90.0, roll=90.0, hip=(100.0, 95.0), knee=(110.0, 105.0), foot=(-20.0, -20.0),
                            swing=(55.0, 50.0), bend=(95.0, 90.0), centered=1.0),
}  # fmt: skip


def running(step: int) -> Posture:
    """Running at a gait step: hips 45° to −15°, knees up to 100°, elbows bent at right angles."""
    share = np.array([step / GAIT_STEPS, (step / GAIT_STEPS + 0.5) % 1.0])
    at = np.arange(0.0, 1.05, 0.1)
    hip = np.interp(share, at, (40.0, 32.0, 15.0, -5.0, -15.0, -5.0, 15.0, 35.0, 45.0, 44.0, 40.0))
    knee = np.interp(share, at, (22.0, 40.0, 30.0, 18.0, 25.0, 60.0, 95.0, 100.0, 70.0, 30.0, 22.0))
    foot = 0.7 * (hip - knee)
    swing = -40.0 * np.cos(2.0 * math.pi * share)

    def pair(values: Float64) -> tuple[float, float]:
        return float(values[0]), float(values[1])

    return Posture(lean=8.0, hip=pair(hip), knee=pair(knee), foot=pair(foot), swing=pair(swing), bend=(90.0, 90.0))


def walking(step: int) -> Posture:
    """Walking at a gait step, -1: standing; the angles of `simulation.objects.person`."""
    legs, arms = gait(step)
    angles = [tuple(math.degrees(v) for v in pair) for pair in zip(*legs, strict=True)]
    reach = [tuple(math.degrees(v) for v in pair) for pair in zip(*arms, strict=True)]
    return Posture(0.0, 0.0, 0.0, *angles, *reach)  # type: ignore[arg-type]


def posed(posture: Posture, scale: float, head: float, is_fine: bool) -> tuple[Part, ...]:
    """All parts of a body of `scale` times the adult of 1.75 m, its head enlarged by `head`; lowest point at 0."""
    p = posture
    legs = [Leg(*map(math.radians, angles)) for angles in zip(p.hip, p.knee, p.foot, strict=True)]
    arms = [Arm(*map(math.radians, angles)) for angles in zip(p.swing, p.bend, strict=True)]
    trunk, limbs = body(legs, arms, is_fine)
    T = _rotation(2, p.turn) @ _rotation(0, p.roll) @ _rotation(1, p.lean)
    T[:3, 3] = -T[:3, :3] @ [0.0, 0.0, HIP_M]
    moved = [(apply(T, _grown(q, head)), q) for q in trunk]
    moved += [(apply(T, q.mesh.vertices_m.astype(np.float64)), q) for q in limbs]
    corners = np.concatenate([v for v, _ in moved])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = np.array([*(0.5 * p.centered * (low + high)[:2]), low[2]])
    return tuple(Part(Mesh((scale * (v - middle)).astype(np.float32), q.mesh.triangles), q.region) for v, q in moved)


def _grown(part: Part, head: float) -> Float64:
    """Vertices of a part of the trunk, those of the head enlarged about its base."""
    vertices = part.mesh.vertices_m.astype(np.float64)
    if part.region in ("jacket", "trousers"):
        return vertices
    base = np.array([0.0, 0.0, HEAD_BASE_M])
    return np.asarray(base + head * (vertices - base))


def _rotation(axis: int, degrees: float) -> Float64:
    """Rotation (4, 4) about x, y or z."""
    c, s, T = math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T[i, i] = T[j, j] = c
    T[i, j], T[j, i] = -s, s
    return T
