"""Planned docking paths driven in the closed loop: forward, cusp, and reverse into the dock."""

import math

import numpy as np
import pytest

from configs.site import Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from geometry.pose2 import Pose2
from planning.config import PlanningConfig
from planning.docking.dock import Docking, plan_docking
from planning.rig import rig_of
from tests.control.plant import IMPLEMENT, VEHICLE, Actuators, Ground, Plant, SensorNoise, Track, true_offsets

SITE = load(Site, find("sites", "demo"))
PLANNING = parse(PlanningConfig, read_yaml(CONFIGS / "stack/planning.yaml"), "stack/planning.yaml")
YARD = Ground(side_slope_deg=0.5, understeer=0.01, soil_radpm=0.001)


@pytest.mark.parametrize(("bay", "start", "speed_gain"), [
    ("wide", Pose2(18.0, -31.0, math.radians(-75.0)), 0.94),
    ("wide", Pose2(20.0, -28.5, math.radians(-110.0)), 1.05),
    ("narrow", Pose2(22.0, -31.0, math.radians(-90.0)), 0.97),
])  # fmt: skip
def test_docking_accuracy(bay, start, speed_gain):
    rig = rig_of(VEHICLE, IMPLEMENT.folded, None, PLANNING.planner)
    docking = Docking(SITE, rig, SITE.bay(bay), PLANNING.docking, 0)
    noise, actuators = SensorNoise(map_m=0.002, angle_zero_deg=-0.3), Actuators(speed_gain=speed_gain)
    plant = Plant(x=start.x_m, y=start.y_m, yaw=start.yaw_rad, ground=YARD, noise=noise, actuators=actuators)
    plant.fold = 1.0
    for path in plan_docking(start, docking, 1):
        before = len(plant.track.x_m)
        track = plant.run(path)
        assert track.commands[-1].is_finished
        driven = Track(x_m=track.x_m[before:], y_m=track.y_m[before:])
        offsets, _ = true_offsets(driven, path)
        assert np.abs(offsets).max() < 0.03
        assert np.abs(track.speed_mps[before:]).max() <= 1.15 * path.speed_mps.max()  # the supervisor cuts
        settle(plant)
    dock = docking.bay.dock
    assert abs(plant.x - dock.x_m) <= 0.02
    assert abs(plant.y - dock.y_m) <= 0.03
    assert abs(math.degrees(math.remainder(plant.yaw - math.radians(dock.heading_deg), 2 * math.pi))) <= 0.5


def settle(plant):
    for _ in range(50):
        plant.control()
        plant.move()
        plant.now_ns += 20_000_000
