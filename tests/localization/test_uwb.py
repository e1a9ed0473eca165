"""UWB tag smoother: derivatives, calibration, outliers, unknown heading, invalid input, and recorded ranges."""

import gtsam
import numpy as np
import pytest

from benchmarks import uwb as benchmark
from configs.strict import CONFIGS, load
from geometry.arrays import Float64
from localization.graph.factors import C, X
from localization.graph.uwb_factor import ranges_factor
from localization.uwb.motion_models import ConstantVelocityModel, MotionModel, OdometryModel
from localization.uwb.tag_smoother import (
    OdometryStep,
    TagSmoother,
    TagSmootherConfig,
    shared_covariance,
    start_headings,
)
from localization.uwb.window import (
    Ranges,
    RobustWeighting,
    Window,
    WindowModel,
    covariance,
    drop_oldest,
    motion_rows,
    range_rows,
    range_weight,
    solve,
)
from messages.errors import FieldError
from tests.recordings import recording

CONFIG = load(TagSmootherConfig, CONFIGS / "uwb.yaml")
ANCHORS = {
    "a": np.array([0.0, 0.0, 2.0]),
    "b": np.array([30.0, 0.0, 2.5]),
    "c": np.array([30.0, 20.0, 2.0]),
    "d": np.array([0.0, 20.0, 3.0]),
}
WHERE = np.array(list(ANCHORS.values()))
WEIGHTING = RobustWeighting(0.1, 2.5, 4.0)
ARM = (1.2, -0.3)
Drive = list[tuple[int, OdometryStep, Float64]]


def window(motion: MotionModel, n: int = 4) -> Window:
    """A window away from its optimum."""
    rng = np.random.default_rng(3)
    c, x = motion.extra + 8, rng.normal(0.0, 1.0, (n, motion.size))
    x[:, :2] += 8.0
    steps = np.abs(rng.normal(1.0, 0.2, (n - 1, 7 if motion.extra else 1)))
    i = np.arange(3 * n)
    far = np.hypot(np.hypot(*(x[i % n, :2] - WHERE[i % 4, :2]).T), 1.0 - WHERE[i % 4, 2]) + rng.normal(0.0, 0.1, 3 * n)
    ranges = Ranges(i % n, i % 4, far, np.array(0.0 if motion.extra else 0.01) * i)
    common = rng.normal(0.0, 0.02, c)
    return Window(common, x, steps, ranges, np.eye(c + motion.size) * 50.0, np.concatenate([common, x[0]]))


def window_model(motion: MotionModel) -> WindowModel:
    """The anchors, and a tag with a lever arm if the model has a heading."""
    return WindowModel(motion, WHERE, np.array(ARM if motion.extra else (0.0, 0.0)), 1.0, WEIGHTING)


def moved(w: Window, d: Float64) -> Window:
    c = len(w.common)
    return Window(w.common + d[:c], w.x + d[c:].reshape(w.x.shape), w.steps, w.ranges, w.prior, w.prior_mean)


@pytest.mark.parametrize("motion", [OdometryModel(), ConstantVelocityModel(0.2)])
@pytest.mark.parametrize("rows", [range_rows, motion_rows])
def test_window_derivatives(motion: MotionModel, rows: object) -> None:
    w, s = window(motion), window_model(motion)
    _, J = rows(s, w)  # type: ignore[operator]
    for i, unit in enumerate(np.eye(J.shape[1]) * 1e-6):
        high, low = rows(s, moved(w, unit))[0], rows(s, moved(w, -unit))[0]  # type: ignore[operator]
        np.testing.assert_allclose(J[:, i], (high - low) / 2e-6, rtol=1e-5, atol=1e-4)


def test_constant_velocity_whitening() -> None:
    T, q = 0.7, 0.3
    K = ConstantVelocityModel(q).linear(np.zeros((1, 4)), np.zeros((1, 4)), np.zeros(0), np.array([[T]])).last[0]
    Q = q * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
    np.testing.assert_allclose(np.linalg.inv(K.T @ K), np.kron(Q, np.eye(2)), atol=1e-12)


