"""Folding: conditions, duration, status on the bus, and the machine's width."""

import itertools

import numpy as np
import pytest

from configs.strict import find, load
from configs.vehicle import ImplementFile
from messages.sensors import LidarScan
from simulation.machine.implement import at_fold
from tests.simulation.simulated_farm import IMPLEMENT, Farm, flat, machine_file

WIDE_M, NARROW_M, DURATION_S = IMPLEMENT.width_m, IMPLEMENT.fold.width_m, IMPLEMENT.fold.duration_s


@pytest.fixture
def farm():
    farm = Farm(config=flat())
    farm.is_drive_enabled = False
    farm.drive(0.3)
    farm.is_drive_enabled = True
    yield farm
    farm.close()


def test_fold_duration_and_status(farm):
    farm.is_folded = True
    farm.drive(0.5 * DURATION_S)
    assert farm.machine.attached.fold == pytest.approx(0.5, abs=0.02)
    farm.drive(0.5 * DURATION_S + 0.3)
    assert farm.machine.attached.fold == 1.0
    reported = [v["FoldPosition"] for _, v in farm.frames["CabState"] if v["Group"] == 3]
    assert reported[0] == 0.0
    assert reported[-1] == 100.0
    assert all(b >= a for a, b in itertools.pairwise(reported))
    times = [t for t, v in farm.frames["CabState"] if v["Group"] == 3]
    assert set(np.diff(times)) == {100_000_000}
    farm.is_folded = False
    farm.drive(DURATION_S + 0.3)
    assert farm.machine.attached.fold == 0.0


def test_fold_held_while_driving_or_without_request(farm):
    farm.is_folded = True
    farm.drive(2.0)
    before = farm.machine.attached.fold
    farm.is_folded = None
    farm.drive(1.0)
    assert farm.machine.attached.fold == pytest.approx(before, abs=0.005)
    farm.is_folded, farm.speed_mps = True, 1.0
    farm.drive(2.0)
    assert farm.machine.speed_mps > 0.5
    moving = farm.machine.attached.fold
    farm.drive(1.0)
    assert farm.machine.attached.fold == moving < 0.5


@pytest.mark.parametrize("why", ["lowered", "stop all", "silent"])
def test_fold_inhibited(farm, why):
    if why == "lowered":
        farm.is_lowered = True
        farm.drive(2.0)
    farm.permit = int(why != "stop all")
    farm.drive(0.2)
    if why == "silent":
        farm.silent = {"AuxiliaryCommand"}
    farm.is_folded = True
    farm.drive(2.0)
    assert farm.machine.attached.fold == 0.0


def test_no_fold_status_without_fold():
    twelve = load(ImplementFile, find("implements", "harrow_12m")).implement
    farm = Farm(config=flat(), implement=twelve, is_folded=True)
    farm.is_folded = True
    farm.drive(1.0)
    assert farm.machine.attached.fold == 0.0
    assert not [v for _, v in farm.frames["CabState"] if v["Group"] == 3]
    farm.close()


@pytest.mark.parametrize(("fold", "width_m"), [(0.0, WIDE_M), (0.5, 0.5 * (WIDE_M + NARROW_M)), (1.0, NARROW_M)])
def test_width_by_fold(fold, width_m):
    assert at_fold(IMPLEMENT, fold).width_m == pytest.approx(width_m)


@pytest.mark.parametrize("is_folded", [False, True])
def test_outline_and_lidar_returns_by_fold(is_folded):
    farm = Farm(config=flat(), vehicle=machine_file(sensors=("lidar",)), is_folded=is_folded)
    outline = farm.world._ground_truth.outline(farm.machine)
    assert outline.bounds[3] - outline.bounds[1] == pytest.approx(NARROW_M if is_folded else WIDE_M)
    scan = [m for t, m in farm.drive(0.3) if t == "lidar/rear"][-1]
    assert isinstance(scan, LidarScan)
    x, y, z = (scan.points_m * [-1.0, -1.0, 1.0]).T + np.array([[-1.0], [0.0], [2.2]])
    on_wing = np.abs(y) > 1.6
    seen = on_wing & (np.abs(y) < 3.1) & (x < -1.0) & (x > -2.5) & (z > 0.3)
    assert (seen.sum() > 20) != is_folded
    farm.close()
