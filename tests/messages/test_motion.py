"""Odometry at the time of a measurement: between messages, predicted, or none."""

import numpy as np
import pytest

from geometry.transforms import planar, yaw_of
from messages.motion import PREDICTED_S, Odometry, odometry_at
from tests.localization.harness import StubInbox

MS = 1_000_000
SPEED, YAW_RATE = 2.5, 0.4


def odometry(stamp_ns):
    """Odometry on a circle through the origin."""
    a, radius = YAW_RATE * stamp_ns * 1e-9, SPEED / YAW_RATE
    T = planar(radius * np.sin(a), radius * (1.0 - np.cos(a)), a)
    return Odometry(stamp_ns, T, SPEED, 0.0, 0.0, YAW_RATE, 1.0 / radius, np.eye(6))


def inbox(stamps_ns):
    messages = [("odom", odometry(s)) for s in stamps_ns]
    return StubInbox(messages, messages)


@pytest.mark.parametrize("stamp_ms", [30, 40, 55, 75])
def test_between_and_after_messages(stamp_ms):
    found, true = odometry_at(inbox([20 * MS, 40 * MS]), stamp_ms * MS), odometry(stamp_ms * MS)
    assert found.stamp_ns == stamp_ms * MS
    assert found.T_odom_base[:2, 3] == pytest.approx(true.T_odom_base[:2, 3], abs=0.002)
    assert yaw_of(found.T_odom_base) == pytest.approx(yaw_of(true.T_odom_base), abs=1e-3)
    assert (found.speed_mps, found.yaw_rate_radps) == (SPEED, YAW_RATE)


def test_motion_of_an_old_message_does_not_go_on():
    found = odometry_at(inbox([0, 20 * MS]), 2_000 * MS)
    assert np.hypot(*(found.T_odom_base - odometry(20 * MS).T_odom_base)[:2, 3]) == pytest.approx(SPEED * PREDICTED_S)


def test_none_before_the_messages_kept():
    assert odometry_at(inbox([20 * MS, 40 * MS]), 10 * MS) is None
    assert odometry_at(StubInbox([]), 10 * MS) is None