@pytest.mark.parametrize("motion", [OdometryModel(), ConstantVelocityModel(0.2)])
def test_predict_leaves_no_residual(motion: MotionModel) -> None:
    step = np.array([1.0, 0.2, 0.3, 0.5, 0.1, 0.1, 0.1]) if motion.extra else np.array([0.5])
    x, extra = np.arange(1.0, 1.0 + motion.size), np.array([0.02, 0.01])[: motion.extra]
    last = motion.predict(x, extra, step)
    np.testing.assert_allclose(motion.linear(x[None], last[None], extra, step[None]).r, 0.0, atol=1e-9)


def test_marginalisation_keeps_covariance() -> None:
    """At the optimum the covariance of the remaining states is the same with and without the oldest keyframe."""
    motion, wide = ConstantVelocityModel(0.2), RobustWeighting(0.1, 1e6, 1e6)
    s = WindowModel(motion, WHERE, np.zeros(2), 1.0, wide)
    w = solve(s, window(motion), 30)
    less = drop_oldest(s, w, np.zeros((8, 8)))
    np.testing.assert_allclose(covariance(s, less), covariance(s, w), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(solve(s, less, 5).x, w.x[1:], atol=1e-6)
    walked = covariance(s, drop_oldest(s, w, np.eye(8) * 1e-2))
    assert np.all(np.diag(walked)[:8] > np.diag(covariance(s, w))[:8])


def test_long_range_weighs_less_than_short_one() -> None:
    w = range_weight(np.array([0.0, 2.5, -2.5, -4.0, 100.0]), WEIGHTING)
    assert w[[0, 1, 3]] == pytest.approx([1.0, 0.5, 0.5])
    assert w[4] < 1e-3 < w[1] < w[2]


def drive(
    seconds: float, scale: float = 1.03, bias_m: float = 0.3, late: float = 0.0, seed: int = 0
) -> tuple[Drive, Float64]:
    """A circle of 6 m at 1.5 m/s, four ranges every 0.2 s; `late` is the ratio of ranges 1 to 6 m too long."""
    rng, out, truth = np.random.default_rng(seed), [], []
    for k in range(1, int(seconds * 5)):
        t, turn = k * 0.2, 0.2 * 1.5 / 6.0
        yaw = 1.5 / 6.0 * t + np.pi / 2
        p = np.array([15.0 + 6.0 * np.cos(yaw - np.pi / 2), 10.0 + 6.0 * np.sin(yaw - np.pi / 2)])
        c, s = np.cos(yaw), np.sin(yaw)
        tag = np.array([p[0] + c * ARM[0] - s * ARM[1], p[1] + s * ARM[0] + c * ARM[1], 1.0])
        ranges = scale * np.linalg.norm(tag - WHERE, axis=1) + bias_m + rng.normal(0.0, 0.05, 4)
        ranges += (rng.uniform(size=4) < late) * rng.uniform(1.0, 6.0, 4)
        chord = 2 * 6.0 * np.sin(turn / 2)
        step = OdometryStep(
            chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn + rng.normal(0, 1e-3), 0.01, 0.01, 2e-3
        )
        out.append((k * 200_000_000, step, ranges))
        truth.append([*p, yaw])
    return out, np.array(truth)


def follow(measured: Drive, starts: list[Float64], sigma: Float64) -> tuple[TagSmoother, Float64]:
    """The smoother after a drive, and its states (n, 3)."""
    localizer = TagSmoother(CONFIG, ANCHORS, 1.0, ARM)
    localizer.start(0, starts, sigma)
    return localizer, np.array([localizer.add(t, s, list(ANCHORS), r).x for t, s, r in measured])


START = [np.array([21.0, 10.0, np.pi / 2])]
KNOWN = np.array([0.05, 0.05, 0.02])


def test_scale_and_bias_converge() -> None:
    measured, truth = drive(40.0)
    localizer, x = follow(measured, START, KNOWN)
    assert localizer.state is not None
    np.testing.assert_allclose(x[-50:, :2], truth[-50:, :2], atol=0.12)
    distance = np.linalg.norm(np.array([15.0, 10.0, 1.0]) - WHERE, axis=1)
    learned = localizer.state.scale * distance + localizer.state.bias_m
    np.testing.assert_allclose(learned, 1.03 * distance + 0.3, atol=0.1)
    assert 0.05 <= localizer.range_sigma_m < 0.1


def test_accuracy_with_20_percent_reflections() -> None:
    measured, truth = drive(40.0, late=0.2, seed=1)
    _, x = follow(measured, START, KNOWN)
    assert np.sqrt(np.mean(np.sum((x[50:, :2] - truth[50:, :2]) ** 2, axis=1))) < 0.15


def test_unknown_initial_heading() -> None:
    measured, truth = drive(20.0, scale=1.0, bias_m=0.0, seed=2)
    _, x = follow(measured, start_headings(21.0, 10.0, 8), np.array([0.2, 0.2, 0.4]))
    assert abs(np.angle(np.exp(1j * (x[-1, 2] - truth[-1, 2])))) < 0.03
    np.testing.assert_allclose(x[-1, :2], truth[-1, :2], atol=0.15)


def from_ranges(measured: Drive) -> tuple[TagSmoother, Float64]:
    """The smoother started from the first ranges, with the states (n, 3) and whether each was the only one."""
    localizer = TagSmoother(CONFIG, ANCHORS, 1.0, ARM)
    assert localizer.start_from_ranges(measured[0][0], list(ANCHORS), measured[0][2], 0.0)
    return localizer, np.array(
        [[*localizer.add(t, s, list(ANCHORS), r).x, localizer.is_unique] for t, s, r in measured[1:]]
    )


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_start_from_ranges_alone(seed: int) -> None:
    measured, truth = drive(20.0, seed=seed)
    localizer, x = from_ranges(measured)
    assert not x[0, 3]  # the heading is not known before the first metre
    assert localizer.is_unique
    placed = x[:, 3] > 0.5
    assert np.max(np.linalg.norm(x[placed, :2] - truth[1:][placed, :2], axis=1)) < 1.0
    assert np.max(np.abs(np.angle(np.exp(1j * (x[placed, 2] - truth[1:][placed, 2]))))) < 0.35
    np.testing.assert_allclose(x[-1, :2], truth[-1, :2], atol=0.25)


def test_start_needs_three_anchors() -> None:
    localizer = TagSmoother(CONFIG, ANCHORS, 1.0, ARM)
    assert not localizer.start_from_ranges(0, ["a", "b", "b"], np.array([15.0, 14.0, 14.1]), 0.0)


def test_two_runs_are_equal_to_the_bit() -> None:
    measured, _ = drive(8.0, late=0.2)
    assert np.array_equal(follow(measured, START, KNOWN)[1], follow(measured, START, KNOWN)[1])


def test_invalid_ranges_are_skipped() -> None:
    measured, _ = drive(3.0)
    good, bad = (TagSmoother(CONFIG, ANCHORS, 1.0, ARM) for _ in range(2))
    good.start(0, START, KNOWN)
    bad.start(0, START, KNOWN)
    wrong = np.array([np.nan, np.inf, 0.0, -1.0, 5.0])
    for t, s, r in measured:
        one = good.add(t, s, list(ANCHORS), r)
        two = bad.add(t, s, [*ANCHORS, "a", "b", "c", "d", "nobody"], np.concatenate([r, wrong]))
        assert np.array_equal(one.x, two.x)


def test_covariance_grows_without_ranges() -> None:
    measured, _ = drive(20.0)
    localizer, _ = follow(measured[:50], START, KNOWN)
    before = localizer.state
    for t, s, _ in measured[50:90]:
        localizer.add(t, s, [], np.zeros(0))
    assert before is not None
    assert localizer.state is not None
    assert np.trace(localizer.state.covariance[:2, :2]) > np.trace(before.covariance[:2, :2])


def test_invalid_use_raises() -> None:
    with pytest.raises(FieldError, match="anchors"):
        TagSmoother(CONFIG, {}, 1.0)
    with pytest.raises(FieldError, match="arm_m"):
        TagSmoother(CONFIG, ANCHORS, 1.0, (0.1, 0.0), has_odometry=False)
    localizer = TagSmoother(CONFIG, ANCHORS, 1.0, has_odometry=False)
    localizer.start(5, [np.zeros(4)], np.ones(4))
    with pytest.raises(FieldError, match="stamp_ns"):
        localizer.add(5, None, [], np.zeros(0))


def test_shared_covariance() -> None:
    np.testing.assert_allclose(shared_covariance(2, 3.0, 4.0), [[25.0, 9.0], [9.0, 25.0]])


def test_ranges_factor_derivatives() -> None:
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 2.0), np.array([3.0, 4.0, 1.0]))
    rows, lever_arms = np.array([1, 3]), np.array([[1.2, -0.3, 2.1], [0.2, 0.4, 2.0]])
    factor = ranges_factor(1, WHERE, lever_arms, rows, np.array([20.0, 15.0]), np.array([0.5, 0.2]))
    calibration = np.array([0.01, -0.02, 0.0, 0.02, 0.1, 0.2, -0.1, 0.05])
    values = gtsam.Values()
    values.insert(X(1), pose)
    values.insert(C(1), calibration)
    gaussian = factor.linearize(values)
    J = dict(zip((X(1), C(1)), np.split(gaussian.jacobian()[0], [6], axis=1), strict=True))
    assert list(gaussian.keys()) == [X(1), C(1)]
    for i, unit in enumerate(np.eye(6) * 1e-6):
        slope = (
            plain(factor, pose.retract(unit), calibration) - plain(factor, pose.retract(-unit), calibration)
        ) / 2e-6
        np.testing.assert_allclose(J[X(1)][:, i], slope, atol=1e-5)
    for i, unit in enumerate(np.eye(8) * 1e-6):
        slope = (plain(factor, pose, calibration + unit) - plain(factor, pose, calibration - unit)) / 2e-6
        np.testing.assert_allclose(J[C(1)][:, i], slope, atol=1e-5)


