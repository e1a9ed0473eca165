"""Inertial unit and wheels that lie: each rule at its limit, and whole drives with one device broken."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from localization.dead_reckoning.plausibility import (
    CODES,
    Agreement,
    AgreementConfig,
    Blame,
    InertialCheck,
    Plausibility,
)
from localization.faults import FAULTS
from messages.faults import Response
from tests.localization.localization_bench import configuration, run
from tests.localization.localization_drive import START_NS, Wrongs, drive

CONFIG = configuration().motion.plausibility
REST = np.array([0.0, 0.0, 9.80665, 0.0, 0.0, 0.0])
STEP_NS = 20_000_000
RULE = AgreementConfig(floor=0.2, per_change=0.1, per_m=0.05)


def around(limit, step):
    return [limit + k * step for k in range(-5, 6) if k]


def shaken(amplitude, axes=slice(0, 6), rest=REST):
    """A check that has seen samples up and down by an amplitude: sigma is √2 times it."""
    check = InertialCheck(CONFIG)
    for k in range(2 * CONFIG.samples):
        value = rest.copy()
        value[axes] += amplitude * (-1) ** k
        value += 1e-9 * k  # noise never repeats itself
        check.add(value)
    doubt = check.doubt()
    return doubt and doubt.code


def test_equal_samples_in_a_row_are_frozen():
    check = InertialCheck(CONFIG)
    for count in range(1, 2 * CONFIG.frozen_samples):
        check.add(REST)
        assert (check.doubt() is not None) == (count >= CONFIG.frozen_samples)
    assert check.doubt().code == "imu.frozen"
    check.add(REST + 1e-9)
    assert check.doubt() is None


def test_shake_at_its_limits():
    for sigma in around(CONFIG.largest_shake_mps2, 1e-3):
        code = shaken(sigma / math.sqrt(2.0), slice(0, 3))
        assert code == ("imu.noisy" if sigma > CONFIG.largest_shake_mps2 else None)
    for sigma in around(CONFIG.largest_shake_radps, 1e-4):
        code = shaken(sigma / math.sqrt(2.0), slice(3, 6))
        assert code == ("imu.noisy" if sigma > CONFIG.largest_shake_radps else None)


@pytest.mark.parametrize("sign", [-1, 1])
def test_weight_at_its_limits(sign):
    for error in around(CONFIG.largest_weight_error_mps2, 1e-3):
        rest = REST + sign * np.array([0.0, 0.0, error, 0.0, 0.0, 0.0])
        assert shaken(1e-6, rest=rest) == ("imu.implausible" if error > CONFIG.largest_weight_error_mps2 else None)


def agreement(first, second, third=None, seconds=2.0, way=0.0, begins_s=0.0):
    """Three measures that change steadily from a time on; the third comes at 10 Hz."""
    both = Agreement(RULE, 1.0, 0.2)
    for k in range(round(seconds * 50) + 1):
        t, stamp_ns = max(0.0, k / 50 - begins_s), k * STEP_NS
        both.add(stamp_ns, first * t, second * t, way * t)
        if third is not None and k % 5 == 0:
            both.refer(stamp_ns, third * t)
    return both


@pytest.mark.parametrize(("change", "way"), [(0.0, 0.0), (0.0, 3.0), (0.5, 0.0), (-0.5, 2.0)])
def test_a_contradiction_at_its_limit(change, way):
    limit = RULE.floor + RULE.per_change * abs(change) + RULE.per_m * way
    for error in around(limit, 1e-4):
        further = change + math.copysign(error, change)
        assert (agreement(further, change, way=way).blame() is not None) == (error > limit)
        assert (agreement(change, further, way=way).blame() is not None) == (error > limit)


def test_a_contradiction_must_last():
    """0.5 a second is over the limit after 0.4 s, and held 0.2 s later."""
    told = [agreement(0.5, 0.0, seconds=s).blame() for s in (0.56, 0.6, 0.64, 0.68)]
    assert told == [None, None, Blame.EITHER, Blame.EITHER]


def test_the_third_says_which_is_wrong():
    assert agreement(1.0, 0.0, third=0.0).blame() is Blame.FIRST
    assert agreement(1.0, 0.0, third=1.0).blame() is Blame.SECOND
    assert agreement(1.0, 0.0, third=0.3).blame() is Blame.FIRST
    assert agreement(1.0, 0.0, third=0.5).blame() is Blame.EITHER
    assert agreement(1.0, 0.0, third=5.0).blame() is Blame.EITHER
    assert agreement(1.0, 0.0).blame() is Blame.EITHER


def test_a_doubt_stays_until_there_has_been_none_for_long_enough():
    whole, heal_ns = Plausibility(CONFIG), round(CONFIG.heal_s * 1e9)
    for _ in range(CONFIG.frozen_samples):
        whole.inertial.add(REST)
    assert whole.judge(START_NS).code == "imu.frozen"
    whole.clear()
    assert whole.judge(START_NS + heal_ns).code == "imu.frozen"
    assert whole.judge(START_NS + heal_ns + 1) is None


def test_every_doubt_stops_the_machine_and_is_told_in_two_languages():
    for code in CODES:
        fault = FAULTS[code]
        assert fault.response is Response.CONTROLLED_STOP
        assert fault.text_en != fault.text_zh


SPEED_MPS, BROKEN_S = 2.0, 9.0


@functools.cache
def truth(curvature=0.0, speed_mps=SPEED_MPS):
    return drive(11, legs=[(4.0, 0.0, 0.0), (100.0, speed_mps, curvature)], wrongs=Wrongs(seed=4))


def doubted(messages):
    """What is told of unit and wheels: code and how long after the device broke."""
    found = [f for f in run(messages).faults if f.code in CODES and f.is_active]
    return [(f.code, (f.stamp_ns - START_NS) * 1e-9 - BROKEN_S) for f in found]


def broken(change, topic, curvature=0.0, speed_mps=SPEED_MPS, without=()):
    """A drive in which a device breaks."""
    out = []
    for arrival, name, message in truth(curvature, speed_mps).messages:
        is_late = message.stamp_ns > START_NS + round(BROKEN_S * 1e9)
        if name not in without or not is_late:
            out.append((arrival, name, change(message) if name == topic and is_late else message))
    return doubted(out)


@pytest.mark.parametrize("curvature", [0.0, 0.2, -0.2])
@pytest.mark.parametrize("speed_mps", [SPEED_MPS, -0.5])
def test_sound_devices_are_believed(curvature, speed_mps):
    assert broken(lambda m: m, "imu", curvature, speed_mps) == []


def test_a_frozen_unit():
    kept = []

    def freeze(m):
        kept.append(m)
        return replace(kept[0], stamp_ns=m.stamp_ns)

    ((code, after_s),) = broken(freeze, "imu")
    assert code == "imu.frozen"
    assert after_s <= 0.13


def test_a_noisy_unit():
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
def test_an_offset_is_found_and_the_right_device_blamed(topic, field, factor, offset, curvature):
    def shift(m):
        return replace(m, **{field: getattr(m, field) + offset * factor})

    ((code, after_s),) = broken(shift, topic, curvature)
    assert code == f"{topic}.implausible"
    assert after_s <= 1.3


def test_wheels_that_turn_the_sign_of_a_slow_speed_are_blamed():
    ((code, after_s),) = broken(lambda m: replace(m, speed_mps=m.speed_mps + 0.5), "wheel", speed_mps=-0.3)
    assert code == "wheel.implausible"
    assert after_s <= 1.3


def test_without_gnss_both_are_named():
    def shift(m):
        return replace(m, speed_mps=m.speed_mps + 0.5)

    ((code, after_s),) = broken(shift, "wheel", without=("gnss/main",))
    assert code == "imu_or_wheel.implausible"
    assert after_s <= 0.3


def test_silent_wheels_are_silent_and_not_implausible():
    curved = truth(0.2).messages
    late = [m for m in curved if m[1] != "wheel" or not 9.0 < (m[0] - START_NS) * 1e-9 < 10.5]
    assert doubted(late) == []
