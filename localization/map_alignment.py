"""Map alignment: the transform from `odom` to `map`, from the newest keyframe of the graph."""

import math
from collections import Counter, deque
from dataclasses import replace

import numpy as np

from geometry.arrays import Float64
from geometry.transforms import invert, planar, yaw_of
from localization.config import MapAlignmentConfig
from localization.dead_reckoning.dead_reckoning import Calibration
from localization.dead_reckoning.wheel_track import WheelTrack
from localization.dock_prior import DockPrior
from localization.gnss_gate import Position, RejectionReason, propagate
from localization.gnss_monitor import VELOCITY, GnssMonitor
from localization.graph.keyframes import KeyframeBuilder, Velocity
from localization.graph.motion_start import MotionStart
from localization.graph.smoother import SmootherFailure, State
from localization.integrity import (
    BY_GNSS,
    accuracy_and_level,
    excluded,
    output_covariance,
    position_source,
    slow_part,
)
from localization.lidar.odometry_spans import OdometrySpans, motion_between
from localization.lidar.pose_measurement import PoseMeasurements
from localization.odometry import OdometryEstimator
from localization.separation import Separation, Swing
from messages.motion import LidarOdometry, MapPose, PositionSource
from messages.sensors import GnssSolution

SWING_NS = 10_000_000  # two samples of 100 Hz: a body on its tyres turns evenly in that time
REST_MPS = 0.05  # before and after a gap: the machine has not moved
SEARCH_NS = 5_000_000_000  # standstill without an answer of the lidars, after which it is reported as missing


