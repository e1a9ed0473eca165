"""GNSS receiver model: antenna position with correlated errors, baseline heading, solution states and outages."""

import math

import numpy as np
from pydantic import Field
from shapely import Point, Polygon

from configs.site import Shed
from configs.strict import Config
from configs.vehicle import Gnss
from geometry.angles import wrap
from geometry.arrays import Float64
from geometry.geodesy import Datum
from messages.message import Message
from messages.sensors import GnssFix, GnssSolution
from simulation.scenario import GnssEpisode
from simulation.sensors.sensor import WorldState, period_ns_of


class GnssConfig(Config):
    """Time behaviour of errors, and accuracy of solutions other than RTK fixed."""

    latency_s: float = Field(ge=0.0, le=1.0)
    correlated_share: float = Field(
        ge=0.0, le=1.0, description="share of the variance in the Gauss-Markov part; the rest is white"
    )
    correlation_s: float = Field(gt=0.1, le=3600.0, description="of the Gauss-Markov part")
    velocity_sigma_mps: float = Field(gt=0.0, le=5.0)
    float_sigma_m: float = Field(gt=0.0, le=10.0)
    single_sigma_m: float = Field(gt=0.0, le=50.0)
    multipath_distance_m: float = Field(
        ge=0.0, le=50.0, description="from a shed: multipath limits the solution to float"
    )
    reacquisition_s: float = Field(ge=0.0, le=600.0, description="from free sky to the first position after a roof")
    ambiguity_fix_s: float = Field(
        ge=0.0, le=600.0, description="from free sky to fixed ambiguities after roof or multipath"
    )
    error_scale: float = Field(gt=0.0, le=10.0, description="true error over the stated sigma")
    wrong_fixes_per_hour: float = Field(ge=0.0, le=600.0, description="wrong ambiguities that are stated as fixed")
    multipath_per_hour: float = Field(ge=0.0, le=600.0, description="multipath that is stated as fixed")
    wrong_fix_m: tuple[float, float] = Field(description="horizontal error of a wrong fix")
    multipath_m: tuple[float, float] = Field(description="largest horizontal error of multipath")
    episode_s: tuple[float, float] = Field(description="duration of a wrong fix or of multipath")


class SkyView:
    """Best solution that sky visibility permits, by present and past antenna positions."""

    def __init__(self, shed: Shed | None, config: GnssConfig) -> None:
        self._roof = None if shed is None else Polygon(shed.outline_m)
        self._config = config
        self._last_covered_s = self._last_multipath_s = -math.inf

    def best_solution(self, x_m: float, y_m: float, elapsed_s: float) -> GnssSolution:
        """Best solution now."""
        distance_m = math.inf if self._roof is None else self._roof.distance(Point(x_m, y_m))
        if distance_m == 0.0:
            self._last_covered_s = elapsed_s
        if distance_m < self._config.multipath_distance_m:
            self._last_multipath_s = elapsed_s
        if elapsed_s - self._last_covered_s < self._config.reacquisition_s or distance_m == 0.0:
            return GnssSolution.NONE
        is_fixed = (
            distance_m >= self._config.multipath_distance_m
            and elapsed_s - self._last_multipath_s >= self._config.ambiguity_fix_s
        )
        return GnssSolution.RTK_FIXED if is_fixed else GnssSolution.RTK_FLOAT


class UnstatedErrors:
    """Wrong fixes (a step) and multipath (a slow rise and fall) that the receiver states as fixed, one at a time."""

    def __init__(self, config: GnssConfig, random: np.random.Generator) -> None:
        self._config, self._random = config, random
        self._rates = np.array([config.wrong_fixes_per_hour, config.multipath_per_hour]) / 3600.0
        self._next_s = self._draw_start(0.0)
        self._began_s = self._end_s = -math.inf
        self._peak_m, self._is_step = np.zeros(3), True

    def error_m(self, elapsed_s: float) -> Float64:
        """Error (3,) east, north, up at this time."""
        if elapsed_s >= self._next_s:
            self._begin(elapsed_s)
        if elapsed_s >= self._end_s:
            return np.zeros(3)
        share = (self._end_s - elapsed_s) / (self._end_s - self._began_s)
        return self._peak_m if self._is_step else self._peak_m * math.sin(math.pi * share)

    def _begin(self, elapsed_s: float) -> None:
        random, config = self._random, self._config
        self._is_step = bool(random.random() < self._rates[0] / self._rates.sum())
        size_m = random.uniform(*(config.wrong_fix_m if self._is_step else config.multipath_m))
        angle = random.uniform(0.0, 2.0 * math.pi)
        self._peak_m = size_m * np.array([math.cos(angle), math.sin(angle), random.uniform(-2.0, 2.0)])
        self._began_s, self._end_s = elapsed_s, elapsed_s + random.uniform(*config.episode_s)
        self._next_s = self._draw_start(self._end_s)

    def _draw_start(self, after_s: float) -> float:
        rate = float(self._rates.sum())
        return after_s + float(self._random.exponential(1.0 / rate)) if rate > 0.0 else math.inf


