"""A drawn plant: equal to the configuration when nominal, different from it in every quantity when drawn."""

import math

import numpy as np
import pytest
from pydantic import BaseModel

from configs.site import Site
from configs.strict import find, load
from configs.vehicle import ImplementFile, Vehicle
from runtime.setup import with_implement_sensors
from simulation.machine.implement import AttachedImplement
from simulation.plant import Plant, PlantModels, draw_plant
from tests.simulation.simulated_farm import CONFIG, EMPTY, SITE, Farm, flat, machine_file

# What a plant does not change: sizes of data, ranges and rates of a design, limits of the actuators' controllers, and
# values of which no error is known.
SAME = {
    "drivetrain.wheel_radius_m": "machine.drive.wheel_radius_error instead", "drivetrain.min_turning_radius_m": "stop",
    "steering.max_wheel_rpm": "limit of the motor", "steering.wheel_turns_per_steer_rad": "gear ratio",
    "max_speed_kmh": "limit of the ECU", "columns": "design", "rate_hz": "design", "field_of_view_deg": "design",
    "range_m": "design", "cone_deg": "design", "size_px": "design", "center_px": "calibrated with the image",
    "distortion": "calibrated with the image", "sigma_horizontal_m": "gnss.error_scale instead",
    "sigma_vertical_m": "gnss.error_scale instead", "sigma_heading_deg": "gnss.error_scale instead",
    "gyro_range_dps": "design", "accelerometer_range_g": "design", "working_width_m": "tools",
    "angle_zero_deg": "machine.angle_offset_rad instead",
    "fold.width_m": "stop", "fold.duration_s": "not part of a stop", "brake": "",
}  # fmt: skip


def leaves(value, name=""):
    """Numbers of a configuration by their dotted name."""
    if isinstance(value, BaseModel):
        value = {key: getattr(value, key) for key in type(value).model_fields}
    if isinstance(value, dict):
        for key, one in value.items():
            yield from leaves(one, f"{name}.{key}" if name else str(key))
    elif isinstance(value, (tuple, list)):
        for k, one in enumerate(value):
            yield from leaves(one, f"{name}[{k}]")
    elif isinstance(value, float):
        yield name, value


def is_same_by_design(name):
    plain = name.split("[")[0]
    # heights and parts of the coverage and of the stack: the simulation has its own
    if plain.startswith("body.solids.") or plain in ("height_m", "lift_m", "pto_stop_s") or plain.endswith(".sinks_m"):
        return True
    return any(plain == key or plain.endswith(f".{key}") for key in SAME if SAME[key])


def configured(machine="tractor_e", implement="harrow_6m", site="demo"):
    vehicle = load(Vehicle, find("machines", machine))
    mounted = load(ImplementFile, find("implements", implement)).implement
    farm = load(Site, find("sites", site))
    vehicle = with_implement_sensors(vehicle, mounted)
    models = PlantModels(CONFIG.machine, CONFIG.gnss, CONFIG.imu)
    return Plant(farm, vehicle, mounted, models, farm.start)


def test_nominal_plant_is_the_configuration():
    plant = configured()
    assert draw_plant("nominal", plant, CONFIG.plant, 7) is plant


def test_slow_brake_differs_in_the_brake_alone():
    given = configured()
    slow = draw_plant("slow_brake", given, CONFIG.plant, 7)
    assert slow.vehicle == given.vehicle.model_copy(update={"brake": CONFIG.plant.worst_brake})
    assert slow.models.machine != given.models.machine
    assert (slow.site, slow.implement, slow.start, slow.clocks) == (given.site, given.implement, given.start, {})


@pytest.mark.parametrize("kind", ["drawn", "worst"])
def test_plant_and_stack_share_no_number(kind):
    given = configured()
    true = draw_plant(kind, given, CONFIG.plant, 3)
    for one, other in ((given.vehicle, true.vehicle), (given.implement, true.implement)):
        before, after = dict(leaves(one)), dict(leaves(other))
        assert before.keys() == after.keys()
        shared = [n for n in before if before[n] == after[n] and before[n] != 0.0 and not is_same_by_design(n)]
        assert shared == []
    shed, moved = given.site.shed, true.site.shed
    for name in ("outline_m", "walls_m", "anchors"):
        before, after = dict(leaves(getattr(shed, name), name)), dict(leaves(getattr(moved, name), name))
        assert all(before[n] != after[n] for n in before), name
    assert [b.dock for b in shed.bays] != [b.dock for b in moved.bays]
    assert len({round(c.offset_s, 12) for c in true.clocks.values()}) == len(true.clocks) >= 8


def test_plant_is_drawn_from_the_seed():
    given = configured()
    one, again, other = (draw_plant("drawn", given, CONFIG.plant, seed) for seed in (5, 5, 6))
    assert one == again
    assert one.vehicle != other.vehicle


