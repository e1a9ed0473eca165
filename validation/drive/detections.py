"""Detection of the true objects by each sensor, one sample per measurement and object."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from configs.sensor_kinds import sensors_of
from configs.vehicle import Vehicle
from geometry.arrays import Float64
from geometry.transforms import invert
from messages.message import Envelope
from messages.perception import Obstacles
from messages.truth import TrueMachine, TrueObject, TrueObjects
from validation.obstacle_stop.boxes import Box, box_of
from validation.obstacle_stop.ranges import range_without_failure, share_bounds
from validation.sensor_registry import FIELDS_OF_VIEW

ASSOCIATION_M = 1.0  # a detection within this distance + its sigma of a true box belongs to that object
MAX_SIGMA_M = 2.0
MAX_AGE_NS = 60_000_000  # of the truth, which has 10 Hz
EDGES_M = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)
MAX_KEPT = 20


@dataclass(frozen=True, eq=False)
class SensorView:
    """Field of view of a sensor: pose in base, half angle about its x axis, maximum range."""

    T_base_sensor: Float64
    half_rad: float
    max_range_m: float

    def range_of(self, box: Box) -> float:
        """Horizontal distance to the box; infinite outside the field of view (box centre) or the range."""
        away = float(box.distance_m(self.T_base_sensor[None, :2, 3])[0])
        p = invert(self.T_base_sensor) @ np.append(box.center_m, 1.0)
        is_in_view = abs(math.atan2(p[1], p[0])) <= self.half_rad and away <= self.max_range_m
        return away if is_in_view else math.inf


def sensor_views(vehicle: Vehicle) -> dict[str, SensorView]:
    """Fields of view of the obstacle sensors by the sensor name in `Obstacles`."""
    return {
        f"{kind}_{name}": SensorView(sensor.mount.T_base_sensor, *field_of_view(sensor))
        for kind, field_of_view in FIELDS_OF_VIEW.items()
        for name, sensor in sensors_of(vehicle.sensors, kind).items()
    }


@dataclass(frozen=True)
class DetectionSample:
    """One measurement and one true object in view; `detected_m` is the detected range, NaN without detection."""

    sensor: str
    stamp_ns: int
    role: str
    label: str
    range_m: float
    detected_m: float

    @property
    def is_detected(self) -> bool:
        """Whether the sensor detected the object."""
        return math.isfinite(self.detected_m)


class Detections:
    """Bus sink; `samples` holds one sample per measurement and object with a role."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.samples: list[DetectionSample] = []
        self._views = sensor_views(vehicle)
        self._truths: deque[TrueObjects] = deque(maxlen=MAX_KEPT)
        self._machines: deque[TrueMachine] = deque(maxlen=2 * MAX_KEPT)

    @property
    def topics(self) -> frozenset[str]:
        """Topics needed."""
        return frozenset({"truth_machine", "truth_objects", *(f"obstacles/{name}" for name in self._views)})

    def needs(self, topic: str) -> bool:
        """Whether the next message of a topic can add samples: some true object is within the sensor range."""
        view = self._views.get(topic.partition("/")[2]) if topic.startswith("obstacles/") else None
        return view is None or any(is_within_range(true, view) for truth in self._truths for true in truth.objects)

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message = envelope.message
        if isinstance(message, TrueObjects):
            self._truths.append(message)
        elif isinstance(message, TrueMachine):
            self._machines.append(message)
        elif isinstance(message, Obstacles) and message.sensor in self._views:
            self._add_samples(message)

    def _add_samples(self, detections: Obstacles) -> None:
        truth = min(self._truths, key=lambda m: abs(m.stamp_ns - detections.stamp_ns), default=None)
        machine = min(self._machines, key=lambda m: abs(m.stamp_ns - detections.stamp_ns), default=None)
        if truth is None or machine is None or abs(truth.stamp_ns - detections.stamp_ns) > MAX_AGE_NS:
            return
        view, T_base_map = self._views[detections.sensor], invert(machine.T_map_base)
        for true in truth.objects:
            if not is_within_range(true, view):
                continue
            box = box_of(true, T_base_map)
            range_m = view.range_of(box)
            if math.isfinite(range_m):
                found = detected_range_m(detections, box, view)
                self.samples.append(
                    DetectionSample(detections.sensor, detections.stamp_ns, true.role, true.label.value, range_m, found)
                )


def is_within_range(true: TrueObject, view: SensorView) -> bool:
    """Whether an object with a role may be in sensor range; sensors are within the machine outline."""
    return bool(true.role) and true.clearance_m <= view.max_range_m


def detected_range_m(detections: Obstacles, box: Box, view: SensorView) -> float:
    """Range (m) of the nearest detection that belongs to the box; NaN without one."""
    if not len(detections.yaw_rad):
        return math.nan
    away = np.minimum(box.distance_m(detections.center_base_m[:, :2]), box.distance_m(detections.nearest_base_m[:, :2]))
    sigma = np.minimum(detections.sigma_m.max(axis=1), MAX_SIGMA_M) if len(detections.sigma_m) else np.zeros(len(away))
    mine = np.flatnonzero(away <= ASSOCIATION_M + sigma)
    if not len(mine):
        return math.nan
    d = detections.nearest_base_m[mine, :2] - view.T_base_sensor[:2, 3]
    return float(np.hypot(d[:, 0], d[:, 1]).min())


def range_rows(samples: Iterable[DetectionSample]) -> list[dict[str, Any]]:
    """By sensor and class: largest range with a detection, and range below which every sample has one."""
    groups: dict[tuple[str, str], list[DetectionSample]] = {}
    for sample in samples:
        groups.setdefault((sample.sensor, sample.label), []).append(sample)
    rows = []
    for (sensor, label), mine in sorted(groups.items()):
        always_m = range_without_failure([(sample.range_m, sample.is_detected) for sample in mine])
        found = [sample.range_m for sample in mine if sample.is_detected]
        rows.append({"sensor": sensor, "class": label, "samples": len(mine), "detected": len(found),
                     "farthest_m": max(found, default=None), "always_detected_m": always_m})  # fmt: skip
    return rows


def share_rows(samples: Iterable[DetectionSample]) -> list[dict[str, Any]]:
    """By sensor, class and range: share of samples with a detection, with exact bounds."""
    counts: dict[tuple[str, str, int], list[int]] = {}
    for sample in samples:
        k = int(np.searchsorted(EDGES_M, sample.range_m, side="right")) - 1
        if k < len(EDGES_M) - 1:
            count = counts.setdefault((sample.sensor, sample.label, k), [0, 0])
            count[0] += sample.is_detected
            count[1] += 1
    rows = []
    for (sensor, label, k), (found, n) in sorted(counts.items()):
        low, high = share_bounds(found, n)
        rows.append({"sensor": sensor, "class": label, "from_m": EDGES_M[k], "to_m": EDGES_M[k + 1], "n": n,
                     "share": found / n, "low": low, "high": high})  # fmt: skip
    return rows
