"""Configuration shared by the parts of the supervisor; no defaults. The limits of single rules are in rules/."""

from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import Config
from configs.vehicle import Degrees, Kmh, Seconds
from safety.stopping_distance import Braking

Metres = Annotated[float, Field(ge=0.0, le=100.0)]
Acceleration = Annotated[float, Field(gt=0.0, le=12.0)]
Speed = Annotated[float, Field(ge=0.0, le=20.0)]


class BrakingConfig(Config):
    """Braking that the stopping distance counts on, and decelerations that are commanded."""

    reaction_s: Seconds = Field(description="τ: detection, confirmation, decision, bus and dead time of the brake")
    build_up_s: Seconds
    deceleration_mps2: Acceleration
    min_deceleration_mps2: Acceleration = Field(
        description="with less left on a grade the machine counts as unable to stop"
    )
    dead_time_s: Seconds = Field(description="part of τ after the brake command")
    controlled_mps2: Acceleration
    full_mps2: Acceleration
    hold_mps2: Acceleration
    hold_factor: float = Field(ge=1.0, le=5.0, description="of gravity along the slope, held at rest")

    @property
    def flat(self) -> Braking:
        """Braking on level ground."""
        return Braking(self.reaction_s, self.build_up_s, self.deceleration_mps2)


class FieldConfig(Config):
    """Raw protective field and ground filter."""

    margin_m: Metres = Field(description="distance to an obstacle on the planned path at standstill")
    arc_margin_m: Metres = Field(description="the same on the arc of the measured steering")
    lateral_margin_near_m: Metres
    lateral_margin_far_m: Metres
    lateral_growth: float = Field(gt=0.0, le=1.0, description="growth of the lateral margin per metre of distance")
    min_height_m: Metres
    min_height_slope: float = Field(ge=0.0, le=0.2)
    overhead_margin_m: Metres
    grade_change: float = Field(ge=0.0, le=0.15, description="greatest change of ground height per metre of distance")
    rise_cap_m: Metres = Field(description="greatest accepted rise of the ground")
    ground_returns: int = Field(ge=1, le=50, description="order of the lowest return of a patch that is its ground")
    ground_ratio: float = Field(ge=0.0, le=0.1, description="or this ratio of its returns, where that is more")
    ground_patch_m: float = Field(gt=0.5, le=10.0)
    furrow_m: Metres = Field(description="depth below the wheels that is not falling ground")
    mask_m: Metres
    cell_m: float = Field(gt=0.05, le=2.0)
    min_returns_single_scan: int = Field(ge=1, le=50, description="returns in a cell in one scan for a hit")
    min_returns_multiple_scan: int = Field(ge=1, le=50, description="returns in a cell in each of two scans for a hit")
    scans_at_rest: int = Field(
        ge=2, le=100, description="scans in a row, at rest, in each of which one return is enough"
    )
    min_returns_in_fog: int = Field(ge=1, le=50, description="returns in a cell that floats, in fog, rain or dust")
    blind_zone_hold_s: float = Field(
        ge=0.0, le=600.0, description="hold time of a hit at the edge of the lowest beam; one farther below has none"
    )
    blind_zone_edge_m: Metres = Field(description="depth of that edge")
    step_m: float = Field(gt=0.05, le=2.0)
    min_length_m: Metres
    max_path_deviation_m: Metres = Field(description="distance of the pose from its path position")
    max_path_deviation_deg: Degrees
    blend_m: float = Field(gt=0.0, le=50.0)
    sigma_factor: float = Field(ge=0.0, le=6.0)
    slow_range_factor: float = Field(
        ge=1.0, le=5.0, description="detection range over S (BD-5.2.4: 2 in simple weather)"
    )

    @model_validator(mode="after")
    def _margins_grow(self) -> "FieldConfig":
        if self.lateral_margin_far_m < self.lateral_margin_near_m:
            far_m, near_m = self.lateral_margin_far_m, self.lateral_margin_near_m
            raise ValueError(f"lateral_margin_far_m {far_m} is less than lateral_margin_near_m {near_m}")
        return self