@pytest.mark.parametrize(("implement", "draft_n"), [("harrow_6m", 6000.0), ("harrow_12m", 6000.0)])
def test_tractor_pulls_every_implement(implement, draft_n):
    """On every drawn soil, up a slope of 4 %; a wide implement works less deep."""
    given = configured(implement=implement)
    machine, random = given.models.machine, np.random.default_rng(0)
    attached = AttachedImplement(given.implement, machine.implement, 0.0, is_folded=False, dt_s=0.01, random=random)
    attached.hitch = 0.0
    assert attached.draft_n() == draft_n
    attached.hitch = 1.0
    assert attached.draft_n() == 0.0
    for seed in range(40):
        true = draw_plant("drawn", given, CONFIG.plant, seed)
        drive, soil = true.models.machine.drive, true.models.machine.implement
        mean_n = min(soil.draft_n_per_m * given.implement.working_width_m, soil.max_draft_n)
        needed = mean_n / true.vehicle.body.mass_kg + drive.rolling_resistance_mps2 + 0.04 * 9.81
        assert needed < drive.max_traction_mps2


def test_docked_machine_stands_in_the_true_shed():
    given = configured()
    bay = given.site.shed.bays[0]
    docked = Plant(given.site, given.vehicle, given.implement, given.models, bay.dock)
    true = draw_plant("drawn", docked, CONFIG.plant, 11)
    dock, limit = true.site.shed.bays[0].dock, CONFIG.plant.start_m
    assert abs(true.start.x_m - dock.x_m) <= limit
    assert abs(true.start.y_m - dock.y_m) <= limit
    assert abs(true.start.heading_deg - dock.heading_deg) <= CONFIG.plant.start_deg


def stopping_distance(speed_mps, dead_time_s, build_up_s, deceleration_mps2):
    """Distance with a dead time, a linear build-up and a constant deceleration, written out."""
    v = speed_mps - 0.5 * deceleration_mps2 * build_up_s
    build_up_m = speed_mps * build_up_s - deceleration_mps2 * build_up_s**2 / 6.0
    return speed_mps * dead_time_s + build_up_m + v * v / (2.0 * deceleration_mps2)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_worst_plant_needs_the_stopping_distance_and_no_more(seed):
    farm = Farm(config=flat(), scenario=EMPTY.model_copy(update={"plant": "worst"}), seed=seed)
    farm.drive_at(2.7)
    speed, x_m = farm.machine.speed_mps, farm.machine.x_m
    farm.brake_mps2 = 9.0
    farm.drive(3.0)
    assert farm.machine.speed_mps == 0.0
    allowed_m = stopping_distance(speed, 0.3, 0.4, 2.5)
    assert 0.93 * allowed_m <= farm.machine.x_m - x_m <= allowed_m
    farm.close()


def test_clocks_shift_stamps_and_delay_messages():
    scenario = EMPTY.model_copy(update={"plant": "drawn"})
    farm = Farm(machine_file(sensors=("imu", "wheels")), flat(), scenario, seed=4)
    imu = [(farm.now_ns, m.stamp_ns) for _ in range(200) for topic, m in farm.drive(0.01) if topic == "imu"]
    offset_ns = round(farm.plant.clocks["imu"].offset_s * 1e9)
    farm.close()
    assert {(stamp - farm.start_ns) % 10_000_000 for _, stamp in imu} == {offset_ns % 10_000_000}
    late = [now - (stamp - offset_ns) for now, stamp in imu]
    assert 0 <= min(late) < max(late)


def test_body_pitches_when_braking_and_shakes_when_driving():
    def poses(kind):
        farm = Farm(config=flat(), scenario=EMPTY.model_copy(update={"plant": kind}), seed=2)
        farm.drive_at(2.5)
        pitch = []
        farm.drive(2.0, lambda f: pitch.append(-math.asin(f.world._poses.steps_ago(0)[2, 0])))
        farm.brake_mps2 = 9.0
        farm.drive(0.9)
        braked = -math.asin(farm.world._poses.steps_ago(0)[2, 0])
        farm.close()
        return np.degrees(pitch), math.degrees(braked), farm.plant

    rigid, level, _ = poses("nominal")
    assert np.abs(rigid).max() < 1e-9
    assert abs(level) < 1e-9
    shaken, braked, plant = poses("drawn")
    motion = plant.models.machine.body_motion
    assert 0.3 < shaken.std() / (2.5 * motion.shake_deg_per_mps) < 2.5
    assert braked - shaken.mean() > 0.5 * motion.pitch_deg_per_mps2


def test_wrong_fix_and_multipath_are_stated_as_fixed():
    gnss = {"wrong_fixes_per_hour": 300.0, "multipath_per_hour": 300.0}
    farm = Farm(machine_file(sensors=("gnss",)), flat(gnss=gnss))
    out = [(m.solution.name, m) for topic, m in farm.drive(60.0) if topic.startswith("gnss/")]
    datum = SITE.datum.datum
    here = farm.vehicle.sensors.gnss["main"].mount.xyz_m
    errors = [
        math.hypot(*(np.array(datum.to_map(m.latitude_rad, m.longitude_rad, m.height_m))[:2] - here[:2]))
        for _, m in out
    ]
    farm.close()
    assert {name for name, _ in out} == {"RTK_FIXED"}
    assert max(errors) > 0.1
    assert max(m.sigma_enu_m[0] for _, m in out) < 0.03


def test_wheel_radius_error_scales_the_measured_speed():
    farm = Farm(config=flat(machine={"drive": {"wheel_radius_error": 0.03}}))
    farm.drive_at(2.0, 8.0)
    assert farm.machine.wheel_speed_mps == pytest.approx(farm.machine.speed_mps / 1.03, rel=0.02)
    assert farm.machine.speed_mps > 2.03
    farm.close()
