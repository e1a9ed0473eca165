"""The node that says where the machine is: continuous in `odom` at every step, fused in `map_pose`."""

import math
from collections.abc import Iterable, Mapping

from pydantic import Field

from configs.site import PoseConfig, Shed
from configs.strict import Config
from configs.vehicle import Vehicle
from geometry.geodesy import Datum
from geometry.transforms import Float64
from localization.dead_reckoning.imu_track import InertialTrack
from localization.dead_reckoning.kernels import warm
from localization.dead_reckoning.plausibility import CODES
from localization.dead_reckoning.wheel_track import WheelTrack
from localization.dock_prior import Docked
from localization.faults import FAULTS
from localization.gnss_gate import Refusal, check, position_of
from localization.graph.imu_preintegration import bias_sigmas
from localization.graph.keyframes import Fusion
from localization.lidar.lidar_odometry import LidarOdometryConfig
from localization.lidar.map_localization import LIDAR_POSE, LidarMapConfig
from localization.map_alignment import Placement, PlacementConfig
from localization.odometry import Motion, MotionConfig
from localization.uwb.range_gate import Ranging
from messages.errors import ConfigError
from messages.fault_reporter import FaultReporter
from messages.motion import LidarLocalization, LidarOdometry
from messages.node import All, Every, Inbox, Node, Output, Read
from messages.sensors import GnssFix, ImuSample, UwbRanges, WheelSample

IMU, WHEEL, GNSS, LIDAR_MOTION = "imu", "wheel", "gnss/main", "lidar_odometry/front"


class LocalizationConfig(Config):
    """Section `localization` of the stack's configuration."""

    period_s: float = Field(ge=0.005, le=0.1)
    pose_period_s: float = Field(ge=0.02, le=1.0)
    oldest_s: float = Field(gt=0.0, le=5.0, description="a sample older than this on arrival is dropped")
    newest_s: float = Field(ge=0.0, le=1.0, description="a sample this far in the future is dropped")
    gnss_silent_s: float = Field(gt=0.0, le=10.0)
    motion: MotionConfig
    placement: PlacementConfig
    lidar_odometry: LidarOdometryConfig
    lidar_map: LidarMapConfig


