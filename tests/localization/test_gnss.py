"""What is believed of a fix, at the boundaries."""

import dataclasses
import math

import numpy as np
import pytest

from localization.gnss_gate import GnssGate, Position, Refusal, check, position_of, source_of
from messages.motion import PositionSource
from messages.sensors import GnssFix, GnssSolution
from tests.localization.localization_bench import configuration
from tests.localization.localization_drive import DATUM, START_NS

CONFIG = configuration().placement.gnss
NAN = math.nan
GOOD = GnssFix(
    START_NS, DATUM.latitude_rad, DATUM.longitude_rad, DATUM.height_m, np.array([0.008, 0.008, 0.015]),
    np.zeros(3), 0.03, 0.5, 0.002, GnssSolution.RTK_FIXED, 18, 0.8, 1.0, "BDS",
)  # fmt: skip


def position(offset_m=0.0, k=0, solution=GnssSolution.RTK_FIXED):
    return Position(
        START_NS + k * 100_000_000,
        np.array([offset_m, 0, 0]),
        np.full(3, 0.006),
        np.full(3, 0.005),
        NAN,
        NAN,
        NAN,
        solution,
    )


def gate():
    out = GnssGate(CONFIG)
    out.trust(position())
    return out


def test_a_good_fix_passes():
    assert check(GOOD, CONFIG) is Refusal.NONE
    assert np.allclose(position_of(GOOD, DATUM, CONFIG, 10.0).p_map_m, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({"latitude_rad": NAN}, Refusal.GARBAGE),
        ({"height_m": math.inf}, Refusal.GARBAGE),
        ({"latitude_rad": math.pi / 2 + 1e-9}, Refusal.GARBAGE),
        ({"sigma_enu_m": np.array([NAN, 0.01, 0.01])}, Refusal.GARBAGE),
        ({"sigma_enu_m": np.array([-0.01, 0.01, 0.01])}, Refusal.GARBAGE),
        ({"solution": GnssSolution.NONE, "latitude_rad": NAN}, Refusal.NO_SOLUTION),
        ({"satellites": CONFIG.least_satellites - 1}, Refusal.FEW_SATELLITES),
        ({"correction_age_s": NAN}, Refusal.OLD_CORRECTIONS),
        ({"correction_age_s": CONFIG.largest_correction_age_s + 1e-6}, Refusal.OLD_CORRECTIONS),
    ],
)
def test_a_bad_fix_is_refused_with_its_reason(change, refusal):
    assert check(dataclasses.replace(GOOD, **change), CONFIG) is refusal


def test_limits_themselves_pass():
    edge = dataclasses.replace(
        GOOD, satellites=CONFIG.least_satellites, correction_age_s=CONFIG.largest_correction_age_s
    )
    assert check(edge, CONFIG) is Refusal.NONE


def test_nothing_is_believed_better_than_its_kind():
    boast = dataclasses.replace(GOOD, sigma_enu_m=np.full(3, 1e-4))
    found = position_of(boast, DATUM, CONFIG, 10.0)
    assert np.hypot(found.sigma_m, found.slow_m) == pytest.approx([0.008, 0.008, 0.015])


def test_kinds_differ_in_worth():
    kinds = (GnssSolution.RTK_FIXED, GnssSolution.PPP, GnssSolution.RTK_FLOAT, GnssSolution.SBAS, GnssSolution.SINGLE)
    sigma = [position_of(dataclasses.replace(GOOD, solution=k), DATUM, CONFIG, 10.0).slow_m[0] for k in kinds]
    assert sigma == sorted(sigma)
    assert source_of(GnssSolution.PPP) is PositionSource.RTK_FLOAT


def test_information_does_not_grow_with_the_rate_of_a_correlated_kind():
    slow, fast = (
        position_of(dataclasses.replace(GOOD, solution=GnssSolution.RTK_FLOAT), DATUM, CONFIG, f) for f in (1.0, 10.0)
    )
    assert fast.sigma_m == pytest.approx(slow.sigma_m * math.sqrt(10.0))


def test_the_gate_opens_exactly_at_its_sigma():
    covariance = np.eye(3) * 0.02**2
    sigma = math.sqrt(0.02**2 + 0.006**2 + 0.005**2 + (CONFIG.gate_floor_m / CONFIG.gate_sigma) ** 2)
    for share in (*np.linspace(0.95, 0.999, 5), *np.linspace(1.001, 1.05, 5)):
        wanted = Refusal.NONE if share < 1 else Refusal.OUTLIER
        assert gate().judge(position(share * sigma * CONFIG.gate_sigma), np.zeros(3), covariance) is wanted


def test_after_an_outage_fixes_must_agree():
    wide, g = np.eye(3), gate()
    late = round(CONFIG.outage_s * 10) + 2
    said = [g.judge(position(0.3, late + k), np.zeros(3), wide) for k in range(CONFIG.probation_fixes + 1)]
    assert said == [Refusal.PROBATION] * (CONFIG.probation_fixes - 1) + [Refusal.NONE] * 2
    g = gate()
    jumping = [g.judge(position(0.3 * (-1) ** k, late + k), np.zeros(3), wide) for k in range(20)]
    assert set(jumping) == {Refusal.PROBATION}


def test_a_better_kind_is_on_probation_too():
    g = GnssGate(CONFIG)
    g.trust(position(solution=GnssSolution.RTK_FLOAT))
    assert g.judge(position(k=1), np.zeros(3), np.eye(3)) is Refusal.PROBATION