class MeasuredGroundConfig(Config):
    """Ground around each return above the plane through the wheels, by the lowest returns of cells."""

    cell_m: float = Field(gt=0.1, le=2.0)
    returns: int = Field(ge=1, le=50, description="order of the lowest return of a cell that is its ground")
    slope: float = Field(ge=0.0, le=1.0, description="greatest rise of the ground, in base, from a lower place")
    reach_cells: int = Field(ge=1, le=20, description="cells over which a lower place bounds the ground")
    range_m: Metres = Field(description="distance from the rear axle; beyond it planes through cells bound the ground")
    wheels_m: Metres = Field(description="distance from the centre between the axles that counts as beside the wheels")
    wheels_cells: int = Field(ge=1, le=100, description="least number of cells there")
    wheels_plane_m: Metres = Field(description="distance from there of cells whose plane counts where there are fewer")
    wheels_tolerance_m: Metres = Field(description="of their median height: farther off the lidar is misaligned")
    plane_reach_cells: int = Field(ge=1, le=20, description="cells on each side for the plane that levels the ground")
    plane_cells: int = Field(ge=3, le=400, description="least number of them with ground")
    near_min_height_m: Metres = Field(description="least height above the levelled ground that counts")


class NearFieldConfig(Config):
    """Low objects on the measured ground near machine and implement."""

    range_m: Metres = Field(description="before the foremost and behind the rearmost point of the machine")
    aside_m: Metres = Field(description="to either side of the machine")
    min_height_m: Metres = Field(description="least height above the measured ground that counts")
    cell_m: float = Field(gt=0.1, le=2.0)
    ground_quantile: float = Field(ge=0.0, le=0.5, description="of the heights in a cell that is its ground")
    max_slope: float = Field(ge=0.0, le=1.0, description="greatest rise of the ground from a lower place to its trend")
    max_residual_slope: float = Field(ge=0.0, le=1.0, description="the same of the ground against its trend")
    max_roughness_m: Metres = Field(description="what is higher above the ground is not its roughness")
    roughness_quantile: float = Field(ge=0.5, le=1.0, description="over cells, of the height that the ground reaches")
    roughness_factor: float = Field(ge=1.0, le=10.0, description="least height that counts, over the quantile")
    min_share: float = Field(ge=0.0, le=0.2, description="of the returns of a cell that are so high; fewer are noise")
    dense_factor: float = Field(ge=1.0, le=10.0, description="the same where many returns of a cell are so high")
    dense_share: float = Field(ge=0.0, le=1.0, description="share that is many")
    dense_returns: int = Field(ge=1, le=100, description="and their least number")
    dense_width_m: float = Field(ge=0.0, le=0.5, description="and their least standard deviation across the machine")


class VegetationConfig(Config):
    """Plants that cover the ground about a place and hide what is lower than they are."""

    min_height_m: Metres = Field(description="lower plants hide nobody who lies")
    max_height_m: Metres = Field(description="what is higher is not called plants")
    margin_m: Metres = Field(description="above the plants from which on a return counts, with consent")
    reach_cells: int = Field(ge=1, le=10, description="cells of the near field on each side over which plants are even")
    share: float = Field(
        gt=0.0, le=0.5, description="of these cells, or of all, that plants cover, and a body does not"
    )
    min_cells: int = Field(ge=1, le=1000, description="cells of the near field that show plants around the machine")
    wheels_m: Metres = Field(
        description="distance from the centre between the axles within which their plane is ground"
    )
    min_near_cells: int = Field(ge=1, le=1000, description="cells there that show how high plants are above that plane")
    min_texture_m: Metres = Field(description="height of the tops of plants above the low returns between them")
    memory_s: float = Field(gt=0.0, le=60.0, description="time constant of the memory of a lidar where plants stood")

    @property
    def uncertainty_m(self) -> float:
        """Height by which plants may be measured higher than they are."""
        return 0.5 * self.margin_m


class AirborneConfig(Config):
    """Evidence in a range image that returns are of dust or birds."""

    dust_range_m: Metres = Field(description="from the sensor, within which a person has dozens of returns")
    dust_returns: int = Field(ge=1, le=1000, description="isolated returns in a scan from which on they are dust")
    clear_m: Metres = Field(description="height of the clear space beneath a return that floats")
    fog_share: float = Field(ge=0.0, le=1.0, description="of scattered returns, above which a scan is of fog")
    follow_s: float = Field(ge=0.0, le=1.0, description="for which what floated may fly on to where nothing shows that")
    follow_m: Metres = Field(description="size of what floats")
    follow_mps: float = Field(ge=0.0, le=20.0, description="at which it flies")


