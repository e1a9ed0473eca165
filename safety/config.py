"""Values that the parts of the supervisor share; none has a default. The limits of single rules are in rules/."""

from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config
from configs.vehicle import Degrees, Kmh, Seconds
from safety.stopping_distance import Braking

Metres = Annotated[float, Field(ge=0.0, le=100.0)]
Acceleration = Annotated[float, Field(gt=0.0, le=12.0)]
Speed = Annotated[float, Field(ge=0.0, le=20.0)]


class BrakingConfig(Config):
    """What the supervisor counts on, and how hard it asks."""

    reaction_s: Seconds = Field(description="τ: sensing, confirming, deciding, bus and dead time of the brake")
    build_up_s: Seconds
    deceleration_mps2: Acceleration
    min_deceleration_mps2: Acceleration = Field(description="on a grade that leaves less it cannot stop")
    dead_time_s: Seconds = Field(description="share of τ that is left once braking is asked for")
    controlled_mps2: Acceleration
    full_mps2: Acceleration
    hold_mps2: Acceleration

    @property
    def flat(self) -> Braking:
        """The same for the formulas, on level ground."""
        return Braking(self.reaction_s, self.build_up_s, self.deceleration_mps2)


class FieldConfig(Config):
    """The raw protective field."""

    margin_m: Metres = Field(description="way left at standstill before what stands on the planned path")
    arc_margin_m: Metres = Field(description="the same on the arc of the present steering, beside a planned path")
    lateral_margin_near_m: Metres
    lateral_margin_far_m: Metres
    lateral_growth: float = Field(gt=0.0, le=1.0, description="lateral margin gained per metre of way")
    min_height_m: Metres
    min_height_slope: float = Field(ge=0.0, le=0.2)
    overhead_margin_m: Metres
    grade_change: float = Field(ge=0.0, le=0.15, description="by how much the ground may bend up or down per metre")
    rise_cap_m: Metres = Field(description="no more than this of rising ground is believed")
    ground_returns: int = Field(ge=1, le=50, description="the so-many-th lowest return of a patch is its ground")
    ground_share: float = Field(ge=0.0, le=0.1, description="or this share of its returns, where that is more")
    ground_patch_m: float = Field(gt=0.5, le=10.0)
    furrow_m: Metres = Field(description="depth below the wheels that is not yet falling ground")
    mask_m: Metres
    cell_m: float = Field(gt=0.05, le=2.0)
    min_returns_single_scan: int = Field(ge=1, le=50, description="returns in one cell in one scan that make a hit")
    min_returns_multiple_scan: int = Field(
        ge=1, le=50, description="returns in one cell in each of two scans that make a hit"
    )
    blind_zone_hold_s: float = Field(ge=0.0, le=600.0, description="how long a hit is kept where no beam can look")
    step_m: float = Field(gt=0.05, le=2.0)
    min_length_m: Metres
    max_path_deviation_m: Metres = Field(description="farthest the pose may be from its place on the path")
    max_path_deviation_deg: Degrees
    blend_m: float = Field(gt=0.0, le=50.0)
    sigma_factor: float = Field(ge=0.0, le=6.0)
    slow_range_factor: float = Field(ge=1.0, le=5.0, description="proven range over S (BD-5.2.4: 2 in simple weather)")

    @model_validator(mode="after")
    def _margins_grow(self) -> "FieldConfig":
        if self.lateral_margin_far_m < self.lateral_margin_near_m:
            far_m, near_m = self.lateral_margin_far_m, self.lateral_margin_near_m
            raise ValueError(f"lateral_margin_far_m {far_m} is less than lateral_margin_near_m {near_m}")
        return self


