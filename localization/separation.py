"""Solution separation: displacement by GNSS positions over a window against displacements that do not use them.

Three references, all horizontal: the receiver's own Doppler velocity, which wrong ambiguities and multipath of the
position leave right; wheels with gyro at the calibration of the window's begin, and lidar odometry with gyro, which no
GNSS signal reaches.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.transforms import yaw_of
from localization.dead_reckoning.dead_reckoning import PoseHistory
from localization.gnss_gate import Position
from localization.graph.smoother import State
from localization.lidar.odometry_spans import is_sane
from messages.motion import LidarOdometry

KEEP_S = 150.0
SCANS_S = 1.0  # lidar odometry that ends earlier says nothing of the present
COURSE_M, COURSE_TURN_RAD, COURSE_GATE = 10.0, 0.1, 3.0  # straight part for a course; sigmas of one that is used
SLIP_SIGMA = 0.3  # wheels that spin (1) are 3.3 sigma, and such that turn against the motion (2) more than any limit


class SeparationConfig(Config):
    """Errors of the references over a window T, in addition to those that graph and receiver state."""

    velocity_sigma_mps: float = Field(gt=0.0, le=1.0, description="lower bound of the Doppler velocity's sigma")
    velocity_bias_mps: float = Field(ge=0.0, le=0.1, description="part of its error that does not average out")
    velocity_stamp_s: float = Field(ge=0.0, le=0.5, description="between the times of position and velocity")
    slip_change: float = Field(ge=0.0, le=0.5, description="sigma of a change of slip at once: load, soil")
    gnss_gap_s: float = Field(gt=0.0, le=5.0, description="a longer time between fixes ends the integration")
    tilt_m: float = Field(
        ge=0.0, le=1.0, description="error of the mounts in roll and pitch, times the height of the antenna"
    )
    lever_arm_m: float = Field(ge=0.0, le=1.0, description="error of that lever arm, which turns with the machine")
    gyro_scale: float = Field(ge=0.0, le=0.1, description="sigma of the scale error of the gyro, for half of the path")
    lidar_m: float = Field(gt=0.0, le=1.0, description="error of a lidar pose in its local map")
    lidar_share: float = Field(ge=0.0, le=0.5, description="drift of lidar odometry per path")
    course_deg: float = Field(gt=0.0, le=5.0, description="error of the mounts of lidar and antennas in yaw")
    course_walk_deg: float = Field(ge=0.0, le=1.0, description="change of that error, per square root of a second")

    def sigma_mps(self, fix: Position) -> float:
        """Sigma of the Doppler velocity of a fix; one that states none (NaN) has the lower bound."""
        return max(self.velocity_sigma_mps, fix.velocity_sigma_mps)


@dataclass(frozen=True)
class Separation:
    """Difference `d_m` (2,) of two displacements in `map` over `age_s`, with its covariance (2, 2).

    `wheel_m` (2,): displacement by the wheels per unit of their scale, zero where no wheels are used.
    """

    age_s: float
    d_m: Float64
    covariance: Float64
    wheel_m: Float64

    @cached_property
    def ratio(self) -> float:
        """Mahalanobis distance."""
        return _distance(self.d_m, self.covariance)

    def ratio_beside_slip(self, wheels_m: Iterable[Float64]) -> float:
        """Mahalanobis distance when the wheels slip by any share in any of the parts with displacements `wheels_m`."""
        widened = self.covariance + SLIP_SIGMA**2 * sum(np.outer(w, w) for w in wheels_m)
        return _distance(self.d_m, widened)

    @cached_property
    def sigma_m(self) -> float:
        """Standard deviation along the major axis."""
        (a, b), (_, c) = self.covariance.tolist()
        return math.sqrt(0.5 * (a + c) + math.hypot(0.5 * (a - c), b))

    def bound_m(self, sigmas: float) -> float:
        """Bound of an error of the positions that began in the window."""
        return math.hypot(*self.d_m.tolist()) + sigmas * self.sigma_m


class _Row(Protocol):
    @property
    def stamp_ns(self) -> int: ...


R = TypeVar("R", bound=_Row)


class _Rows(Generic[R]):
    """Rows of the last `KEEP_S` seconds by stamp."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._rows: list[R] = []

    def clear(self) -> None:
        """Drops all rows."""
        self._stamps.clear()
        self._rows.clear()

    def add(self, row: R) -> None:
        """Appends a row newer than all others."""
        self._stamps.append(row.stamp_ns)
        self._rows.append(row)
        if row.stamp_ns - self._stamps[0] > 1.2e9 * KEEP_S:
            drop = bisect_right(self._stamps, row.stamp_ns - int(KEEP_S * 1e9))
            del self._stamps[:drop], self._rows[:drop]

    @property
    def newest(self) -> R | None:
        """The newest row."""
        return self._rows[-1] if self._rows else None

    def at(self, stamp_ns: int) -> R | None:
        """The newest row not after a time."""
        k = bisect_right(self._stamps, stamp_ns)
        return self._rows[k - 1] if k else None


