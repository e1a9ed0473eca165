"""Objects that were perceived in the path of a log: confirmed tracks there, and causes of stop requests without one.

They are proposed to a person as true objects. Objects that were not perceived are not among them.
"""

import math
from array import array
from bisect import bisect_left
from collections.abc import Container, Iterator
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import Float32, Float64, Int64, UInt8
from geometry.pose2 import Pose2, from_frame, to_frame
from messages.command import SupervisorState
from messages.message import Envelope
from messages.motion import Odometry
from messages.perception import ObstacleClass, Track, Tracks
from messages.sensors import CameraImage, LidarScan
from validation.obstacle_stop.observation import LogObservation, Setting

COASTING_NS = 300_000_000  # a track that was not seen for so long is only predicted
ENDED_NS = 2_000_000_000
PAUSE_NS = 600_000_000  # requests further apart have separate causes
EVERY_NS = 100_000_000  # between the requests that are looked at
CAUSE_M = 1.0  # triggering points so much further than the nearest one may have another cause
NEAR_M = 1.5  # triggering points so close to a track or to the last cause belong to it
MIN_SIZE_M = 0.2
VIEW_M = 4.0  # the view of an object is its nearest one from here on
SCENE_M = 40.0
CLOSE_M = 4.0
THINNING = 8
VIEW_EVERY_NS = 1_000_000_000
MAX_CAUSE_VIEWS = 300
MAX_WIDTH_PX = 640


@dataclass(frozen=True, eq=False)
class View:
    """Returns (N, 3) in base at one scan: close to the object, and thinned all around; and the last camera image."""

    stamp_ns: int
    close_m: Float32
    scene_m: Float32
    bgr: UInt8 | None


@dataclass(frozen=True, eq=False)
class Perceived:
    """One object: boxes (N, 7: centre, size, yaw) in base at the stamps (N,) of scans, and ranges from the front."""

    id: int
    label: str
    is_stop_requested: bool
    stamps_ns: Int64
    boxes: Float64
    ranges_m: Float64
    view: View | None


@dataclass(eq=False)
class _History:
    """Boxes of one object in odom as columns."""

    label: str = ""
    stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    rows: "array[float]" = field(default_factory=lambda: array("d"))
    is_stop_requested: bool = False
    view: View | None = None

    def add(self, stamp_ns: int, row: tuple[float, ...]) -> None:
        if not self.stamps_ns or stamp_ns > self.stamps_ns[-1]:
            self.stamps_ns.append(stamp_ns)
            self.rows.extend(row)

    def boxes_at(self, stamps_ns: Int64) -> Float64:
        """Boxes (N, 7) in odom, linear between the samples."""
        rows = np.array(self.rows).reshape(-1, 7)
        rows[:, 6] = np.unwrap(rows[:, 6], period=math.pi)
        first = self.stamps_ns[0]
        t, own = (stamps_ns - first).astype(np.float64), np.array(self.stamps_ns, np.int64) - first
        return np.column_stack([np.interp(t, own, column) for column in rows.T])


