"""Random scripts against a closed-form judge: constant speed, a standing box, the brake of the conditions.

The judge below shares nothing with the code under test but the values of the brake.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from tests.validation.obstacle_stop.closed_form import BUILD_UP, DEAD, TAU, A, braked_m
from tests.validation.obstacle_stop.scripted import (
    CONDITIONS,
    FRONT_M,
    TRUTH_S,
    WIDTH_M,
    Request,
    Script,
    judge,
    standing,
    straight,
)

SPLIT_M, SETTLING_S, PROMPT_S, START_S = 0.5, 1.0, 0.32, 0.25
SIDE_M = 0.3  # half size of the box
COUNT = 500


def lag_m(v: float, t: float) -> float:
    """How far the braking machine is behind one at constant speed, `t` after the start of the build-up."""
    if t <= 0.0:
        return 0.0
    stop = math.sqrt(2.0 * v * BUILD_UP / A) if v < 0.5 * A * BUILD_UP else 0.5 * BUILD_UP + v / A
    if t >= stop:
        return v * t - braked_m(v)
    if t <= BUILD_UP:
        return A * t**3 / (6.0 * BUILD_UP)
    late = t - BUILD_UP
    return A * BUILD_UP**2 / 6.0 + 0.5 * A * BUILD_UP * late + 0.5 * A * late**2


@dataclass(frozen=True)
class Case:
    """Gap at the start, lateral offset of the box, speed, duration, intervals of requests, and their latency."""

    gap_m: float
    y_m: float
    v: float
    seconds: float
    intervals: tuple[tuple[float, float], ...]
    latency_s: float


def draw(rng: np.random.Generator) -> Case:
    v = float(rng.uniform(1.0, 9.0))
    gap = float(rng.uniform(0.5, 45.0))
    y = float(rng.choice([rng.uniform(-1.1, 1.1), rng.uniform(1.3, 4.0)], p=[0.85, 0.15]))
    seconds = round(float(rng.uniform(0.5, (gap + 3.0) / v + 0.6)), 1)
    due = (gap - v * TAU - braked_m(v)) / v
    edges, t = [], max(0.0, due + float(rng.normal(0.0, 0.8)))
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.15, 0.55, 0.2, 0.1]))):
        length = float(rng.choice([0.1, rng.uniform(0.2, 2.0), 99.0], p=[0.2, 0.4, 0.4]))
        edges.append((round(t / 0.02) * 0.02, round((t + length) / 0.02) * 0.02))
        t += length + float(rng.uniform(0.5, 1.5))
    return Case(gap, y, v, seconds, tuple(edges), float(rng.choice([0.0, 0.2, 1.5], p=[0.6, 0.2, 0.2])))


def expected(c: Case) -> tuple[str | None, float | None, bool]:
    """Outcome (None: no encounter), margin, and whether the case is too near to a boundary to be compared."""
    edge = abs(abs(c.y_m) - 0.5 * WIDTH_M - SIDE_M) < 0.02
    if abs(c.y_m) > 0.5 * WIDTH_M + SIDE_M:
        return None, None, edge
    S = c.v * TAU + braked_m(c.v)
    moments = [round(k * TRUTH_S, 6) for k in range(round(c.seconds / TRUTH_S) + 1)]
    in_path = [t for t in moments if c.v * t < c.gap_m + 2.0 * SIDE_M + FRONT_M + 1.0]
    due = next((t for t in in_path if c.gap_m - c.v * t < S), None)
    edge |= min(abs(c.gap_m - c.v * t - S) for t in in_path) < 0.02
    end = min(in_path[-1] + 0.3, c.seconds)
    runs = [(a + c.latency_s, b + c.latency_s) for a, b in c.intervals if a + c.latency_s <= end]
    for a, b in runs:
        is_latched, at_release = b > end, lag_m(c.v, b - a - DEAD)
        edge |= abs(at_release - SPLIT_M) < 0.06 or abs(b - end) < 0.05 or abs(a - end) < 0.05
        if is_latched or at_release > SPLIT_M:
            margin = c.gap_m - c.v * a - c.v * DEAD - braked_m(c.v)
            return outcome(c, S, due, a, margin >= 0.0, in_path[-1]), margin, edge or abs(margin) < 0.03
    last = runs[-1][0] if runs else None
    return outcome(c, S, due, last, due is None, in_path[-1]), None, edge


def outcome(c: Case, S: float, due: float | None, request: float | None, is_avoided: bool, end: float) -> str:
    if due is None and request is None:
        return "no demand"
    if request is not None and is_avoided:
        return "in time"
    if due is None:
        return "late"
    if due <= START_S and request is not None and request <= SETTLING_S:
        return "censored"
    if request is not None:
        return "late"
    return "censored" if end <= (SETTLING_S if due <= START_S else due + PROMPT_S) else "missed"


@pytest.mark.parametrize("part", range(5))
def test_same_outcome_and_margin_as_in_closed_form(part: int) -> None:
    rng, compared, seen = np.random.default_rng(part), 0, set()
    while compared < COUNT // 5:
        case = draw(rng)
        name, margin_m, is_edge = expected(case)
        if is_edge:
            continue
        compared += 1
        thing = standing(1, FRONT_M + case.gap_m + SIDE_M, case.y_m)
        requests = [Request(a, b, 1) for a, b in case.intervals]
        found = judge(Script(straight(case.v), [thing], requests, case.seconds, case.latency_s))
        got = found[0].outcome.value if found else None
        seen.add(got)
        assert got == name, (case, margin_m, found)
        if found and (margin_m is not None or found[0].margin_m is not None):
            assert found[0].margin_m == pytest.approx(margin_m, abs=0.1), (case, found)
            assert found[0].has_contact == (margin_m < 0.0), case
    assert {None, "in time", "late", "missed", "no demand"} <= seen


def test_closed_form_uses_the_values_of_the_conditions() -> None:
    braking = CONDITIONS.braking
    values = (braking.reaction_s, braking.dead_time_s, braking.build_up_s, braking.deceleration_mps2)
    assert (*values, CONDITIONS.settling_s) == (TAU, DEAD, BUILD_UP, A, SETTLING_S)
