"""Bus sink that checks the inputs of an evaluation against each other."""

import math
from array import array
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Float64
from geometry.rectangle import Rectangle
from messages.command import MachineState
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import GnssFix, ImuSample, LidarScan, WheelSample
from messages.truth import TrueMachine, TrueObjects
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.consistency import coverage, mount_motion, odometry, time_offset
from validation.obstacle_stop.consistency.finding import Finding, not_checked
from validation.obstacle_stop.consistency.ground_plane import GroundPlane
from validation.obstacle_stop.consistency.kernels import reduce_scan
from validation.obstacle_stop.consistency.motion_series import MotionSeries
from validation.obstacle_stop.consistency.ring_model import RingModel
from validation.obstacle_stop.consistency.scan_motion import ScanMotion, ScanSteps
from validation.obstacle_stop.consistency.truth_fit import TruthFit
from validation.obstacle_stop.consistency.truth_shifts import TrueBoxes
from validation.obstacle_stop.observation import Setting

MAX_RANGE_M = 60.0
OWN_MARGIN_M = 0.2
USED, TRUTH = "odom", "truth_machine"
RECORDED = "/recorded/"


class _LidarState:
    """Checks of one lidar."""

    def __init__(self, name: str, lidar: Lidar) -> None:
        self.name, self.lidar = name, lidar
        self.motion = ScanMotion()
        self.ground, self.rings = GroundPlane(name, lidar), RingModel(name, lidar)
        self.stamps, self.ground_ns, self.unplaced = array("q"), 0, 0

    def T_base_sensor(self, hitch: float) -> Float64 | None:
        """Pose in base (4, 4) at a measured hitch position; None on an implement whose hitch is unknown."""
        if self.lidar.mount.sinks_m > 0.0 and not math.isfinite(hitch):
            self.unplaced += 1
            return None
        return self.lidar.mount.at_hitch(hitch if math.isfinite(hitch) else 1.0)

    def findings_of_place(self) -> list[Finding]:
        """Scans that could not be placed."""
        if not self.unplaced:
            return []
        reason = f"the hitch that carries it was not measured in {self.unplaced} of {len(self.stamps)} scans"
        return [not_checked(f"these scans of lidar {self.name}", reason)]