class DetectionRangeConfig(Config):
    """How far a lidar proves the field free, judged by its raw returns."""

    cap_m: Metres
    object_m: tuple[float, float] = Field(description="width and height of what must be seen")
    min_object_returns: int = Field(ge=1, le=100)
    beams_m: tuple[float, float] = Field(description="beams that meet level ground within this range must come back")
    blind_ratio: float = Field(ge=0.0, lt=1.0)
    good_ratio: float = Field(gt=0.0, le=1.0)
    sectors: int = Field(ge=4, le=72)
    half_cone_deg: float = Field(
        gt=0.0, le=90.0, description="half angle about the direction of travel that must be proven"
    )
    frozen_scans: int = Field(ge=1, le=20, description="so many equal scans in a row are no scans")

    @model_validator(mode="after")
    def _shares_rise(self) -> "DetectionRangeConfig":
        if self.good_ratio <= self.blind_ratio:
            raise ValueError(f"good_ratio {self.good_ratio} is not above blind_ratio {self.blind_ratio}")
        return self


class TrackedConfig(Config):
    """The channel of tracked obstacles."""

    moving_mps: Speed
    long_moving_mps: Speed = Field(
        description="the same for vehicles and what is longer than `max_unclassified_length_m`"
    )
    max_static_class_speed_mps: Speed = Field(
        description="what is fixed by its class and seems faster than this stands"
    )
    max_static_length_m: Metres = Field(
        description="no machine is longer; what is and stands counts in the raw field alone"
    )
    max_coasting_s: Seconds = Field(description="unseen for longer, what has no class does not count as moving")
    moving_sigmas: float = Field(ge=0.0, le=10.0)
    fragment_parent_m: Metres = Field(description="longest side from which on what stands may be seen in pieces")
    fragment_margin_m: Metres = Field(
        description="a smaller track this near to the box of such a thing is a piece of it"
    )
    lateral_m: Metres
    min_track_age_s: Seconds = Field(description="a velocity is believed once the track is that old")
    max_unclassified_length_m: Metres = Field(description="longest side of what may move without having a class")
    self_filter_m: Metres = Field(description="a track this near to machine or implement is their own")
    min_horizon_s: Seconds
    max_horizon_s: Seconds
    steps: int = Field(ge=2, le=50)
    uncertainty_cap_m: Metres


class RadarConfig(Config):
    """What of a radar's detections counts in the raw field."""

    cycles: int = Field(ge=1, le=50, description="cycles that are remembered")
    memory_s: Seconds
    near_m: Metres = Field(description="detections this near to each other are one thing")
    standing_cycles: int = Field(ge=1, le=50)
    moving_cycles: int = Field(ge=1, le=50)
    moving_mps: Speed
    standing_rcs_dbsm: float = Field(ge=-60.0, le=60.0)
    moving_rcs_dbsm: float = Field(ge=-60.0, le=60.0)
    standing_cap_m: Metres
    moving_cap_m: Metres
    bearing_sigmas: float = Field(ge=0.0, le=6.0, description="a hit counts when its bearing surely lies in the way")
    frozen_cycles: int = Field(ge=1, le=100)

    @model_validator(mode="after")
    def _cycles_are_kept(self) -> "RadarConfig":
        if max(self.standing_cycles, self.moving_cycles) > self.cycles:
            raise ValueError(f"cycles {self.cycles} are fewer than are needed for a hit")
        return self


class UltrasonicConfig(Config):
    """What of an ultrasonic sensor's echoes counts in the raw field."""

    window: int = Field(ge=1, le=50)
    repeats: int = Field(ge=1, le=50)
    gate_m: Metres
    max_object_speed_mps: Speed
    ground_share: float = Field(gt=0.0, le=1.0, description="of the range at which the axis meets the ground")
    memory_s: Seconds
    dead_zone_margin_m: Metres
    dead_zone_hold_s: Seconds = Field(description="how long what went into the dead zone is kept")
    max_speed_kmh: Kmh = Field(description="faster, an echo comes too late to matter")
    min_arc_ratio: float = Field(gt=0.0, le=1.0, description="of the arc that must lie in the way")
    track_match_m: Metres = Field(description="a thing that a lidar follows, this near to the arc, answered")

    @model_validator(mode="after")
    def _window_holds_repeats(self) -> "UltrasonicConfig":
        if self.repeats > self.window:
            raise ValueError(f"repeats {self.repeats} do not fit a window of {self.window}")
        return self


