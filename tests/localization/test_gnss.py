"""GNSS gate at its limits."""

import dataclasses
import math

import numpy as np
import pytest

from datasets.importers.formats import open_recording
from localization.gnss_gate import GnssGate, Position, RejectionReason, check, position_of, source_of
from messages.motion import PositionSource
from messages.sensors import GnssFix, GnssSolution
from tests.localization.harness import configuration
from tests.localization.synthetic_drive import DATUM, START_NS
from tests.recordings import SAMPLES

CONFIG = configuration().map_alignment.gnss
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
        np.zeros(3),
        0.03,
        np.full(3, 0.008),
    )


def gate():
    out = GnssGate(CONFIG)
    out.trust(position())
    return out


def test_valid_fix_passes():
    assert check(GOOD, CONFIG) is RejectionReason.NONE
    assert np.allclose(position_of(GOOD, DATUM, CONFIG, 10.0).p_map_m, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "rejection"),
    [
        ({"latitude_rad": NAN}, RejectionReason.INVALID),
        ({"height_m": math.inf}, RejectionReason.INVALID),
        ({"latitude_rad": math.pi / 2 + 1e-9}, RejectionReason.INVALID),
        ({"sigma_enu_m": np.array([math.inf, 0.01, 0.01])}, RejectionReason.INVALID),
        ({"sigma_enu_m": np.array([-0.01, 0.01, 0.01])}, RejectionReason.INVALID),
        ({"solution": GnssSolution.NONE, "latitude_rad": NAN}, RejectionReason.NO_SOLUTION),
        ({"latitude_rad": 0.0, "longitude_rad": 0.0}, RejectionReason.INVALID),
        ({"satellites": CONFIG.min_satellites - 1}, RejectionReason.FEW_SATELLITES),
        ({"correction_age_s": CONFIG.max_correction_age_s + 1e-6}, RejectionReason.OLD_CORRECTIONS),
    ],
)
def test_rejection_reason(change, rejection):
    assert check(dataclasses.replace(GOOD, **change), CONFIG) is rejection


def test_fix_at_limits_passes():
    edge = dataclasses.replace(GOOD, satellites=CONFIG.min_satellites, correction_age_s=CONFIG.max_correction_age_s)
    assert check(edge, CONFIG) is RejectionReason.NONE


def test_unknown_values_are_no_reason_to_refuse():
    unknown = dataclasses.replace(
        GOOD, satellites=None, correction_age_s=NAN, hdop=NAN, sigma_enu_m=np.array([NAN, NAN, 0.1])
    )
    assert check(unknown, CONFIG) is RejectionReason.NONE
    found = position_of(unknown, DATUM, CONFIG, 10.0)
    factor = CONFIG.unknown_sigma_factor
    assert np.hypot(found.sigma_m, found.slow_m) == pytest.approx([0.008 * factor, 0.008 * factor, 0.1])
    assert check(dataclasses.replace(unknown, satellites=0), CONFIG) is RejectionReason.FEW_SATELLITES
    old = dataclasses.replace(unknown, correction_age_s=CONFIG.max_correction_age_s + 1.0)
    assert check(old, CONFIG) is RejectionReason.OLD_CORRECTIONS


def test_sigma_lower_bound():
    optimistic = dataclasses.replace(GOOD, sigma_enu_m=np.full(3, 1e-4))
    found = position_of(optimistic, DATUM, CONFIG, 10.0)
    assert np.hypot(found.sigma_m, found.slow_m) == pytest.approx([0.008, 0.008, 0.015])


def test_accuracy_order_of_solutions():
    kinds = (GnssSolution.RTK_FIXED, GnssSolution.PPP, GnssSolution.RTK_FLOAT, GnssSolution.SBAS, GnssSolution.SINGLE)
    sigma = [position_of(dataclasses.replace(GOOD, solution=k), DATUM, CONFIG, 10.0).slow_m[0] for k in kinds]
    assert sigma == sorted(sigma)
    assert source_of(GnssSolution.PPP) is PositionSource.RTK_FLOAT


def test_correlated_solution_information_independent_of_rate():
    slow, fast = (
        position_of(dataclasses.replace(GOOD, solution=GnssSolution.RTK_FLOAT), DATUM, CONFIG, f) for f in (1.0, 10.0)
    )
    assert fast.sigma_m == pytest.approx(slow.sigma_m * math.sqrt(10.0))


