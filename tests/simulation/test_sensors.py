"""Sensor models against geometry and physics computed by hand."""

import json
import math

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from configs.strict import parse
from geometry.transforms import apply, planar, transform, yaw_of
from messages.sensors import GnssFix, GnssSolution, ImuSample, LidarScan, WheelSample
from simulation.scenario import GnssEpisode, Scenario
from simulation.sensors.gnss import solution_at
from simulation.sensors.imu import mean_motion
from tests.simulation.simulated_farm import CONFIG, EMPTY, SITE, Farm, flat, machine_file

G = 9.80665
FENCE_M = 30.0 + CONFIG.scenery.fence_offset_m  # the field extends to 30 m on either side


def of(outputs, topic):
    return [message for t, message in outputs if t == topic]


@pytest.fixture(scope="module")
def scans():
    """Scans of both lidars on level ground, at rest at the origin, at least 20 m from the fence."""
    farm = Farm(vehicle=machine_file(sensors=("lidar",)), config=flat(scenery={"crop_height_m": 0.0, "trees": 0}))
    outputs = farm.drive(0.5)
    farm.close()
    return outputs, farm.vehicle


def test_message_rates_and_stamps():
    farm = Farm(vehicle=machine_file(sensors=("gnss", "imu", "wheels")))
    outputs = farm.drive(2.0)
    farm.close()
    counts = {
        topic: len(of(outputs, topic)) for topic in ("imu", "wheel", "gnss/main", "truth_machine", "truth_objects")
    }
    assert counts == {"imu": 200, "wheel": 100, "gnss/main": 19, "truth_machine": 40, "truth_objects": 20}
    stamps = np.array([m.stamp_ns for m in of(outputs, "imu")])
    assert set(np.diff(stamps)) == {10_000_000}


def test_start_command_time():
    farm = Farm()
    outputs = farm.drive(4.0)
    farm.close()
    confirmation, order = of(outputs, "order/operator")
    assert json.loads(confirmation.payload)["order"] == "confirm_clear"
    content = json.loads(order.payload)
    assert (content["order"], content["machine"], content["session"]) == ("start", "farm", "00")
    assert order.stamp_ns - farm.start_ns == 3_000_000_000
    assert content["expires_ns"] > order.stamp_ns == content["sequence"] - 1
    Ed25519PublicKey.from_public_bytes(order.public_key).verify(order.signature, order.payload)


def test_imu_gravity_at_rest():
    farm = Farm(vehicle=machine_file(sensors=("imu",)))
    samples = [m for m in of(farm.drive(5.0), "imu") if isinstance(m, ImuSample)]
    farm.close()
    force = np.mean([m.acceleration_mps2 for m in samples], axis=0)
    rate = np.mean([m.rate_radps for m in samples], axis=0)
    assert force == pytest.approx([0.0, 0.0, G], abs=4e-3 * G)  # bias sigma 1 mg
    assert rate == pytest.approx([0.0, 0.0, 0.0], abs=4 * 4 * math.pi / 180 / 3600 + 2e-4)


def test_imu_gravity_on_slope():
    T = transform((0.0, 0.0, 0.0), (0.05, -0.08, 1.0))
    force = mean_motion(T, T, T, 0.01)[:3]
    assert force == pytest.approx(T[:3, :3].T @ [0.0, 0.0, G])


def test_imu_in_turn():
    v, r = 3.0, 0.4
    T_base_imu = transform((1.0, 0.5, 1.0))

    def pose(t):
        return planar(v / r * math.sin(r * t), v / r * (1 - math.cos(r * t)), r * t) @ T_base_imu

    motion = mean_motion(pose(1.0), pose(1.005), pose(1.01), 0.01)
    # at (1, 0.5) of base: forward acceleration -r² x, left acceleration v r - r² y
    assert motion == pytest.approx([-(r**2) * 1.0, v * r - r**2 * 0.5, G, 0.0, 0.0, r], abs=1e-5)


def test_imu_integrates_to_true_motion():
    config = flat(imu={"idle_vibration_mps2": 0.0, "driving_vibration_mps2_per_mps": 0.0})
    farm = Farm(vehicle=machine_file(sensors=("imu",)), config=config)
    farm.curvature_radpm = 0.1
    farm.drive_at(2.0)
    samples = of(farm.outputs, "imu")
    farm.close()
    turned = sum(m.rate_radps[2] for m in samples) * 0.01
    assert turned == pytest.approx(farm.machine.yaw_rad, abs=2e-3)
    speed, yaw = np.zeros(2), 0.0
    for m in samples:
        middle = yaw + 0.5 * m.rate_radps[2] * 0.01
        c, s = math.cos(middle), math.sin(middle)
        speed += 0.01 * (np.array([[c, -s], [s, c]]) @ m.acceleration_mps2[:2])
        yaw += m.rate_radps[2] * 0.01
    assert np.linalg.norm(speed) == pytest.approx(farm.machine.speed_mps, abs=0.3)