def plain(factor: gtsam.CustomFactor, pose: gtsam.Pose3, calibration: Float64) -> Float64:
    values = gtsam.Values()
    values.insert(X(1), pose)
    values.insert(C(1), calibration)
    return np.asarray(factor.unwhitenedError(values)) / np.array([0.5, 0.2])


def test_labyrinth() -> None:
    ours, truth = benchmark.tuc(recording("tuc-labyrinth-uwb") / "datasets" / "Indoor_UWB", CONFIG)
    assert benchmark.rms(benchmark.errors_m(ours, truth)) < 0.10


@pytest.mark.parametrize("run", benchmark.HANYANG[:1])
def test_recorded_ranges_without_a_start(run: str) -> None:
    folder = recording("hanyang-outdoor-uwb") / run
    truth, ours = benchmark.hanyang_track(folder / "trajectory.csv"), benchmark.hanyang(folder, CONFIG)
    assert benchmark.rms(benchmark.errors_m(ours, truth)) < 0.65
    assert benchmark.nees(ours, truth) < 3.0


def test_authors_result_is_reproduced() -> None:
    run = recording("hanyang-outdoor-uwb") / benchmark.HANYANG[0]
    truth = benchmark.hanyang_track(run / "trajectory.csv")
    part = benchmark.hanyang_track(run / "LS.csv").between(*benchmark.authors_window(truth))
    assert benchmark.rms(benchmark.errors_m(part, truth)) == pytest.approx(1.0383547, abs=2e-3)