class MapAlignment:
    """Owns the graph and derives `T_map_odom` from its newest keyframe."""

    def __init__(
        self, config: MapAlignmentConfig, keyframes: KeyframeBuilder, odometry: OdometryEstimator,
        dock_prior: DockPrior, motion_start: MotionStart, has_lidar: bool,
    ) -> None:  # fmt: skip
        self._config, self._odometry, self._dock_prior = config, odometry, dock_prior
        self.keyframes, self._has_lidar = keyframes, has_lidar
        self.odometry_spans = OdometrySpans(config.odometry_spans)
        self.pose_measurements = PoseMeasurements(config.pose_measurement)
        self.monitor = GnssMonitor(config.gnss_monitor, keyframes.separation(config.gnss_monitor.separation))
        self.motion_start = motion_start
        self._queue: deque[Position] = deque()
        self._pending: list[Position] = []
        self._T_map_odom = np.eye(4)
        self._accepted: Position | None = None
        self._accepted_ns = self._rejected_ns = 0
        self._late_m = 0.0  # what late or early stamps did to the newest accepted fix
        self._rejected_since_ns: int | None = None
        self._failed_ns: int | None = None
        self._taken_ns: int | None = None  # newest fix since the start
        self._accuracy_m = math.inf  # of the newest pose
        self._apart_m = 0.0  # of base from the position by the newest fix
        self.is_initialized = False
        self.failures: list[str] = []
        self.dock_rejection, self._was_initialized = "", False
        self._rejected_in_row = 0
        self.is_refusing = False  # not the first fixes after an outage, which are awaited until they agree
        self.fixes: Counter[RejectionReason] = Counter()  # by what became of them

    @property
    def state(self) -> State | None:
        """The newest keyframe, None before the start."""
        return self.keyframes.smoother.state if self.is_initialized else None

    @property
    def is_rejecting(self) -> bool:
        """Whether the newest fixes have been rejected."""
        return self._rejected_since_ns is not None

    def add_lidar_odometry(self, motion: LidarOdometry) -> None:
        """Takes a motion between two scans."""
        self.odometry_spans.add(motion)
        self.monitor.odometry.lidar.add(motion, self._odometry.history)

    def add(self, position: Position) -> None:
        """Queues a fix until IMU samples reach its stamp; ignores fixes beside the shed while UWB is available.

        One that is older than the newest keyframe waits for the next; one that is not newer than the last is dropped.
        Before the start, and while fixes are rejected, they go to the window of a start in motion.
        """
        if not self.is_initialized or self.is_rejecting:
            self.motion_start.window.add(position)
        if not self.is_initialized:
            self.fixes[RejectionReason.BEFORE_START] += 1
            return
        if self._is_uwb_active(position.stamp_ns) and self._dock_prior.has_sky_obstruction(position.p_map_m):
            self.fixes[RejectionReason.SHED] += 1
            return
        if self._taken_ns is not None and position.stamp_ns <= self._taken_ns:
            self.fixes[RejectionReason.LATE] += 1
            return
        self._taken_ns = position.stamp_ns
        self._queue.append(position)

    def _newest_ns(self) -> int:
        state = self.state
        return state.stamp_ns if state is not None else -(2**63)

    def clear_measurements(self) -> None:
        """Drops queued measurements after a gap or clock jump."""
        self._drop_queued()
        self._taken_ns = None
        self.odometry_spans.clear()
        self.pose_measurements.clear()
        self.monitor.interrupt()
        self.motion_start.clear()
        if self.keyframes.range_gate is not None:
            self.keyframes.range_gate.clear()
        self._end_rejection()

    def _drop_queued(self) -> None:
        self.fixes[RejectionReason.LATE] += len(self._queue) + len(self._pending)
        self._queue.clear()
        self._pending.clear()

    def start(self) -> bool:
        """Starts at standstill: at the dock when ranges confirm it, else from fixes with heading; else in motion.

        The dock is used for the first start only; afterwards the machine may be anywhere. With lidars the pose at the
        dock is the one that they find in the shed, without any it is the surveyed one.
        """
        self.motion_start.window.advance(self._odometry.track, self._wheels)
        try:
            self.is_initialized = (
                (not self._was_initialized and self._start_at_dock())
                or self._start_from_gnss()
                or self._start_in_motion()
            )
        except SmootherFailure as failure:
            self.failures.append(str(failure))
        self.monitor.clear()
        if self.is_initialized:
            self.motion_start.clear()
            self._taken_ns = self._newest_ns()
            self._drop_queued()  # before the position was lost
        self._was_initialized |= self.is_initialized
        return self.is_initialized

    def _start_at_dock(self) -> bool:
        odometry, range_gate = self._odometry, self.keyframes.range_gate
        tilt, still_ns, stamp_ns = odometry.tilt(), odometry.standstill.since_ns, odometry.track.last_ns
        if range_gate is None or self._dock_prior.start is None or tilt is None or still_ns is None:
            return False
        T_base_body = self.keyframes.lever_arms.T_base_body
        tilt_sigma = math.hypot(math.radians(self._config.initial_alignment.tilt_sigma_deg), tilt.sigma_rad)
        sigmas, T_map_base = self._dock_prior.sigmas(tilt_sigma), self._dock_prior.pose(tilt)
        if self._has_lidar:
            found = self.pose_measurements.newest
            if found is None or found.stamp_ns < still_ns:
                is_late = stamp_ns - still_ns > SEARCH_NS
                self.dock_rejection = "no lidar scans" if is_late else ""
                return False
            if not found.is_valid:
                self.dock_rejection = found.reason
                return False
            sigmas, T_map_base = self._dock_prior.sigmas_of(found, tilt_sigma), found.T_map_base
        T = T_map_base @ T_base_body
        batch = range_gate.mean_since(still_ns, invert(T_base_body))
        if batch is None:
            self.dock_rejection = "no UWB ranges"
            return False
        self.dock_rejection = range_gate.disagreement(batch, T, np.diag(sigmas**2))
        if self.dock_rejection or odometry.history.at(stamp_ns) is None:
            return False
        range_gate.start(stamp_ns, batch, T)
        self.pose_measurements.clear()
        self._align(self.keyframes.start_at(stamp_ns, tilt, T, np.diag(sigmas**2)))
        return True

    def _start_from_gnss(self) -> bool:
        standstill, tilt = self._odometry.standstill, self._odometry.tilt()
        position, newest = standstill.position(), standstill.newest
        if tilt is None or position is None or newest is None:
            return False
        stamp_ns = max(newest.stamp_ns, self._odometry.track.first_ns)
        if stamp_ns > self._odometry.track.last_ns or self._odometry.history.at(stamp_ns) is None:
            return False
        self.keyframes.gnss_gate.trust(newest)
        self._align(self.keyframes.start(stamp_ns, tilt, position))
        self._accept(newest)
        return True

    @property
    def _wheels(self) -> WheelTrack | None:
        return self._odometry.wheels if self._odometry.inertial is None else None

    def _start_in_motion(self) -> bool:
        """Starts at the newest fix of a window that proves pose and heading; `odom` begins there if it has not."""
        odometry, newest = self._odometry, next(iter(reversed(self.motion_start.window.fixes)), None)
        state = self.motion_start.state()
        if state is None or newest is None:
            return False
        if odometry.dead_reckoning is None:
            T_map_base = state.T_map_body @ invert(self.keyframes.lever_arms.T_base_body)
            odometry.start_in_motion(state.stamp_ns, T_map_base, Calibration(state.bias[3:], state.slip))
        if odometry.history.at(state.stamp_ns) is None:
            return False
        self.keyframes.gnss_gate.trust(newest)
        self._align(self.keyframes.restart(state))
        self._accept(newest)
        return True

    def resume(self, gap_s: float) -> bool:
        """Continues after a gap at the newest IMU sample, with a larger covariance; False when the gap is too long."""
        if self._odometry.gap_speed_mps > REST_MPS and gap_s > self._config.max_bridge_s:
            self.is_initialized = False
        return self.widen(gap_s, self._odometry.motion_in_gap(gap_s))

    def widen(self, gap_s: float, T_before_now: Float64) -> bool:
        """Continues at the newest IMU sample after a time without measurements, in which base has moved as assumed."""
        state, cfg = self.state, self._config
        if state is None:
            return False
        speed_mps, most_mps = self._odometry.speed_mps, self._odometry.gap_speed_mps
        turn_rad = cfg.resume_turn_radps * (gap_s if most_mps > REST_MPS else min(gap_s, 1.0))
        by_speed_mps = cfg.resume_speed_ratio * most_mps
        tilt_rad = min(turn_rad, cfg.resume_turn_radps)  # by the ground, which goes on as it was
        added_sigmas = np.array([tilt_rad, tilt_rad, turn_rad, *np.full(3, by_speed_mps * gap_s)]) + 1e-3
        T = self._T_map_odom @ self._odom_now() @ T_before_now @ self.keyframes.lever_arms.T_base_body
        velocity = T[:3, 0] * speed_mps
        sigmas = state.sigmas.copy()
        sigmas[6:9] = np.maximum(sigmas[6:9], max(0.2, by_speed_mps))
        resumed = replace(
            state, stamp_ns=self._odometry.stamp_ns, T_map_body=T, velocity_mps=velocity,
            covariance=state.covariance + np.diag(added_sigmas**2), sigmas=sigmas,
        )  # fmt: skip
        return self._restart(resumed)

    def _odom_now(self) -> Float64:
        dead_reckoning = self._odometry.dead_reckoning
        assert dead_reckoning is not None, "odometry starts before map alignment"
        return dead_reckoning.T_odom_base

    def advance(self) -> None:
        """Adds the keyframes that the samples received so far allow."""
        cfg, end_ns = self._config.smoother, self._odometry.track.last_ns
        if self.is_rejecting:
            self.motion_start.window.advance(self._odometry.track, self._wheels)
        period_ns = round(cfg.period_s * 1e9)
        while self.is_initialized and self._queue and self._queue[0].stamp_ns <= end_ns:
            fix = self._queue.popleft()
            if self._odometry.history.at(fix.stamp_ns) is None:  # from before a gap
                self.fixes[RejectionReason.LATE] += 1
                continue
            self._fill(fix.stamp_ns - period_ns // 2)
            self._pending.append(fix)
            if self.is_initialized and fix.stamp_ns - self._newest_ns() >= 0.9 * period_ns:
                self._add_keyframe(fix.stamp_ns)
        self._fill(end_ns - round(cfg.wait_s * 1e9))

    def _fill(self, until_ns: int) -> None:
        """Adds keyframes at the period up to a time."""
        period_ns = round(self._config.smoother.period_s * 1e9)
        while self.is_initialized and until_ns - self._newest_ns() >= period_ns:
            self._add_keyframe(self._newest_ns() + period_ns)

    def _add_keyframe(self, stamp_ns: int) -> None:
        odometry = self._odometry
        fixes, self._pending = self._pending, []
        self._add_spans()
        before, range_gate = self.state, self.keyframes.range_gate
        T_body_base = invert(self.keyframes.lever_arms.T_base_body)
        batch = range_gate.take(stamp_ns, odometry.history, T_body_base) if range_gate is not None else None
        found = self.pose_measurements.take(stamp_ns, odometry.history)
        try:
            propagated = [self._propagate(fix, stamp_ns) for fix in fixes]
            used = [] if self.monitor.suspicion else propagated
            reasons = self.keyframes.add(
                stamp_ns, odometry.track, odometry.wheels, used, batch,
                () if self._is_fixed(stamp_ns) else found, self._needs_ranges(stamp_ns), self._velocity(fixes),
            )  # fmt: skip
        except SmootherFailure as failure:
            self._recover(stamp_ns, before, str(failure))
            return
        state = self.state
        assert state is not None, "a keyframe was added"
        self._align(state)
        reasons = reasons if used else [RejectionReason.SUSPECTED] * len(fixes)
        for fix, reason in zip(fixes, reasons, strict=True):
            self._count(fix, reason)
        for fix in fixes:
            swing = self._swing(fix.stamp_ns, self.keyframes.lever_arms.antenna_m - self.keyframes.lever_arms.base_m)
            if swing is not None:
                self.monitor.add(fix, swing)
        if before is not None:
            # code may be metres off for minutes; its fixes are tried again and again
            is_outlier = RejectionReason.OUTLIER in reasons and not fixes[-1].is_estimated
            self._monitor(before, propagated, is_outlier)

    def _monitor(self, before: State, fixes: list[Position], is_outlier: bool) -> None:
        """Compares fixes at the newest keyframe with their references; excludes wrong ones from the graph."""
        state, columns, history = self.state, self.keyframes.columns, self._odometry.history
        T_odom_before = history.at(before.stamp_ns)
        T_odom_base = None if state is None else history.at(state.stamp_ns)
        if state is None or columns is None or T_odom_before is None or T_odom_base is None:
            self.monitor.odometry.clear()
            return
        self.monitor.odometry.advance(T_odom_before, columns)
        if not fixes:
            return
        T_base_body, arm_m = self.keyframes.lever_arms.T_base_body, self.keyframes.lever_arms.antenna_m
        R = state.T_map_body[:3, :3]
        base_m = fixes[-1].p_map_m - R @ (arm_m + T_base_body[:3, 3])
        self.monitor.odometry.add(fixes[-1], base_m, state, self._T_map_odom, T_odom_base, self.keyframes.late_rad)
        apart_m = (base_m - (state.T_map_body @ invert(T_base_body))[:3, 3])[:2]
        self._apart_m = float(np.linalg.norm(apart_m))
        if fixes[-1].solution is GnssSolution.RTK_FIXED:
            self.monitor.add_fixed(state.stamp_ns, self._accuracy_m + self.keyframes.gnss_gate.innovation_m)
        covariance = (R @ state.covariance[3:, 3:] @ R.T)[:2, :2] + np.diag(fixes[-1].total_m[:2] ** 2)
        apart = Separation(0.0, apart_m, covariance, np.zeros(2))
        finding = self.monitor.evaluate(state.stamp_ns, is_outlier, apart)
        if finding is not None and self._undisputed_ns < self._accepted_ns:
            reference_m = base_m[:2] - finding.separation.d_m
            self._restart(excluded(state, T_base_body, reference_m, finding))

    def _needs_ranges(self, stamp_ns: int) -> bool:
        """Whether ranges justify their unknowns: far from the shed they add nothing to fixed ambiguities."""
        state = self.state
        is_near = state is None or self._dock_prior.is_near_shed(state.T_map_body[:3, 3])
        return is_near or not self._is_fixed(stamp_ns)

    def _is_fixed(self, stamp_ns: int) -> bool:
        """Whether fixed ambiguities give the position.

        The lidar map does not then: survey, mounts and antenna are centimetres off, which would tilt the machine.
        """
        fix, outage_ns = self._accepted, self._config.integrity.outage_s * 1e9
        is_fixed = fix is not None and fix.solution is GnssSolution.RTK_FIXED
        is_used = not self.is_rejecting and not self.monitor.suspicion
        return is_fixed and is_used and stamp_ns - self._accepted_ns <= outage_ns

    def _is_uwb_active(self, stamp_ns: int) -> bool:
        """Whether UWB constrains the position."""
        range_gate = self.keyframes.range_gate
        return self.is_initialized and range_gate is not None and range_gate.is_active(stamp_ns)

    def _propagate(self, fix: Position, stamp_ns: int) -> Position:
        """Propagates a fix to a keyframe by dead reckoning, over a fraction of a second, with the error of its path."""
        then, now = self._odometry.history.at(fix.stamp_ns), self._odometry.history.at(stamp_ns)
        assert then is not None, "checked when the fix left the queue"
        assert now is not None, "poses reach to the newest sample"
        antenna = self.keyframes.lever_arms.antenna_m - self.keyframes.lever_arms.base_m
        moved = propagate(fix, then, now, antenna, self._T_map_odom)
        slip_sigma = 0.0 if self.state is None else float(np.linalg.norm(self.state.sigmas[15:17]))
        path_m = float(np.linalg.norm(moved.p_map_m - fix.p_map_m))
        by_path_m = slip_sigma * path_m
        return replace(moved, sigma_m=np.hypot(fix.sigma_m, by_path_m), total_m=np.hypot(fix.total_m, by_path_m))

    def _velocity(self, fixes: list[Position]) -> Velocity | None:
        """Velocity of the IMU by the newest fix while positions contradict it: then it is right."""
        if self.monitor.suspicion != VELOCITY or not fixes or not np.isfinite(fixes[-1].velocity_mps).all():
            return None
        swing = self._swing(fixes[-1].stamp_ns, self.keyframes.lever_arms.antenna_m)
        if swing is None:
            return None
        sigma_mps = math.hypot(self._config.gnss_monitor.separation.sigma_mps(fixes[-1]), swing.sigma_mps)
        return Velocity(fixes[-1].stamp_ns, fixes[-1].velocity_mps[:2] - swing.velocity_mps, sigma_mps)

    def _swing(self, stamp_ns: int, arm_m: Float64) -> Swing | None:
        """Motion of the antenna about the other end of an arm (3,) in base at a fix, by the samples beside it."""
        odometry, odom = self._odometry, self._odometry.history.at(stamp_ns)
        if odom is None or odometry.dead_reckoning is None:
            return None
        rates = odometry.track.between(stamp_ns - SWING_NS, stamp_ns + SWING_NS).rate_radps
        turn = np.cross(rates.mean(axis=0) - odometry.dead_reckoning.calibration.gyro_bias_radps, arm_m)
        R = (planar(0.0, 0.0, yaw_of(self._T_map_odom)) @ odom)[:2, :3]  # the tilt of `odom` never steps
        noise = odometry.plausibility.imu.noise[1] / math.sqrt(len(rates))
        return Swing(R @ arm_m, R @ turn, noise * float(np.linalg.norm(arm_m)))

    def _recover(self, stamp_ns: int, before: State | None, reason: str) -> None:
        """Restarts a failed graph at the pose by dead reckoning; a second failure within the lag loses the position."""
        self.failures.append(reason)
        odom = self._odometry.history.at(stamp_ns)
        assert before is not None, "keyframes follow a start"
        lag_ns, failed_ns = round(self._config.smoother.lag_s * 1e9), self._failed_ns
        self._failed_ns = stamp_ns
        if odom is None or (failed_ns is not None and stamp_ns - failed_ns <= lag_ns):
            self.is_initialized = False
            return
        T = self._T_map_odom @ odom @ self.keyframes.lever_arms.T_base_body
        covariance = before.covariance + np.diag(self._config.reset_sigmas**2)
        reset = replace(before, stamp_ns=stamp_ns, T_map_body=T, covariance=covariance)
        self._restart(reset)

    def _restart(self, state: State) -> bool:
        """Restarts the graph at a state; False when that is not possible, and the position is lost."""
        try:
            self._align(self.keyframes.restart(state))
        except SmootherFailure as failure:
            self.failures.append(str(failure))
            self.is_initialized = False
        return self.is_initialized

    def _add_spans(self) -> None:
        smoother, tolerance_ns = self.keyframes.smoother, int(self._config.odometry_spans.tolerance_s * 1e9)
        for span in self.odometry_spans.take(self._newest_ns() + tolerance_ns // 2):
            start, end = smoother.key_near(span.start_ns, tolerance_ns), smoother.key_near(span.end_ns, tolerance_ns)
            if start is None or end is None or start[0] == end[0]:
                continue
            T = motion_between(span, self._odometry.history, start[1], end[1])
            if T is not None:
                course = self.monitor.odometry.course_at(self._undisputed_ns)
                self.keyframes.add_relative_pose(start[0], end[0], T, self.odometry_spans.covariance(span), course)

    def _count(self, position: Position, reason: RejectionReason) -> None:
        self.fixes[reason] += 1
        if reason is RejectionReason.NONE:
            self._accept(position)
            return
        self._rejected_in_row += 1
        self._rejected_ns = position.stamp_ns
        is_late = self._rejected_in_row > 2 * self._config.gnss.confirmation_fixes
        self.is_refusing = is_late or reason is not RejectionReason.CONFIRMATION
        if self._rejected_since_ns is None:
            self._rejected_since_ns = position.stamp_ns
        still_ns = self._odometry.standstill.since_ns
        rejected_ns = position.stamp_ns - max(self._rejected_since_ns, still_ns or self._odometry.stamp_ns)
        moving_ns = position.stamp_ns - self._rejected_since_ns
        if rejected_ns > self._config.realign_s * 1e9 or moving_ns > self._config.realign_moving_s * 1e9:
            self.is_initialized = False

    def _accept(self, position: Position) -> None:
        if self.is_rejecting:
            self.motion_start.clear()
        self._accepted, self._accepted_ns = position, position.stamp_ns
        self._late_m = self._config.gnss.stamp_s * abs(self._odometry.speed_mps)
        self._end_rejection()

    def _end_rejection(self) -> None:
        self._rejected_since_ns, self._rejected_in_row, self.is_refusing = None, 0, False

    def _align(self, state: State) -> None:
        """Aligns `odom` with a keyframe and passes the calibration on to dead reckoning."""
        odometry = self._odometry
        odom = odometry.history.at(state.stamp_ns)
        if odom is None or odometry.dead_reckoning is None:
            return
        T_map_base = state.T_map_body @ invert(self.keyframes.lever_arms.T_base_body)
        self._T_map_odom = T_map_base @ invert(odom)
        is_code = self._accepted is not None and self._accepted.solution < GnssSolution.PPP  # hides slip
        calibration = Calibration(state.bias[3:], self.keyframes.slip if is_code else state.slip)
        if odometry.inertial is not None:
            calibration = Calibration(state.bias[3:], np.array([1.0, state.slip[1], 0.0, 0.0]))
            odometry.inertial.correct(state.stamp_ns, self._forward_mps(state), float(state.bias[0]))
        elif self.keyframes.is_slipping:
            scale = odometry.scale_at(state.stamp_ns, self._forward_mps(state), calibration)
            calibration = Calibration(state.bias[3:], np.array([scale, *calibration.slip[1:]]))
        odometry.dead_reckoning.correct(calibration, state.T_map_body[2, :3], odom)

    def _is_disputed(self, stamp_ns: int) -> bool:
        """Whether fixes are suspected, or refused now: a single one before an outage is no dispute for good."""
        is_refused = self.is_rejecting and stamp_ns - self._rejected_ns <= self._config.integrity.outage_s * 1e9
        return is_refused or bool(self.monitor.suspicion)

    @property
    def _undisputed_ns(self) -> int:
        """Time up to which fixes have been right, as far as is known."""
        anchor_ns = self.monitor.anchor_ns
        return self._accepted_ns if anchor_ns is None else min(anchor_ns, self._accepted_ns)

    def _forward_mps(self, state: State) -> float:
        """Forward speed of base by the graph."""
        turn = self._odometry.track.at(state.stamp_ns)[3:6] - state.bias[3:]
        at_base = np.cross(turn, self.keyframes.lever_arms.base_m)
        return float((state.T_map_body[:3, :3].T @ state.velocity_mps + at_base)[0])

    def pose(self) -> MapPose:
        """Builds the MapPose message at the time of the newest `odom`."""
        state, stamp_ns = self.state, self._odometry.stamp_ns
        if state is None:
            covariance = np.eye(6) * 1e6
            return MapPose(
                stamp_ns, np.eye(4), self._odom_now().copy(), covariance, PositionSource.NONE, math.inf, math.inf, False
            )
        T = self._T_map_odom @ self._odom_now()
        age_s = math.inf if self._accepted is None else max(0, stamp_ns - self._accepted_ns) * 1e-9
        used = None if self.monitor.suspicion else self._accepted  # else dead reckoning from before the suspicion
        source = position_source(used, age_s, self._is_uwb_active(stamp_ns), self._config.integrity.outage_s)
        covariance = self._covariance(state, T, stamp_ns, source)
        accuracy_m, level_m = accuracy_and_level(covariance, T, source, self._config.integrity)
        self._accuracy_m = accuracy_m
        level_m += self._wrong_speed_mps(state, stamp_ns) * max(0, stamp_ns - state.stamp_ns) * 1e-9
        if source in BY_GNSS:
            level_m += self._config.gnss.stamp_s * abs(self._odometry.speed_mps)
        elif source is PositionSource.DEAD_RECKONING:  # from a place that the stamps had shifted
            level_m = max(level_m, accuracy_m + self._late_m)
        is_disputed = self._is_disputed(stamp_ns)
        if source in BY_GNSS or is_disputed:
            level_m = max(level_m, accuracy_m + self.monitor.level_m(stamp_ns))
        if is_disputed and self.monitor.suspicion != VELOCITY:  # the refused fixes may be right
            level_m = max(level_m, accuracy_m + self._apart_m)
        if self.is_rejecting and self._wheels is None:  # nothing separates fixes from inertial motion: either is right
            level_m = max(level_m, accuracy_m + self._refused_m(stamp_ns))
        range_gate = self.keyframes.range_gate
        uwb_age_s = range_gate.age_s(stamp_ns) if range_gate is not None else math.inf
        return MapPose(
            stamp_ns, self._T_map_odom.copy(), T, covariance, source, level_m, age_s, True, uwb_age_s, accuracy_m
        )

    def _wrong_speed_mps(self, state: State, stamp_ns: int) -> float:
        """By how much the wheels, which give the path since the keyframe, contradict the IMU.

        Without fixes before a keyframe knows of it.
        """
        by_graph_mps = abs(self._forward_mps(state) - self._odometry.speed_mps) if self.keyframes.is_slipping else 0.0
        has_fixes = stamp_ns - self._accepted_ns <= self._config.smoother.wait_s * 1e9
        return by_graph_mps if has_fixes else max(by_graph_mps, self._odometry.plausibility.speed.contradiction)

    def _refused_m(self, stamp_ns: int) -> float:
        """Distance of a refused fix, growing as errors of heading and tilt do since the last accepted one."""
        grown_s = max(1e-3, (self._rejected_ns - self._accepted_ns) * 1e-9)
        growth = max(1.0, (stamp_ns - self._accepted_ns) * 1e-9 / grown_s)
        return self.keyframes.gnss_gate.innovation_m * growth**2

    def _covariance(self, state: State, T_map_base: Float64, stamp_ns: int, source: PositionSource) -> Float64:
        slow, turn_rad = slow_part(source, self._accepted, self._config.pose_measurement)
        R = T_map_base[:3, :3]
        age_s = (stamp_ns - state.stamp_ns) * 1e-9
        T_base_body = self.keyframes.lever_arms.T_base_body
        out = output_covariance(
            state.covariance, T_base_body, R.T @ np.diag(slow**2) @ R, age_s, self._odometry.speed_mps, 1e-3
        )
        out[2, 2] += turn_rad**2
        return out
