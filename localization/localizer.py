"""Localizer node: continuous pose in `odom` at every step, fused pose in `map_pose`."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from configs.site import PoseConfig, Shed
from configs.vehicle import Vehicle
from geometry.arrays import Float64
from geometry.geodesy import Datum
from localization.config import LocalizationConfig
from localization.dead_reckoning.imu_track import ImuTrack
from localization.dead_reckoning.kernels import warm_up
from localization.dead_reckoning.plausibility import CODES
from localization.dead_reckoning.wheel_track import WheelTrack
from localization.dock_prior import DockPrior
from localization.faults import FAULTS
from localization.gnss_gate import Position, RejectionReason, check, position_of, repeats
from localization.gnss_monitor import ODOMETRY, VELOCITY
from localization.graph.imu_preintegration import bias_sigmas
from localization.graph.keyframes import KeyframeBuilder
from localization.lidar.map_localization import LIDAR_LOCALIZATION
from localization.map_alignment import MapAlignment
from localization.odometry import OdometryEstimator
from localization.uwb.range_gate import RangeGate
from messages.errors import ConfigError
from messages.fault_reporter import FaultReporter
from messages.motion import LidarLocalization, LidarOdometry
from messages.node import All, Every, Inbox, Node, Output, Read
from messages.sensors import GnssFix, ImuSample, UwbRanges, WheelSample
from messages.topics import spec_of

IMU, WHEEL = "imu", "wheel"
LONG_AGO_NS = -(2**62)


class Localizer(Node):
    """Fuses GNSS, IMU, wheels, UWB and lidars; writes no `odom` while IMU or wheels give no data.

    `start` is the surveyed pose at which the machine was parked; it is used once UWB ranges confirm it.
    """

    def __init__(
        self, vehicle: Vehicle, datum: Datum, config: LocalizationConfig, shed: Shed | None = None,
        start: PoseConfig | None = None,
    ) -> None:  # fmt: skip
        receiver = config.map_alignment.gnss.sensor
        if receiver not in vehicle.sensors.gnss or vehicle.sensors.imu is None:
            raise ConfigError(f"vehicle {vehicle.name!r}: the localizer needs sensors.gnss.{receiver} and sensors.imu")
        self.name = "localizer"
        tags = vehicle.sensors.uwb if shed is not None and shed.anchors else {}
        self._uwb = tuple(f"uwb/{tag}" for tag in tags)
        sensor = config.lidar_odometry.sensor
        self._lidar_odometry, self._gnss = f"lidar_odometry/{sensor}", f"gnss/{receiver}"
        self.reads: Mapping[str, Read] = {IMU: All(200), self._gnss: All(20)}
        self._has_wheels = vehicle.sensors.wheels is not None
        if self._has_wheels:
            self.reads = {IMU: All(200), WHEEL: All(100), self._gnss: All(20)}
        if sensor in vehicle.sensors.lidar:
            self.reads = {**self.reads, self._lidar_odometry: All(20)}
        if vehicle.sensors.lidar:
            self.reads = {**self.reads, LIDAR_LOCALIZATION: All(20)}
        self.reads = {**self.reads, **dict.fromkeys(self._uwb, All(20))}
        self.writes = ("odom", "map_pose", "fault/localizer")
        self.runs = Every(round(config.period_s * 1e9))
        self._config, self._datum = config, datum
        warm_up()
        self._gnss_rate_hz = vehicle.sensors.gnss[receiver].rate_hz
        self._gyro_bias_sigma = bias_sigmas(vehicle.sensors.imu)[1]
        alignment, gravity_at = config.map_alignment, (datum.latitude_rad, datum.height_m)
        self._odometry = OdometryEstimator(vehicle, config.odometry, alignment.initial_alignment)
        self._range_gate = RangeGate(alignment.range_gate, tags, shed.anchors) if shed is not None and tags else None
        keyframes = KeyframeBuilder(
            vehicle,
            gravity_at,
            config.odometry.imu,
            config.odometry.wheels,
            alignment.gnss,
            alignment.smoother,
            alignment.initial_alignment,
            alignment.pose_measurement,
            self._range_gate,
        )
        dock_prior = DockPrior(start, shed, alignment.dock_prior)
        motion_start = keyframes.motion_start(alignment.motion_start, vehicle.sensors.imu, config.odometry.imu)
        has_lidar = LIDAR_LOCALIZATION in self.reads
        self._map_alignment = MapAlignment(alignment, keyframes, self._odometry, dock_prior, motion_start, has_lidar)
        self._faults = FaultReporter(self.name)
        self._now_ns: int | None = None
        self._first_ns = 0  # silence before the first sample counts from here
        self._gnss_ns: int | None = None
        self._last_fix: GnssFix | None = None
        self._lidar_odometry_ns: int | None = None
        self._lidar_localization_ns: int | None = None
        self._pose_ns: int | None = None
        self._gap_s: float | None = None
        self._was_initialized = False
        self._dropped = dict.fromkeys((IMU, WHEEL, "gnss", "uwb"), 0)
        self._refused: Counter[RejectionReason] = Counter()

    @property
    def dropped(self) -> int:
        """Number of samples with invalid values or stamps."""
        return sum(self._dropped.values())

    @property
    def fixes(self) -> Counter[RejectionReason]:
        """Number of fixes by what became of them; NONE: in the graph."""
        return self._refused + self._map_alignment.fixes

    @property
    def imu_ns(self) -> int | None:
        """Stamp of the newest IMU sample that was taken, None before the first and after a gap."""
        track = self._odometry.track
        return track.last_ns if len(track) else None

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Takes new measurements, integrates to the newest IMU sample and writes poses and faults."""
        self._check_clock(now_ns)
        self._take(now_ns, inbox)
        if len(self._odometry.track):
            self._advance()
        self._update_faults(now_ns)
        outputs: list[Output] = [("fault/localizer", fault) for fault in self._faults.take(now_ns)]
        return [*self._poses(now_ns), *outputs]

    def _check_clock(self, now_ns: int) -> None:
        """Drops all stamps when the clock jumps; a jump of more than 1 s cannot be distinguished from a pause."""
        previous, self._now_ns = self._now_ns, now_ns
        if previous is None:
            self._first_ns = now_ns
        if previous is None or 0 <= now_ns - previous <= 1_000_000_000:
            return
        gap_s = max(0.1, (now_ns - previous) * 1e-9)
        self._faults.report_event(FAULTS["clock.jumped"], f"{(now_ns - previous) * 1e-9:+.3f} s")
        self._clear_samples(gap_s)
        self._gnss_ns = self._pose_ns = self._lidar_odometry_ns = self._lidar_localization_ns = None
        self._first_ns = LONG_AGO_NS

    def _clear_samples(self, gap_s: float) -> None:
        self._gap_s = gap_s if self._gap_s is None else self._gap_s + gap_s
        self._odometry.clear_samples()
        self._map_alignment.clear_measurements()

    def _take(self, now_ns: int, inbox: Inbox) -> None:
        before = self._dropped.copy()
        for wheel in inbox.all(WHEEL, WheelSample) if self._has_wheels else ():
            self._dropped[WHEEL] += not (self.is_timely(wheel.stamp_ns, now_ns) and self._odometry.add_wheels(wheel))
        for sample in inbox.all(IMU, ImuSample):
            self._dropped[IMU] += not (self.is_timely(sample.stamp_ns, now_ns) and self._add_imu(sample))
        for fix in inbox.all(self._gnss, GnssFix):
            self._dropped["gnss"] += not self._add_fix(fix, now_ns)
        if self._lidar_odometry in self.reads:
            for motion in inbox.all(self._lidar_odometry, LidarOdometry):
                self._lidar_odometry_ns = now_ns
                self._map_alignment.add_lidar_odometry(motion)
        if LIDAR_LOCALIZATION in self.reads:
            for pose in inbox.all(LIDAR_LOCALIZATION, LidarLocalization):
                self._lidar_localization_ns = now_ns
                self._map_alignment.pose_measurements.add(pose)
        for topic in self._uwb:
            for ranges in inbox.all(topic, UwbRanges):
                self._dropped["uwb"] += not (self.is_timely(ranges.stamp_ns, now_ns) and self._add_ranges(ranges))
        for kind in before:
            self._faults.set(
                FAULTS[f"{kind}.invalid"], self._dropped[kind] > before[kind], f"{self._dropped[kind]} in total"
            )

    def is_timely(self, stamp_ns: int, now_ns: int) -> bool:
        """Whether a stamp is near enough to the time of arrival."""
        return -self._config.max_sample_age_s * 1e9 <= stamp_ns - now_ns <= self._config.max_sample_lead_s * 1e9

    def _add_imu(self, sample: ImuSample) -> bool:
        track = self._odometry.track
        if not track.is_valid(sample):
            return False  # a gap lasts until the next valid one
        if len(track) and sample.stamp_ns - track.last_ns > self._config.odometry.imu.max_gap_s * 1e9:
            self._clear_samples((sample.stamp_ns - track.last_ns) * 1e-9)
        return self._odometry.add_imu(sample)

    def _add_ranges(self, ranges: UwbRanges) -> bool:
        return self._range_gate is not None and self._range_gate.add(ranges)

    def _add_fix(self, fix: GnssFix, now_ns: int) -> bool:
        config = self._config.map_alignment.gnss
        is_timely = self.is_timely(fix.stamp_ns, now_ns)
        reason = check(fix, config) if is_timely else RejectionReason.STAMP
        last, self._last_fix = self._last_fix, fix
        is_rolling = abs(self._odometry.speed_mps) > self._config.odometry.wheels.standstill_mps
        if reason is RejectionReason.NONE and is_rolling and last is not None and repeats(fix, last):
            reason = RejectionReason.REPEATED
        elif is_timely:
            self._gnss_ns = fix.stamp_ns
        if reason is not RejectionReason.NONE:
            self._refused[reason] += 1
            return reason not in (RejectionReason.INVALID, RejectionReason.STAMP)
        position = position_of(fix, self._datum, config, self._gnss_rate_hz)
        self._odometry.standstill.add(position)
        is_wrong = self._map_alignment.monitor.is_velocity_wrong(fix.stamp_ns)
        speed_mps = math.nan if is_wrong else self._ground_speed_mps(position)
        if self._has_wheels:
            self._odometry.plausibility.set_reference(fix.stamp_ns, position.heading_rad, speed_mps)
        self._map_alignment.add(position)
        return True

    def _ground_speed_mps(self, fix: Position) -> float:
        """Speed over ground, negative in reverse: sign by the GNSS heading where there is one, else by the wheels."""
        east_mps, north_mps = fix.velocity_mps[:2].tolist()
        forward_mps = east_mps * math.cos(fix.heading_rad) + north_mps * math.sin(fix.heading_rad)
        sign = forward_mps if math.isfinite(forward_mps) else self._odometry.speed_mps
        return math.copysign(math.hypot(east_mps, north_mps), sign)

    def _advance(self) -> None:
        odometry, alignment = self._odometry, self._map_alignment
        unmeasured_s = odometry.plausibility.imu.take_unmeasured_s()
        if unmeasured_s > 0.0:
            alignment.motion_start.clear()
        if odometry.dead_reckoning is None:
            tilt = odometry.tilt()
            if tilt is not None:
                odometry.start(tilt)
            elif not alignment.start():
                return
        elif self._gap_s is not None:
            odometry.resume()
            alignment.resume(self._gap_s)
        self._gap_s = None
        odometry.advance()
        if unmeasured_s > 0.0:
            alignment.widen(unmeasured_s, np.eye(4))
        if alignment.is_initialized:
            alignment.advance()
        else:
            alignment.start()
        self._was_initialized |= alignment.is_initialized

    def _update_faults(self, now_ns: int) -> None:
        odometry, alignment, faults = self._odometry, self._map_alignment, self._faults
        imu_gap_s, wheel_gap_s = self._config.odometry.imu.max_gap_s, self._config.odometry.wheels.max_gap_s
        faults.set(FAULTS["imu.silent"], self._is_silent(odometry.track, now_ns, imu_gap_s))
        is_silent = self._has_wheels and self._is_silent(odometry.wheels, now_ns, wheel_gap_s)
        faults.set(FAULTS["wheel.silent"], is_silent)
        if faults.is_active("imu.silent") or faults.is_active("wheel.silent"):
            odometry.plausibility.clear()
        suspicion = odometry.plausibility.evaluate(now_ns)
        for code in CODES:
            is_suspected = suspicion is not None and suspicion.code == code
            faults.set(FAULTS[code], is_suspected, "" if suspicion is None else suspicion.detail)
        gnss_ns = self._gnss_ns if self._gnss_ns is not None else self._first_ns
        faults.set(FAULTS["gnss.silent"], now_ns - gnss_ns > self._config.gnss_timeout_s * 1e9)
        for topic, last_ns in (
            (self._lidar_odometry, self._lidar_odometry_ns), (LIDAR_LOCALIZATION, self._lidar_localization_ns)
        ):  # fmt: skip
            gap_s = 2.0 * spec_of(topic).max_age_s  # lidars at 2.5 Hz may lose a scan
            is_silent = last_ns is not None and abs(now_ns - last_ns) > gap_s * 1e9
            faults.set(FAULTS[f"{topic.partition('/')[0]}.silent"], is_silent)
        faults.set(FAULTS["gnss.refused"], alignment.is_refusing, "contradict the prediction")
        for code in (VELOCITY, ODOMETRY):
            faults.set(FAULTS[code], alignment.monitor.suspicion == code, alignment.monitor.detail)
        faults.set(FAULTS["gnss.velocity_refused"], alignment.monitor.is_velocity_wrong(now_ns))
        is_turned = alignment.keyframes.headings_refused >= self._config.map_alignment.gnss_monitor.refused_fixes
        faults.set(FAULTS["gnss.heading_refused"], alignment.is_initialized and is_turned)
        faults.set(FAULTS["wheel.slipping"], alignment.monitor.is_slipping)
        faults.set(FAULTS["localization.lost"], self._was_initialized and not alignment.is_initialized)
        # far from the shed few ranges are received, and beside good fixes they are not needed
        is_needed = faults.is_active("gnss.silent") or faults.is_active("gnss.refused")
        faults.set(FAULTS["uwb.refused"], is_needed and self._range_gate is not None and self._range_gate.is_rejecting)
        reason = "" if alignment.is_initialized else alignment.dock_rejection
        faults.set(FAULTS["localization.not_docked"], bool(reason), reason)
        lacks_heading = not alignment.is_initialized and odometry.standstill.lacks_heading
        faults.set(FAULTS["gnss.no_heading"], lacks_heading, alignment.motion_start.awaited)
        is_moving = len(odometry.track) > 0 and odometry.standstill.since_ns is None
        awaited = self.awaited if is_moving or odometry.standstill.obstacle else ""
        faults.set(FAULTS["localization.awaits"], bool(awaited), awaited)
        for failure in alignment.failures:
            faults.report_event(FAULTS["localization.rebuilt"], failure)
        alignment.failures.clear()

    @property
    def awaited(self) -> str:
        """What the start awaits, "" while the position is known."""
        alignment, standstill = self._map_alignment, self._odometry.standstill
        if alignment.is_initialized:
            return ""
        if not len(self._odometry.track):
            return "IMU samples"
        if standstill.obstacle:
            return "; ".join(filter(None, (standstill.obstacle, alignment.motion_start.awaited)))
        if self._gnss_ns is None:
            return "GNSS fixes"
        is_waiting = standstill.since_ns is not None and standstill.position() is None and not standstill.lacks_heading
        return "fixes at standstill" if is_waiting else alignment.motion_start.awaited or "fixes"

    def _poses(self, now_ns: int) -> list[Output]:
        is_silent = self._faults.is_active("imu.silent") or self._faults.is_active("wheel.silent")
        if self._odometry.dead_reckoning is None or is_silent:
            return []
        out: list[Output] = [("odom", self._odometry.message(*self._calibration_sigmas()))]
        period_ns = round(self._config.pose_period_s * 1e9)
        if self._pose_ns is None or now_ns - self._pose_ns >= period_ns:
            self._pose_ns = now_ns
            out.append(("map_pose", self._map_alignment.pose()))
        return out

    def _calibration_sigmas(self) -> tuple[float, Float64]:
        state = self._map_alignment.state
        if state is None:
            return self._gyro_bias_sigma, self._config.odometry.wheels.start_sigma
        return float(state.sigmas[14]), state.sigmas[15:19]

    def _is_silent(self, track: ImuTrack | WheelTrack, now_ns: int, max_gap_s: float) -> bool:
        return now_ns - (track.last_ns if len(track) else self._first_ns) > max_gap_s * 1e9
