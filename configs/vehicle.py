"""Vehicle with its sensors, and implement; also the vehicle that recorded a log."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from configs.strict import Config
from geometry.arrays import Float64
from geometry.rectangle import Rectangle
from geometry.transforms import transform

Length = Annotated[float, Field(gt=0.0, le=50.0)]
Offset = Annotated[float, Field(ge=-50.0, le=50.0)]
Seconds = Annotated[float, Field(ge=0.0, le=30.0)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Kmh = Annotated[float, Field(gt=0.0, le=80.0)]
Pixels = Annotated[int, Field(ge=16, le=16384)]
Focal = Annotated[float, Field(gt=1.0, le=100000.0)]


class Mount(Config):
    """Mount of a sensor: origin and fixed-axis roll, pitch and yaw in `base`.

    On an implement it is that of the raised one, and the sensor is `sinks_m` lower when the implement is lowered.
    """

    xyz_m: tuple[Offset, Offset, Offset]
    rpy_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    sinks_m: float = Field(default=0.0, ge=0.0, le=3.0)

    @property
    def T_base_sensor(self) -> Float64:
        """Pose of the sensor in base, (4, 4); on an implement when raised."""
        return transform(self.xyz_m, np.radians(self.rpy_deg))

    def at_hitch(self, hitch: float) -> Float64:
        """Pose of the sensor in base, (4, 4), at a hitch position from 0 (lowest) to 1 (highest)."""
        T = self.T_base_sensor
        T[2, 3] -= self.sinks_m * (1.0 - hitch)
        return T


class Sensor(Config):
    """Part common to all sensors: `topic` names the stream of a recording with its messages (None: by equal name)."""

    topic: str | None = Field(default=None, min_length=1, max_length=200)


class Lidar(Sensor):
    """Lidar: rings at the given elevations (lowest first), columns over the field of view."""

    mount: Mount
    elevation_deg: tuple[Degrees, ...] = Field(min_length=1, max_length=256)
    columns: int = Field(ge=16, le=8192)
    field_of_view_deg: float = Field(default=360.0, gt=0.0, le=360.0)
    rate_hz: float = Field(gt=0.0, le=100.0)
    range_m: tuple[float, float] = Field(description="nearest and farthest")
    range_sigma_m: float = Field(ge=0.0, le=1.0)

    @property
    def looks_down(self) -> bool:
        """Whether all beams are below the horizon of the sensor: it measures the ground around the machine."""
        return max(self.elevation_deg) < 0.0


class Camera(Sensor):
    """A camera: pinhole with Brown's distortion (k1, k2, p1, p2, k3; OpenCV's order), none in rectified images.

    The mount is that of the body frame (x forward, y left, z up); the optical axis is its x.
    """

    mount: Mount
    size_px: tuple[Pixels, Pixels] = Field(description="width and height")
    focal_px: tuple[Focal, Focal]
    center_px: tuple[float, float] = Field(description="principal point, from the centre of the first pixel")
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    rate_hz: float = Field(gt=0.0, le=120.0)

    @model_validator(mode="after")
    def _center_is_in_image(self) -> "Camera":
        if not (0.0 <= self.center_px[0] <= self.size_px[0] and 0.0 <= self.center_px[1] <= self.size_px[1]):
            raise ValueError(f"center_px {self.center_px} lies outside size_px {self.size_px}")
        return self


class Radar(Sensor):
    """Radar with detections of range, azimuth, Doppler and cross-section (BD-5.4.4)."""

    mount: Mount
    field_of_view_deg: float = Field(gt=0.0, le=180.0, description="full width in azimuth")
    rate_hz: float = Field(gt=0.0, le=100.0)
    range_m: tuple[float, float] = Field(description="nearest and farthest")
    range_sigma_m: float = Field(gt=0.0, le=5.0)
    azimuth_sigma_deg: float = Field(gt=0.0, le=10.0)
    doppler_sigma_mps: float = Field(gt=0.0, le=5.0)


class Ultrasonic(Sensor):
    """An ultrasonic sensor: a cone along x of its mount, no echo below the first of `range_m` (BD-5.4.5)."""

    mount: Mount
    cone_deg: float = Field(gt=0.0, le=120.0, description="full opening")
    rate_hz: float = Field(gt=0.0, le=100.0)
    range_m: tuple[float, float] = Field(description="end of the dead zone and farthest")
    range_sigma_m: float = Field(gt=0.0, le=1.0)


class Uwb(Sensor):
    """Ultra-wideband tag, measures ranges to the anchors of the site."""

    mount: Mount
    rate_hz: float = Field(gt=0.0, le=100.0)
    range_sigma_m: float = Field(gt=0.0, le=2.0)
    range_m: tuple[float, float] = Field(description="nearest and farthest")


class Gnss(Sensor):
    """An antenna; with `has_heading` a second one measures the heading of the baseline."""

    mount: Mount
    has_heading: bool
    rate_hz: float = Field(gt=0.0, le=100.0)
    sigma_horizontal_m: float = Field(gt=0.0, le=10.0)
    sigma_vertical_m: float = Field(gt=0.0, le=20.0)
    sigma_heading_deg: float = Field(gt=0.0, le=10.0)


class Imu(Sensor):
    """An IMU; noise as densities and in-run bias instability."""

    mount: Mount
    rate_hz: float = Field(ge=10.0, le=2000.0)
    gyro_noise_dps_rthz: float = Field(gt=0.0, le=10.0)
    gyro_bias_dph: float = Field(ge=0.0, le=1000.0)
    gyro_range_dps: float = Field(gt=0.0, le=10000.0)
    accelerometer_noise_ug_rthz: float = Field(gt=0.0, le=10000.0)
    accelerometer_bias_mg: float = Field(ge=0.0, le=1000.0)
    accelerometer_range_g: float = Field(gt=0.0, le=1000.0)


class Wheels(Sensor):
    """Wheel speed and steering angle sensors."""

    rate_hz: float = Field(gt=0.0, le=1000.0)
    speed_sigma_mps: float = Field(ge=0.0, le=1.0)
    angle_sigma_deg: float = Field(ge=0.0, le=5.0)
    angle_zero_deg: float = Field(
        default=0.0, ge=-15.0, le=15.0, description="angle of the sensor at straight wheels, which its driver subtracts"
    )


@dataclass(frozen=True)
class SensorKind:
    """Facts of a kind of obstacle sensor.

    `is_required`: the machine stops without its messages; otherwise their loss limits the detection range.
    `is_raw_source`: its measurements are part of the raw protective field.
    `needs_detector`: it finds no obstacles without a detector model.
    """

    is_required: bool = False
    is_raw_source: bool = False
    needs_detector: bool = False


class Sensors(Config):
    """All sensors by kind and name; the topic of a lidar `front` is `lidar/front`.

    The fields with a `SensorKind` are the table of the kinds of obstacle sensors (configs/sensor_kinds.py).
    """

    lidar: Annotated[dict[str, Lidar], SensorKind(is_required=True, is_raw_source=True)] = Field(default_factory=dict)
    camera: Annotated[dict[str, Camera], SensorKind(needs_detector=True)] = Field(default_factory=dict)
    radar: Annotated[dict[str, Radar], SensorKind(is_raw_source=True)] = Field(default_factory=dict)
    ultrasonic: Annotated[dict[str, Ultrasonic], SensorKind(is_raw_source=True)] = Field(default_factory=dict)
    gnss: dict[str, Gnss] = Field(default_factory=dict)
    uwb: dict[str, Uwb] = Field(default_factory=dict)
    imu: Imu | None = None
    wheels: Wheels | None = None

    @property
    def segmented_lidars(self) -> dict[str, Lidar]:
        """Lidars whose scans are divided into ground and objects: those with a beam at or above their horizon.

        Others cut objects off and serve the raw protective field alone; all, where no lidar has such a beam.
        """
        upright = {name: one for name, one in self.lidar.items() if not one.looks_down}
        return upright or self.lidar


class Ackermann(Config):
    """Front-wheel steering with a fixed rear axle."""

    kind: Literal["ackermann"]
    wheelbase_m: Length
    track_m: Length
    wheel_radius_m: Length
    min_turning_radius_m: Length

    @property
    def max_curvature_radpm(self) -> float:
        """Maximum curvature of the rear axle centre."""
        return 1.0 / self.min_turning_radius_m


class ElectricWheel(Config):
    """Motor on the steering wheel (BD-5.5.2a)."""

    kind: Literal["electric_wheel"]
    max_wheel_rpm: float = Field(gt=0.0, le=300.0)
    wheel_turns_per_steer_rad: float = Field(gt=0.0, le=50.0)
    dead_time_s: Seconds
    lag_s: Seconds
    backlash_deg: float = Field(ge=0.0, le=20.0, description="at the front wheels")


class HydraulicValve(Config):
    """Proportional valve on the steering cylinder (T14-4.5: 8 to 30 L/min)."""

    kind: Literal["hydraulic_valve"]
    max_flow_lpm: float = Field(ge=1.0, le=60.0)
    cylinder_l_per_rad: float = Field(gt=0.0, le=5.0)
    dead_band: float = Field(ge=0.0, lt=0.5, description="share of full command")
    dead_time_s: Seconds
    lag_s: Seconds


class Brake(Config):
    """Response of the brakes for prediction; the supervisor has values of its own."""

    dead_time_s: Seconds
    build_up_s: Seconds
    deceleration_mps2: float = Field(gt=0.0, le=12.0)


class Solid(Config):
    """Box in `base` that beams do not pass: limits along each axis."""

    x_m: tuple[Offset, Offset]
    y_m: tuple[Offset, Offset]
    z_m: tuple[Offset, Offset]

    @model_validator(mode="after")
    def _limits_rise(self) -> "Solid":
        for key in ("x_m", "y_m", "z_m"):
            low, high = getattr(self, key)
            if low >= high:
                raise ValueError(f"{key}: {low} is not below {high}")
        return self


class Body(Config):
    """Extent of the machine without implement around `base`; `solids` are its parts that hide what lies behind.

    Without `solids` the machine hides like one box of its extent.
    """

    front_m: Length
    rear_m: Length
    width_m: Length
    height_m: Length
    mass_kg: float = Field(gt=0.0, le=100000.0)
    solids: dict[str, Solid] = Field(default_factory=dict)


class Vehicle(Config):
    """Machine: dimensions, drivetrain, actuators and sensors, without defaults."""

    name: str = Field(min_length=1, max_length=60)
    drivetrain: Ackermann
    body: Body
    steering: Annotated[ElectricWheel | HydraulicValve, Field(discriminator="kind")]
    brake: Brake
    max_speed_kmh: Kmh
    acceleration_mps2: float = Field(gt=0.0, le=5.0)
    sensors: Sensors


def steering_rate(vehicle: Vehicle) -> float:
    """Maximum rate of the front-wheel angle, rad/s."""
    actuator = vehicle.steering
    if isinstance(actuator, ElectricWheel):
        return actuator.max_wheel_rpm / 60.0 / actuator.wheel_turns_per_steer_rad
    return actuator.max_flow_lpm / 60.0 / actuator.cylinder_l_per_rad


class _Implement(Config):
    name: str = Field(min_length=1, max_length=60)
    working_width_m: Length
    width_m: Length
    lift_s: Seconds
    lower_s: Seconds
    uses_pto: bool
    pto_stop_s: Seconds = Field(default=5.0, description="run-down of the PTO after its command; 5: not measured")

    @model_validator(mode="after")
    def _width_covers_working_width(self) -> "_Implement":
        if self.width_m < self.working_width_m:
            raise ValueError(f"width_m {self.width_m} is less than working_width_m {self.working_width_m}")
        return self


class Fold(Config):
    """Folding for transport: width when folded, duration of folding or unfolding at standstill."""

    width_m: Length
    duration_s: Seconds


class MountedImplement(_Implement):
    """Implement on the hitch; `working_point_m` and the ends are along x of `base` (negative: behind).

    `fold` None means that it cannot be folded. `sensors` are on the implement, outside of wings that fold; their mounts
    are in `base` with raised implement, from where they sink by `lift_m` with it.
    """

    kind: Literal["mounted"]
    working_point_m: Offset
    front_end_m: Offset
    rear_end_m: Offset
    height_m: Annotated[float, Field(gt=0.0, le=5.0, description="of its top above the ground when lowered")]
    lift_m: Annotated[float, Field(ge=0.0, le=3.0, description="stroke: height above the ground when raised")]
    fold: Fold | None = None
    sensors: Sensors = Sensors()

    @model_validator(mode="after")
    def _sensors_move_with_the_hitch_only(self) -> "MountedImplement":
        for kind, some in self.sensors:
            if some and not any(isinstance(fact, SensorKind) for fact in Sensors.model_fields[kind].metadata):
                raise ValueError(f"sensors.{kind}: not on an implement")
            for name, one in (some or {}).items():
                x_m, y_m, _ = one.mount.xyz_m
                if self.fold is not None and abs(y_m) > 0.5 * self.fold.width_m:
                    raise ValueError(f"sensors.{kind}.{name}: y {y_m} m is on a wing that folds (x {x_m} m)")
        return self

    @property
    def ends_m(self) -> tuple[float, float]:
        """Front and rear end along x of `base` (m)."""
        return self.front_end_m, self.rear_end_m

    @property
    def folded(self) -> "MountedImplement":
        """The implement when folded for transport; unchanged without `fold`."""
        return self if self.fold is None else self.model_copy(update={"width_m": self.fold.width_m})


class TrailedImplement(_Implement):
    """Implement on a drawbar from `hitch_m` along x of `base`; lengths are from the hitch backwards."""

    kind: Literal["trailed"]
    hitch_m: Offset
    axle_length_m: Length
    working_length_m: Length
    total_length_m: Length
    max_hitch_deg: float = Field(default=60.0, gt=5.0, lt=90.0, description="largest angle between machine and drawbar")

    @property
    def ends_m(self) -> tuple[float, float]:
        """Front and rear end along x of `base` (m), in line with the machine."""
        return self.hitch_m, self.hitch_m - self.total_length_m

    @property
    def folded(self) -> "TrailedImplement":
        """The implement unchanged: it does not fold."""
        return self


def undriven(implement: TrailedImplement) -> str:
    """Why no machine drives with a trailed implement: the line of a refusal."""
    return (
        f"implement {implement.name!r} is trailed: it is planned (./headland plan), not driven. Its angle is not "
        "measured, and no sensor covers the places that it sweeps (./headland coverage)"
    )


Implement = Annotated[MountedImplement | TrailedImplement, Field(discriminator="kind")]


def outlines(body: Body, implement: MountedImplement | TrailedImplement | None) -> tuple[Rectangle, ...]:
    """Outlines of the machine and of the implement (trailed: straight behind) in `base`; see also `folded`."""
    machine = Rectangle(-body.rear_m, body.front_m, body.width_m)
    if implement is None:
        return (machine,)
    front_m, rear_m = implement.ends_m
    return machine, Rectangle(rear_m, front_m, implement.width_m)


FOLDED = 0.99  # of `MachineState.fold_position`: locked in transport position


class ImplementFile(Config):
    """Content of a file in `configs/implements/`."""

    implement: Implement


def kmh(speed_kmh: float) -> float:
    """Speed in m/s."""
    return speed_kmh / 3.6


def deg(angle_deg: float) -> float:
    """Angle in radians."""
    return math.radians(angle_deg)
