"""Bounds of the hitch angle from the path driven, against implements pulled by their equation of motion."""

import math

import numpy as np
import pytest

from configs.vehicle import Vehicle
from geometry.drawbar import Drawbar, hitch_poses
from geometry.transforms import planar
from messages.motion import Odometry
from safety.collision_monitor import CollisionMonitor, MonitorInputs
from safety.config import SafetyConfig
from safety.hitch_angle import APART_RAD, MARGIN_RAD, HitchAngle, angles_between
from safety.obstacle_sources import SourceData
from safety.zones.footprint import footprint_of, footprints_of
from safety.zones.swept_area import arc_poses, distance_to_contact_m, sweep_along
from tests.safety.safety_world import START_NS, WAGON

DRAWBAR, MOST_RAD = Drawbar(-1.1, 3.7), math.radians(60.0)


def drive(curvatures: np.ndarray, direction: int = 1, step_m: float = 0.05) -> np.ndarray:
    """Poses (N, 3) of base."""
    yaw = np.concatenate([[0.3], 0.3 + np.cumsum(direction * step_m * curvatures)])
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    ahead = direction * step_m * np.column_stack([np.cos(middle), np.sin(middle)])
    return np.column_stack([np.array([5.0, -2.0]) + np.vstack([np.zeros((1, 2)), np.cumsum(ahead, axis=0)]), yaw])


def pulled(poses: np.ndarray, angle_rad: float, axle_m: float = 3.7, slip_rad: float = 0.0) -> np.ndarray:
    """True hitch angles (N,): the wheels roll along the implement, or beside it by a slip angle."""
    yaw, found = poses[0, 2] + angle_rad, [angle_rad]
    hitch = poses[:, :2] + DRAWBAR.hitch_m * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    for pose, step in zip(poses[1:], np.diff(hitch, axis=0), strict=True):
        for _ in range(5):
            yaw += float(step[1] * math.cos(yaw + slip_rad) - step[0] * math.sin(yaw + slip_rad)) / (5.0 * axle_m)
        found.append(math.remainder(yaw - pose[2], 2.0 * math.pi))
    return np.array(found)


def bounds_along(poses: np.ndarray) -> np.ndarray:
    """Bounds (N, 2) at each pose."""
    angle, found = HitchAngle(DRAWBAR, MOST_RAD), []
    for pose in poses:
        angle.add(pose)
        found.append(angle.bounds_rad)
    return np.array(found)


@pytest.mark.parametrize("seed", range(8))
def test_the_true_angle_is_within_the_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curvatures = np.repeat(rng.uniform(-0.18, 0.18, 30), rng.integers(20, 120, 30))
    poses = drive(curvatures)
    bounds = bounds_along(poses)
    axle_m, slip_rad = 3.7 * rng.uniform(0.98, 1.02), math.radians(rng.uniform(-1.0, 1.0))
    for start in rng.uniform(-1.0, 1.0, 4):
        true = pulled(poses, float(start), axle_m, slip_rad)
        assert (bounds[:, 0] <= true).all()
        assert (true <= bounds[:, 1]).all()
    apart = bounds[:, 1] - bounds[:, 0]
    assert apart[0] == pytest.approx(2.0 * MOST_RAD)
    assert apart[400] < math.radians(10.0)  # after 20 m
    assert apart[-1] == pytest.approx(2.0 * MARGIN_RAD, abs=1e-3)


def test_bounds_open_in_reverse_and_after_a_jump() -> None:
    poses = drive(np.zeros(600))
    back = drive(np.zeros(300), -1)
    back[:, :2] += poses[-1, :2] - back[0, :2]
    bounds = bounds_along(np.vstack([poses, back]))
    assert bounds[600] == pytest.approx((-MARGIN_RAD, MARGIN_RAD), abs=0.002)
    assert bounds[-1, 1] - bounds[-1, 0] > bounds[600, 1] - bounds[600, 0]
    angle = HitchAngle(DRAWBAR, MOST_RAD)
    for pose in poses:
        angle.add(pose)
    angle.add(poses[-1])  # standing changes nothing
    assert angle.bounds_rad == pytest.approx(tuple(bounds[600]))
    angle.add(poses[-1] + np.array([1.0, 0.0, 0.0]))
    assert angle.bounds_rad == (-MOST_RAD, MOST_RAD)


def test_angles_between_bounds() -> None:
    found = angles_between((-0.2, 0.3))
    assert (found[0], found[-1]) == pytest.approx((-0.2, 0.3))
    assert max(np.diff(found)) <= APART_RAD
    assert angles_between((0.1, 0.1)) == pytest.approx([0.1])


def test_swept_field_behind_a_turn_covers_the_implement_where_it_is(vehicle: Vehicle, config: SafetyConfig) -> None:
    """Shortly after a turn the steering is straight, the implement is not: steady driving would place it 2 m away."""
    poses = drive(np.concatenate([np.zeros(400), np.full(200, 0.17), np.zeros(20)]))
    drawbar = Drawbar(WAGON.hitch_m, WAGON.axle_length_m)
    true = float(hitch_poses(drawbar, poses[:, :2], poses[:, 2], 0.4)[-1, 2] - poses[-1, 2])
    monitor = CollisionMonitor(footprints_of(vehicle, WAGON), vehicle.sensors, None, None, config)
    for k, (x, y, yaw) in enumerate(poses):
        odom = Odometry(START_NS + k * 20_000_000, planar(x, y, yaw), 2.5, 0.0, 0.0, 0.0, 0.0, np.eye(6))
        monitor.update(inputs_of(odom), 1, 2.5, config.braking.flat, 2.0)
    area = monitor.lay_field(odom, None, None, 1, 2.5, config.braking.flat, 2.0).main
    angles = [places[0, 2] for body, places in area.bodies if body.rear_m == -WAGON.total_length_m]
    assert true < math.radians(-30.0)
    assert min(angles) <= true <= max(angles) < math.radians(-20.0)
    behind = placed(drawbar, true, -WAGON.total_length_m)
    assert distance_to_contact_m(behind, area)[0] == 0.0
    steady = sweep_along(
        footprint_of(vehicle, WAGON), 1, np.arange(0.0, 4.0, 0.2), arc_poses(0.0, 1, np.arange(0.0, 4.0, 0.2)), 0.0,
        config.field, True,
    )  # fmt: skip
    assert distance_to_contact_m(behind, steady)[0] > 0.0


def placed(drawbar: Drawbar, angle_rad: float, x_m: float) -> np.ndarray:
    """A place on the axis of the implement, (1, 2) in base."""
    return np.array([[drawbar.hitch_m + x_m * math.cos(angle_rad), x_m * math.sin(angle_rad)]])


def inputs_of(odom: Odometry) -> MonitorInputs:
    """What the monitor knows without sensors."""
    return MonitorInputs(
        odom=odom, map_pose=None, path=None, control_command=None, tracks=None, fold=0.0, hitch=1.0,
        source_data=SourceData({}, {}, {}), health={},
    )  # fmt: skip


def test_wagon_has_a_largest_angle(vehicle: Vehicle) -> None:
    assert footprints_of(vehicle, WAGON).max_hitch_rad == pytest.approx(math.radians(WAGON.max_hitch_deg))
    assert footprints_of(vehicle, None).max_hitch_rad == 0.0
