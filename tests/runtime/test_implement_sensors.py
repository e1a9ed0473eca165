"""Sensors on an implement: part of the machine, moved by the hitch, refused where they cannot be placed."""

import numpy as np
import pytest

from configs.strict import CONFIGS, load, parse, read_yaml
from configs.vehicle import ImplementFile, MountedImplement, Vehicle
from messages.errors import ConfigError
from messages.perception import HealthState
from perception.lidar.obstacles import LidarObstacles
from runtime.setup import load_setup, with_implement_sensors
from safety.sources.detection_range import covers
from safety.zones.footprint import footprint_of
from tests.perception.lidar_scenes import LIDAR_CONFIG, Feed, box, cast, odometry
from tests.safety.safety_world import START_NS, machine_state
from tests.simulation.simulated_farm import Farm, flat

TRACTOR = load(Vehicle, CONFIGS / "machines/tractor_e.yaml")
VALUES = read_yaml(CONFIGS / "implements/harrow_6m.yaml")


def harrow(**sensors: object) -> MountedImplement:
    values = {"implement": VALUES["implement"] | {"sensors": sensors}}
    found = parse(ImplementFile, values, "harrow").implement
    assert isinstance(found, MountedImplement)
    return found


LIDAR = {
    "mount": {"xyz_m": [-2.5, 0.0, 1.7], "rpy_deg": [0.0, 0.0, 180.0]},
    "elevation_deg": [-73.6, -63.28, -51.1, -45.47, -37.03, -30.47, -25.78, -22.03, -16.41, -13.6, -9.84, -6.09],
    "columns": 96, "field_of_view_deg": 190, "rate_hz": 10, "range_m": [0.1, 30.0], "range_sigma_m": 0.02,
}  # fmt: skip
RADAR = read_yaml(CONFIGS / "machines/tractor_e.yaml")["sensors"]["radar"]["front"]


def test_all_kinds_join_the_machine_and_sink_with_the_hitch() -> None:
    joined = with_implement_sensors(TRACTOR, harrow(lidar={"near": LIDAR}, radar={"near": RADAR})).sensors
    assert set(joined.lidar) == {*TRACTOR.sensors.lidar, "near"}
    assert set(joined.radar) == {*TRACTOR.sensors.radar, "near"}
    mount = joined.lidar["near"].mount
    assert [mount.at_hitch(h)[2, 3] for h in (0.0, 0.5, 1.0)] == pytest.approx([1.1, 1.4, 1.7])
    front = joined.lidar["front"].mount
    assert np.array_equal(front.at_hitch(0.0), front.T_base_sensor)


def test_bad_sensors_of_an_implement_are_refused() -> None:
    with pytest.raises(ConfigError, match="lidar 'front' is on"):
        with_implement_sensors(TRACTOR, harrow(lidar={"front": LIDAR}))
    aside = LIDAR | {"mount": {"xyz_m": [-2.5, 2.0, 1.7]}}
    with pytest.raises(ConfigError, match="wing that folds"):
        harrow(lidar={"near": aside})
    with pytest.raises(ConfigError, match=r"sensors.uwb: not on an implement"):
        harrow(
            uwb={
                "main": {
                    "mount": {"xyz_m": [0.2, 0.0, 3.0]},
                    "rate_hz": 10,
                    "range_sigma_m": 0.05,
                    "range_m": [0.2, 60.0],
                }
            }
        )
    with pytest.raises(ConfigError, match="not on an implement"):
        harrow(wheels={"rate_hz": 50, "speed_sigma_mps": 0.01, "angle_sigma_deg": 0.1})


@pytest.mark.parametrize("hitch", [0.0, 1.0])
def test_simulated_lidar_moves_with_the_implement(hitch: float) -> None:
    """Straight behind, a ray of elevation e meets level ground at height / sin(-e)."""
    vehicle = with_implement_sensors(
        TRACTOR.model_copy(update={"sensors": type(TRACTOR.sensors)()}), harrow(lidar={"near": LIDAR})
    )
    farm = Farm(vehicle=vehicle, config=flat())
    farm.machine.attached.hitch = hitch
    scan = [m for topic, m in farm.drive(0.15) if topic == "lidar/near"][-1]
    farm.close()
    ring = int(np.argmin(np.abs(np.degrees(scan.elevation_rad) + 45.47)))
    middle = scan.ranges_mm[ring, scan.ranges_mm.shape[1] // 2] / 1000.0
    assert middle == pytest.approx((1.1 + 0.6 * hitch) / np.sin(np.radians(45.47)), abs=0.1)


def test_steep_rings_do_not_make_a_lidar_blind() -> None:
    steep = with_implement_sensors(TRACTOR, harrow(lidar={"near": LIDAR})).sensors.lidar["near"]
    scan = cast((), lidar=steep)
    node = LidarObstacles("near", steep, TRACTOR, None, LIDAR_CONFIG)
    health = dict(node.step(scan.stamp_ns, Feed(lidar__near=scan, odom=odometry(scan.stamp_ns))))["health/lidar_near"]
    assert health.state is HealthState.GOOD


@pytest.mark.parametrize("hitch", [0.0, 1.0, np.nan])
def test_perceived_obstacle_behind_a_lidar_on_the_implement(hitch: float) -> None:
    raised = with_implement_sensors(TRACTOR, harrow(lidar={"near": LIDAR})).sensors.lidar["near"]
    truth = raised.mount.model_copy(update={"xyz_m": (-2.5, 0.0, 1.1 if hitch == 0.0 else 1.7)})
    body = box(-5.0, 0.5, 0.5, 0.5, 1.0)
    scan = cast((body,), lidar=raised.model_copy(update={"mount": truth}))
    node = LidarObstacles("near", raised, TRACTOR, None, LIDAR_CONFIG)
    feed = Feed(lidar__near=scan, odom=odometry(scan.stamp_ns), machine=machine_state(START_NS, hitch=hitch))
    found = dict(node.step(scan.stamp_ns, feed))["obstacles/lidar_near"]
    assert len(found.yaw_rad) == 1
    assert found.center_base_m[0] == pytest.approx([-4.8, 0.5, 0.5], abs=0.3)


def test_silence_of_every_lidar_of_the_wide_harrow_is_watched_in_forward_drive() -> None:
    setup = load_setup("line", None, "harrow_12m", None, 1)
    footprint = footprint_of(setup.vehicle, setup.implement)
    forward = {name for name, one in setup.vehicle.sensors.lidar.items() if covers(one, footprint, 1)}
    assert forward == {"front", "front_left", "front_right", "wing_left", "wing_right"}
