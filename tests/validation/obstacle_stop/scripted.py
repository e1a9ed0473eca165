"""Scripted drives: messages of a replay from a motion, true objects, and requests at stated times. No sensor data."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from geometry.drawbar import Trailer
from geometry.pose2 import from_frame
from geometry.rectangle import Rectangle
from geometry.transforms import planar
from messages.command import Mode, RuleResult, SupervisorState
from messages.faults import Response
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.perception import ObstacleClass
from messages.truth import Occlusion, TrueObject, TrueObjects
from validation.obstacle_stop.conditions import Conditions, load_conditions
from validation.obstacle_stop.encounters import Encounter, find_encounters
from validation.obstacle_stop.observation import LogObservation, Setting
from validation.obstacle_stop.observer import Observer
from validation.obstacle_stop.swept_path import Outline
from validation.obstacle_stop.visibility import View

START_NS = 1_700_000_000_000_000_000
FRONT_M, REAR_M, WIDTH_M = 3.6, 1.0, 1.8
STEP_S, TRUTH_S, STATE_S = 0.02, 0.1, 0.02
CONDITIONS = load_conditions(None)
NONE = RuleResult("protective_field", Response.NONE, math.inf, "")
Motion = Callable[[float], tuple[float, float, float]]  # x, y, yaw by time
Positions = Callable[[float], tuple[float, float]]


def straight(speed_mps: float) -> Motion:
    """Constant speed along x; negative: reverse."""
    return lambda t: (speed_mps * t, 0.0, 0.0)


def braking(speed_mps: float, from_s: float, deceleration_mps2: float) -> Motion:
    """Constant speed along x, then braking to standstill."""

    def at(t: float) -> tuple[float, float, float]:
        after = min(max(0.0, t - from_s), speed_mps / deceleration_mps2)
        return speed_mps * (min(t, from_s) + after) - 0.5 * deceleration_mps2 * after**2, 0.0, 0.0

    return at


@dataclass(frozen=True)
class Thing:
    """A true object: positions of its centre by time (None: no label), size, occlusion by label."""

    id: int
    at: Callable[[float], tuple[float, float] | None]
    size_m: tuple[float, float, float] = (0.6, 0.6, 1.8)
    occlusion: Occlusion = Occlusion.UNKNOWN
    label: ObstacleClass = ObstacleClass.PERSON


def standing(id: int, x_m: float, y_m: float = 0.0, **more: object) -> Thing:
    """An object that stays."""
    return Thing(id, lambda t: (x_m, y_m), **more)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Request:
    """A requested speed from one stamp to another for an object (None: points at `at_base_m`)."""

    from_s: float
    to_s: float
    object_id: int | None
    limit_mps: float = 0.0
    at_base_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Script:
    """A drive of `seconds`; requests are delivered `latency_s` after their stamps."""

    motion: Motion
    things: Sequence[Thing]
    requests: Sequence[Request] = ()
    seconds: float = 5.0
    latency_s: float = 0.0
    working: Outline = field(default_factory=lambda: Outline((Rectangle(-REAR_M, FRONT_M, WIDTH_M),)))
    half_width_m: float = 0.5 * WIDTH_M
    is_manual: bool = True


def with_implement(body: Rectangle, trailer: Trailer | None = None) -> Outline:
    """Machine with an implement."""
    return Outline((Rectangle(-REAR_M, FRONT_M, WIDTH_M), body), trailer)


def setting_of(script: Script) -> Setting:
    """Setting with one lidar that sees all around."""
    T = np.eye(4)
    T[:3, 3] = (1.0, 0.0, 2.0)
    view = View(T, math.pi, (math.radians(-30.0), math.radians(10.0)), 80.0)
    return Setting("script", {"base": np.eye(4)}, FRONT_M, WIDTH_M, script.half_width_m, "base", math.pi,
                   script.working, script.working, (view,), script.is_manual)  # fmt: skip


def messages_of(script: Script) -> list[Envelope]:
    """All messages in the order of delivery."""
    rows = [_row("odom", t, 0.0, _odometry(script.motion, t)) for t in _times(script, STEP_S)]
    rows += [_row("truth_objects/base", t, 0.0, _truth(script, t)) for t in _times(script, TRUTH_S)]
    rows += [_row("supervisor", t, script.latency_s, _state(script, t)) for t in _times(script, STATE_S)]
    end_ns = START_NS + round(script.seconds * 1e9)
    rows = [row for row in rows if row[0] <= end_ns]
    return [Envelope(topic, k, at, message) for k, (at, topic, message) in enumerate(sorted(rows, key=lambda r: r[0]))]


def _times(script: Script, step_s: float) -> list[float]:
    return [k * step_s for k in range(round(script.seconds / step_s) + 1)]


def _row(topic: str, t: float, latency_s: float, message: Message) -> tuple[int, str, Message]:
    return START_NS + round((t + latency_s) * 1e9), topic, message


def _odometry(motion: Motion, t: float) -> Odometry:
    (x, y, yaw), (x1, y1, yaw1) = motion(t), motion(t + 1e-4)
    speed = ((x1 - x) * math.cos(yaw) + (y1 - y) * math.sin(yaw)) / 1e-4
    rate = (yaw1 - yaw) / 1e-4
    return Odometry(START_NS + round(t * 1e9), planar(x, y, yaw), speed, 0.0, 0.0, rate, 0.0, np.eye(6))


def in_base(script: Script, thing: Thing, t: float) -> np.ndarray | None:
    """Centre (2,) of an object in base at a time."""
    xy = thing.at(t)
    return None if xy is None else from_frame(np.array(script.motion(t)), np.array([xy]))[0]


def _truth(script: Script, t: float) -> TrueObjects:
    objects = []
    for thing in script.things:
        xy = in_base(script, thing, t)
        if xy is not None:
            center, size = np.array([*xy, 0.5 * thing.size_m[2]]), np.array(thing.size_m)
            yaw = -script.motion(t)[2]
            objects.append(TrueObject(thing.id, thing.label, f"object {thing.id}", center, size, yaw,
                                      np.full(2, np.nan), math.nan, thing.occlusion))  # fmt: skip
    return TrueObjects(START_NS + round(t * 1e9), tuple(objects))


def _state(script: Script, t: float) -> SupervisorState:
    active = [r for r in script.requests if r.from_s - 1e-6 <= t < r.to_s - 1e-6]
    rules, points = (NONE,), np.empty((0, 3), np.float32)
    if active:
        one = active[0]
        response = Response.CONTROLLED_STOP if one.limit_mps <= 0.0 else Response.LIMIT
        rules = (RuleResult("protective_field", response, one.limit_mps, "obstacle"),)
        thing = next((thing for thing in script.things if thing.id == one.object_id), None)
        xy = np.array(one.at_base_m) if thing is None else in_base(script, thing, t)
        points = np.array([[*xy, 0.5]], np.float32) if xy is not None else points
    return SupervisorState(
        START_NS + round(t * 1e9), Mode.AUTOMATIC, "", rules, ObstacleClass.PERSON, math.inf, 0.0, 0.0, 0.0, 0.0,
        points, np.empty((0, 2)),
    )  # fmt: skip


def observe(script: Script, conditions: Conditions = CONDITIONS) -> LogObservation:
    """Observation of a script."""
    observer = Observer(setting_of(script), conditions)
    for envelope in messages_of(script):
        observer(envelope)
    return observer.finish()


def judge(script: Script, conditions: Conditions = CONDITIONS) -> list[Encounter]:
    """Encounters of a script."""
    return find_encounters("script", observe(script, conditions), conditions)
