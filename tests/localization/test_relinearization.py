"""A graph that is begun again at its newest keyframe with all that the old one knew of it."""

import math

import numpy as np
import pytest

from benchmarks.localization_faults import lidar_motions
from localization.graph.factors import X
from localization.graph.keyframes import KeyframeBuilder
from localization.localizer import Localizer
from tests.localization.harness import configuration, run
from tests.localization.synthetic_drive import DATUM, SensorErrors, drive, tractor

LEGS = [(4.0, 0.0, 0.0), (6.0, 2.0, 0.0), (10.0, 1.8, 0.15)]


def test_it_knows_as_much_as_before():
    node = Localizer(tractor(), DATUM, configuration())
    run(drive(16, legs=LEGS, sensor_errors=SensorErrors(seed=3)).messages, localizer=node)
    smoother = node._map_alignment.keyframes.smoother
    before = smoother.state
    smoother.relinearize()
    after = smoother._read(smoother.next_key - 1, before.stamp_ns)
    assert np.allclose(after.T_map_body, before.T_map_body, atol=1e-6)
    assert np.allclose(after.covariance, before.covariance, rtol=1e-3, atol=1e-9)
    assert np.allclose(after.bias, before.bias, atol=1e-6)
    assert smoother.is_within_lag(smoother.next_key - 1)
    assert not smoother.is_within_lag(smoother.next_key - 2)
    assert smoother._graph.getLinearizationPoint().exists(X(smoother.next_key - 1))


@pytest.mark.parametrize("has_lidar", [False, True])
def test_motions_of_the_lidar_end_with_the_keyframes_to_which_they_refer(monkeypatch, has_lidar):
    """The worst case: at every fix."""
    monkeypatch.setattr(KeyframeBuilder, "_bends", lambda *_: True)
    truth = drive(18, legs=LEGS, sensor_errors=SensorErrors(seed=3))
    motions = lidar_motions(truth, 3, 18.0) if has_lidar else []
    result = run(sorted([*truth.messages, *motions], key=lambda m: m[0]))
    assert not {f.code for f in result.faults} & {"localization.rebuilt", "localization.lost"}
    placed = [p for p in result.poses if p.is_initialized]
    assert len(placed) > 100
    assert all(math.dist(p.T_map_base[:2, 3], truth.at(p.stamp_ns)[:2, 3]) < 0.05 for p in placed)
