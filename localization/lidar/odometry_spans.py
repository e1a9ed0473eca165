"""Odometry spans: lidar motions between scans, joined to one factor between two keyframes."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.arrays import Float64
from geometry.transforms import invert
from localization.dead_reckoning.dead_reckoning import PoseHistory
from messages.motion import LidarOdometry


class OdometrySpansConfig(Config):
    """Section `odometry_spans`; errors of matching against one local map do not accumulate between scans."""

    span_s: float = Field(gt=0.0, le=10.0)
    tolerance_s: float = Field(
        gt=0.0, le=0.5, description="from a scan to the nearest keyframe, bridged by dead reckoning"
    )
    rotation_sigma_deg: float = Field(gt=0.0, le=10.0, description="lower bound of a span")
    translation_sigma_m: float = Field(gt=0.0, le=1.0)
    translation_sigma_share: float = Field(ge=0.0, le=0.5, description="per path length")


@dataclass(frozen=True)
class OdometrySpan:
    """A motion of base over some scans."""

    start_ns: int
    end_ns: int
    T_start_end: Float64
    covariance: Float64


def is_sane(motion: LidarOdometry) -> bool:
    """Whether a motion is valid and finite."""
    if not motion.is_valid or motion.from_stamp_ns >= motion.stamp_ns:
        return False
    T, covariance = motion.T_from_to, motion.covariance
    return (
        T.shape == (4, 4)
        and covariance.shape == (6, 6)
        and bool(np.isfinite(T).all() and np.isfinite(covariance).all())
    )


class OdometrySpans:
    """Joins consecutive valid motions; a gap or an invalid motion starts a new span."""

    def __init__(self, config: OdometrySpansConfig) -> None:
        self._config = config
        self._open: OdometrySpan | None = None
        self._done: list[OdometrySpan] = []

    def clear(self) -> None:
        """Drops all motions."""
        self._open = None
        self._done.clear()

    def add(self, motion: LidarOdometry) -> None:
        """Takes the next motion."""
        if not is_sane(motion):
            self._open = None
            return
        span = self._open
        if span is not None and span.end_ns == motion.from_stamp_ns:
            T = span.T_start_end @ motion.T_from_to
            span = OdometrySpan(span.start_ns, motion.stamp_ns, T, np.maximum(span.covariance, motion.covariance))
        else:
            span = OdometrySpan(motion.from_stamp_ns, motion.stamp_ns, motion.T_from_to, motion.covariance)
        self._open = span
        if span.end_ns - span.start_ns >= self._config.span_s * 1e9:
            self._done.append(span)
            self._open = None

    def take(self, until_ns: int) -> list[OdometrySpan]:
        """Finished spans that end before `until_ns`."""
        ready = [span for span in self._done if span.end_ns <= until_ns]
        self._done = [span for span in self._done if span.end_ns > until_ns]
        return ready

    def covariance(self, span: OdometrySpan) -> Float64:
        """Covariance (6, 6) of a span: that of matching, with the configured floor."""
        path_m = float(np.linalg.norm(span.T_start_end[:3, 3]))
        translation = self._config.translation_sigma_m + self._config.translation_sigma_share * path_m
        floor = np.repeat([np.radians(self._config.rotation_sigma_deg), translation], 3) ** 2
        return np.diag(np.maximum(np.diag(span.covariance), floor))


def motion_between(span: OdometrySpan, history: PoseHistory, start_ns: int, end_ns: int) -> Float64 | None:
    """The span's motion moved to two keyframes near its ends by dead reckoning; None when not covered."""
    poses = [history.at(t) for t in (start_ns, span.start_ns, span.end_ns, end_ns)]
    if any(p is None for p in poses):
        return None
    key_start, scan_start, scan_end, key_end = (p for p in poses if p is not None)
    return invert(key_start) @ scan_start @ span.T_start_end @ invert(scan_end) @ key_end