@dataclass(frozen=True)
class _Fix:
    """Base by a fix, with the integral of the velocity so far and its variance."""

    stamp_ns: int
    p_map_m: Float64
    sigma_m: float
    velocity_mps: Float64
    path_m: Float64
    variance_m2: float


@dataclass(frozen=True)
class Swing:
    """Motion of the antenna about base in `map`: position (2,), velocity (2,) by the gyro and its sigma."""

    arm_m: Float64
    velocity_mps: Float64
    sigma_mps: float


class VelocitySeparation:
    """Positions of base against the integral of its Doppler velocity.

    Both are those of the antenna less its swing: at the rate of fixes the velocity of an antenna on a body that shakes
    on its tyres is aliased. An error of the lever arm cancels.
    """

    def __init__(self, config: SeparationConfig) -> None:
        self._config = config
        self._rows: _Rows[_Fix] = _Rows()

    def clear(self) -> None:
        """Drops all fixes."""
        self._rows.clear()

    def add(self, fix: Position, swing: Swing) -> None:
        """Takes the next fix; one without velocity, or after a gap, starts a new integral."""
        velocity, last = fix.velocity_mps[:2] - swing.velocity_mps, self._rows.newest
        if not np.isfinite(velocity).all():
            self.clear()
            return
        path_m, variance_m2 = np.zeros(2), 0.0
        if last is not None:
            dt_s = (fix.stamp_ns - last.stamp_ns) * 1e-9
            if 0.0 < dt_s <= self._config.gnss_gap_s:
                path_m = last.path_m + 0.5 * dt_s * (last.velocity_mps + velocity)
                sigma = self._config.sigma_mps(fix)
                variance_m2 = last.variance_m2 + (sigma**2 + swing.sigma_mps**2) * dt_s**2
            else:
                self.clear()
        p_map_m = fix.p_map_m[:2] - swing.arm_m
        self._rows.add(_Fix(fix.stamp_ns, p_map_m, _sigma_m(fix), velocity, path_m, variance_m2))

    def since(self, stamp_ns: int) -> Separation | None:
        """Separation of the newest fix since a time; None when fixes do not reach back to it."""
        first, last, cfg = self._rows.at(stamp_ns), self._rows.newest, self._config
        if first is None or last is None or last.stamp_ns <= stamp_ns:
            return None
        age_s = (last.stamp_ns - first.stamp_ns) * 1e-9
        turned_m = cfg.velocity_stamp_s * float(np.linalg.norm(last.velocity_mps - first.velocity_mps))
        variance = last.variance_m2 - first.variance_m2 + (cfg.velocity_bias_mps * age_s) ** 2 + turned_m**2
        variance += first.sigma_m**2 + last.sigma_m**2
        d_m = last.p_map_m - first.p_map_m - (last.path_m - first.path_m)
        return Separation(age_s, d_m, variance * np.eye(2), np.zeros(2))


@dataclass(frozen=True)
class _Keyframe:
    """A keyframe with a fix: position of base by that fix, and all that predicts later ones.

    `columns` (2, 4) is the displacement per slip parameter since the start and `odom_m` (2,) the position,
    both in `odom`; `path_m` is the length driven and `turned_rad` the sum of all turns; `heading_rad` counts turns;
    `tilt_m` is what errors of roll and pitch do to base.
    """

    stamp_ns: int
    p_map_m: Float64
    sigma_m: float
    tilt_m: float
    velocity_mps: Float64
    columns: Float64
    odom_m: Float64
    path_m: float
    turned_rad: float
    heading_rad: float
    yaw_map_odom_rad: float
    yaw_variance: float
    gyro_sigma_radps: float
    slip: Float64
    slip_sigma: Float64