class DockingConfig(Config):
    """The field in and before the shed, where walls stand within every other margin."""

    speed_kmh: float = Field(gt=0.0, le=1.8)
    ultrasonic_lost_kmh: float = Field(gt=0.0, le=1.8, description="with an ultrasonic sensor lost")
    near_m: Metres = Field(description="about the roof")
    margin_m: Metres
    arc_margin_m: Metres
    lateral_m: Metres
    known_structure_tolerance_m: Metres = Field(
        description="what is seen this near to a surveyed surface is that surface"
    )
    clearance_m: Metres = Field(description="kept from surveyed surfaces beyond what the pose leaves open")
    sigmas: float = Field(ge=1.0, le=6.0)
    protection_stop_m: Metres
    max_uwb_age_s: Seconds


class BrakeTestConfig(Config):
    """The brake is tried once before the first metre is over."""

    speed_kmh: float = Field(gt=0.5, le=5.0, description="highest speed before the brake is tried")
    brake_kmh: float = Field(gt=0.2, le=5.0, description="speed at which it is tried")

    @model_validator(mode="after")
    def _is_reached(self) -> "BrakeTestConfig":
        if self.brake_kmh >= self.speed_kmh:
            raise ValueError(f"brake_kmh {self.brake_kmh} is never reached at speed_kmh {self.speed_kmh}")
        return self


class LimitsConfig(Config):
    """Limits used by more than one part."""

    speed_kmh: Kmh
    reduced_kmh: Kmh = Field(description="speed with a reported fault or with a position that is not accurate")
    geofence_margin_m: Metres
    driver_torque_nm: float = Field(gt=0.0, le=50.0, description="torque on the hand wheel that counts as forced")
    curvature_error_radpm: float = Field(gt=0.0, le=1.0)
    curvature_late_s: Seconds = Field(description="time within which the steering follows its command")
    min_brake_ratio: float = Field(gt=0.0, le=1.0, description="measured over commanded deceleration")
    max_group_age_s: Seconds = Field(description="maximum age of a group within the machine's state")
    clock_step_s: Seconds = Field(description="deviation from the period above which the clock has stepped")


class ModesConfig(Config):
    """Times of the mode machine."""

    start_warning_s: Seconds
    resume_warning_s: Seconds
    resume_clear_s: Seconds
    resume_kmh: Kmh = Field(description="the way ahead must allow this speed before the machine resumes")
    standstill_mps: Speed
    creep_mps: Speed = Field(description="a lower allowed speed is no speed")
    park_after_s: Seconds
    fold_after_s: Seconds = Field(description="standstill before the implement folds")
    seat_empty_s: Seconds = Field(description="a driver's seat empty for so long has no driver")
    authorities: tuple[str, ...] = Field(min_length=1)


class SafetyConfig(Config):
    """The shared values of the supervisor."""

    braking: BrakingConfig
    field: FieldConfig
    detection_range: DetectionRangeConfig
    tracked: TrackedConfig
    radar: RadarConfig
    ultrasonic: UltrasonicConfig
    docking: DockingConfig
    brake_test: BrakeTestConfig
    limits: LimitsConfig
    modes: ModesConfig
    jerk_mps3: float = Field(gt=0.0, le=50.0)
    curvature_rate_radpms: float = Field(gt=0.0, le=5.0)

    @property
    def docked(self) -> "SafetyConfig":
        """The same with the docking field in place of the open one."""
        near = self.docking
        margins = {
            "margin_m": near.margin_m,
            "arc_margin_m": near.arc_margin_m,
            "lateral_margin_near_m": near.lateral_m,
            "lateral_margin_far_m": near.lateral_m,
        }
        return self.model_copy(update={"field": self.field.model_copy(update=margins)})
