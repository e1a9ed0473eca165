"""An adult of 1.75 m in work clothes: head with hair and face, torso, arms with hands, legs and shoes.

Proportions: DIN 33402-2 (50th percentile, men). Hip, knee and ankle angles over a stride: Winter (1991).
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from simulation.environment.lofting import Keys, Part, blob, loft
from simulation.objects.solid import GAIT_STEPS

_AT = np.arange(0.0, 1.05, 0.1)
HIP_DEG = (22.0, 18.0, 10.0, 1.0, -7.0, -12.0, -5.0, 9.0, 19.0, 23.0, 22.0)
KNEE_DEG = (5.0, 16.0, 14.0, 8.0, 6.0, 12.0, 34.0, 56.0, 50.0, 16.0, 5.0)
ANKLE_DEG = (0.0, -4.0, 4.0, 8.0, 9.0, 2.0, -16.0, -8.0, 0.0, 2.0, 0.0)
THIGH_M, SHANK_M, HIP_M = 0.43, 0.41, 0.92
UPPER_ARM_M, FOREARM_M, SHOULDER_M = 0.29, 0.25, 1.41

TROUSERS: Keys = (
    (0.0, 0.0, 0.80, 0.04, 0.08), (0.0, 0.0, 0.83, 0.09, 0.15), (-0.005, 0.0, 0.90, 0.118, 0.175),
    (0.0, 0.0, 0.98, 0.108, 0.166), (0.0, 0.0, 1.04, 0.10, 0.152), (0.0, 0.0, 1.05, 0.05, 0.09),
)  # fmt: skip
JACKET: Keys = (
    (0.0, 0.0, 0.915, 0.115, 0.170), (0.0, 0.0, 0.92, 0.129, 0.186), (0.0, 0.0, 0.99, 0.122, 0.176),
    (0.0, 0.0, 1.08, 0.113, 0.164), (0.0, 0.0, 1.18, 0.118, 0.174), (0.005, 0.0, 1.28, 0.125, 0.190),
    (0.0, 0.0, 1.36, 0.116, 0.198), (-0.004, 0.0, 1.41, 0.100, 0.200), (-0.008, 0.0, 1.437, 0.084, 0.176),
    (-0.008, 0.0, 1.462, 0.072, 0.125), (-0.006, 0.0, 1.485, 0.066, 0.080), (-0.005, 0.0, 1.51, 0.063, 0.064),
    (0.0, 0.0, 1.512, 0.03, 0.03),
)  # fmt: skip
NECK: Keys = ((-0.01, 0.0, 1.44, 0.058, 0.06), (0.0, 0.0, 1.50, 0.056, 0.055), (0.01, 0.0, 1.58, 0.058, 0.055))
HEAD: Keys = (
    (0.05, 0.0, 1.512, 0.012, 0.012), (0.045, 0.0, 1.52, 0.045, 0.035), (0.032, 0.0, 1.55, 0.075, 0.056),
    (0.022, 0.0, 1.59, 0.090, 0.067), (0.014, 0.0, 1.64, 0.098, 0.074), (0.008, 0.0, 1.69, 0.094, 0.073),
    (0.004, 0.0, 1.725, 0.072, 0.058), (0.002, 0.0, 1.743, 0.035, 0.03), (0.002, 0.0, 1.747, 0.008, 0.008),
)  # fmt: skip
HAIR: Keys = (
    (-0.045, 0.0, 1.575, 0.03, 0.045), (-0.03, 0.0, 1.60, 0.060, 0.068), (-0.018, 0.0, 1.65, 0.080, 0.079),
    (-0.004, 0.0, 1.69, 0.094, 0.080), (0.002, 0.0, 1.725, 0.082, 0.068), (0.002, 0.0, 1.75, 0.045, 0.04),
    (0.002, 0.0, 1.755, 0.008, 0.008),
)  # fmt: skip
SHOE: Keys = (
    (-0.085, 0.0, 0.04, 0.015, 0.02), (-0.08, 0.0, 0.045, 0.038, 0.034), (-0.03, 0.0, 0.055, 0.055, 0.040),
    (0.03, 0.0, 0.05, 0.050, 0.042), (0.09, 0.0, 0.036, 0.036, 0.048), (0.15, 0.0, 0.028, 0.028, 0.047),
    (0.185, 0.0, 0.024, 0.022, 0.035), (0.20, 0.0, 0.022, 0.006, 0.012),
)  # fmt: skip


class Leg(NamedTuple):
    """Flexion of hip and knee and pitch of the foot (toes up), in rad, against an upright trunk."""

    hip: float
    knee: float
    foot: float


class Arm(NamedTuple):
    """Flexion of shoulder and elbow, in rad."""

    swing: float
    bend: float


@cache
def person(step: int, is_fine: bool) -> tuple[Part, ...]:
    """All parts at a gait step (-1: standing); the lowest sole is at height 0."""
    return on_soles(*body(*gait(step), is_fine))


def gait(step: int) -> tuple[list[Leg], list[Arm]]:
    """Joint angles at a gait step (-1: standing), left before right."""
    shares = [None if step < 0 else (step / GAIT_STEPS + late) % 1.0 for late in (0.0, 0.5)]
    return [_walking_leg(share) for share in shares], [_walking_arm(share) for share in shares]


def body(legs: list[Leg], arms: list[Arm], is_fine: bool) -> tuple[list[Part], list[Part]]:
    """Trunk with head, and limbs, with the hips at `HIP_M`; left before right."""
    sides, more = (24, 3) if is_fine else (10, 1)
    trunk = [
        Part(loft(TROUSERS, sides, 5 * more + 1), "trousers"),
        Part(loft(JACKET, sides, 11 * more, power=2.3), "jacket"), Part(loft(HEAD, sides, 8 * more), "skin"),
        Part(loft(HAIR, sides, 6 * more), "hair"),
    ]  # fmt: skip
    if is_fine:
        trunk += [Part(loft(NECK, sides, 4), "skin"), *_face()]
    limbs = []
    for side, leg, arm in zip((1.0, -1.0), legs, arms, strict=True):
        limbs += _leg(side, leg, sides, more)
        limbs += _arm(side, arm, sides, more)
    return trunk, limbs


def on_soles(trunk: list[Part], limbs: list[Part]) -> tuple[Part, ...]:
    """All parts, moved so that the lowest point of the limbs is at height 0."""
    sole = min(float(p.mesh.vertices_m[:, 2].min()) for p in limbs)
    T = np.eye(4)
    T[2, 3] = -sole
    return tuple(Part(p.mesh.transformed(T), p.region) for p in trunk + limbs)


def _face() -> list[Part]:
    """Eyes, brows, nose, mouth and ears, facing x."""
    parts = [Part(blob((0.104, 0.0, 1.605), (0.020, 0.014, 0.026), 10, 7), "skin"),
             Part(blob((0.098, 0.0, 1.562), (0.008, 0.024, 0.006), 10, 5), "lips")]  # fmt: skip
    for s in (1.0, -1.0):
        parts += [Part(blob((0.099, 0.032 * s, 1.637), (0.008, 0.014, 0.007), 10, 5), "dark"),
                  Part(blob((0.100, 0.032 * s, 1.657), (0.008, 0.020, 0.005), 10, 5), "hair"),
                  Part(blob((0.005, 0.076 * s, 1.62), (0.022, 0.010, 0.032), 10, 7), "skin")]  # fmt: skip
    return parts


def _bent(share: float | None, degrees: tuple[float, ...], standing_deg: float) -> float:
    return math.radians(standing_deg if share is None else float(np.interp(share, _AT, degrees)))


def _walking_leg(share: float | None) -> Leg:
    hip, knee = _bent(share, HIP_DEG, 1.0), _bent(share, KNEE_DEG, 2.0)
    ankle = _bent(share, ANKLE_DEG, 0.0)
    return Leg(hip, knee, 0.6 * (hip - knee) - ankle if share is not None else 0.0)


def _walking_arm(share: float | None) -> Arm:
    """The arm swings against the leg of its side."""
    if share is None:
        return Arm(math.radians(2.0), math.radians(14.0))
    wave = math.cos(2.0 * math.pi * share)
    return Arm(math.radians(-20.0 * wave - 2.0), math.radians(22.0 - 12.0 * wave))


def _leg(side: float, leg: Leg, sides: int, more: int) -> list[Part]:
    hip, knee, pitch = leg
    y = 0.09 * side
    shank = hip - knee
    at_knee = (THIGH_M * math.sin(hip), HIP_M - THIGH_M * math.cos(hip))
    at_ankle = (at_knee[0] + SHANK_M * math.sin(shank), at_knee[1] - SHANK_M * math.cos(shank))

    def on(t: float, half_x: float, half_y: float) -> tuple[float, float, float, float, float]:
        """A section of the leg: hip at 0, knee at 1, ankle at 2."""
        a, b = ((0.0, HIP_M), at_knee) if t < 1.0 else (at_knee, at_ankle)
        f = t if t < 1.0 else t - 1.0
        return (a[0] + f * (b[0] - a[0]), y * (1.0 + 0.12 * t), a[1] + f * (b[1] - a[1]), half_x, half_y)

    cloth = (on(0.0, 0.085, 0.078), on(0.12, 0.102, 0.086), on(0.35, 0.093, 0.084), on(0.65, 0.080, 0.074),
             on(0.92, 0.068, 0.064), on(1.08, 0.067, 0.062), on(1.35, 0.070, 0.062), on(1.65, 0.063, 0.058),
             on(1.93, 0.060, 0.056), on(1.94, 0.03, 0.03))  # fmt: skip
    shoe = loft(SHOE, max(sides // 2, 8), 7 * max(more - 1, 1))
    c, s = math.cos(pitch), math.sin(pitch)
    out = side * math.radians(7.0)
    T = np.array([[c, 0.0, -s, at_ankle[0]], [0.0, 1.0, 0.0, 1.24 * y], [s, 0.0, c, at_ankle[1]], [0, 0, 0, 1.0]])
    turn = np.array([[math.cos(out), -math.sin(out), 0, 0], [math.sin(out), math.cos(out), 0, 0], [0, 0, 1, -0.085],
                     [0, 0, 0, 1.0]])  # fmt: skip
    return [Part(loft(cloth, sides, 9 * more), "trousers"), Part(shoe.transformed(T @ turn), "shoes")]


def _arm(side: float, arm: Arm, sides: int, more: int) -> list[Part]:
    """Sleeve and hand."""
    swing, bend = arm
    aside = math.radians(7.0)
    shoulder = np.array([-0.005, 0.182 * side, SHOULDER_M])

    def direction(angle: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.array([math.sin(angle), side * math.sin(aside), -math.cos(angle)])

    elbow = shoulder + UPPER_ARM_M * direction(swing)
    wrist = elbow + FOREARM_M * direction(swing + bend) * np.array([1.0, 0.3, 1.0])
    tip = wrist + 0.18 * direction(swing + bend + 0.2) * np.array([1.0, -0.2, 1.0])

    def on(a: np.ndarray, b: np.ndarray, f: float, x: float, y: float) -> tuple[float, float, float, float, float]:
        p = a + f * (b - a)
        return (float(p[0]), float(p[1]), float(p[2]), x, y)

    sleeve = (on(shoulder, elbow, -0.13, 0.030, 0.02), on(shoulder, elbow, -0.08, 0.052, 0.036),
              on(shoulder, elbow, 0.06, 0.066, 0.054), on(shoulder, elbow, 0.35, 0.060, 0.054),
              on(shoulder, elbow, 0.9, 0.049, 0.046), on(elbow, wrist, 0.1, 0.048, 0.045),
              on(elbow, wrist, 0.5, 0.045, 0.042), on(elbow, wrist, 0.97, 0.036, 0.034),
              on(elbow, wrist, 0.98, 0.015, 0.015))  # fmt: skip
    hand = (on(wrist, tip, -0.1, 0.024, 0.018), on(wrist, tip, 0.15, 0.030, 0.020), on(wrist, tip, 0.4, 0.042, 0.019),
            on(wrist, tip, 0.7, 0.036, 0.017), on(wrist, tip, 0.95, 0.022, 0.013),
            on(wrist, tip, 1.0, 0.006, 0.005))  # fmt: skip
    return [
        Part(loft(sleeve, max(sides - 2, 8), 8 * more), "jacket"),
        Part(loft(hand, max(sides // 2, 6), 5 * more), "skin"),
    ]
