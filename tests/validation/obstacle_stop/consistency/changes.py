"""Changes of the messages of a log, as a fault of its recording would make them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from datasets.importers.point_clouds import list_scan
from messages.message import Envelope
from messages.motion import Odometry
from messages.sensors import LidarScan
from messages.truth import TrueMachine, TrueObjects

Change = Callable[[Envelope], Envelope | None]


def unchanged(envelope: Envelope) -> Envelope:
    """The log as it is."""
    return envelope


def moved_labels(x_m: float, y_m: float) -> Change:
    """Labels out of place."""

    def change(envelope: Envelope) -> Envelope:
        truth = envelope.message
        if not isinstance(truth, TrueObjects):
            return envelope
        by = np.array([x_m, y_m, 0.0])
        objects = tuple(replace(o, center_map_m=o.center_map_m + by) for o in truth.objects)
        return replace(envelope, message=replace(truth, objects=objects))

    return change


def late(kinds: type | tuple[type, ...], by_s: float) -> Change:
    """Messages of these types stamped and delivered late."""

    def change(envelope: Envelope) -> Envelope:
        if not isinstance(envelope.message, kinds):
            return envelope
        by = round(by_s * 1e9)
        message = replace(envelope.message, stamp_ns=envelope.message.stamp_ns + by)
        return replace(envelope, receive_ns=envelope.receive_ns + by, message=message)

    return change


def late_truth(by_s: float) -> Change:
    """Truth with times later than the true ones."""
    return late((TrueObjects, TrueMachine), by_s)


def late_scans(by_s: float) -> Change:
    """Scans with times later than the true ones."""
    return late(LidarScan, by_s)


def without_rings(elevation_deg: tuple[float, ...], is_kept: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Scans with a selection of the rings, by number from below."""
    table = np.array(elevation_deg)

    def change(envelope: Envelope) -> Envelope:
        scan = envelope.message
        if not isinstance(scan, LidarScan):
            return envelope
        p = scan.points_m
        elevation = np.degrees(np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1])))
        after = np.clip(np.searchsorted(table, elevation), 1, len(table) - 1)
        ring = after - (elevation - table[after - 1] < table[after] - elevation)
        return replace(envelope, message=list_scan(scan.stamp_ns, p[is_kept(ring)]))

    return change


def scaled_odometry(factor: float) -> Change:
    """Odometry with distances and speed by a factor."""

    def change(envelope: Envelope) -> Envelope:
        odom = envelope.message
        if not isinstance(odom, Odometry):
            return envelope
        T = odom.T_odom_base.copy()
        T[:2, 3] *= factor
        return replace(envelope, message=replace(odom, T_odom_base=T, speed_mps=odom.speed_mps * factor))

    return change


def between(kinds: type | tuple[type, ...], from_s: float, to_s: float, start_ns: int) -> Change:
    """A log without the messages of these types in an interval."""

    def change(envelope: Envelope) -> Envelope | None:
        t_s = (envelope.message.stamp_ns - start_ns) * 1e-9
        return None if isinstance(envelope.message, kinds) and from_s <= t_s < to_s else envelope

    return change