class GnssModel:
    """One receiver with its antenna (and a second one, ahead of it, if it measures heading)."""

    def __init__(
        self, name: str, gnss: Gnss, datum: Datum, shed: Shed | None, episodes: tuple[GnssEpisode, ...],
        config: GnssConfig, random: np.random.Generator,
    ) -> None:  # fmt: skip
        self.topic = f"gnss/{name}"
        self.period_ns = period_ns_of(gnss.rate_hz)
        self.latency_ns = round(config.latency_s * 1e9)
        self._gnss, self._datum, self._episodes, self._config, self._random = gnss, datum, episodes, config, random
        self._T_base_antenna = gnss.mount.T_base_sensor
        self._sky_view = SkyView(shed, config)
        self._correlated = random.standard_normal(4)
        self._corrected_s = 0.0
        self._unstated = UnstatedErrors(config, random)

    def sample(self, state: WorldState) -> Message:
        """The fix now; NaN position without a solution."""
        antenna = state.poses.steps_ago(0) @ self._T_base_antenna
        sky_view = self._sky_view.best_solution(float(antenna[0, 3]), float(antenna[1, 3]), state.elapsed_s)
        solution = min(sky_view, solution_at(self._episodes, state.elapsed_s))
        self._corrected_s = state.elapsed_s if solution >= GnssSolution.RTK_FLOAT else self._corrected_s
        errors = self._draw_errors()
        if solution == GnssSolution.NONE:
            return no_fix(state.stamp_ns)
        before = state.poses.steps_ago(2) @ self._T_base_antenna
        velocity = (antenna[:3, 3] - before[:3, 3]) / (2e-9 * state.poses.step_ns)
        sigma = self._sigma_enu(solution)
        error_m = self._config.error_scale * sigma * errors[:3] + self._unstated.error_m(state.elapsed_s)
        latitude, longitude, height = self._datum.to_ellipsoid(*map(float, antenna[:3, 3] + error_m))
        heading_sigma = math.radians(self._gnss.sigma_heading_deg) if self._has_heading(solution) else math.nan
        age = 1.0 if solution >= GnssSolution.RTK_FLOAT else state.elapsed_s - self._corrected_s
        return GnssFix(
            state.stamp_ns, latitude, longitude, height, sigma,
            velocity + self._config.velocity_sigma_mps * self._random.standard_normal(3),
            self._config.velocity_sigma_mps, wrap(math.atan2(antenna[1, 0], antenna[0, 0]) + heading_sigma * errors[3]),
            heading_sigma, solution, 22 if solution > GnssSolution.SINGLE else 9, 0.7, age, "BDS+GPS",
        )  # fmt: skip

    def _has_heading(self, solution: GnssSolution) -> bool:
        return self._gnss.has_heading and solution >= GnssSolution.RTK_FLOAT

    def _sigma_enu(self, solution: GnssSolution) -> Float64:
        scale = {
            GnssSolution.RTK_FIXED: 1.0,
            GnssSolution.RTK_FLOAT: self._config.float_sigma_m / self._gnss.sigma_horizontal_m,
        }.get(solution, self._config.single_sigma_m / self._gnss.sigma_horizontal_m)
        horizontal, vertical = self._gnss.sigma_horizontal_m * scale, self._gnss.sigma_vertical_m * scale
        return np.array([horizontal, horizontal, vertical])

    def _draw_errors(self) -> Float64:
        """Normalised errors of east, north, up and heading: a first-order Gauss-Markov and a white part."""
        keep = math.exp(-self.period_ns * 1e-9 / self._config.correlation_s)
        self._correlated = keep * self._correlated + math.sqrt(1.0 - keep * keep) * self._random.standard_normal(4)
        share = self._config.correlated_share
        return np.asarray(
            math.sqrt(share) * self._correlated + math.sqrt(1.0 - share) * self._random.standard_normal(4)
        )


def solution_at(episodes: tuple[GnssEpisode, ...], elapsed_s: float) -> GnssSolution:
    """Worst state of all active episodes; RTK fixed without one."""
    states = [GnssSolution[e.state.upper()] for e in episodes if e.from_s <= elapsed_s < e.from_s + e.for_s]
    return min(states, default=GnssSolution.RTK_FIXED)


def no_fix(stamp_ns: int) -> GnssFix:
    """A fix without position."""
    nan = math.nan
    nans = np.full(3, nan)
    return GnssFix(stamp_ns, nan, nan, nan, nans, nans.copy(), nan, nan, nan, GnssSolution.NONE, 0, nan, nan, "")