class NegativeObstacleConfig(Config):
    """Ditches and edges where the ground falls away."""

    depth_m: Metres = Field(description="least depth of a return below the ground around it; plants add their height")
    beneath_m: Metres = Field(
        description="least run of its beam beneath the ground: furrows and wheel tracks are narrower"
    )
    fall: float = Field(ge=0.0, le=1.0, description="grade at which it falls away, more than the ground on both sides")


class DepartureConfig(Config):
    """Following what blocked the path until it has left."""

    seen_s: Seconds = Field(description="time for which an object must have been seen to be followed")
    near_m: Metres = Field(description="distance before the foremost point within which `seen_near_s` is enough")
    seen_near_s: Seconds
    ahead_m: Metres = Field(description="part of the swept area in which an object counts as blocking")
    follow_m: Metres = Field(description="greatest movement of a person or animal from one scan to the next")
    away_m: Metres = Field(description="distance from the swept area at which it has left")
    kept_m: Metres = Field(description="distance of the machine from where it was lost, beyond which it is forgotten")


class DetectionRangeConfig(Config):
    """Detection range of a lidar by its raw returns."""

    cap_m: Metres
    object_m: tuple[float, float] = Field(description="width and height of the object to be detected")
    min_object_returns: int = Field(ge=1, le=100)
    beams_m: tuple[Metres, ...] = Field(
        min_length=2, description="bounds of bands of range: beams that meet level ground in them must return"
    )
    blind_ratio: float = Field(ge=0.0, lt=1.0)
    good_ratio: float = Field(gt=0.0, le=1.0)
    sectors: int = Field(ge=4, le=72)
    half_cone_deg: float = Field(gt=0.0, le=90.0, description="half angle of the cone about the direction of travel")
    frozen_scans: int = Field(ge=1, le=20, description="repeated scans in a row that mean a frozen lidar")
    repeat_memory_scans: int = Field(ge=1, le=10_000, description="earlier scans that a repeated one is compared with")

    @model_validator(mode="after")
    def _values_rise(self) -> "DetectionRangeConfig":
        if self.good_ratio <= self.blind_ratio:
            raise ValueError(f"good_ratio {self.good_ratio} is not above blind_ratio {self.blind_ratio}")
        if not all(low < high for low, high in pairwise(self.beams_m)):
            raise ValueError(f"beams_m {self.beams_m} do not ascend")
        return self


class LidarAgreementConfig(Config):
    """Comparison of the ground that lidars find in the same places."""

    cell_m: float = Field(ge=0.2, le=5.0)
    range_m: Metres = Field(description="beams that meet level ground within it are compared")
    min_cells: int = Field(ge=3, le=1000, description="cells that two lidars must have in common")
    max_difference_m: Metres = Field(description="of the median height over the cells")
    max_height_m: Metres = Field(description="of the median over all cells, above or below the wheels")
    max_interval_s: Seconds = Field(description="between the scans that are compared")
    hold_s: Seconds = Field(description="time for which a lidar must contradict the others")


class TrackedConfig(Config):
    """Tracked obstacle channel."""

    moving_mps: Speed
    long_moving_mps: Speed = Field(description="the same for vehicles and long tracks")
    max_static_class_speed_mps: Speed = Field(description="a track of a static class above this is static")
    max_static_length_m: Metres = Field(description="longer static tracks are left to the raw field")
    max_static_width_m: Metres = Field(description="so are broader ones: the box of two vehicles")
    max_coasting_s: Seconds = Field(description="an unclassified track unseen for longer does not move")
    moving_sigmas: float = Field(ge=0.0, le=10.0)
    fragment_parent_m: Metres = Field(description="length from which a static track may have fragments")
    fragment_margin_m: Metres = Field(description="distance of a fragment from the box of its parent")
    lateral_m: Metres
    min_track_age_s: Seconds = Field(description="minimum age of a track for its velocity to count")
    max_unclassified_length_m: Metres = Field(description="longest side of a moving unclassified track")
    broad_m: Metres = Field(description="shortest side from which a longer unclassified track beside may be a vehicle")
    self_filter_m: Metres = Field(description="a track this near to machine or implement is the machine itself")
    post_tolerance_m: Metres = Field(description="a static track this near to a surveyed gate post is the post")
    max_post_width_m: Metres = Field(description="unless its longest side is longer")
    joined_post_s: Seconds = Field(description="age from which the motion of a longer track at a post counts")
    min_horizon_s: Seconds
    max_horizon_s: Seconds
    steps: int = Field(ge=2, le=50)
    uncertainty_cap_m: Metres


