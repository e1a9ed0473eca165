"""Self filter: the implement counts as folded only while the machine state reports it."""

from types import SimpleNamespace

import numpy as np
import pytest

from configs.strict import find, load
from configs.vehicle import ImplementFile
from perception.lidar.obstacles import LidarObstacles
from perception.self_filter import is_folded, is_inside, own_outlines
from tests.perception.lidar_scenes import LIDAR_CONFIG, VEHICLE, Feed, box, cast, odometry

HARROW = load(ImplementFile, find("implements", "harrow_6m")).implement
BESIDE = (0.5 * sum(HARROW.ends_m), 2.2)  # beside the folded harrow, inside the unfolded one
REAR = VEHICLE.sensors.lidar["rear"]


def machine(fold):
    return SimpleNamespace(fold_position=fold, hitch=1.0)


@pytest.mark.parametrize(("fold", "folded"), [(0.0, False), (0.5, False), (0.989, False), (0.99, True), (1.0, True)])
def test_folded_threshold(fold, folded):
    assert is_folded(machine(fold)) is folded
    assert not is_folded(None)


def test_outline_by_fold():
    wide, narrow = own_outlines(VEHICLE, HARROW)
    assert np.array_equal(wide[0], narrow[0])
    assert (np.ptp(wide[1, :, 1]), np.ptp(narrow[1, :, 1])) == (HARROW.width_m, HARROW.fold.width_m)
    assert np.array_equal(wide[1, :, 0], narrow[1, :, 0])
    assert [bool(is_inside(np.array([BESIDE]), one)[0]) for one in (wide, narrow)] == [True, False]
    assert all(np.array_equal(a, b) for a, b in [own_outlines(VEHICLE, None)])


def test_obstacle_beside_folded_implement():
    node = LidarObstacles("rear", REAR, VEHICLE, HARROW, LIDAR_CONFIG)
    for k, (state, count) in enumerate([(machine(1.0), 1), (machine(0.5), 0), (None, 0)]):
        stamp = 10**9 * (k + 1)
        scan = cast([box(*BESIDE, 0.4, 0.5, 1.2)], REAR, stamp_ns=stamp, seed=k)
        feed = Feed(lidar__rear=scan, odom=odometry(stamp), **({"machine": state} if state else {}))
        obstacles = dict(node.step(stamp, feed))["obstacles/lidar_rear"]
        away = np.hypot(*(obstacles.center_base_m[:, :2] - BESIDE).T)
        assert (away < 0.5).sum() == count
