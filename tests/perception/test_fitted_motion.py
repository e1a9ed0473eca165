"""Velocity by a line through the last detections of a track."""

import numpy as np
import pytest

from configs.strict import CONFIGS, parse, read_yaml
from perception.config import PerceptionConfig
from perception.fusion.fitted_motion import (
    KEPT,
    FittedMotionConfig,
    fitted_motion,
    has_travelled,
    length_in_view,
    remember,
)

PERIOD_NS, SINCE = 100_000_000, np.zeros(1, np.int64)


@pytest.fixture(scope="module")
def config() -> FittedMotionConfig:
    values = read_yaml(CONFIGS / "stack/perception.yaml")
    return parse(PerceptionConfig, values, "stack/perception.yaml").tracker.fitted_motion


def body(length_m: float = 0.6, height_m: float = 1.2) -> np.ndarray:
    return np.array([[length_m, 0.4, height_m]])


def seen(p_m: np.ndarray, period_ns: int = PERIOD_NS) -> tuple[np.ndarray, np.ndarray]:
    """Last detections of one track at the places (N, 2)."""
    recent_ns, recent_m = np.zeros((1, KEPT), np.int64), np.zeros((1, KEPT, 2))
    for k, p in enumerate(p_m):
        remember((recent_ns, recent_m, np.zeros((1, KEPT, 2))), (k + 1) * period_ns, p[None], np.zeros((1, 2)))
    return recent_ns, recent_m


def walk(count: int, speed_mps: float, noise_m: float = 0.0, seed: int = 1, period_s: float = 0.1) -> np.ndarray:
    t = period_s * np.arange(count)
    return np.stack([5.0 - speed_mps * t, np.full(count, 3.0)], axis=1) + np.random.default_rng(seed).normal(
        0.0, noise_m, (count, 2)
    )


def test_velocity_of_a_slow_walker(config: FittedMotionConfig) -> None:
    velocity, sigma, moves = fitted_motion(*seen(walk(12, 0.8)), SINCE, body(), config)
    assert velocity[0] == pytest.approx([-0.8, 0.0])
    t = 0.1 * np.arange(11)  # of one second
    assert sigma[0] == pytest.approx(config.min_residual_m / np.sqrt(((t - t.mean()) ** 2).sum()))
    assert moves[0]


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_no_motion_and_hides_none(config: FittedMotionConfig, seed: int) -> None:
    size_m = body()
    assert not fitted_motion(*seen(walk(12, 0.0, 0.06, seed)), SINCE, size_m, config)[2][0]
    velocity, sigma, moves = fitted_motion(*seen(walk(12, 1.2, 0.05, seed)), SINCE, size_m, config)
    assert moves[0]
    assert np.abs(velocity[0] - [-1.2, 0.0]).max() < 4.0 * sigma[0]


def test_what_is_no_motion(config: FittedMotionConfig) -> None:
    def moves(p_m: np.ndarray, **size: float) -> bool:
        return bool(fitted_motion(*seen(p_m), SINCE, body(**size), config)[2][0])

    fewest = config.detections
    assert moves(walk(fewest, 1.2))
    assert not moves(walk(fewest - 1, 1.2))
    assert not moves(walk(12, config.min_speed_mps - 0.01))
    assert moves(walk(12, config.min_speed_mps + 0.01))
    assert moves(walk(12, 1.2), length_m=config.max_length_m)
    assert not moves(walk(12, 1.2), length_m=config.max_length_m + 0.01)
    assert not moves(walk(12, 0.9), length_m=0.9 / config.length_share + 0.01)  # less than half of its length
    assert moves(walk(12, 1.2), height_m=config.min_height_m)
    assert not moves(walk(12, 1.2), height_m=config.min_height_m - 0.01)
    jump = walk(12, 0.0)
    jump[6:, 0] += 1.0
    assert not moves(jump)


def test_only_the_window_counts(config: FittedMotionConfig) -> None:
    turned = np.concatenate([walk(6, -3.0), walk(6, 1.2, period_s=0.25)])
    recent_ns, recent_m = seen(turned)
    recent_ns[0, -6:] = recent_ns[0, -7] + 250_000_000 * np.arange(1, 7)
    velocity, _, _ = fitted_motion(recent_ns, recent_m, SINCE, body(), config)
    assert velocity[0] == pytest.approx([-1.2, 0.0])
    _, sigma, moves = fitted_motion(np.zeros((1, KEPT), np.int64), np.zeros((1, KEPT, 2)), SINCE, body(), config)
    assert np.isfinite(sigma).all()
    assert not moves.any()


def test_only_detections_since_the_start_count(config: FittedMotionConfig) -> None:
    """A jump to another part, and then rest, is no motion; without the start at the jump the line has a slope."""
    p_m = np.concatenate([np.full((6, 2), 5.0), np.full((6, 2), 4.7)])
    since = np.array([7 * PERIOD_NS])
    velocity, _, _ = fitted_motion(*seen(p_m), SINCE, body(), config)
    assert velocity[0, 0] < -0.3
    velocity, _, moves = fitted_motion(*seen(p_m), since, body(), config)
    assert velocity[0] == pytest.approx([0.0, 0.0])
    assert not moves[0]


def test_travel_by_more_than_the_parts_of_a_body_are_apart() -> None:
    """In both halves of the time: parts of a calf alternate, a fence is seen elsewhere at once."""

    def travelled(p_m: np.ndarray, length_m: float = 1.3) -> bool:
        recent = seen(p_m[:-1])
        return bool(has_travelled(*recent, len(p_m) * PERIOD_NS, p_m[-1:], np.array([length_m]))[0])

    parts = np.zeros((8, 2))
    parts[::2, 0] = 0.5
    assert travelled(walk(8, 3.5) + parts)
    assert not travelled(walk(8, 1.0) + parts)
    assert not travelled(parts)
    assert not travelled(walk(8, 3.5) + parts, 2.0)
    jump = np.zeros((8, 2))
    for at in range(1, 8):
        jump[:] = 0.0
        jump[at:, 0] = 4.0
        assert not travelled(jump), at
    assert not travelled(walk(1, 3.5))


def test_length_as_each_sensor_saw_it_last() -> None:
    recent = np.zeros((1, KEPT), np.int64), np.zeros((1, KEPT, 2)), np.zeros((1, KEPT, 2))
    for k, (sensor, length_m) in enumerate([(0, 3.7), (2, 1.3), (0, 3.8), (2, 1.2)]):
        remember(recent, (k + 1) * PERIOD_NS, np.zeros((1, 2)), np.array([[sensor, length_m]]))

    def seen_m(sensor: int, since_ns: int = 0) -> float:
        return float(length_in_view(recent[0], recent[2], sensor, since_ns)[0])

    assert (seen_m(0), seen_m(2)) == (3.8, 1.2)
    assert np.isnan(seen_m(1))
    assert seen_m(0, 3 * PERIOD_NS) == 3.8
    assert np.isnan(seen_m(0, 3 * PERIOD_NS + 1))