class BystanderConfig(Config):
    """Tracked bodies that come towards machine or implement from any side."""

    min_unclassified_age_s: Seconds = Field(description="minimum age of an unclassified track for its motion to count")
    max_unclassified_height_m: Metres = Field(description="height of an unclassified narrow track that moves itself")
    min_coming_s: Seconds = Field(description="time for which a track must come")
    min_coming_m: Metres = Field(description="and distance for which, at its speed")
    min_following_s: Seconds = Field(description="the same of one that follows and would be reached by braking")
    manoeuvre_mps2: float = Field(ge=0.0, le=10.0, description="change of its velocity that a body may make")
    turn_radps: float = Field(ge=0.0, le=10.0, description="turning rate of a person or animal, at its speed")
    max_manoeuvre_mps2: float = Field(ge=0.0, le=10.0, description="largest change of velocity by it")
    closing_m: Metres = Field(description="a predicted approach by less is none")
    follow_m: Metres = Field(description="a new track this near to the last place of a lost one continues it")
    overlap_s: Seconds = Field(description="age at which a track is new then: it began while the other was seen")
    same_m: Metres = Field(description="an older track this near to the place continues it as well")
    away_m: Metres = Field(description="distance from machine and implement at which a bystander seen there has left")
    lost_m: Metres = Field(description="the same for one that is no longer seen")
    arrived_m: Metres = Field(description="who came so much nearer to a machine at rest is a bystander")
    at_machine_m: Metres = Field(description="distance within which returns keep a machine at rest")
    at_machine_s: Seconds = Field(description="time for which they must be there")
    pto_walk_mps: float = Field(ge=0.0, le=10.0, description="speed of who walks to a PTO while it runs down")
    pto_margin_m: Metres = Field(description="distance that is left to them")
    pto_hold_s: Seconds = Field(description="time for which the PTO stays off after that")


class StandingBodyConfig(Config):
    """Persons and animals that stand beside the swept area."""

    min_age_s: Seconds = Field(description="minimum age of a track for its class to count")
    walk_mps: Speed = Field(description="speed with which a body may set off towards the machine")
    notice_s: Seconds = Field(description="time until its motion is known, before the reaction time")
    min_mps: Speed = Field(description="speed that is always allowed")
    hold_s: Seconds = Field(description="time for which one that is lost from view stays where it was")
    lost_s: Seconds = Field(description="time after which one among plants that hide who lies counts as lost from view")
    reach_m: Metres = Field(description="distance up to which such a one stays where it was")
    glimpsed_s: Seconds = Field(description="time for which a young body in cover was seen to count as such")
    glimpsed_above_m: Metres = Field(description="its least height above the cover")
    glimpsed_length_m: Metres = Field(description="its largest length, and the distance that it may have moved")


class RadarConfig(Config):
    """Confirmation of radar detections."""

    cycles: int = Field(ge=1, le=50, description="length of the memory in cycles")
    memory_s: Seconds
    association_m: Metres = Field(description="detections this near to each other are one object")
    static_cycles: int = Field(ge=1, le=50)
    moving_cycles: int = Field(ge=1, le=50)
    moving_mps: Speed
    static_rcs_dbsm: float = Field(ge=-60.0, le=60.0)
    moving_rcs_dbsm: float = Field(ge=-60.0, le=60.0)
    static_cap_m: Metres
    moving_cap_m: Metres
    bearing_sigmas: float = Field(ge=0.0, le=6.0, description="margin by which the bearing must lie in the swept area")
    frozen_cycles: int = Field(ge=1, le=100)

    @model_validator(mode="after")
    def _cycles_are_kept(self) -> "RadarConfig":
        if max(self.static_cycles, self.moving_cycles) > self.cycles:
            raise ValueError(f"cycles {self.cycles} are fewer than a hit needs")
        return self