class ConsistencyObserver:
    """Call with every envelope of a replay; `finish` returns the findings.

    `is_odometry_from_scans`: the odometry was computed from the scans, for want of another one. `imu_T` (4, 4) is the
    pose of the IMU in base, None unknown. `odometry_topic` is the recorded one that is used, if any.
    """

    def __init__(
        self, setting: Setting, lidars: Mapping[str, Lidar], outlines: tuple[Rectangle, ...],
        is_odometry_from_scans: bool, conditions: Conditions, imu_T: Float64 | None = None, odometry_topic: str = "",
    ) -> None:  # fmt: skip
        self._setting, self._conditions, self._limits = setting, conditions, conditions.consistency
        self._is_from_scans, self._imu_T = is_odometry_from_scans, imu_T
        self._own_source = RECORDED + odometry_topic
        self._lidars = {name: _LidarState(name, lidar) for name, lidar in lidars.items()}
        self._own = np.array(
            [[r.rear_m - OWN_MARGIN_M, r.front_m + OWN_MARGIN_M, r.half_width_m + OWN_MARGIN_M] for r in outlines]
        ).reshape(-1, 3)
        self._series: dict[str, MotionSeries] = {USED: MotionSeries("the odometry")}
        classes = {label.value for label in conditions.classes}
        self._truth = TrueBoxes(setting.truth_frame, setting.T_base_lidar, classes)
        self._fit = TruthFit(self._truth, self._limits.truth, conditions.truth.max_age_s)
        self._fit_ns = self._first_ns = 0
        self._scan_stamps, self._has_truth = array("q"), array("b")
        self._driven_m, self._last_xy, self._hitch = 0.0, np.zeros(2), math.nan

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message, topic = envelope.message, envelope.topic
        if isinstance(message, LidarScan):
            name = topic.partition("/")[2]
            if topic.startswith("lidar/") and name in self._lidars:
                self._add_scan(self._lidars[name], message)
        elif isinstance(message, Odometry):
            series = MotionSeries(f"odometry {topic.removeprefix(RECORDED)}")
            self._series.setdefault(topic, series).add_odometry(message)
        elif isinstance(message, TrueObjects | TrueMachine):
            self._truth.add(message)
            self._fit.advance()
            if isinstance(message, TrueMachine) and self._truth.has_machine:
                series = self._series.setdefault(TRUTH, MotionSeries("the machine of the truth"))
                series.add_pose(message.stamp_ns, message.T_map_base)
        elif isinstance(message, MachineState):
            self._hitch = message.hitch
        else:
            self._add_motion(topic, message)

    def _add_motion(self, topic: str, message: object) -> None:
        """Speeds and yaw rates of other sources than odometry."""
        of = self._series.setdefault
        if isinstance(message, WheelSample):
            series = of(topic, MotionSeries("the wheel speed", has_yaw=False, has_positions=False))
            series.add_speed(message.stamp_ns, message.speed_mps)
        elif isinstance(message, GnssFix):
            name = f"the speed of {topic.removeprefix(RECORDED)}"
            series = of(topic, MotionSeries(name, has_yaw=False, is_signed=False, has_positions=False))
            series.add_speed(message.stamp_ns, float(np.hypot(*message.velocity_enu_mps[:2])))
        elif isinstance(message, ImuSample) and self._imu_T is not None:
            series = of(topic, MotionSeries("the yaw rate of the IMU", has_speed=False, has_positions=False))
            series.add_turn(message.stamp_ns, float(self._imu_T[2, :3] @ message.rate_radps))

    def _add_scan(self, state: _LidarState, scan: LidarScan) -> None:
        stamp_ns, sampling = scan.stamp_ns, self._limits.sampling
        self._first_ns = self._first_ns or stamp_ns
        state.stamps.append(stamp_ns)
        t_s = (stamp_ns - self._first_ns) * 1e-9
        if self._setting.truth_frame is not None and self._conditions.is_evaluated(self._setting.log, t_s):
            self._scan_stamps.append(stamp_ns)
            age_ns = round(self._conditions.truth.max_age_s * 1e9)
            self._has_truth.append(self._truth.is_known(stamp_ns, age_ns))
        is_ground = stamp_ns - state.ground_ns >= round((sampling.ground_s - 0.02) * 1e9)
        is_fit = self._setting.truth_frame is not None and stamp_ns - self._fit_ns >= round(sampling.truth_s * 1e9)
        step = self._odometry_since(state.motion.reference_ns, stamp_ns)
        is_motion = state.motion.is_due(stamp_ns, step, sampling.registration_s)
        if not (is_ground or is_fit or is_motion) or not len(scan.points_m):
            return
        T_base_sensor = state.T_base_sensor(self._hitch)
        if T_base_sensor is None:
            return
        keep = len(scan.points_m) // sampling.max_points + 1
        speed, turn = self._series[USED].rates_at(stamp_ns)
        points = reduce_scan(
            scan.points_m, scan.point_offset_s, keep, T_base_sensor, speed, turn, self._own, MAX_RANGE_M
        )  # fmt: skip
        if is_motion:
            state.motion.add(stamp_ns, points, step)
        if is_ground:
            state.ground_ns = stamp_ns
            self._drive_to(stamp_ns)
            if abs(speed * turn) <= self._limits.mount.max_lateral_mps2:
                state.ground.add(points, self._driven_m)
            state.rings.add(scan, keep)
        if is_fit:
            self._fit_ns = stamp_ns
            self._fit.add(stamp_ns, points, keep, state.lidar, self._series[USED].pose_at(stamp_ns))

    def _odometry_since(self, from_ns: int | None, to_ns: int) -> Float64 | None:
        if from_ns is None:
            return None
        a, b = self._series[USED].pose_at(from_ns), self._series[USED].pose_at(to_ns)
        if a is None or b is None:
            return None
        middle, d = 0.5 * (a[2] + b[2]), b - a
        c, s = np.cos(middle), np.sin(middle)
        return np.array([c * d[0] + s * d[1], c * d[1] - s * d[0], d[2]])

    def _drive_to(self, stamp_ns: int) -> None:
        pose = self._series[USED].pose_at(stamp_ns)
        if pose is not None:
            step = float(np.hypot(*(pose[:2] - self._last_xy)))
            self._driven_m += step if step > 0.1 else 0.0
            self._last_xy = pose[:2] if step > 0.1 else self._last_xy

    def finish(self) -> tuple[Finding, ...]:
        """All findings, blocking ones first."""
        used, limits = self._series[USED], self._limits
        others = [s for topic, s in self._series.items() if topic not in (USED, TRUTH)]
        out = odometry.check_driven(used, limits.motion)
        stamps = [
            s for state in self._lidars.values() for s in (state.stamps[:1].tolist() + state.stamps[-1:].tolist())
        ]
        if stamps:
            span = (min(stamps), max(stamps))
            recorded = self._series.get(self._own_source, used)  # what is used is interpolated over gaps
            out += coverage.check_odometry(used.name, recorded.stamps, span, limits.coverage)
        for series in [used, *others]:
            out += odometry.check_own_speed(series, limits.motion) if series.has_positions else []
        steps = {name: state.motion.steps() for name, state in self._lidars.items()}
        known, truth = list(steps.values()), self._series.get(TRUTH)
        if truth is not None:
            found = odometry.check_against(used, truth, [], self._is_from_scans, limits.motion)
            out += [replace(f, code="truth_poses") if f.is_blocking else f for f in found]
        sources = [s for topic, s in self._series.items() if topic not in (USED, self._own_source)]
        out += [] if self._is_from_scans else odometry.check_confirmed(used, sources, known, limits.motion)
        for other in (o for o in others if o.has_speed):
            out += odometry.check_against(used, other, known, self._is_from_scans, limits.motion)
        for name, state in self._lidars.items():
            out += coverage.check_scans(name, state.stamps, used.moving_span(), limits.coverage)
            out += self._of_lidar(name, state, steps[name], others)
        out += self._of_truth()
        return tuple(sorted(out, key=lambda f: not f.is_blocking))

    def _of_lidar(self, name: str, state: _LidarState, steps: ScanSteps, others: list[MotionSeries]) -> list[Finding]:
        limits, used = self._limits, self._series[USED]
        out = odometry.check_against_scans(used, steps, self._is_from_scans, limits.motion)
        out += state.ground.findings(limits.mount) + state.rings.findings(limits.rings)
        out += state.findings_of_place() + mount_motion.check_yaw(name, steps, limits.mount)
        independent = others if self._is_from_scans else [used, *others]
        out += time_offset.check_lags(name, steps, independent, limits.time)
        if self._is_from_scans:
            out.append(not_checked(f"place across of lidar {name}", "the odometry comes from the scans"))
        else:
            out += mount_motion.check_lateral(name, steps, used, limits.mount)
        return out + time_offset.check_stamps(name, np.array(state.stamps, np.int64))

    def _of_truth(self) -> list[Finding]:
        if self._setting.truth_frame is None:
            return []
        # a shift in time is the cause of truth that is missing at one end
        out = self._fit.findings()
        out += coverage.check_truth(self._scan_stamps, self._has_truth, self._limits.coverage)
        return out + coverage.check_sector(self._setting.view_rad)
