"""Plant: what is true of site, machine, implement, sensors and clocks, drawn around the configuration of the stack.

`nominal` equals the configuration, `drawn` differs in every quantity, `worst` is `drawn` with the slowest brake that
the stopping distance allows, `slow_brake` differs in that brake alone. The stack never reads a plant.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from pydantic import Field

from configs.sensor_kinds import sensors_of
from configs.site import Bay, PoseConfig, Post, Shed, Site
from configs.strict import Config
from configs.vehicle import Brake, Camera, Lidar, Mount, MountedImplement, Sensors, TrailedImplement, Vehicle
from geometry.arrays import Float64
from simulation.machine.implement import ImplementConfig
from simulation.machine.machine import MachineConfig
from simulation.randomness import generator
from simulation.scenario import PlantKind
from simulation.sensors.gnss import GnssConfig
from simulation.sensors.imu import ImuConfig

Share = Field(ge=0.0, le=0.9)
Factor = tuple[float, float]
S = TypeVar("S", bound=Config)
# Noise and bias of the sensors in the vehicle file.
ERROR_KEYS = (
    "range_sigma_m", "azimuth_sigma_deg", "doppler_sigma_mps", "gyro_noise_dps_rthz", "gyro_bias_dph",
    "accelerometer_noise_ug_rthz", "accelerometer_bias_mg", "speed_sigma_mps", "angle_sigma_deg",
)  # fmt: skip


class PlantConfig(Config):
    """Section `simulation.plant`: spreads of a drawn plant, uniform up to the given value or between two factors."""

    mount_m: float = Field(ge=0.0, le=0.2, description="of each coordinate of a mount")
    mount_deg: float = Field(ge=0.0, le=5.0, description="of each angle of a mount")
    ring_deg: float = Field(ge=0.0, le=0.5, description="of the elevation of a lidar ring")
    focal_share: float = Share
    dimension_m: float = Field(ge=0.0, le=0.2, description="of lengths of machine and implement")
    mass_share: float = Share
    actuator_factor: Factor = Field(description="of dead times, lags and strokes")
    brake_factor: Factor = Field(description="of the deceleration of the brakes")
    soil_factor: Factor = Field(description="of rolling resistance, draft, slip, tyre stiffness and side force")
    error_factor: Factor = Field(description="of sensor noise and bias, and of GNSS errors over their stated sigma")
    wheel_radius_share: float = Share
    imu_scale_share: float = Share
    vibration_factor: Factor = Field(description="of the IMU's vibration")
    clock_offset_s: float = Field(ge=0.0, le=0.1, description="of a sensor's clock")
    clock_jitter_s: float = Field(ge=0.0, le=0.1, description="mean additional delay of a message, exponential")
    survey_m: Factor = Field(description="displacement of the shed, and error of an anchor's position")
    survey_deg: float = Field(ge=0.0, le=5.0, description="rotation of the shed")
    post_m: float = Field(ge=0.0, le=0.1)
    start_m: float = Field(ge=0.0, le=1.0, description="of each coordinate of the start pose")
    start_deg: float = Field(ge=0.0, le=10.0)
    gnss_correlation_s: Factor
    wrong_fixes_per_hour: float = Field(ge=0.0, le=60.0)
    multipath_per_hour: float = Field(ge=0.0, le=60.0)
    pitch_deg_per_mps2: Factor = Field(description="of the body, under longitudinal acceleration")
    roll_deg_per_mps2: Factor = Field(description="of the body, under lateral acceleration")
    shake_deg_per_mps: Factor = Field(description="sigma of pitch and roll of the body, per speed")
    worst_brake: Brake
    worst_resistance_factor: float = Field(ge=0.0, le=1.0, description="of rolling resistance and draft, when worst")


@dataclass(frozen=True)
class Clock:
    """Clock and link of one sensor: offset of its stamps and mean additional delay (s)."""

    offset_s: float
    jitter_s: float


@dataclass(frozen=True)
class PlantModels:
    """Models of the plant that a draw changes, sections of the same names of the simulation configuration."""

    machine: MachineConfig
    gnss: GnssConfig
    imu: ImuConfig


@dataclass(frozen=True)
class Plant:
    """True site, machine, implement, models and start pose; clocks by topic, exact where missing."""

    site: Site
    vehicle: Vehicle
    implement: MountedImplement | TrailedImplement
    models: PlantModels
    start: PoseConfig
    clocks: Mapping[str, Clock] = field(default_factory=dict)


def draw_plant(kind: PlantKind, configured: Plant, config: PlantConfig, seed: int) -> Plant:
    """Plant of a seed around the configured values."""
    if kind == "nominal":
        return configured
    if kind == "slow_brake":
        return _with_slowest_brake(configured, config)
    draw = _Draw(config, generator(seed, "plant"))
    site = draw.site(configured.site)
    start = draw.start(configured.start, configured.site, site)
    vehicle, implement = draw.vehicle(configured.vehicle), draw.implement(configured.implement)
    if isinstance(implement, MountedImplement):
        own = {
            kind: {name: sensors_of(vehicle.sensors, kind).get(name, one) for name, one in some.items()}
            for kind, some in implement.sensors
            if isinstance(some, dict)
        }
        implement = implement.model_copy(update={"sensors": implement.sensors.model_copy(update=own)})
    models = draw.models(configured.models)
    topics = [f"{name}/{one}" for name, some in configured.vehicle.sensors if isinstance(some, dict) for one in some]
    clocks = {topic: draw.clock() for topic in (*topics, "imu", "wheel")}
    drawn = Plant(site, vehicle, implement, models, start, clocks)
    return _with_slowest_brake(drawn, config) if kind == "worst" else drawn


def calibrated(plant: Plant, built: Vehicle, assumed: Vehicle) -> Plant:
    """Plant whose wheel and angle sensors are read with the wheel radius and steering zero of `assumed`."""
    machine, wheels = plant.models.machine, plant.vehicle.sensors.wheels
    ratio = built.drivetrain.wheel_radius_m / assumed.drivetrain.wheel_radius_m
    error = machine.drive.wheel_radius_error
    error += (1.0 + error) * (ratio - 1.0)  # exact where nothing differs
    drive = machine.drive.model_copy(update={"wheel_radius_error": error})
    models = replace(plant.models, machine=machine.model_copy(update={"drive": drive}))
    if wheels is None or assumed.sensors.wheels is None:
        return replace(plant, models=models)
    wheels = wheels.model_copy(update={"angle_zero_deg": assumed.sensors.wheels.angle_zero_deg})
    sensors = plant.vehicle.sensors.model_copy(update={"wheels": wheels})
    return replace(plant, models=models, vehicle=plant.vehicle.model_copy(update={"sensors": sensors}))


def _with_slowest_brake(plant: Plant, config: PlantConfig) -> Plant:
    vehicle = plant.vehicle.model_copy(update={"brake": config.worst_brake})
    return replace(plant, vehicle=vehicle, models=_with_resistance(plant.models, config.worst_resistance_factor))


def _with_resistance(models: PlantModels, factor: float) -> PlantModels:
    machine = models.machine
    drive = machine.drive.model_copy(update={"rolling_resistance_mps2": factor * machine.drive.rolling_resistance_mps2})
    implement = _with_draft(machine.implement, factor)
    return PlantModels(machine.model_copy(update={"drive": drive, "implement": implement}), models.gnss, models.imu)


def _with_draft(implement: ImplementConfig, factor: float) -> ImplementConfig:
    change = {"draft_n_per_m": factor * implement.draft_n_per_m, "max_draft_n": factor * implement.max_draft_n}
    return implement.model_copy(update=change)


class _Draw:
    """Draws of one plant, in a fixed order."""

    def __init__(self, config: PlantConfig, random: np.random.Generator) -> None:
        self._config, self._random = config, random

    def error(self, limit: float) -> float:
        """Uniform error up to a limit."""
        return float(self._random.uniform(-limit, limit))

    def between(self, factor: Factor) -> float:
        """Uniform value between two limits."""
        return float(self._random.uniform(*factor))

    def clock(self) -> Clock:
        """Clock of one sensor."""
        return Clock(self.error(self._config.clock_offset_s), self.between((0.0, self._config.clock_jitter_s)))

    def scaled(self, values: Config, factor: Factor, *keys: str) -> dict[str, float]:
        """The named values of a section, each times a factor."""
        return {key: getattr(values, key) * self.between(factor) for key in keys}

    def shifted(self, values: Config, *keys: str) -> dict[str, float]:
        """The named lengths of a section, each with an error."""
        return {key: getattr(values, key) + self.error(self._config.dimension_m) for key in keys}

    def mount(self, mount: Mount) -> Mount:
        """True mount of a sensor."""
        x, y, z = (value + self.error(self._config.mount_m) for value in mount.xyz_m)
        roll, pitch, yaw = (value + self.error(self._config.mount_deg) for value in mount.rpy_deg)
        return Mount(xyz_m=(x, y, z), rpy_deg=(roll, pitch, yaw), sinks_m=mount.sinks_m)

    def vehicle(self, vehicle: Vehicle) -> Vehicle:
        """True machine."""
        actuator, drivetrain, body = self._config.actuator_factor, vehicle.drivetrain, vehicle.body
        slow = [key for key in ("dead_time_s", "lag_s", "backlash_deg", "dead_band") if hasattr(vehicle.steering, key)]
        mass_kg = body.mass_kg * (1.0 + self.error(self._config.mass_share))
        brake = self.scaled(vehicle.brake, actuator, "dead_time_s", "build_up_s")
        brake |= self.scaled(vehicle.brake, self._config.brake_factor, "deceleration_mps2")
        return vehicle.model_copy(update={
            "drivetrain": drivetrain.model_copy(update=self.shifted(drivetrain, "wheelbase_m", "track_m")),
            "body": body.model_copy(
                update=self.shifted(body, "front_m", "rear_m", "width_m", "height_m") | {"mass_kg": mass_kg}
            ),
            "steering": vehicle.steering.model_copy(update=self.scaled(vehicle.steering, actuator, *slow)),
            "brake": vehicle.brake.model_copy(update=brake),
            "acceleration_mps2": vehicle.acceleration_mps2 * self.between(actuator),
            "sensors": self.sensors(vehicle.sensors),
        })  # fmt: skip

    def sensors(self, sensors: Sensors) -> Sensors:
        """True mounts and errors of all sensors."""
        found: dict[str, object] = {}
        for kind, some in sensors:
            if isinstance(some, dict):
                found[kind] = {name: self.sensor(one) for name, one in some.items()}
            elif some is not None:
                found[kind] = self.sensor(some)
        return sensors.model_copy(update=found)

    def sensor(self, sensor: S) -> S:
        """True mount and errors of one sensor."""
        keys = [key for key in ERROR_KEYS if hasattr(sensor, key)]
        true: dict[str, object] = dict(self.scaled(sensor, self._config.error_factor, *keys))
        if isinstance(found := getattr(sensor, "mount", None), Mount):
            true["mount"] = self.mount(found)
        if isinstance(sensor, Lidar):
            true["elevation_deg"] = tuple(e + self.error(self._config.ring_deg) for e in sensor.elevation_deg)
        if isinstance(sensor, Camera):
            scale = 1.0 + self.error(self._config.focal_share)
            true["focal_px"] = tuple(scale * f for f in sensor.focal_px)
        return sensor.model_copy(update=true)

    def implement(self, implement: MountedImplement | TrailedImplement) -> MountedImplement | TrailedImplement:
        """True implement."""
        lengths = ("working_point_m", "front_end_m", "rear_end_m", "hitch_m", "axle_length_m", "working_length_m",
                   "total_length_m")  # fmt: skip
        true = self.scaled(implement, self._config.actuator_factor, "lift_s", "lower_s")
        true |= self.shifted(implement, *(key for key in lengths if hasattr(implement, key)))
        true["width_m"] = implement.width_m + abs(self.error(self._config.dimension_m))
        return implement.model_copy(update=true)

    def models(self, models: PlantModels) -> PlantModels:
        """True tyres, soil, drive, body, and errors of GNSS and IMU."""
        machine, soil, actuator = models.machine, self._config.soil_factor, self._config.actuator_factor
        drive = self.scaled(machine.drive, soil, "rolling_resistance_mps2", "slip_per_traction")
        drive |= self.scaled(machine.drive, actuator, "lag_s", "park_brake_s")
        drive["wheel_radius_error"] = self.error(self._config.wheel_radius_share)
        tyres = self.scaled(machine.tyres, soil, "front_stiffness", "rear_stiffness", "relaxation_length_m",
                            "soil_lateral_sigma_mps2", "max_angle_offset_deg")  # fmt: skip
        body = {key: self.between(getattr(self._config, key)) for key in
                ("pitch_deg_per_mps2", "roll_deg_per_mps2", "shake_deg_per_mps")}  # fmt: skip
        sections = {
            "drive": machine.drive.model_copy(update=drive), "tyres": machine.tyres.model_copy(update=tyres),
            "implement": _with_draft(machine.implement, self.between(soil)),
            "body_motion": machine.body_motion.model_copy(update=body),
        }  # fmt: skip
        return PlantModels(machine.model_copy(update=sections), self.gnss(models.gnss), self.imu(models.imu))

    def gnss(self, gnss: GnssConfig) -> GnssConfig:
        """True GNSS errors: correlated over minutes, larger than stated, with wrong fixes and multipath."""
        return gnss.model_copy(update={
            "correlation_s": self.between(self._config.gnss_correlation_s),
            "error_scale": self.between(self._config.error_factor),
            "wrong_fixes_per_hour": self._config.wrong_fixes_per_hour,
            "multipath_per_hour": self._config.multipath_per_hour,
        })  # fmt: skip

    def imu(self, imu: ImuConfig) -> ImuConfig:
        """True scale error and vibration of the IMU."""
        vibration = self.scaled(imu, self._config.vibration_factor, "idle_vibration_mps2", "idle_vibration_radps",
                                "driving_vibration_mps2_per_mps", "driving_vibration_radps_per_mps")  # fmt: skip
        return imu.model_copy(update=vibration | {"scale_sigma": self._config.imu_scale_share})

    def site(self, site: Site) -> Site:
        """True site: the shed displaced and rotated as a whole, its posts and anchors each with an error."""
        if site.shed is None:
            return site
        config, shed = self._config, site.shed
        turn, away, angle = self.error(config.survey_deg), self.between(config.survey_m), self.error(180.0)
        shift = away * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
        moved = moved_shed(shed, shift, turn)
        posts = tuple(
            Post(
                at_m=(p.at_m[0] + self.error(config.post_m), p.at_m[1] + self.error(config.post_m)), radius_m=p.radius_m
            )
            for p in moved.posts
        )
        anchors = {}
        for name, p in moved.anchors.items():
            way = self._random.standard_normal(3)
            way *= self.between(config.survey_m) / float(np.linalg.norm(way))
            anchors[name] = (p[0] + float(way[0]), p[1] + float(way[1]), p[2] + float(way[2]))
        return site.model_copy(update={"shed": moved.model_copy(update={"posts": posts, "anchors": anchors})})

    def start(self, start: PoseConfig, configured: Site, true: Site) -> PoseConfig:
        """True start pose; a docked machine stands in the true shed."""
        if configured.shed is not None and true.shed is not None:
            docks = {bay.name: bay.dock for bay in true.shed.bays}
            start = next((docks[bay.name] for bay in configured.shed.bays if bay.dock == start), start)
        return PoseConfig(
            x_m=start.x_m + self.error(self._config.start_m), y_m=start.y_m + self.error(self._config.start_m),
            heading_deg=start.heading_deg + self.error(self._config.start_deg),
        )  # fmt: skip


def moved_shed(shed: Shed, shift_m: Float64, turn_deg: float) -> Shed:
    """The shed after a rotation about the centre of its outline and a displacement (2,)."""
    center = np.array(shed.outline_m).mean(axis=0)
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))

    def moved(x_m: float, y_m: float) -> tuple[float, float]:
        x, y = x_m - center[0], y_m - center[1]
        return float(center[0] + shift_m[0] + c * x - s * y), float(center[1] + shift_m[1] + s * x + c * y)

    def moved_bay(bay: Bay) -> Bay:
        x, y = moved(bay.dock.x_m, bay.dock.y_m)
        dock = PoseConfig(x_m=x, y_m=y, heading_deg=bay.dock.heading_deg + turn_deg)
        return bay.model_copy(update={"dock": dock})

    return shed.model_copy(update={
        "outline_m": tuple(moved(*p) for p in shed.outline_m),
        "walls_m": tuple(tuple(moved(*p) for p in wall) for wall in shed.walls_m),
        "posts": tuple(Post(at_m=moved(*p.at_m), radius_m=p.radius_m) for p in shed.posts),
        "bays": tuple(moved_bay(bay) for bay in shed.bays),
        "anchors": {name: (*moved(p[0], p[1]), p[2]) for name, p in shed.anchors.items()},
    })  # fmt: skip
