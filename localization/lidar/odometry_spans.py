"""Lidar motions from scan to scan, joined to spans long enough to be worth a factor between two keyframes."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from configs.strict import Config
from geometry.transforms import Float64, invert
from localization.dead_reckoning.dead_reckoning import PoseHistory
from messages.motion import LidarOdometry


class LidarLinkConfig(Config):
    """Spans of lidar odometry. Errors of matching against one local map do not add up from scan to scan."""

    span_s: float = Field(gt=0.0, le=10.0)
    tolerance_s: float = Field(
        gt=0.0, le=0.5, description="from a scan to the nearest keyframe, bridged by dead reckoning"
    )
    rotation_sigma_deg: float = Field(gt=0.0, le=10.0, description="a span is not believed better than this")
    translation_sigma_m: float = Field(gt=0.0, le=1.0)
    translation_sigma_share: float = Field(ge=0.0, le=0.5, description="of the way")


@dataclass(frozen=True)
class Span:
    """A motion of base over some scans."""

    start_ns: int
    end_ns: int
    T_start_end: Float64
    covariance: Float64


def is_sane(motion: LidarOdometry) -> bool:
    """Whether a motion may be looked at at all."""
    if not motion.is_valid or motion.from_stamp_ns >= motion.stamp_ns:
        return False
    T, covariance = motion.T_from_to, motion.covariance
    return (
        T.shape == (4, 4)
        and covariance.shape == (6, 6)
        and bool(np.isfinite(T).all() and np.isfinite(covariance).all())
    )


class LidarLink:
    """Joins valid motions that follow on each other; a gap or a refused one starts anew."""

    def __init__(self, config: LidarLinkConfig) -> None:
        self._config = config
        self._open: Span | None = None
        self._done: list[Span] = []

    def clear(self) -> None:
        """Forgets everything."""
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
            span = Span(span.start_ns, motion.stamp_ns, T, np.maximum(span.covariance, motion.covariance))
        else:
            span = Span(motion.from_stamp_ns, motion.stamp_ns, motion.T_from_to, motion.covariance)
        self._open = span
        if span.end_ns - span.start_ns >= self._config.span_s * 1e9:
            self._done.append(span)
            self._open = None

    def take(self, until_ns: int) -> list[Span]:
        """Finished spans that end before `until_ns`."""
        ready = [span for span in self._done if span.end_ns <= until_ns]
        self._done = [span for span in self._done if span.end_ns > until_ns]
        return ready

    def covariance(self, span: Span) -> Float64:
        """What to trust a span with, (6, 6): matching's own covariance, never below the floor."""
        way = float(np.linalg.norm(span.T_start_end[:3, 3]))
        translation = self._config.translation_sigma_m + self._config.translation_sigma_share * way
        floor = np.repeat([np.radians(self._config.rotation_sigma_deg), translation], 3) ** 2
        return np.diag(np.maximum(np.diag(span.covariance), floor))


def moved_to(span: Span, history: PoseHistory, start_ns: int, end_ns: int) -> Float64 | None:
    """The span's motion carried over to two keyframes near its ends by dead reckoning; None when not covered."""
    poses = [history.at(t) for t in (start_ns, span.start_ns, span.end_ns, end_ns)]
    if any(p is None for p in poses):
        return None
    key_start, scan_start, scan_end, key_end = (p for p in poses if p is not None)
    return invert(key_start) @ scan_start @ span.T_start_end @ invert(scan_end) @ key_end