class Localizer(Node):
    """Fuses GNSS, inertial unit, wheels, UWB and lidars; `odom` stops when inertial unit or wheels are silent.

    `start` is the surveyed pose at which the machine was left; it is believed once UWB ranges agree with it.
    """

    def __init__(
        self, vehicle: Vehicle, datum: Datum, config: LocalizationConfig, shed: Shed | None = None,
        start: PoseConfig | None = None,
    ) -> None:  # fmt: skip
        if "main" not in vehicle.sensors.gnss or vehicle.sensors.imu is None:
            raise ConfigError(f"vehicle {vehicle.name!r}: the localizer needs sensors.gnss.main and sensors.imu")
        self.name = "localizer"
        self.reads: Mapping[str, Read] = {IMU: All(200), WHEEL: All(100), GNSS: All(20)}
        if "front" in vehicle.sensors.lidar:
            self.reads = {**self.reads, LIDAR_MOTION: All(20), LIDAR_POSE: All(20)}
        tags = vehicle.sensors.uwb if shed is not None and shed.anchors else {}
        self._uwb = tuple(f"uwb/{tag}" for tag in tags)
        self.reads = {**self.reads, **dict.fromkeys(self._uwb, All(20))}
        self.writes = ("odom", "map_pose", "fault/localizer")
        self.runs = Every(round(config.period_s * 1e9))
        self._config, self._datum = config, datum
        warm()
        self._gnss_rate_hz = vehicle.sensors.gnss["main"].rate_hz
        self._gyro_bias_sigma = bias_sigmas(vehicle.sensors.imu)[1]
        place, gravity_at = config.placement, (datum.latitude_rad, datum.height_m)
        self._motion = Motion(vehicle, config.motion, place.alignment)
        self._ranging = Ranging(place.ranging, tags, shed.anchors) if shed is not None and tags else None
        fusion = Fusion(
            vehicle,
            gravity_at,
            config.motion.inertial,
            config.motion.wheels,
            place.gnss,
            place.smoother,
            place.alignment,
            place.sighting,
            self._ranging,
        )
        self._placement = Placement(place, fusion, self._motion, Docked(start, shed, place.docked))
        self._faults = FaultReporter(self.name)
        self._now_ns: int | None = None
        self._gnss_ns: int | None = None
        self._posed_ns: int | None = None
        self._gap_s: float | None = None
        self._was_lost = False
        self.dropped = 0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Takes what came, goes on, says where the machine is."""
        self._follow_clock(now_ns)
        self._take(now_ns, inbox)
        if len(self._motion.track):
            self._advance()
        self._watch(now_ns)
        outputs: list[Output] = [("fault/localizer", fault) for fault in self._faults.take(now_ns)]
        return [*self._poses(now_ns), *outputs]

    def _follow_clock(self, now_ns: int) -> None:
        """Forgets stamps when time itself jumps; a leap of more than a second cannot be told from a pause."""
        previous, self._now_ns = self._now_ns, now_ns
        if previous is None or 0 <= now_ns - previous <= 1_000_000_000:
            return
        gap_s = max(0.1, (now_ns - previous) * 1e-9)
        self._faults.report_event(FAULTS["clock.jumped"], f"{(now_ns - previous) * 1e-9:+.3f} s")
        self._forget_time(gap_s)
        self._gnss_ns = self._posed_ns = None

    def _forget_time(self, gap_s: float) -> None:
        self._gap_s = gap_s if self._gap_s is None else self._gap_s + gap_s
        self._motion.forget_time()
        self._placement.forget_time()

    def _take(self, now_ns: int, inbox: Inbox) -> None:
        before = self.dropped
        for wheel in inbox.all(WHEEL, WheelSample):
            self.dropped += not (self._is_timely(wheel.stamp_ns, now_ns) and self._motion.add_wheels(wheel))
        for sample in inbox.all(IMU, ImuSample):
            self.dropped += not (self._is_timely(sample.stamp_ns, now_ns) and self._add_inertial(sample))
        for fix in inbox.all(GNSS, GnssFix):
            self.dropped += not (self._is_timely(fix.stamp_ns, now_ns) and self._add_fix(fix))
        if LIDAR_MOTION in self.reads:
            for motion in inbox.all(LIDAR_MOTION, LidarOdometry):
                self._placement.link.add(motion)
            for pose in inbox.all(LIDAR_POSE, LidarLocalization):
                self._placement.sightings.add(pose)
        for topic in self._uwb:
            for heard in inbox.all(topic, UwbRanges):
                self.dropped += not (self._is_timely(heard.stamp_ns, now_ns) and self._add_ranges(heard))
        self._faults.set(FAULTS["localization.garbage"], self.dropped > before, f"{self.dropped} in all")

    def _is_timely(self, stamp_ns: int, now_ns: int) -> bool:
        return -self._config.oldest_s * 1e9 <= stamp_ns - now_ns <= self._config.newest_s * 1e9

    def _add_inertial(self, sample: ImuSample) -> bool:
        track = self._motion.track
        if len(track) and sample.stamp_ns - track.last_ns > self._config.motion.inertial.largest_gap_s * 1e9:
            self._forget_time((sample.stamp_ns - track.last_ns) * 1e-9)
        return self._motion.add_inertial(sample)

    def _add_ranges(self, heard: UwbRanges) -> bool:
        return self._ranging is not None and self._ranging.add(heard)

    def _add_fix(self, fix: GnssFix) -> bool:
        self._gnss_ns = fix.stamp_ns
        refusal = check(fix, self._config.placement.gnss)
        if refusal is not Refusal.NONE:
            return refusal is not Refusal.GARBAGE
        position = position_of(fix, self._datum, self._config.placement.gnss, self._gnss_rate_hz)
        self._motion.standstill.add(position)
        self._motion.plausibility.refer(fix.stamp_ns, position.heading_rad, self._ground_mps(fix, position.heading_rad))
        if self._placement.is_initialized:
            self._placement.add(position)
        return True

    def _ground_mps(self, fix: GnssFix, heading_rad: float) -> float:
        """Speed over ground, backwards below 0: by the two antennas where they tell the heading, else by the wheels."""
        east_mps, north_mps = fix.velocity_enu_mps[:2].tolist()
        forward_mps = east_mps * math.cos(heading_rad) + north_mps * math.sin(heading_rad)
        sign = forward_mps if math.isfinite(forward_mps) else self._motion.speed_mps
        return math.copysign(math.hypot(east_mps, north_mps), sign)

    def _advance(self) -> None:
        motion, placement = self._motion, self._placement
        if motion.reckoning is None:
            level = motion.level()
            if level is None:
                return
            motion.begin(level)
        elif self._gap_s is not None:
            motion.resume()
            placement.resume(self._gap_s, motion.speed_mps)
        self._gap_s = None
        motion.advance()
        if placement.is_initialized:
            placement.advance()
        else:
            placement.start()
        self._was_lost |= placement.is_initialized

    def _watch(self, now_ns: int) -> None:
        """Sets the faults."""
        motion, faults = self._motion, self._faults
        faults.set(
            FAULTS["imu.silent"], self._is_silent(motion.track, now_ns, self._config.motion.inertial.largest_gap_s)
        )
        faults.set(
            FAULTS["wheel.silent"], self._is_silent(motion.wheels, now_ns, self._config.motion.wheels.largest_gap_s)
        )
        if faults.is_active("imu.silent") or faults.is_active("wheel.silent"):
            motion.plausibility.clear()
        doubt = motion.plausibility.judge(now_ns)
        for code in CODES:
            faults.set(FAULTS[code], doubt is not None and doubt.code == code, "" if doubt is None else doubt.detail)
        gnss_ns = self._gnss_ns if self._gnss_ns is not None else -(2**62)
        faults.set(FAULTS["gnss.silent"], now_ns - gnss_ns > self._config.gnss_silent_s * 1e9)
        faults.set(FAULTS["gnss.refused"], self._placement.is_refusing, "contradict the prediction")
        is_lost = self._was_lost and not self._placement.is_initialized
        faults.set(FAULTS["localization.lost"], is_lost)
        # far from the shed few ranges come through, and beside good fixes nobody needs them
        is_needed = faults.is_active("gnss.silent") or faults.is_active("gnss.refused")
        faults.set(FAULTS["uwb.refused"], is_needed and self._ranging is not None and self._ranging.is_refusing)
        reason = "" if self._placement.is_initialized else self._placement.doubt
        faults.set(FAULTS["localization.not_docked"], bool(reason), reason)
        faults.set(FAULTS["gnss.no_heading"], not self._placement.is_initialized and motion.standstill.lacks_heading)
        for failure in self._placement.failures:
            faults.report_event(FAULTS["localization.rebuilt"], failure)
        self._placement.failures.clear()

    def _poses(self, now_ns: int) -> list[Output]:
        motion = self._motion
        if motion.reckoning is None or self._faults.is_active("imu.silent") or self._faults.is_active("wheel.silent"):
            return []
        out: list[Output] = [("odom", motion.odometry(*self._calibration_sigmas()))]
        period_ns = round(self._config.pose_period_s * 1e9)
        if self._posed_ns is None or now_ns - self._posed_ns >= period_ns:
            self._posed_ns = now_ns
            out.append(("map_pose", self._placement.pose()))
        return out

    def _calibration_sigmas(self) -> tuple[float, Float64]:
        state = self._placement.state
        wheels = self._config.motion.wheels
        if state is None:
            return self._gyro_bias_sigma, wheels.start_sigma
        return float(state.sigmas[14]), state.sigmas[15:19]

    @staticmethod
    def _is_silent(track: InertialTrack | WheelTrack, now_ns: int, largest_gap_s: float) -> bool:
        return len(track) == 0 or now_ns - track.last_ns > largest_gap_s * 1e9