class UltrasonicConfig(Config):
    """Confirmation of ultrasonic echoes."""

    window_s: Seconds = Field(description="longest time from the first to the last of three echoes that agree")
    gate_m: Metres
    max_object_speed_mps: Speed
    ground_ratio: float = Field(
        gt=0.0, le=1.0, description="of the range at which the axis meets the ground: greatest range used"
    )
    memory_s: Seconds
    dead_zone_margin_m: Metres
    dead_zone_hold_s: Seconds = Field(description="hold time of an echo that entered the dead zone")
    max_speed_kmh: Kmh = Field(description="above it echoes are not used")
    min_arc_ratio: float = Field(gt=0.0, le=1.0, description="of the arc that must lie in the swept area")
    track_match_m: Metres = Field(description="greatest distance from the arc of a lidar track that explains the echo")


class DockingConfig(Config):
    """Docking field in and before the shed, where walls lie within every other margin."""

    speed_kmh: float = Field(gt=0.0, le=1.8)
    ultrasonic_lost_kmh: float = Field(gt=0.0, le=1.8, description="with a failed ultrasonic sensor")
    shed_distance_m: Metres = Field(description="distance from the roof outline within which the docking field applies")
    margin_m: Metres
    arc_margin_m: Metres
    lateral_m: Metres
    known_structure_tolerance_m: Metres = Field(description="returns this near to a known surface belong to it")
    clearance_m: Metres = Field(description="distance from known surfaces beyond the pose uncertainty")
    sigmas: float = Field(ge=1.0, le=6.0)
    protection_stop_m: Metres
    max_uwb_age_s: Seconds


class BrakeTestConfig(Config):
    """Brake proof test within the first metre."""

    speed_kmh: float = Field(gt=0.5, le=5.0, description="highest speed before the test is passed")
    brake_kmh: float = Field(gt=0.2, le=5.0, description="speed at which the brake is tested")

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
    curvature_delay_s: Seconds = Field(description="time within which the steering follows its command")
    protection_alert_s: Seconds = Field(description="for which a level above the limit makes a fault; speed 0 at once")
    curvature_memory_s: Seconds = Field(description="in which the durations of deviations are summed")
    overspeed_mps: float = Field(gt=0.0, le=5.0, description="speed above what was commanded that is a fault")
    min_slowing_mps2: Acceleration = Field(
        description="deceleration expected of the machine when its command is lowered"
    )
    min_drive_ratio: float = Field(gt=0.0, lt=1.0, description="measured over commanded speed")
    min_brake_ratio: float = Field(gt=0.0, le=1.0, description="measured over commanded deceleration")
    max_group_age_s: Seconds = Field(description="maximum age of a group within the machine's state")
    clock_step_s: Seconds = Field(description="deviation from the period above which the clock has stepped")


class ModesConfig(Config):
    """Times of the mode machine."""

    start_warning_s: Seconds = Field(description="longer until the path was clear for `resume_clear_s`")
    resume_warning_s: Seconds
    resume_clear_s: Seconds
    resume_kmh: Kmh = Field(description="allowed speed required ahead before the machine resumes")
    standstill_mps: Speed
    creep_mps: Speed = Field(description="a lower allowed speed counts as 0")
    park_after_s: Seconds
    unsighted_s: Seconds = Field(description="at rest without sight, after which an operator confirms a start")
    max_pending_s: Seconds = Field(description="for which a start waits for its execution")
    fold_after_s: Seconds = Field(description="standstill before the implement folds")
    seat_empty_s: Seconds = Field(description="off-delay of the seat switch")
    max_confirmation_s: float = Field(gt=0.0, le=60.0, description="longest validity of a confirm_clear")
    authorities: tuple[str, ...] = Field(min_length=1)


class SafetyConfig(Config):
    """Configuration shared by the parts of the supervisor."""

    braking: BrakingConfig
    field: FieldConfig
    measured_ground: MeasuredGroundConfig
    near_field: NearFieldConfig
    vegetation: VegetationConfig
    airborne: AirborneConfig
    negative_obstacle: NegativeObstacleConfig
    departure: DepartureConfig
    detection_range: DetectionRangeConfig
    lidar_agreement: LidarAgreementConfig
    tracked: TrackedConfig
    bystanders: BystanderConfig
    standing_body: StandingBodyConfig
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
        """Copy with the docking field in place of the open field."""
        near = self.docking
        margins = {
            "margin_m": near.margin_m,
            "arc_margin_m": near.arc_margin_m,
            "lateral_margin_near_m": near.lateral_m,
            "lateral_margin_far_m": near.lateral_m,
        }
        return self.model_copy(update={"field": self.field.model_copy(update=margins)})
