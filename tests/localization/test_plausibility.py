"""Plausibility of IMU and wheels: each limit, and drives with one faulty sensor."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from localization.dead_reckoning.plausibility import (
    CODES,
    CrossCheck,
    CrossCheckConfig,
    ImuCheck,
    Plausibility,
    Suspect,
)
from localization.faults import FAULTS
from messages.faults import Response
from tests.localization.harness import configuration, run
from tests.localization.synthetic_drive import START_NS, SensorErrors, drive

CONFIG = configuration().odometry.plausibility
REST = np.array([0.0, 0.0, 9.80665, 0.0, 0.0, 0.0])
STEP_NS = 20_000_000
RULE = CrossCheckConfig(floor=0.2, per_change=0.1, per_m=0.05, per_noise=0.2)


def around(limit, step):
    return [limit + k * step for k in range(-5, 6) if k]


def shaken(amplitude, axes=slice(0, 6), rest=REST):
    """Suspicion after alternating samples of an amplitude: sigma is √2 times it."""
    check = ImuCheck(CONFIG)
    for k in range(2 * max(CONFIG.samples, CONFIG.gravity_samples)):
        value = rest.copy()
        value[axes] += amplitude * (-1) ** k
        value += 1e-5 * (k % 3)  # noise never repeats
        check.add(k, value)
    suspicion = check.suspicion()
    return suspicion and suspicion.code


def test_frozen_imu_limit():
    check = ImuCheck(CONFIG)
    for count in range(1, 2 * CONFIG.frozen_samples):
        check.add(count, REST)
        assert (check.suspicion() is not None) == (count >= CONFIG.frozen_samples)
    assert check.suspicion().code == "imu.frozen"
    check.add(2 * CONFIG.frozen_samples, REST + 1e-5)
    assert check.suspicion() is None


def test_interpolated_samples_are_no_measurements():
    check, rng = ImuCheck(CONFIG), np.random.default_rng(1)
    for k in range(120):
        is_lost = 40 <= k < 80
        check.add(k * STEP_NS, REST + (1e-3 * (k - 40) if is_lost else 1e-3 * rng.standard_normal(6)))
        assert (check.suspicion() is not None) == (40 + CONFIG.frozen_samples - 1 <= k < 80)
        assert check.take_unmeasured_s() == (pytest.approx(39 * STEP_NS * 1e-9) if k == 80 else 0.0)


def test_interpolated_samples_hide_a_turn_from_the_heading():
    truth = drive(16.0, legs=[(4.0, 0.0, 0.0), (100.0, 2.5, 0.0)], sensor_errors=SensorErrors(seed=2))
    imu = [m for _, topic, m in truth.messages if topic == "imu"]
    from_s, to_s = 10.0, 11.0
    lost = [m for m in imu if from_s <= (m.stamp_ns - START_NS) * 1e-9 <= to_s]
    stamps = [lost[0].stamp_ns, lost[-1].stamp_ns]

    def interpolated(message, field):
        ends = np.array([getattr(lost[0], field), getattr(lost[-1], field)])
        return np.array([np.interp(message.stamp_ns, stamps, ends[:, k]) for k in range(3)])

    messages = [
        (a, t, replace(m, **{f: interpolated(m, f) for f in ("acceleration_mps2", "rate_radps")}))
        if t == "imu" and stamps[0] <= m.stamp_ns <= stamps[1] else (a, t, m)
        for a, t, m in truth.messages
        if not (t.startswith("gnss") and from_s <= (m.stamp_ns - START_NS) * 1e-9)
    ]  # fmt: skip
    result = run(messages)
    t_s = np.array([(p.stamp_ns - START_NS) * 1e-9 for p in result.poses])
    sigma_deg = np.degrees([math.sqrt(p.covariance[2, 2]) for p in result.poses])
    assert np.max(sigma_deg[(t_s > 9.0) & (t_s < 10.5)]) < 1.0
    assert np.min(sigma_deg[t_s > 12.0]) > 5.0
    assert "imu.frozen" in {f.code for f in result.faults}


def test_noise_limits():
    for sigma in around(CONFIG.max_noise_mps2, 1e-3):
        code = shaken(sigma / math.sqrt(2.0), slice(0, 3))
        assert code == ("imu.noisy" if sigma > CONFIG.max_noise_mps2 else None)
    for sigma in around(CONFIG.max_noise_radps, 1e-4):
        code = shaken(sigma / math.sqrt(2.0), slice(3, 6))
        assert code == ("imu.noisy" if sigma > CONFIG.max_noise_radps else None)


@pytest.mark.parametrize("sign", [-1, 1])
def test_gravity_error_limits(sign):
    for error in around(CONFIG.max_gravity_error_mps2, 1e-3):
        rest = REST + sign * np.array([0.0, 0.0, error, 0.0, 0.0, 0.0])
        assert shaken(1e-6, rest=rest) == ("imu.implausible" if error > CONFIG.max_gravity_error_mps2 else None)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_fall_into_a_rut_is_no_error_of_gravity(sign):
    check = ImuCheck(CONFIG)
    for k in range(3 * CONFIG.gravity_samples):
        value = REST + 1e-5 * (k % 3)
        if 0 <= k - 1.5 * CONFIG.gravity_samples < 20:
            value[2] += sign * 7.5  # 0.2 s at 100 Hz: 1.5 m/s
        check.add(k, value)
        assert check.suspicion() is None


def cross_check(first, second, reference=None, seconds=2.0, path=0.0, begins_s=0.0, noise=0.0):
    """A cross check after steady changes from a time on; the reference comes at 10 Hz."""
    check = CrossCheck(RULE, 1.0, 0.2)
    for k in range(round(seconds * 50) + 1):
        t, stamp_ns = max(0.0, k / 50 - begins_s), k * STEP_NS
        check.add(stamp_ns, first * t, second * t, path * t, noise)
        if reference is not None and k % 5 == 0:
            check.set_reference(stamp_ns, reference * t)
    return check


@pytest.mark.parametrize(
    ("change", "path", "noise"), [(0.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.5, 0.0, 0.0), (-0.5, 2.0, 0.0), (0.5, 2.0, 3.0)]
)
def test_contradiction_limit(change, path, noise):
    limit = RULE.floor + RULE.per_change * abs(change) + RULE.per_m * path + RULE.per_noise * noise
    for error in around(limit, 1e-4):
        further = change + math.copysign(error, change)
        for pair in ((further, change), (change, further)):
            assert (cross_check(*pair, path=path, noise=noise).suspect() is not None) == (error > limit)


def test_contradiction_debounce():
    """0.5 per second exceeds the limit after 0.4 s, and the debounce time 0.2 s later."""
    suspects = [cross_check(0.5, 0.0, seconds=s).suspect() for s in (0.56, 0.6, 0.64, 0.68)]
    assert suspects == [None, None, Suspect.EITHER, Suspect.EITHER]


def test_reference_identifies_faulty_sensor():
    assert cross_check(1.0, 0.0, reference=0.0).suspect() is Suspect.FIRST
    assert cross_check(1.0, 0.0, reference=1.0).suspect() is Suspect.SECOND
    assert cross_check(1.0, 0.0, reference=0.3).suspect() is Suspect.FIRST
    assert cross_check(1.0, 0.0, reference=0.5).suspect() is Suspect.EITHER
    assert cross_check(1.0, 0.0, reference=5.0).suspect() is Suspect.EITHER
    assert cross_check(1.0, 0.0).suspect() is Suspect.EITHER


def test_suspicion_recovery():
    plausibility, heal_ns = Plausibility(CONFIG), round(CONFIG.recovery_s * 1e9)
    for _ in range(CONFIG.frozen_samples):
        plausibility.imu.add(START_NS, REST)
    assert plausibility.evaluate(START_NS).code == "imu.frozen"
    plausibility.clear()
    assert plausibility.evaluate(START_NS + heal_ns).code == "imu.frozen"
    assert plausibility.evaluate(START_NS + heal_ns + 1) is None


def test_noise_of_the_imu_is_allowed_for_in_its_changes():
    """A vibration of 3 m/s²: a change of speed by 0.5 m/s that the wheels do not show is no contradiction."""
    for vibration in (0.0, 3.0):
        plausibility = Plausibility(CONFIG)
        for k in range(120):
            shaking = vibration * (-1) ** k / math.sqrt(2.0) * np.array([1, 1, 1, 0, 0, 0])
            plausibility.imu.add(START_NS + k * STEP_NS, REST + shaking + 1e-5 * (k % 3))
            plausibility.evaluate(START_NS + k * STEP_NS)
            plausibility.advance(START_NS + k * STEP_NS, 0.02, (0.0, 0.5), (0.0, 0.0))
        assert (plausibility.speed.suspect() is None) == (vibration > 0.0)


def test_every_suspicion_stops_and_has_two_texts():
    for code in CODES:
        fault = FAULTS[code]
        assert fault.response is Response.CONTROLLED_STOP
        assert fault.text_en != fault.text_zh


SPEED_MPS, BROKEN_S = 2.0, 9.0


@functools.cache
def truth(curvature=0.0, speed_mps=SPEED_MPS):
    return drive(11, legs=[(4.0, 0.0, 0.0), (100.0, speed_mps, curvature)], sensor_errors=SensorErrors(seed=4))


def suspected(messages):
    """Faults of IMU and wheels: code and time after the failure (s)."""
    found = [f for f in run(messages).faults if f.code in CODES and f.is_active]
    return [(f.code, (f.stamp_ns - START_NS) * 1e-9 - BROKEN_S) for f in found]


def broken(change, topic, curvature=0.0, speed_mps=SPEED_MPS, without=()):
    """Faults of a drive in which a sensor fails."""
    out = []
    for arrival, name, message in truth(curvature, speed_mps).messages:
        is_late = message.stamp_ns > START_NS + round(BROKEN_S * 1e9)
        if name not in without or not is_late:
            out.append((arrival, name, change(message) if name == topic and is_late else message))
    return suspected(out)


@pytest.mark.parametrize("curvature", [0.0, 0.2, -0.2])
@pytest.mark.parametrize("speed_mps", [SPEED_MPS, -0.5])
def test_no_fault_with_working_sensors(curvature, speed_mps):
    assert broken(lambda m: m, "imu", curvature, speed_mps) == []


def test_no_fault_over_crests():
    """Crests of 0.24 m every 6.3 m swing the IMU, 1.1 m above the wheels, to and fro with 0.3 m/s."""
    truth = drive(14.0, sensor_errors=SensorErrors(furrow_m=0.12))
    assert run(truth.messages).faults == []


def test_frozen_imu():
    kept = []

    def freeze(m):
        kept.append(m)
        return replace(kept[0], stamp_ns=m.stamp_ns)

    ((code, after_s),) = broken(freeze, "imu")
    assert code == "imu.frozen"
    assert after_s <= 0.13


def test_noisy_imu():
    rng = np.random.default_rng(1)

    def shake(m):
        rate = m.rate_radps + rng.normal(0.0, 0.3, 3)
        return replace(m, rate_radps=rate, acceleration_mps2=m.acceleration_mps2 + rng.normal(0.0, 5.0, 3))

    ((code, after_s),) = broken(shake, "imu")
    assert code == "imu.noisy"
    assert after_s <= 0.2


@pytest.mark.parametrize("curvature", [0.0, 0.2, -0.2])
@pytest.mark.parametrize("offset", [-0.1, 0.1])
@pytest.mark.parametrize(
    ("topic", "field", "factor"),
    [("imu", "rate_radps", np.array([0.0, 0.0, 1.0])), ("imu", "acceleration_mps2", np.array([6.0, 0.0, 0.0])),
     ("wheel", "steering_angle_rad", 1.2), ("wheel", "speed_mps", 5.0)],
)  # fmt: skip
def test_offset_identifies_faulty_sensor(topic, field, factor, offset, curvature):
    def shift(m):
        return replace(m, **{field: getattr(m, field) + offset * factor})

    ((code, after_s),) = broken(shift, topic, curvature)
    assert code == f"{topic}.implausible"
    assert after_s <= 1.3


def test_wheel_offset_reversing_slow_speed():
    ((code, after_s),) = broken(lambda m: replace(m, speed_mps=m.speed_mps + 0.5), "wheel", speed_mps=-0.3)
    assert code == "wheel.implausible"
    assert after_s <= 1.3


def test_either_suspected_without_gnss():
    def shift(m):
        return replace(m, speed_mps=m.speed_mps + 0.5)

    ((code, after_s),) = broken(shift, "wheel", without=("gnss/main",))
    assert code == "imu_or_wheel.implausible"
    assert after_s <= 0.3


def test_wheel_timeout_is_not_implausible():
    curved = truth(0.2).messages
    late = [m for m in curved if m[1] != "wheel" or not 9.0 < (m[0] - START_NS) * 1e-9 < 10.5]
    assert suspected(late) == []
