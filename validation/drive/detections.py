"""What each sensor told of the objects that were truly there, look by look."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from configs.vehicle import Vehicle
from geometry.arrays import Float64
from geometry.transforms import invert
from messages.message import Envelope
from messages.perception import Obstacles
from messages.truth import TrueMachine, TrueObject, TrueObjects
from validation.obstacle_stop.boxes import Box, box_of
from validation.obstacle_stop.ranges import range_without_failure, share_bounds

NEAR_M = 1.0  # a detection this near to a true box, and its own sigma, is of that object
MOST_SIGMA_M = 2.0
SAME_NS = 60_000_000  # truth comes at 10 Hz
EDGES_M = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)
KEPT = 20


@dataclass(frozen=True, eq=False)
class View:
    """Where a sensor looks: its pose in base, half its opening about its x axis, and how far it reaches."""

    T_base_sensor: Float64
    half_rad: float
    reach_m: float

    def range_of(self, box: Box) -> float:
        """Level distance to the box, infinite when its middle is out of view or it is too far."""
        away = float(box.away_m(self.T_base_sensor[None, :2, 3])[0])
        p = invert(self.T_base_sensor) @ np.append(box.center_m, 1.0)
        is_seen = abs(math.atan2(p[1], p[0])) <= self.half_rad and away <= self.reach_m
        return away if is_seen else math.inf


def views_of(vehicle: Vehicle) -> dict[str, View]:
    """The vehicle's obstacle sensors by the names that their obstacles carry."""
    sensors, out = vehicle.sensors, {}
    for name, lidar in sensors.lidar.items():
        half = math.radians(lidar.field_of_view_deg) / 2.0
        out[f"lidar_{name}"] = View(lidar.mount.T_base_sensor, half, lidar.range_m[1])
    for name, camera in sensors.camera.items():
        half = math.atan(0.5 * camera.size_px[0] / camera.focal_px[0])
        out[f"camera_{name}"] = View(camera.mount.T_base_sensor, half, EDGES_M[-1])
    for name, radar in sensors.radar.items():
        half = math.radians(radar.field_of_view_deg) / 2.0
        out[f"radar_{name}"] = View(radar.mount.T_base_sensor, half, radar.range_m[1])
    for name, one in sensors.ultrasonic.items():
        out[f"ultrasonic_{name}"] = View(one.mount.T_base_sensor, math.radians(one.cone_deg) / 2.0, one.range_m[1])
    return out


@dataclass(frozen=True)
class Look:
    """One sensor's measurement and one true object in its view; `found_m` is the range that it told, NaN for none."""

    sensor: str
    stamp_ns: int
    role: str
    label: str
    range_m: float
    found_m: float

    @property
    def is_found(self) -> bool:
        """Whether it told the object."""
        return math.isfinite(self.found_m)


class Detections:
    """A sink: call it with every envelope; `looks` are then all looks at objects with a role."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.looks: list[Look] = []
        self._views = views_of(vehicle)
        self._truths: deque[TrueObjects] = deque(maxlen=KEPT)
        self._machines: deque[TrueMachine] = deque(maxlen=2 * KEPT)

    @property
    def topics(self) -> frozenset[str]:
        """What it must be shown of a log."""
        return frozenset({"truth_machine", "truth_objects", *(f"obstacles/{name}" for name in self._views)})

    def needs(self, topic: str) -> bool:
        """Whether the next message of a topic can tell of anything: most objects are far from a short sight."""
        view = self._views.get(topic.partition("/")[2]) if topic.startswith("obstacles/") else None
        return view is None or any(is_within_reach(thing, view) for truth in self._truths for thing in truth.objects)

    def __call__(self, envelope: Envelope) -> None:
        """Take note of a message."""
        message = envelope.message
        if isinstance(message, TrueObjects):
            self._truths.append(message)
        elif isinstance(message, TrueMachine):
            self._machines.append(message)
        elif isinstance(message, Obstacles) and message.sensor in self._views:
            self._look(message)

    def _look(self, told: Obstacles) -> None:
        truth = min(self._truths, key=lambda m: abs(m.stamp_ns - told.stamp_ns), default=None)
        machine = min(self._machines, key=lambda m: abs(m.stamp_ns - told.stamp_ns), default=None)
        if truth is None or machine is None or abs(truth.stamp_ns - told.stamp_ns) > SAME_NS:
            return
        view, T_base_map = self._views[told.sensor], invert(machine.T_map_base)
        for thing in truth.objects:
            if not is_within_reach(thing, view):
                continue
            box = box_of(thing, T_base_map)
            range_m = view.range_of(box)
            if math.isfinite(range_m):
                found = found_range(told, box, view)
                self.looks.append(Look(told.sensor, told.stamp_ns, thing.role, thing.label.value, range_m, found))


def is_within_reach(thing: TrueObject, view: View) -> bool:
    """Whether an object of the scenario may be in a sensor's reach: sensors are within the machine's outline."""
    return bool(thing.role) and thing.clearance_m <= view.reach_m


def found_range(told: Obstacles, box: Box, view: View) -> float:
    """Range of the nearest detection that is of the box; NaN when there is none."""
    if not len(told.yaw_rad):
        return math.nan
    away = np.minimum(box.away_m(told.center_base_m[:, :2]), box.away_m(told.nearest_base_m[:, :2]))
    sigma = np.minimum(told.sigma_m.max(axis=1), MOST_SIGMA_M) if len(told.sigma_m) else np.zeros(len(away))
    mine = np.flatnonzero(away <= NEAR_M + sigma)
    if not len(mine):
        return math.nan
    d = told.nearest_base_m[mine, :2] - view.T_base_sensor[:2, 3]
    return float(np.hypot(d[:, 0], d[:, 1]).min())


def range_rows(looks: Iterable[Look]) -> list[dict[str, Any]]:
    """By sensor and class: the farthest range at which it was told, and that below which it always was."""
    groups: dict[tuple[str, str], list[Look]] = {}
    for look in looks:
        groups.setdefault((look.sensor, look.label), []).append(look)
    rows = []
    for (sensor, label), mine in sorted(groups.items()):
        held = range_without_failure([(look.range_m, look.is_found) for look in mine])
        found = [look.range_m for look in mine if look.is_found]
        rows.append({"sensor": sensor, "class": label, "looks": len(mine), "found": len(found),
                     "farthest_m": max(found, default=None), "held_from_m": held})  # fmt: skip
    return rows


def share_rows(looks: Iterable[Look]) -> list[dict[str, Any]]:
    """By sensor, class and range: the share of looks in which the object was told, with exact bounds."""
    counts: dict[tuple[str, str, int], list[int]] = {}
    for look in looks:
        k = int(np.searchsorted(EDGES_M, look.range_m, side="right")) - 1
        if k < len(EDGES_M) - 1:
            count = counts.setdefault((look.sensor, look.label, k), [0, 0])
            count[0] += look.is_found
            count[1] += 1
    rows = []
    for (sensor, label, k), (found, n) in sorted(counts.items()):
        low, high = share_bounds(found, n)
        rows.append({"sensor": sensor, "class": label, "from_m": EDGES_M[k], "to_m": EDGES_M[k + 1], "n": n,
                     "share": found / n, "low": low, "high": high})  # fmt: skip
    return rows
