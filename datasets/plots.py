"""Flat numbers for the plots of viewers, which cannot plot a pose matrix: pure functions."""

import math
from dataclasses import dataclass

from geometry.arrays import Float64
from geometry.transforms import yaw_of
from messages.command import SupervisorState
from messages.faults import Response
from messages.message import MessagePart

STOP_MPS = 0.3  # a limit below it is a request to stand


@dataclass(frozen=True)
class PlottedPose(MessagePart):
    """Planar pose of `base` in the frame of the topic, and its motion."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True)
class PlottedState(MessagePart):
    """Supervisor state; NaN where there is no limit or no obstacle."""

    mode: str
    reason: str
    obstacle_class: str
    speed_limit_mps: float
    clearance_m: float
    stopping_distance_m: float
    required_range_m: float
    detection_range_m: float


@dataclass(frozen=True)
class PlottedEvent(MessagePart):
    """A stop or an encounter at the time of the message; `id` is that of the true object, -1 without one."""

    kind: str
    id: int
    outcome: str
    text: str


def plotted_pose(T: Float64, speed_mps: float, yaw_rate_radps: float) -> PlottedPose:
    """The planar part of a pose (4, 4)."""
    return PlottedPose(float(T[0, 3]), float(T[1, 3]), yaw_of(T), speed_mps, yaw_rate_radps)


def plotted_state(state: SupervisorState) -> PlottedState:
    """The state with the lowest limit of its rules."""
    limit_mps = min((rule.speed_limit_mps for rule in state.rules), default=math.inf)
    return PlottedState(
        str(state.mode), state.reason, str(state.obstacle_class), _finite(limit_mps), _finite(state.clearance_m),
        _finite(state.stopping_distance_m), _finite(state.required_range_m), _finite(state.detection_range_m),
    )  # fmt: skip


def stop_request(state: SupervisorState) -> str:
    """Code of the first rule that requests a stop, "" without one."""
    rules = (r for r in state.rules if r.response >= Response.CONTROLLED_STOP or r.speed_limit_mps < STOP_MPS)
    return next((rule.code for rule in rules), "")


def _finite(value: float) -> float:
    return value if math.isfinite(value) else math.nan