class PerceivedObjects:
    """Bus sink; `in_path` has the ids of the tracks that entered the driving corridor so far."""

    def __init__(self, setting: Setting, in_path: Container[int]) -> None:
        self._setting, self._in_path = setting, in_path
        self.lidar = next(iter(setting.T_base_lidar))
        self._scans: list[int] = []
        self._last_scan: LidarScan | None = None
        self._bgr: UInt8 | None = None
        self._pose: Float64 | None = None
        self._cause_views: dict[int, View] = {}
        self._tracks: dict[int, _History] = {}
        self._causes: dict[int, Float64] = {}

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message, topic = envelope.message, envelope.topic
        if isinstance(message, LidarScan) and topic == f"lidar/{self.lidar}":
            self._scans.append(message.stamp_ns)
            self._last_scan = message
        elif isinstance(message, Odometry) and topic.partition("/")[0] == "odom":
            self._pose = np.array(Pose2.of(message.T_odom_base))
        elif isinstance(message, CameraImage) and topic.startswith("camera/") and message.bgr.size:
            step = max(1, math.ceil(message.bgr.shape[1] / MAX_WIDTH_PX))
            self._bgr = message.bgr[::step, ::step]
        elif isinstance(message, Tracks) and topic == "tracks":
            for track in message.tracks:
                self._add(track, message.stamp_ns)
            self._forget(message.stamp_ns)
        elif isinstance(message, SupervisorState) and topic == "supervisor":
            self._add_cause(message)

    def _add(self, track: Track, stamp_ns: int) -> None:
        history = self._tracks.setdefault(track.id, _History())
        if stamp_ns - track.last_seen_ns > COASTING_NS:
            return
        history.add(stamp_ns, (*track.p_odom_m, *np.maximum(track.size_m, MIN_SIZE_M), track.yaw_rad))
        if track.is_confirmed or not history.label:
            history.label = track.label.value

        if self._pose is not None and track.id in self._in_path:
            xy = from_frame(self._pose, track.p_odom_m[None, :2])[0]
            box = np.array([*xy, track.p_odom_m[2], *track.size_m, 0.0])
            if history.view is None or self._range_m(box) >= VIEW_M:
                history.view = self._view(box[:3], stamp_ns)

    def _add_cause(self, state: SupervisorState) -> None:
        points = state.triggering_points_base_m.astype(np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return
        away = np.hypot(points[:, 0] - self._setting.front_m, points[:, 1])
        nearest = points[away <= away.min() + CAUSE_M]
        corners = np.array([nearest.min(axis=0), nearest.max(axis=0)])
        self._causes[state.stamp_ns] = corners
        last_ns = next(reversed(self._cause_views), 0)
        if state.stamp_ns - last_ns > VIEW_EVERY_NS and len(self._cause_views) < MAX_CAUSE_VIEWS:
            view = self._view(corners.mean(axis=0), state.stamp_ns)
            if view is not None:
                self._cause_views[state.stamp_ns] = view

    def _view(self, center_m: Float64, stamp_ns: int) -> View | None:
        """Returns of the last scan around a point in base."""
        if self._last_scan is None:
            return None
        T = self._setting.T_base_lidar[self.lidar].astype(np.float32)
        points = self._last_scan.points_m @ T[:3, :3].T + T[:3, 3]
        away = np.abs(points[:, :2] - center_m[:2].astype(np.float32)).max(axis=1)
        scene = points[::THINNING]
        return View(stamp_ns, points[away < CLOSE_M], scene[np.hypot(scene[:, 0], scene[:, 1]) < SCENE_M], self._bgr)

    def _forget(self, now_ns: int) -> None:
        """Drops ended tracks that were never in the path."""
        for i in [i for i, h in self._tracks.items() if i not in self._in_path]:
            stamps = self._tracks[i].stamps_ns
            if not stamps or now_ns - stamps[-1] > ENDED_NS:
                del self._tracks[i]

    @property
    def scans_ns(self) -> list[int]:
        """Stamps of the scans of the lidar in whose frame the boxes are."""
        return sorted(set(self._scans))

    def objects(self, observed: LogObservation) -> list[Perceived]:
        """All objects in the order of their first boxes."""
        confirmed = {i for i, rows in observed.tracks.items() if any(row.is_confirmed for row in rows)}
        histories = {i: h for i, h in self._tracks.items() if i in confirmed and h.stamps_ns}
        others = list(self._other_causes(histories, observed))
        number = max([0, *self._tracks, *observed.tracks]) + 1
        histories |= {number + k: history for k, history in enumerate(others)}
        scans = np.array(self.scans_ns, np.int64)
        found = [self._perceived(i, history, scans, observed) for i, history in histories.items()]
        return sorted((one for one in found if len(one.stamps_ns)), key=lambda o: (o.stamps_ns[0], o.id))

    def _perceived(self, i: int, history: _History, scans: Int64, observed: LogObservation) -> Perceived:
        half_ns = round(0.5e9 * observed.period_s)
        inside = (scans >= history.stamps_ns[0] - half_ns) & (scans <= history.stamps_ns[-1] + half_ns)
        stamps = np.array([t for t in scans[inside].tolist() if observed.motion.index(t) is not None], np.int64)
        boxes = history.boxes_at(stamps)
        for row, stamp_ns in zip(boxes, stamps.tolist(), strict=True):
            pose = _pose(observed, stamp_ns)
            row[:2], row[6] = from_frame(pose, row[None, :2])[0], row[6] - pose[2]
        ranges = np.array([self._range_m(row) for row in boxes])
        return Perceived(i, history.label, history.is_stop_requested, stamps, boxes, ranges, history.view)

    def _range_m(self, box: Float64) -> float:
        """Distance of a box from the front edge, at least; by the circle within its outline."""
        ahead = max(0.0, float(box[0]) - self._setting.front_m)
        aside = max(0.0, abs(float(box[1])) - 0.5 * self._setting.width_m)
        return max(0.0, math.hypot(ahead, aside) - 0.5 * float(box[3:5].min()))

    def _other_causes(self, histories: dict[int, _History], observed: LogObservation) -> Iterator[_History]:
        """Causes of requests at which none of these tracks was; marks the tracks that were."""
        last: _History | None = None
        last_ns, last_xy = 0, np.zeros(2)
        for stamp_ns in self._requested_ns(observed):
            pose, box = _pose(observed, stamp_ns), _box_of(self._causes[stamp_ns])
            xy = to_frame(pose, box[None, :2])[0]
            mine = [h for h in histories.values() if _is_at(h, stamp_ns, xy, 0.5 * float(box[3:5].min()))]
            for history in mine:
                history.is_stop_requested = True
            if mine:
                continue
            is_same = last is not None and stamp_ns - last_ns <= PAUSE_NS
            if last is None or not is_same or np.hypot(*(xy - last_xy)) > NEAR_M + float(np.hypot(*box[3:5])):
                if last is not None:
                    yield last
                last = _History(ObstacleClass.UNKNOWN.value, is_stop_requested=True)
            last.add(stamp_ns, (*xy, *box[2:6], pose[2]))
            last.view = last.view or self._cause_view(stamp_ns)
            last_ns, last_xy = stamp_ns, xy
        if last is not None:
            yield last

    def _cause_view(self, stamp_ns: int) -> View | None:
        stamps = list(self._cause_views)
        k = bisect_left(stamps, stamp_ns + 1) - 1
        return self._cause_views[stamps[k]] if k >= 0 and stamp_ns - stamps[k] <= VIEW_EVERY_NS else None

    def _requested_ns(self, observed: LogObservation) -> Iterator[int]:
        """Stamps of braking requests with triggering points, not closer than `EVERY_NS`."""
        last_ns = -EVERY_NS
        for stamp_ns in sorted({request.stamp_ns for request in observed.requests if request.is_braking}):
            is_known = stamp_ns in self._causes and observed.motion.index(stamp_ns) is not None
            if is_known and stamp_ns - last_ns >= EVERY_NS:
                last_ns = stamp_ns
                yield stamp_ns


def _pose(observed: LogObservation, stamp_ns: int) -> Float64:
    k = observed.motion.index(stamp_ns)
    assert k is not None, "checked by the caller"
    return observed.motion.pose(k)


def _box_of(corners: Float64) -> Float64:
    """Upright box (7,) around two corners (2, 3)."""
    size = np.maximum(corners[1] - corners[0], MIN_SIZE_M)
    return np.array([*corners.mean(axis=0), *size, 0.0])


def _is_at(history: _History, stamp_ns: int, xy: Float64, radius_m: float) -> bool:
    """Whether a track was within `NEAR_M` of a circle at a time, or half a second before."""
    stamps = history.stamps_ns
    if not stamps[0] <= stamp_ns <= stamps[-1] + PAUSE_NS:
        return False
    k = 7 * min(bisect_left(stamps, stamp_ns), len(stamps) - 1)
    x, y, _, length, width, _, yaw = history.rows[k : k + 7]
    along, across = from_frame(np.array([x, y, yaw]), xy[None])[0]
    outside = math.hypot(max(0.0, abs(along) - 0.5 * length), max(0.0, abs(across) - 0.5 * width))
    return outside <= NEAR_M + radius_m
