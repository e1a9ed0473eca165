"""The node that keeps one list of obstacles from all sensors."""

from collections.abc import Iterable, Sequence

import numpy as np

from messages.message import Int64
from messages.motion import Odometry
from messages.node import All, At, Inbox, Node, On, Output
from messages.perception import Obstacles, Track, Tracks
from messages.topics import spec_of
from perception.fusion.detections import to_odom
from perception.fusion.static_occupancy import Stillness
from perception.fusion.tracks import (
    CLASSES,
    TrackerConfig,
    alive,
    begin,
    classify,
    confirm,
    doubt,
    empty_table,
    hosts_of,
    is_body,
    is_upright,
    left_over,
    match,
    move,
    not_explained,
    not_parts,
    prolong,
    velocities,
    warm,
)
from perception.fusion.update import update


class Tracker(Node):
    """Runs on every obstacles topic; without odometry at the time of a message that message is not used."""

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
        self._stillness = Stillness(config.stillness)
        self._table = empty_table()
        self._stamp_ns, self._told_ns = 0, 0
        self._period_ns = round(spec_of("tracks").period_s * 1e9)
        self._next_id = 1
        warm(config)

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """New messages enter in the order of their times; with a lidar's scan, or in time, all tracks are told."""
        news = [(m.stamp_ns, i, m) for i, topic in enumerate(self._topics) for m in inbox.all(topic, Obstacles)]
        is_due = False
        for stamp_ns, sensor, message in sorted(news, key=lambda n: n[:2]):
            odom = inbox.at("odom", Odometry, message.stamp_ns) or inbox.latest("odom", Odometry)
            if odom is not None and not self._is_quiet(message, sensor):
                self._absorb(message, odom, sensor)
                is_due |= self._lidars >> sensor & 1 == 1 or stamp_ns - self._told_ns >= self._period_ns
        if not is_due:
            return ()
        self._told_ns = self._stamp_ns
        return (("tracks", self._tell()),)

    def _is_quiet(self, message: Obstacles, sensor: int) -> bool:
        """Whether a message changes nothing: it is empty, and nothing that its sensor saw waits to be confirmed."""
        mine = self._table.is_confirmed[self._table.sensors >> sensor & 1 == 1]
        return not len(message.yaw_rad) and bool(mine.all()) and message.stamp_ns - self._told_ns < self._period_ns

    def _absorb(self, message: Obstacles, odom: Odometry, sensor: int) -> None:
        config, table = self._config, self._table
        seen = to_odom(message, odom.T_odom_base, sensor, self._stillness, config.kinds, config.noise)
        move(table, (message.stamp_ns - self._stamp_ns) * 1e-9 if self._stamp_ns else 0.0, config)
        self._stamp_ns = max(self._stamp_ns, message.stamp_ns)
        tracks, rows = match(table, seen, config)
        if len(tracks):
            update(table, tracks, seen, rows, self._stillness, self._lidars, config)
        doubt(table, self._missed(tracks, sensor), seen.kind, config)
        confirm(table, config)
        prolong(table, tracks, seen)
        table = table.rows(alive(table, self._stamp_ns))
        fresh = left_over(len(seen.yaw_rad), rows)
        if seen.is_lidar or len(fresh):
            hosts = hosts_of(table, self._lidars, config)
            fresh = not_explained(seen, fresh, hosts, config)
            if seen.is_lidar:
                table = table.rows(not_parts(table, hosts, self._lidars, self._cameras, config))
        self._table = table.below(begin(seen, fresh, self._next_id, config))
        self._next_id += len(fresh)

    def _missed(self, matched: Int64, sensor: int) -> Int64:
        """Rows that this sensor has seen before and does not see now."""
        mine = (self._table.sensors >> sensor) & 1 == 1
        mine[matched] = False
        return np.flatnonzero(mine).astype(np.int64)

    def _tell(self) -> Tracks:
        t = self._table
        velocity = velocities(t, self._config)
        stays = self._stillness.is_refuted(t.x, velocity, t.size_m, self._stamp_ns)
        velocity[stays & ~is_body(t.evidence)] = 0.0
        label, confidence = classify(t, velocity)
        velocity[is_upright(t.size_m, label)] = 0.0
        # what is not known to move is where it was seen last, and its uncertain speed takes it nowhere
        unseen_s = np.where(velocity.any(axis=1), 0.0, (self._stamp_ns - t.last_ns) * 1e-9)
        p = t.x[:, :2] - t.x[:, 2:] * unseen_s[:, None]
        places = np.concatenate([p, t.height_m[:, None]], axis=1)
        names = {bits: self._names(bits) for bits in set(t.sensors.tolist())}
        columns = zip(
            t.id.tolist(), label.tolist(), confidence.tolist(), places, velocity, t.P.copy(), t.size_m.copy(),
            t.yaw_rad.tolist(), t.first_ns.tolist(), t.last_ns.tolist(), t.is_confirmed.tolist(), t.sensors.tolist(),
            strict=True,
        )  # fmt: skip
        return Tracks(
            self._stamp_ns,
            tuple(
                Track(number, CLASSES[best], sure, place, speed, P, size, yaw, first, last, confirmed > 0, names[bits])
                for number, best, sure, place, speed, P, size, yaw, first, last, confirmed, bits in columns
            ),
        )

    def _names(self, bits: int) -> tuple[str, ...]:
        """Names of the sensors that `bits` stand for."""
        return tuple(topic.partition("/")[2] for i, topic in enumerate(self._topics) if bits >> i & 1)
