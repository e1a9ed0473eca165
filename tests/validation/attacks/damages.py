"""Changes of a whole log, as a fault of its recording, its import or its labels would make them."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from datasets.importers.point_clouds import list_scan
from messages.message import Envelope, Message
from messages.motion import Odometry
from messages.sensors import LidarScan
from messages.truth import TrueMachine, TrueObject, TrueObjects
from tests.validation.obstacle_stop.consistency.changes import Change as Each
from tests.validation.obstacle_stop.consistency.world import START_NS

Envelopes = list[Envelope]
Change = Callable[[Envelopes], Iterable[Envelope]]
TRUTH = (TrueObjects, TrueMachine)


def seconds(message: Message) -> float:
    """Time of a message since the start of the log."""
    return (message.stamp_ns - START_NS) * 1e-9


def by_time(envelopes: Iterable[Envelope]) -> Envelopes:
    """In order of delivery."""
    return sorted(envelopes, key=lambda e: e.receive_ns)


def each(change: Each) -> Change:
    """A change of each message (None drops it)."""
    return lambda es: by_time(c for e in es if (c := change(e)) is not None)


def both(first: Change, second: Change) -> Change:
    """One change after the other."""
    return lambda es: second(list(first(es)))


def of(kind: type | tuple[type, ...], change: Callable[[Any], Message | None]) -> Change:
    """A change of the messages of a type by their content (None drops one)."""

    def one(envelope: Envelope) -> Envelope | None:
        if not isinstance(envelope.message, kind):
            return envelope
        message = change(envelope.message)
        return None if message is None else replace(envelope, message=message)

    return each(one)


def delivered_late(kind: type | tuple[type, ...], by_s: float) -> Change:
    """Messages of a type received late, with their true stamps."""
    by = round(by_s * 1e9)
    return each(lambda e: replace(e, receive_ns=e.receive_ns + by) if isinstance(e.message, kind) else e)


def stamped(kind: type | tuple[type, ...], by_s: float) -> Change:
    """Messages of a type with stamps out of time, received as before."""
    return of(kind, lambda m: replace(m, stamp_ns=m.stamp_ns + round(by_s * 1e9)))


def points(change: Callable[[np.ndarray, float], np.ndarray]) -> Change:
    """Scans with other points, by the points and the time."""
    return of(LidarScan, lambda s: list_scan(s.stamp_ns, change(s.points_m, seconds(s)).astype(np.float32)))


def labels(change: Callable[[TrueObject, float], TrueObject | None]) -> Change:
    """Truth with other objects, by the object and the time (None removes one)."""

    def changed(truth: TrueObjects) -> TrueObjects:
        objects = (change(one, seconds(truth)) for one in truth.objects)
        return replace(truth, objects=tuple(o for o in objects if o is not None))

    return of(TrueObjects, changed)


def one_label(id: int, change: Callable[[TrueObject, float], TrueObject | None]) -> Change:
    """Truth with another object of this number."""
    return labels(lambda one, t: change(one, t) if one.id == id else one)


def cloud(center_m: tuple[float, float, float], spread_m: float, count: int, from_s: float = 0.0) -> Change:
    """Scans with a cloud of returns around a point in the frame of the sensor, in every scan from a time on."""
    rng = np.random.default_rng(11)

    def add(p: np.ndarray, t: float) -> np.ndarray:
        return np.vstack([p, rng.normal(center_m, spread_m, (count, 3))]) if t >= from_s else p

    return points(add)


def moved_poses(change: Callable[[np.ndarray, float], np.ndarray]) -> Change:
    """Odometry with other poses (4, 4), by pose and time; the speed as before."""
    return of(Odometry, lambda m: replace(m, T_odom_base=change(m.T_odom_base.copy(), seconds(m))))


def cut(from_s: float, to_s: float) -> Change:
    """A part of the log."""
    return lambda es: [e for e in es if from_s <= (e.receive_ns - START_NS) * 1e-9 < to_s]


def every(kind: type | tuple[type, ...], n: int) -> Change:
    """Each n-th moment with messages of a type."""
    return of(kind, lambda m: m if round(seconds(m) * 10) % n == 0 else None)