class LidarPath:
    """What lidar odometry adds to positions in `odom`: each motion, from its pose there, ends beside the next one.

    With the variance of matching at that time: errors of matching against one map do not accumulate.
    """

    def __init__(self) -> None:
        self._stamps: deque[int] = deque()
        self._rows: deque[Float64] = deque()

    def clear(self) -> None:
        """Drops all motions."""
        self._stamps.clear()
        self._rows.clear()

    @property
    def last_ns(self) -> int:
        """End of the newest motion; long ago without one."""
        return self._stamps[-1] if self._stamps else -(2**62)

    def add(self, motion: LidarOdometry, history: PoseHistory) -> None:
        """Takes the next motion; one that does not follow, or is not valid, begins a new path."""
        before, after = history.at(motion.from_stamp_ns), history.at(motion.stamp_ns)
        if not is_sane(motion) or before is None or after is None:
            self.clear()
            return
        if motion.from_stamp_ns != self.last_ns:
            self.clear()
            self._stamps.append(motion.from_stamp_ns)
            self._rows.append(np.array([0.0, 0.0, float(np.max(np.diag(motion.covariance)[3:5]))]))
        ends_m = before[:3, 3] + before[:3, :3] @ motion.T_from_to[:3, 3]
        added_m = self._rows[-1][:2] + (ends_m - after[:3, 3])[:2]
        self._stamps.append(motion.stamp_ns)
        self._rows.append(np.array([*added_m, float(np.max(np.diag(motion.covariance)[3:5]))]))
        while self._stamps[-1] - self._stamps[0] > KEEP_S * 1e9:
            self._stamps.popleft()
            self._rows.popleft()

    def at(self, stamp_ns: int) -> Float64 | None:
        """What is added (x, y) at a time and its variance, (3,); None where the path does not reach."""
        if not self._stamps or not self._stamps[0] <= stamp_ns <= self._stamps[-1]:
            return None
        k = min(bisect_right(self._stamps, stamp_ns), len(self._stamps) - 1)
        first, last = self._stamps[k - 1], self._stamps[k]
        share = (stamp_ns - first) / (last - first)
        return np.asarray((1.0 - share) * self._rows[k - 1] + share * self._rows[k])


@dataclass(frozen=True)
class Course:
    """Angle of lidar odometry against the positions and its variance, as known from a time on; `walk` per second."""

    stamp_ns: int
    angle_rad: float
    variance: float
    walk: float


class CourseOffset:
    """Angle by which lidar odometry is turned against the positions: mounts of lidar and antennas in yaw.

    Learned on straight parts of the path, and given as of a time, so that a fault that began later is not in it.
    """

    def __init__(self, config: SeparationConfig) -> None:
        self._rows: _Rows[Course] = _Rows()
        self._prior = Course(0, 0.0, math.radians(config.course_deg) ** 2, math.radians(config.course_walk_deg) ** 2)

    def clear(self) -> None:
        """Drops what is known of times; the newest angle remains, as well known as mounts are without a drive."""
        newest = self._rows.newest or self._prior
        self._rows.clear()
        self._prior = replace(self._prior, angle_rad=newest.angle_rad)

    def at(self, stamp_ns: int) -> Course:
        """What is known at a time."""
        return self._rows.at(stamp_ns) or self._prior

    def learn(self, stamp_ns: int, angle_rad: float, variance: float) -> None:
        """Takes the angle of a straight part of the path; one that contradicts the others is not used."""
        newest = self._rows.newest
        angle, known = (newest or self._prior).angle_rad, (newest or self._prior).variance
        if newest is not None:
            known = min(known + self._prior.walk * (stamp_ns - newest.stamp_ns) * 1e-9, self._prior.variance)
        total, off = known + variance, angle_rad - angle
        if off * off <= COURSE_GATE**2 * total:
            angle, known = angle + known / total * off, known * variance / total
        self._rows.add(Course(stamp_ns, angle, known, self._prior.walk))


