"""The fused side: where `odom` lies in `map`, from the graph's newest keyframe."""

import math
from collections import deque
from dataclasses import replace

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.transforms import Float64, invert
from localization.dead_reckoning.dead_reckoning import Calibration
from localization.dead_reckoning.initial_alignment import AlignmentConfig
from localization.dock_prior import Docked, DockedConfig
from localization.gnss_gate import GnssConfig, Position, Refusal, carried
from localization.graph.keyframes import Fusion
from localization.graph.smoother import SmootherConfig, SmootherFailure, State
from localization.integrity import (
    IntegrityConfig,
    output_covariance,
    position_source,
    protection_level,
    slow_part,
)
from localization.lidar.odometry_spans import LidarLink, LidarLinkConfig, moved_to
from localization.lidar.pose_measurement import SightingConfig, Sightings
from localization.odometry import Motion
from localization.uwb.range_gate import RangingConfig
from messages.motion import MapPose, PositionSource
from messages.sensors import GnssSolution


class PlacementConfig(Config):
    """What the fused pose needs."""

    gnss: GnssConfig
    smoother: SmootherConfig
    alignment: AlignmentConfig
    lidar_link: LidarLinkConfig
    sighting: SightingConfig
    ranging: RangingConfig
    docked: DockedConfig
    integrity: IntegrityConfig
    resume_turn_radps: float = Field(gt=0.0, le=2.0, description="how fast the pose may have turned during a gap")
    resume_share: float = Field(gt=0.0, le=2.0, description="part of the speed by which it may have moved otherwise")
    longest_bridge_s: float = Field(gt=0.0, le=10.0, description="a longer gap while driving loses the position")
    realign_s: float = Field(gt=0.0, le=600.0, description="refused for so long at standstill: start anew")


