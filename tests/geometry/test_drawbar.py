"""Implement on a drawbar against its equation of motion in small steps."""

import math

import numpy as np
import pytest

from geometry.drawbar import Drawbar, curvature_of, follow, hitch_poses, run_in_m, steady_angle

DRAWBAR = Drawbar(-1.1, 3.7)


def pulled(p_m: np.ndarray, heading_rad: np.ndarray, hitch_rad: float, steps: int = 400) -> float:
    """Heading of the implement at the end: its axle rolls along it (Euler's method)."""
    yaw = float(heading_rad[0]) + hitch_rad
    every = np.arange(len(heading_rad))
    fine = np.linspace(0.0, len(heading_rad) - 1.0, (len(heading_rad) - 1) * steps + 1)
    x, y, h = (np.interp(fine, every, v) for v in (p_m[:, 0], p_m[:, 1], heading_rad))
    hitch = np.column_stack([x + DRAWBAR.hitch_m * np.cos(h), y + DRAWBAR.hitch_m * np.sin(h)])
    for dx, dy in np.diff(hitch, axis=0):
        yaw += (dy * math.cos(yaw) - dx * math.sin(yaw)) / DRAWBAR.axle_m
    return yaw


def wave(step_m: float, direction: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Poses along a curve of changing curvature, 25 m."""
    s = direction * np.arange(0.0, 25.0, step_m)
    heading = 0.8 * np.sin(0.2 * s)
    ds = np.gradient(s)
    return np.column_stack([np.cumsum(ds * np.cos(heading)), np.cumsum(ds * np.sin(heading))]), heading


@pytest.mark.parametrize("hitch_rad", [0.0, 0.7, -0.5])
@pytest.mark.parametrize(("step_m", "error_rad"), [(0.1, 3e-4), (0.5, 5e-3)])
def test_follows_the_hitch(hitch_rad: float, step_m: float, error_rad: float) -> None:
    p, heading = wave(step_m)
    found = hitch_poses(DRAWBAR, p, heading, hitch_rad)
    assert found[-1, 2] == pytest.approx(pulled(p, heading, hitch_rad), abs=error_rad)
    assert found[:, :2] == pytest.approx(p + DRAWBAR.hitch_m * np.column_stack([np.cos(heading), np.sin(heading)]))


def test_angle_grows_in_reverse() -> None:
    p = np.column_stack([-np.arange(0.0, 6.0, 0.1), np.zeros(60)])
    found = hitch_poses(DRAWBAR, p, np.zeros(60), 0.1)
    assert found[-1, 2] == pytest.approx(pulled(p, np.zeros(60), 0.1), abs=1e-4)
    assert found[-1, 2] > 0.4
    assert follow(0.0, -3.0, 0.0, 3.7) == pytest.approx(0.0)


def test_closed_line_has_one_angle_where_it_begins_and_ends() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 400)
    p, heading = 6.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]), angle
    found = hitch_poses(DRAWBAR, p, heading, is_closed=True)
    hitch = found[:, 2] - heading
    assert hitch[0] == pytest.approx(hitch[-1], abs=5e-4)
    assert hitch[0] == pytest.approx(steady_angle(DRAWBAR, 1.0 / 6.0), abs=1e-3)


@pytest.mark.parametrize("hitch_rad", [0.2, 0.6, 1.05, 1.3])
def test_curvature_of_a_hitch_angle(hitch_rad: float) -> None:
    assert abs(steady_angle(DRAWBAR, curvature_of(DRAWBAR, hitch_rad))) == pytest.approx(hitch_rad)


@pytest.mark.parametrize("seed", range(5))
def test_no_driving_on_less_curvature_exceeds_the_angle(seed: int) -> None:
    rng, limit = np.random.default_rng(seed), curvature_of(DRAWBAR, 1.0)
    curvature = np.repeat(rng.choice([-limit, 0.0, limit], 60), rng.integers(1, 80, 60))
    heading = np.cumsum(curvature * 0.1)
    p = np.cumsum(0.1 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    hitch = hitch_poses(DRAWBAR, p, heading)[:, 2] - heading
    assert 0.8 < np.abs(hitch).max() < 1.0 + 0.02  # steps of a tenth of a metre


def test_run_in() -> None:
    length_m = run_in_m(DRAWBAR, 0.9, 0.02)
    p = np.column_stack([np.linspace(0.0, length_m, 200), np.zeros(200)])
    assert hitch_poses(DRAWBAR, p, np.zeros(200), 0.9)[-1, 2] == pytest.approx(0.02)
