"""Node: tracks obstacles of all sensors in one list."""

from collections.abc import Iterable, Sequence

import numpy as np

from geometry.arrays import Int64
from messages.motion import Odometry, odometry_at
from messages.node import All, At, Inbox, Node, On, Output
from messages.perception import Obstacles, Track, Tracks
from messages.topics import spec_of
from perception.class_order import CLASSES
from perception.fusion.classes import classify
from perception.fusion.detections import to_odom
from perception.fusion.static_occupancy import StaticOccupancy
from perception.fusion.tracks import (
    TrackerConfig,
    active_rows,
    confirm,
    drop_fragments,
    empty_table,
    extend_lifetime,
    is_line_along,
    is_moving_class,
    is_rail,
    is_upright,
    is_view,
    match,
    merge_fragments,
    parent_tracks,
    penalize_misses,
    predict_tracks,
    start_tracks,
    unmatched,
    velocities,
    warm,
)
from perception.fusion.update import update


class Tracker(Node):
    """Runs on every obstacles topic; a message without odometry is not used."""

    def __init__(self, topics: Sequence[str], config: TrackerConfig) -> None:
        self.name = "tracker"
        self.reads = {topic: All(10) for topic in topics} | {"odom": At(1.0)}
        self.writes = ("tracks",)
        self.runs = On(tuple(topics))
        self._topics = tuple(topics)
        self._lidars, self._cameras = (
            sum(1 << i for i, topic in enumerate(topics) if topic.startswith(f"obstacles/{kind}"))
            for kind in ("lidar", "camera")
        )
        self._config = config
        self._static_occupancy = StaticOccupancy(config.static_occupancy)
        self._moving = np.zeros(0, np.int64)  # tracks of the last message whose motion nothing contradicted
        self._table = empty_table()
        self._stamp_ns, self._published_ns = 0, 0
        self._period_ns = round(spec_of("tracks").period_s * 1e9)
        self._next_id = 1
        warm(config)

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Processes new messages in order of stamps; publishes all tracks after a lidar scan or once per period."""
        messages = [(m.stamp_ns, i, m) for i, topic in enumerate(self._topics) for m in inbox.all(topic, Obstacles)]
        is_due = False
        for stamp_ns, sensor, message in sorted(messages, key=lambda entry: entry[:2]):
            odom = odometry_at(inbox, message.stamp_ns)
            if odom is not None and not self._is_without_effect(message, sensor):
                self._process(message, odom, sensor)
                is_due |= self._lidars >> sensor & 1 == 1 or stamp_ns - self._published_ns >= self._period_ns
        if not is_due:
            return ()
        self._published_ns = self._stamp_ns
        return (("tracks", self._tracks_message()),)

    def _is_without_effect(self, message: Obstacles, sensor: int) -> bool:
        """Whether a message is empty and no unconfirmed track of its sensor exists."""
        is_confirmed = self._table.is_confirmed[self._table.sensors >> sensor & 1 == 1]
        return (
            not len(message.yaw_rad)
            and bool(is_confirmed.all())
            and message.stamp_ns - self._published_ns < self._period_ns
        )

    def _process(self, message: Obstacles, odom: Odometry, sensor: int) -> None:
        config, table = self._config, self._table
        detections = to_odom(message, odom.T_odom_base, sensor, self._static_occupancy, config.kinds, config.noise)
        predict_tracks(table, (message.stamp_ns - self._stamp_ns) * 1e-9 if self._stamp_ns else 0.0, config)
        self._stamp_ns = max(self._stamp_ns, message.stamp_ns)
        tracks, rows = match(table, detections, config)
        if len(tracks):
            update(table, tracks, detections, rows, self._lidars, config)
        penalize_misses(table, self._missed(tracks, sensor), detections.kind, config)
        confirm(table, config)
        extend_lifetime(table, tracks, detections)
        table = table.select(active_rows(table, self._stamp_ns))
        fresh = unmatched(len(detections.yaw_rad), rows)
        if detections.is_lidar or len(fresh):
            parents = parent_tracks(table, self._lidars, config)
            fresh = drop_fragments(detections, fresh, parents, config)
            if detections.is_lidar:
                table = table.select(merge_fragments(table, parents, self._lidars, self._cameras, config))
        self._table = table.append(start_tracks(detections, fresh, self._next_id, config))
        self._next_id += len(fresh)

    def _missed(self, matched: Int64, sensor: int) -> Int64:
        """Rows of tracks of this sensor without a detection now."""
        is_own = (self._table.sensors >> sensor) & 1 == 1
        is_own[matched] = False
        return np.flatnonzero(is_own).astype(np.int64)

    def _tracks_message(self) -> Tracks:
        t = self._table
        velocity, covariance = velocities(t, self._config)
        occupancy = self._static_occupancy
        is_static = occupancy.contradicts_motion(t.x, velocity, t.size_m, self._stamp_ns)
        is_static &= ~is_moving_class(t.class_evidence) | is_rail(t.size_m, t.class_evidence)
        velocity[is_static & ~np.isin(t.id, self._moving)] = 0.0  # one contradiction does not stop a body that moved
        self._moving = t.id[velocity.any(axis=1) & ~is_static]
        is_along = is_line_along(t.size_m, t.yaw_rad, velocity)
        velocity[is_along & occupancy.continues_ahead(t.x, velocity, t.size_m, self._stamp_ns)] = 0.0
        label, confidence = classify(t, velocity)
        velocity[is_upright(t.size_m, label) | is_view(t.size_m, label, velocity)] = 0.0
        # a track without confirmed motion stays at its last detection: its uncertain speed does not move it
        unseen_s = np.where(velocity.any(axis=1), 0.0, (self._stamp_ns - t.last_ns) * 1e-9)
        p = t.x[:, :2] - t.x[:, 2:] * unseen_s[:, None]
        positions = np.concatenate([p, t.height_m[:, None]], axis=1)
        P = t.P.copy()
        P[:, 2:, 2:] = covariance
        names = {bits: self._names(bits) for bits in set(t.sensors.tolist())}
        columns = zip(
            t.id.tolist(), label.tolist(), confidence.tolist(), positions, velocity, P, t.size_m.copy(),
            t.yaw_rad.tolist(), t.first_ns.tolist(), t.last_ns.tolist(), t.is_confirmed.tolist(), t.sensors.tolist(),
            strict=True,
        )  # fmt: skip
        return Tracks(
            self._stamp_ns,
            tuple(
                Track(number, CLASSES[best], score, p, v, P, size, yaw, first, last, confirmed > 0, names[bits])
                for number, best, score, p, v, P, size, yaw, first, last, confirmed, bits in columns
            ),
        )

    def _names(self, bits: int) -> tuple[str, ...]:
        """Names of the sensors in the mask `bits`."""
        return tuple(topic.partition("/")[2] for i, topic in enumerate(self._topics) if bits >> i & 1)