class Placement:
    """Owns the graph and turns its newest keyframe into `T_map_odom`."""

    def __init__(self, config: PlacementConfig, fusion: Fusion, motion: Motion, docked: Docked) -> None:
        self._config, self._motion, self._docked = config, motion, docked
        self.fusion = fusion
        self.link, self.sightings = LidarLink(config.lidar_link), Sightings(config.sighting)
        self._queue: deque[Position] = deque()
        self._carried: list[Position] = []
        self._T_map_odom = np.eye(4)
        self._accepted: Position | None = None
        self._accepted_ns = 0
        self._refused_since_ns: int | None = None
        self.is_initialized = False
        self.failures: list[str] = []
        self.doubt, self._was_placed = "", False
        self.refusals = 0
        self.late = 0

    @property
    def state(self) -> State | None:
        """The newest keyframe, None before the start."""
        return self.fusion.smoother.state if self.is_initialized else None

    @property
    def is_refusing(self) -> bool:
        """Whether the newest fixes have been refused."""
        return self._refused_since_ns is not None

    def add(self, position: Position) -> None:
        """Takes a fix; it waits until inertial samples reach it. Beside the shed UWB knows better."""
        if self._is_ranged(position.stamp_ns) and self._docked.is_shaded(position.p_map_m):
            return
        newest = max((fix.stamp_ns for fix in (*self._carried, *self._queue)), default=self._newest_ns())
        if position.stamp_ns <= newest:
            self.late += 1
            return
        self._queue.append(position)

    def _newest_ns(self) -> int:
        state = self.state
        return state.stamp_ns if state is not None else -(2**63)

    def forget_time(self) -> None:
        """Drops what waits."""
        self._queue.clear()
        self._carried.clear()
        self.link.clear()
        self.sightings.clear()
        if self.fusion.ranging is not None:
            self.fusion.ranging.clear()
        self._refused_since_ns = None

    def start(self) -> bool:
        """Begins at a standstill: at the dock when ranges confirm it, else when there are fixes with heading.

        Once placed it may be anywhere: only fixes find it again.
        """
        self.is_initialized = (not self._was_placed and self._start_docked()) or self._start_fixed()
        self._was_placed |= self.is_initialized
        return self.is_initialized

    def _start_docked(self) -> bool:
        motion, ranging = self._motion, self.fusion.ranging
        level, still_ns, stamp_ns = motion.level(), motion.standstill.since_ns, motion.track.last_ns
        if ranging is None or self._docked.start is None or level is None or still_ns is None:
            return False
        T_base_body = self.fusion.arms.T_base_body
        T = self._docked.pose_of(level) @ T_base_body
        sigmas = self._docked.sigmas(math.radians(self._config.alignment.tilt_sigma_deg))
        heard = ranging.since(still_ns, invert(T_base_body))
        if heard is None:
            self.doubt = "no UWB ranges"
            return False
        self.doubt = ranging.disagreement(heard, T, np.diag(sigmas**2))
        if self.doubt or motion.history.at(stamp_ns) is None:
            return False
        ranging.begin(stamp_ns, heard, T)
        self._place(self.fusion.start_at(stamp_ns, level, T, sigmas))
        return True

    def _start_fixed(self) -> bool:
        still, level = self._motion.standstill, self._motion.level()
        placed, newest = still.place(), still.newest
        if level is None or placed is None or newest is None:
            return False
        stamp_ns = max(newest.stamp_ns, self._motion.track.first_ns)
        if stamp_ns > self._motion.track.last_ns or self._motion.history.at(stamp_ns) is None:
            return False
        self.fusion.gate.trust(newest)
        self._place(self.fusion.start(stamp_ns, level, placed))
        self._accept(newest)
        return True

    def resume(self, gap_s: float, speed_mps: float) -> bool:
        """Goes on after a gap at the newest inertial sample with a wider covariance; False when that is too wide."""
        state = self.state
        if state is None:
            return False
        if abs(speed_mps) > 0.05 and gap_s > self._config.longest_bridge_s:
            self.is_initialized = False
            return False
        wider = np.repeat(
            [self._config.resume_turn_radps * min(gap_s, 1.0), self._config.resume_share * abs(speed_mps) * gap_s], 3
        )
        wider += 1e-3
        T = self._T_map_odom @ self._odom_now() @ self.fusion.arms.T_base_body
        velocity = T[:3, 0] * speed_mps
        sigmas = state.sigmas.copy()
        sigmas[6:9] = np.maximum(sigmas[6:9], 0.2)
        again = replace(
            state, stamp_ns=self._motion.stamp_ns, T_map_body=T, velocity_mps=velocity,
            covariance=state.covariance + np.diag(wider**2), sigmas=sigmas,
        )  # fmt: skip
        self._place(self.fusion.restart(again))
        return True

    def _odom_now(self) -> Float64:
        reckoning = self._motion.reckoning
        assert reckoning is not None, "the pose is continuous before it is placed"
        return reckoning.T_odom_base

    def advance(self) -> None:
        """Makes the keyframes that the samples so far allow."""
        cfg, reach = self._config.smoother, self._motion.track.last_ns
        period_ns = round(cfg.period_s * 1e9)
        while self._queue and self._queue[0].stamp_ns <= reach:
            fix = self._queue.popleft()
            self._fill(fix.stamp_ns - period_ns // 2)
            self._carried.append(fix)
            if fix.stamp_ns - self._newest_ns() >= 0.9 * period_ns:
                self._keyframe(fix.stamp_ns)
        self._fill(reach - round(cfg.wait_s * 1e9))

    def _fill(self, until_ns: int) -> None:
        """Keyframes at the period up to a time."""
        period_ns = round(self._config.smoother.period_s * 1e9)
        while self.is_initialized and until_ns - self._newest_ns() >= period_ns:
            self._keyframe(self._newest_ns() + period_ns)

    def _keyframe(self, stamp_ns: int) -> None:
        motion = self._motion
        fixes, self._carried = self._carried, []
        self._add_spans()
        before, ranging, T_body_base = self.state, self.fusion.ranging, invert(self.fusion.arms.T_base_body)
        heard = ranging.take(stamp_ns, motion.history, T_body_base) if ranging is not None else None
        try:
            moved = [self._carry(fix, stamp_ns) for fix in fixes]
            refusals = self.fusion.keyframe(
                stamp_ns, motion.track, motion.wheels, moved, heard,
                self.sightings.take(stamp_ns, motion.history), self._needs_ranges(stamp_ns),
            )  # fmt: skip
        except SmootherFailure as failure:
            self._recover(stamp_ns, before, str(failure))
            return
        state = self.state
        assert state is not None, "a keyframe was made"
        self._place(state)
        for fix, refusal in zip(fixes, refusals, strict=True):
            self._count(fix, refusal)

    def _needs_ranges(self, stamp_ns: int) -> bool:
        """Whether ranges are worth their unknowns: far from the shed they add nothing to fixed ambiguities."""
        fix, state, outage_ns = self._accepted, self.state, self._config.integrity.outage_s * 1e9
        is_fixed = fix is not None and fix.solution is GnssSolution.RTK_FIXED and not self.is_refusing
        if not is_fixed or state is None or stamp_ns - self._accepted_ns > outage_ns:
            return True
        return self._docked.is_near(state.T_map_body[:3, 3])

    def _is_ranged(self, stamp_ns: int) -> bool:
        """Whether UWB holds the position."""
        ranging = self.fusion.ranging
        return self.is_initialized and ranging is not None and ranging.is_alive(stamp_ns)

    def _carry(self, fix: Position, stamp_ns: int) -> Position:
        """A fix moved on to a keyframe by dead reckoning, over a fraction of a second."""
        then, now = self._motion.history.at(fix.stamp_ns), self._motion.history.at(stamp_ns)
        if then is None or now is None:
            return fix
        antenna = self.fusion.arms.antenna_m - self.fusion.arms.base_m
        return carried(fix, then, now, antenna, self._T_map_odom)

    def _recover(self, stamp_ns: int, before: State | None, reason: str) -> None:
        """Starts anew at a failed keyframe's time, where dead reckoning says."""
        self.failures.append(reason)
        odom = self._motion.history.at(stamp_ns)
        assert before is not None, "keyframes follow a start"
        if odom is None:
            return
        T = self._T_map_odom @ odom @ self.fusion.arms.T_base_body
        widened = replace(
            before, stamp_ns=stamp_ns, T_map_body=T, covariance=4.0 * before.covariance, sigmas=2.0 * before.sigmas
        )
        self._place(self.fusion.restart(widened))

    def _add_spans(self) -> None:
        smoother, tolerance_ns = self.fusion.smoother, int(self._config.lidar_link.tolerance_s * 1e9)
        for span in self.link.take(self._newest_ns() + tolerance_ns // 2):
            start, end = smoother.key_near(span.start_ns, tolerance_ns), smoother.key_near(span.end_ns, tolerance_ns)
            if start is None or end is None or start[0] == end[0]:
                continue
            T = moved_to(span, self._motion.history, start[1], end[1])
            if T is not None:
                self.fusion.add_motion(start[0], end[0], T, self.link.covariance(span))

    def _count(self, position: Position, refusal: Refusal) -> None:
        if refusal is Refusal.NONE:
            self._accept(position)
            return
        self.refusals += 1
        if self._refused_since_ns is None:
            self._refused_since_ns = position.stamp_ns
        stands_ns = self._motion.standstill.since_ns
        refused_ns = position.stamp_ns - max(self._refused_since_ns, stands_ns or self._motion.stamp_ns)
        if refused_ns > self._config.realign_s * 1e9:
            self.is_initialized = False

    def _accept(self, position: Position) -> None:
        self._accepted, self._accepted_ns = position, position.stamp_ns
        self._refused_since_ns = None

    def _place(self, state: State) -> None:
        """Anchors `odom` at a keyframe and hands the calibration on to dead reckoning."""
        motion = self._motion
        odom = motion.history.at(state.stamp_ns)
        if odom is None or motion.reckoning is None:
            return
        T_map_base = state.T_map_body @ invert(self.fusion.arms.T_base_body)
        self._T_map_odom = T_map_base @ invert(odom)
        calibration = Calibration(state.bias[3:], state.slip)
        motion.reckoning.correct(calibration, state.T_map_body[2, :3], odom)

    def pose(self) -> MapPose:
        """The message at the time of the newest `odom`."""
        state, stamp_ns = self.state, self._motion.stamp_ns
        if state is None:
            covariance = np.eye(6) * 1e6
            return MapPose(
                stamp_ns, np.eye(4), self._odom_now().copy(), covariance, PositionSource.NONE, math.inf, math.inf, False
            )
        T = self._T_map_odom @ self._odom_now()
        age_s = math.inf if self._accepted is None else max(0, stamp_ns - self._accepted_ns) * 1e-9
        source = position_source(self._accepted, age_s, self._is_ranged(stamp_ns), self._config.integrity.outage_s)
        covariance = self._covariance(state, T, stamp_ns, source)
        level = protection_level(covariance, T, source, self._config.integrity)
        ranging = self.fusion.ranging
        uwb_age_s = ranging.age_s(stamp_ns) if ranging is not None else math.inf
        return MapPose(stamp_ns, self._T_map_odom.copy(), T, covariance, source, level, age_s, True, uwb_age_s)

    def _covariance(self, state: State, T_map_base: Float64, stamp_ns: int, source: PositionSource) -> Float64:
        slow, turn_rad = slow_part(source, self._accepted, self._config.sighting)
        R = T_map_base[:3, :3]
        age_s = (stamp_ns - state.stamp_ns) * 1e-9
        T_base_body = self.fusion.arms.T_base_body
        out = output_covariance(
            state.covariance, T_base_body, R.T @ np.diag(slow**2) @ R, age_s, self._motion.speed_mps, 1e-3
        )
        out[2, 2] += turn_rad**2
        return out