def test_innovation_gate_limit():
    covariance = np.eye(3) * 0.02**2
    sigma = math.sqrt(0.02**2 + 0.008**2 + (CONFIG.gate_floor_m / CONFIG.gate_sigma) ** 2)
    for share in (*np.linspace(0.95, 0.999, 5), *np.linspace(1.001, 1.05, 5)):
        expected = RejectionReason.NONE if share < 1 else RejectionReason.OUTLIER
        assert gate().evaluate(position(share * sigma * CONFIG.gate_sigma), np.zeros(3), covariance) is expected


def test_code_far_from_the_prediction_is_refused_whatever_its_correlation():
    fix = dataclasses.replace(GOOD, solution=GnssSolution.SBAS, sigma_enu_m=np.array([0.9, 0.9, 1.8]))
    code, covariance = position_of(fix, DATUM, CONFIG, 10.0), np.diag([2.0, 2.0, 1.0]) ** 2
    tested = GnssGate(CONFIG)
    tested.trust(code)
    assert tested.evaluate(code, np.array([8.0, 0.0, 0.0]), covariance) is RejectionReason.NONE
    assert tested.evaluate(code, np.array([20.0, 0.0, 0.0]), covariance) is RejectionReason.OUTLIER


@pytest.mark.parametrize(("solution", "is_used"), [(GnssSolution.SBAS, True), (GnssSolution.RTK_FIXED, False)])
def test_a_wrong_height_refuses_fixed_ambiguities_only(solution, is_used):
    fix = position_of(dataclasses.replace(GOOD, solution=solution), DATUM, CONFIG, 10.0)
    tested, far_m, covariance = GnssGate(CONFIG), np.array([0.0, 0.0, 30.0]), 0.01 * np.eye(3)
    tested.trust(fix)
    assert (tested.evaluate(fix, far_m, covariance) is RejectionReason.NONE) is is_used
    assert not tested.has_height(fix, far_m, covariance)
    assert tested.has_height(fix, np.zeros(3), covariance)


def test_confirmation_after_outage():
    wide, g = np.eye(3), gate()
    late = round(CONFIG.outage_s * 10) + 2
    reasons = [g.evaluate(position(0.3, late + k), np.zeros(3), wide) for k in range(CONFIG.confirmation_fixes + 1)]
    assert reasons == [RejectionReason.CONFIRMATION] * (CONFIG.confirmation_fixes - 1) + [RejectionReason.NONE] * 2
    g = gate()
    jumping = [g.evaluate(position(0.3 * (-1) ** k, late + k), np.zeros(3), wide) for k in range(20)]
    assert set(jumping) == {RejectionReason.CONFIRMATION}


def test_confirmation_after_upgrade():
    g = GnssGate(CONFIG)
    g.trust(position(solution=GnssSolution.RTK_FLOAT))
    assert g.evaluate(position(k=1), np.zeros(3), np.eye(3)) is RejectionReason.CONFIRMATION


def test_fixes_of_a_receiver_with_unknown_sigmas_are_judged_by_what_is_known():
    """The committed NMEA sample has neither GST nor the age of corrections in all of its fixes."""
    fixes = [m for _, _, m in open_recording(SAMPLES / "gnss/nmea_rtk.log").read()]
    usable = [fix for fix in fixes if CONFIG.of(fix.solution) is not None]
    assert {fix.solution for fix in usable} >= {GnssSolution.RTK_FIXED}
    reasons = {check(fix, CONFIG) for fix in usable}
    assert reasons <= {RejectionReason.NONE, RejectionReason.OLD_CORRECTIONS}
    accepted = [fix for fix in usable if check(fix, CONFIG) is RejectionReason.NONE]
    assert accepted
    for fix in accepted:
        assert np.isnan(fix.sigma_enu_m).all()
        assert np.isfinite(position_of(fix, DATUM, CONFIG, 10.0).sigma_m).all()


def test_fix_without_height():
    fix = dataclasses.replace(GOOD, height_m=NAN)
    assert check(fix, CONFIG) is RejectionReason.NONE
    found, here = position_of(fix, DATUM, CONFIG, 10.0), np.array([0.0, 0.0, 7.0])  # the machine has climbed
    assert not found.has_height
    assert gate().evaluate(found, here, 1e-6 * np.eye(3)) is RejectionReason.NONE
    assert not gate().has_height(found, here, 1e-6 * np.eye(3))
    assert gate().evaluate(position(), here, 1e-6 * np.eye(3)) is RejectionReason.OUTLIER


@pytest.mark.parametrize("speed_mps", [516.0, -1e300, math.inf])
def test_impossible_velocity_is_no_measurement(speed_mps):
    fix = dataclasses.replace(GOOD, velocity_enu_mps=np.array([0.0, speed_mps, 0.0]))
    assert np.isnan(position_of(fix, DATUM, CONFIG, 10.0).velocity_mps).all()