def test_imu_saturation():
    vehicle = machine_file(sensors=("imu",))
    tight = vehicle.sensors.imu.model_copy(update={"accelerometer_range_g": 0.5})
    vehicle = vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"imu": tight})})
    farm = Farm(vehicle=vehicle)
    assert max(m.acceleration_mps2[2] for m in of(farm.drive(0.2), "imu")) == pytest.approx(0.5 * G)
    farm.close()


def test_gnss_antenna_position():
    vehicle = machine_file(sensors=("gnss",))
    mount = vehicle.sensors.gnss["main"].mount.model_copy(update={"xyz_m": (1.5, 0.7, 3.0)})
    gnss = vehicle.sensors.gnss["main"].model_copy(update={"mount": mount})
    sensors = vehicle.sensors.model_copy(update={"gnss": {"main": gnss}})
    farm = Farm(vehicle=vehicle.model_copy(update={"sensors": sensors}), config=CONFIG)
    fixes = [m for m in of(farm.drive(3.0), "gnss/main") if isinstance(m, GnssFix)]
    expected = apply(farm.machine.T_map_base, np.array([[1.5, 0.7, 3.0]]))[0]
    found = [SITE.datum.datum.to_map(m.latitude_rad, m.longitude_rad, m.height_m) for m in fixes]
    farm.close()
    assert np.mean(found, axis=0) == pytest.approx(expected, abs=0.03)
    assert 0.002 < np.std(found, axis=0)[0] < 0.016
    assert np.mean([m.heading_rad for m in fixes]) == pytest.approx(
        yaw_of(farm.machine.T_map_base), abs=math.radians(0.3)
    )


def test_gnss_velocity_lever_arm():
    vehicle = machine_file(sensors=("gnss",))
    farm = Farm(vehicle=vehicle)
    farm.curvature_radpm = 0.2
    farm.drive_at(1.5)
    fix = of(farm.outputs, "gnss/main")[-1]
    truth = of(farm.outputs, "truth_machine")[-1]
    farm.close()
    yaw = yaw_of(truth.T_map_base)
    speed, rate = truth.speed_mps, truth.yaw_rate_radps
    ahead = np.array([speed, rate * 0.6])
    c, s = math.cos(yaw), math.sin(yaw)
    assert fix.velocity_enu_mps[:2] == pytest.approx(np.array([[c, -s], [s, c]]) @ ahead, abs=0.15)


@pytest.mark.parametrize(
    ("elapsed_s", "solution"),
    [(0.0, GnssSolution.RTK_FIXED), (9.99, GnssSolution.RTK_FIXED), (10.0, GnssSolution.RTK_FLOAT),
     (14.99, GnssSolution.RTK_FLOAT), (15.0, GnssSolution.NONE), (19.99, GnssSolution.NONE),
     (20.0, GnssSolution.RTK_FIXED)],
)  # fmt: skip
def test_gnss_episodes(elapsed_s, solution):
    episodes = (GnssEpisode(from_s=10, for_s=10, state="rtk_float"), GnssEpisode(from_s=15, for_s=5, state="none"))
    assert solution_at(episodes, elapsed_s) == solution


def test_gnss_outage_states_and_sigma():
    nothing, poor = {"from_s": 1.0, "for_s": 1.0, "state": "none"}, {"from_s": 2.0, "for_s": 2.0, "state": "rtk_float"}
    values = {"name": "outage", "operator_commands": [], "gnss": [nothing, poor]}
    farm = Farm(vehicle=machine_file(sensors=("gnss",)), scenario=parse(Scenario, values, "test"))
    fixes = of(farm.drive(5.0), "gnss/main")
    farm.close()
    states = {m.solution: m for m in fixes}
    assert set(states) == {GnssSolution.RTK_FIXED, GnssSolution.NONE, GnssSolution.RTK_FLOAT}
    assert math.isnan(states[GnssSolution.NONE].latitude_rad)
    assert states[GnssSolution.RTK_FLOAT].sigma_enu_m[0] == pytest.approx(0.2)
    assert states[GnssSolution.RTK_FIXED].sigma_enu_m[0] == pytest.approx(0.008)


def test_wheel_slip_and_angle_offset():
    farm = Farm(vehicle=machine_file(sensors=("wheels",)))
    still = of(farm.drive(0.5), "wheel")
    assert {m.speed_mps for m in still if isinstance(m, WheelSample)} == {0.0}
    angle = np.mean([m.steering_angle_rad for m in still])
    assert angle == pytest.approx(farm.machine.angle_offset_rad, abs=math.radians(0.1))
    assert abs(farm.machine.angle_offset_rad) <= math.radians(0.3)
    farm.is_lowered = True
    farm.drive_at(2.78)
    moving = of(farm.outputs, "wheel")[-100:]
    farm.close()
    assert np.mean([m.speed_mps for m in moving]) > 1.02 * farm.machine.speed_mps


def test_angle_offset_by_seed():
    zeros = set()
    for seed in range(4):
        farm = Farm(seed=seed)
        zeros.add(farm.machine.angle_offset_rad)
        farm.close()
    assert len(zeros) == 4