class OdometrySeparation:
    """Positions of base against wheels at the calibration of the window's begin, or lidar odometry, both with gyro."""

    def __init__(
        self, config: SeparationConfig, slip_walk: Float64, density_m_per_rts: float, gyro: float, stamp_s: float
    ) -> None:
        self._config, self._slip_walk, self._density, self._gyro = config, slip_walk, density_m_per_rts, gyro
        self._stamp_s = stamp_s
        self._rows: _Rows[_Keyframe] = _Rows()
        self._columns = np.zeros((2, 4))
        self.lidar, self._course = LidarPath(), CourseOffset(config)
        self._straight: _Keyframe | None = None  # where the part of the path began whose course is measured next

    def clear(self) -> None:
        """Drops all keyframes."""
        self._rows.clear()
        self._course.clear()
        self._straight = None

    def advance(self, T_odom_base: Float64, columns: Float64) -> None:
        """Adds the displacement between two keyframes: `columns` (3, 4) in base at the first one, which is given."""
        self._columns = self._columns + (T_odom_base[:3, :3] @ columns)[:2]

    def add(
        self, fix: Position, base_m: Float64, state: State, T_map_odom: Float64, T_odom_base: Float64,
        late_rad: float,
    ) -> None:  # fmt: skip
        """Takes a fix propagated to the newest keyframe, and the position of base that follows from it.

        `late_rad`: error of the heading there by late fixes.
        """
        heading_slow = fix.heading_slow_rad if math.isfinite(fix.heading_slow_rad) else 0.0
        heading, last = yaw_of(state.T_map_body), self._rows.newest
        height_m = float((fix.p_map_m - base_m)[2])
        tilt_m = math.hypot(self._config.tilt_m, height_m * math.sqrt(float(np.max(np.diag(state.covariance)[:2]))))
        odom_m, path_m, turned = T_odom_base[:2, 3].copy(), 0.0, 0.0
        if last is not None:
            heading = last.heading_rad + wrap(heading - last.heading_rad)
            path_m = last.path_m + math.dist(odom_m, last.odom_m)
            turned = last.turned_rad + abs(heading - last.heading_rad)
        row = _Keyframe(
            state.stamp_ns, base_m[:2], _sigma_m(fix), tilt_m, state.velocity_mps[:2], self._columns,
            odom_m, path_m, turned, heading, yaw_of(T_map_odom),
            float(state.covariance[2, 2]) + heading_slow**2 + late_rad**2, float(state.sigmas[14]), state.slip,
            state.sigmas[15:19],
        )  # fmt: skip
        self._rows.add(row)
        self._learn_course()

    def course_at(self, stamp_ns: int) -> Course:
        """Angle of lidar odometry against the positions, as known at a time."""
        return self._course.at(stamp_ns)

    def _learn_course(self) -> None:
        """Measures the course offset when lidar odometry has passed `COURSE_M`."""
        first, last = self._straight, self._rows.at(self.lidar.last_ns)
        if last is None or (first is not None and last.stamp_ns <= first.stamp_ns):
            return
        found = None if first is None else self._by_lidar(first, last, 0.0)
        if first is not None and found is not None and math.hypot(*found[0]) < COURSE_M:
            return
        self._straight = last
        if first is None or found is None or abs(last.heading_rad - first.heading_rad) > COURSE_TURN_RAD:
            return
        moved_m, variance = found
        d_m, path2 = last.p_map_m - first.p_map_m - moved_m, float(moved_m @ moved_m)
        across = _across(moved_m)
        covariance = variance * np.eye(2) + self._common(first, last, moved_m)
        self._course.learn(last.stamp_ns, float(across @ d_m) / path2, float(across @ covariance @ across) / path2**2)

    def _by_lidar(self, first: _Keyframe, last: _Keyframe, course_rad: float) -> tuple[Float64, float] | None:
        """Displacement (2,) in `map` by lidar odometry that is turned by an angle, and its variance beside that of all
        paths; None where the lidar path does not reach."""
        begin, end, cfg = self.lidar.at(first.stamp_ns), self.lidar.at(last.stamp_ns), self._config
        if begin is None or end is None:
            return None
        moved_m = last.odom_m - first.odom_m + (end - begin)[:2]
        white = 2.0 * cfg.lidar_m**2 + (cfg.lidar_share * (last.path_m - first.path_m)) ** 2 + float(begin[2] + end[2])
        return _turn(first.yaw_map_odom_rad + course_rad) @ moved_m, white

    def slip_at(self, stamp_ns: int) -> tuple[Float64, Float64] | None:
        """Slip (4,) and its sigmas (4,) at a time, None before the first keyframe."""
        row = self._rows.at(stamp_ns)
        return None if row is None else (row.slip, row.slip_sigma)

    def since(self, stamp_ns: int) -> Separation | None:
        """Separation of the newest keyframe from wheels since a time; None when keyframes do not reach back to it."""
        first, last, cfg = self._rows.at(stamp_ns), self._rows.newest, self._config
        if first is None or last is None or last.stamp_ns <= stamp_ns:
            return None
        age_s = (last.stamp_ns - first.stamp_ns) * 1e-9
        columns = _turn(first.yaw_map_odom_rad) @ (last.columns - first.columns)
        moved_m = columns @ first.slip
        slip = first.slip_sigma**2 + self._slip_walk**2 * age_s / 3.0
        slip[0] += cfg.slip_change**2
        covariance = columns @ np.diag(slip) @ columns.T + self._density**2 * age_s * np.eye(2)
        covariance += self._common(first, last, moved_m)
        return Separation(age_s, last.p_map_m - first.p_map_m - moved_m, covariance, columns[:, 0])

    def by_lidar_since(self, stamp_ns: int) -> Separation | None:
        """Separation from lidar odometry since a time, of the newest keyframe that scans reach; None without them."""
        newest = self._rows.newest
        first, last = self._rows.at(stamp_ns), self._rows.at(self.lidar.last_ns)
        if newest is None or first is None or last is None or last.stamp_ns <= first.stamp_ns:
            return None
        course = self._course.at(first.stamp_ns)
        found = self._by_lidar(first, last, course.angle_rad)
        if found is None or newest.stamp_ns - last.stamp_ns > SCANS_S * 1e9:
            return None
        moved_m, white = found
        across = _across(moved_m)
        covariance = white * np.eye(2) + course.variance * np.outer(across, across)
        covariance += self._common(first, last, moved_m)
        age_s = (last.stamp_ns - first.stamp_ns) * 1e-9
        return Separation(age_s, last.p_map_m - first.p_map_m - moved_m, covariance, np.zeros(2))

    def _common(self, first: _Keyframe, last: _Keyframe, moved_m: Float64) -> Float64:
        """Covariance (2, 2) by fixes, gyro and mounting, whatever measures the path `moved_m` (2,)."""
        cfg, age_s = self._config, (last.stamp_ns - first.stamp_ns) * 1e-9
        across = _across(moved_m)
        turned = last.heading_rad - first.heading_rad
        yaw = first.yaw_variance + self._gyro**2 * age_s / 3.0 + (first.gyro_sigma_radps * age_s) ** 2 / 3.0
        turned_m = self._stamp_s * float(np.linalg.norm(last.velocity_mps - first.velocity_mps))
        white = first.sigma_m**2 + last.sigma_m**2 + turned_m**2 + first.tilt_m**2
        white += (2.0 * math.sin(0.5 * turned) * cfg.lever_arm_m) ** 2
        white += (cfg.gyro_scale * (last.turned_rad - first.turned_rad) * 0.5 * (last.path_m - first.path_m)) ** 2
        return np.asarray(yaw * np.outer(across, across) + white * np.eye(2))


def _distance(d_m: Float64, covariance: Float64) -> float:
    """Mahalanobis distance of d (2,)."""
    (a, b), (_, c) = covariance.tolist()
    x, y = d_m.tolist()
    return math.sqrt((c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b))


def _across(moved_m: Float64) -> Float64:
    return np.array([-moved_m[1], moved_m[0]])


def _turn(yaw_rad: float) -> Float64:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def _sigma_m(fix: Position) -> float:
    return float(np.max(np.hypot(fix.sigma_m, fix.slow_m)[:2]))