def test_lidar_shape_and_offsets(scans):
    outputs, vehicle = scans
    scan = of(outputs, "lidar/front")[-1]
    assert isinstance(scan, LidarScan)
    assert scan.ranges_mm.shape == (32, 1024)
    assert scan.offset_s[-1] == 0.0
    assert -0.1 < scan.offset_s[0] < -0.0999 + 0.0001
    assert np.all(np.diff(scan.offset_s) > 0)
    assert scan.ranges_mm.max() <= 60000
    assert len(scan.points_m) > 15000
    assert of(outputs, "lidar/rear")[-1].ranges_mm.shape == (16, 256)
    assert vehicle.sensors.lidar["front"].columns == 1024


def test_lidar_level_ground(scans):
    outputs, vehicle = scans
    for name in ("front", "rear"):
        scan = of(outputs, f"lidar/{name}")[-1]
        points = apply(vehicle.sensors.lidar[name].mount.T_base_sensor, scan.points_m)
        low = points[
            (points[:, 2] < 0.3) & (np.hypot(points[:, 0], points[:, 1]) > 6.0) & (np.abs(points[:, 0]) < 19.0)
        ]
        assert len(low) > 300
        assert np.abs(np.median(low[:, 2])) < 0.02
        assert np.percentile(np.abs(low[:, 2]), 95) < 0.06


def test_lidar_self_returns(scans):
    outputs, vehicle = scans
    scan = of(outputs, "lidar/front")[-1]
    points = apply(vehicle.sensors.lidar["front"].mount.T_base_sensor, scan.points_m)
    b = vehicle.body
    inside = (
        (points[:, 0] < b.front_m + 0.1) & (points[:, 0] > -b.rear_m) & (np.abs(points[:, 1]) < 0.5 * b.width_m + 0.1)
    )
    assert np.sum(inside & (points[:, 2] > 0.5)) > 1000


def test_lidar_fence_distance(scans):
    outputs, vehicle = scans
    scan = of(outputs, "lidar/front")[-1]
    points = apply(vehicle.sensors.lidar["front"].mount.T_base_sensor, scan.points_m)
    left = points[(points[:, 1] > 28.0) & (points[:, 2] > 0.3) & (np.abs(points[:, 0]) < 30.0)]
    assert len(left) > 50
    assert np.median(left[:, 1]) == pytest.approx(FENCE_M, abs=0.06)


def test_lidar_motion_distortion():
    """In a turn the points fit the fence when each column is placed by its own pose."""
    vehicle = machine_file(sensors=("lidar",))
    farm = Farm(vehicle=vehicle, config=flat(scenery={"crop_height_m": 0.0, "trees": 0}))
    farm.curvature_radpm = 0.15
    farm.drive_at(2.0, seconds=8.0)
    poses = {}
    farm.outputs.clear()
    farm.drive(0.5, each=lambda f: poses.__setitem__(f.now_ns, f.machine.T_map_base))
    scan = of(farm.outputs, "lidar/front")[-1]
    farm.close()
    mount = vehicle.sensors.lidar["front"].mount.T_base_sensor
    stamps = scan.stamp_ns + np.round(scan.point_offset_s.astype(float) * 100).astype(np.int64) * 10_000_000
    found = []
    for stamp in np.unique(stamps):
        here = stamps == stamp
        found.append(apply(poses[int(stamp)] @ mount, scan.points_m[here].astype(float)))
    points = np.concatenate(found)
    fence = points[
        (np.abs(np.abs(points[:, 1]) - FENCE_M) < 1.5) & (points[:, 2] > 0.4) & (np.abs(points[:, 0] - 10) < 25)
    ]
    assert len(fence) > 50
    assert np.percentile(np.abs(np.abs(fence[:, 1]) - FENCE_M), 80) < 0.08


def test_messages_by_seed():
    def digest(seed):
        farm = Farm(vehicle=machine_file(sensors=("lidar", "gnss", "imu", "wheels")), config=CONFIG, seed=seed)
        farm.drive_at(2.0, seconds=1.0)
        farm.close()
        return [
            (
                topic,
                m.stamp_ns,
                *[np.asarray(v).tobytes() for v in vars(m).values() if isinstance(v, (float, np.ndarray))],
            )
            for topic, m in farm.outputs
        ]

    first, again, other = digest(3), digest(3), digest(4)
    assert first == again
    kinds = {topic for topic, *_ in first}
    for kind in kinds - {"order/operator", "truth_objects"}:
        assert [d for d in first if d[0] == kind] != [d for d in other if d[0] == kind], kind


def test_additional_sensor_independent():
    def imu(sensors):
        farm = Farm(vehicle=machine_file(sensors=sensors))
        outputs = farm.drive(0.3)
        farm.close()
        return np.array([m.acceleration_mps2 for m in of(outputs, "imu")])

    assert np.array_equal(imu(("imu",)), imu(("imu", "gnss", "wheels")))


def test_scenario_without_command():
    farm = Farm(scenario=EMPTY.model_copy(update={"operator_commands": ()}))
    assert not of(farm.drive(4.0), "order/operator")
    farm.close()
