"""Test harness: runs nodes on a list of messages as the executor does, and compares the result with the truth."""

import dataclasses
import itertools
import time

import numpy as np

from configs.strict import CONFIGS, parse, read_yaml
from localization.config import LocalizationConfig
from localization.localizer import Localizer
from messages.faults import Fault
from messages.motion import LidarLocalization, LidarOdometry, MapPose, Odometry
from tests.localization.synthetic_drive import DATUM, START_NS, Truth, tractor

STEP_NS = 20_000_000


def configuration() -> LocalizationConfig:
    return parse(LocalizationConfig, read_yaml(CONFIGS / "stack/localization.yaml"), "stack/localization.yaml")


class StubInbox:
    """Inbox with given messages."""

    def __init__(self, messages, history=()):
        self._messages, self._history = messages, history

    def all(self, topic, kind):
        return tuple(m for name, m in self._messages if name == topic)

    def latest(self, topic, kind):
        found = self.all(topic, kind)
        return found[-1] if found else None

    last = latest

    def at(self, topic, kind, stamp_ns):
        found = [m for name, m in self._history if name == topic]
        for a, b in itertools.pairwise(found):
            if a.stamp_ns <= stamp_ns <= b.stamp_ns:
                return a.interpolate(b, stamp_ns)
        return None


@dataclasses.dataclass
class Run:
    """Outputs of a run, and CPU time of each step (s)."""

    odom: list[Odometry]
    poses: list[MapPose]
    faults: list[Fault]
    step_s: np.ndarray
    localizer: Localizer
    lidar_motions: list[LidarOdometry]
    localizations: list[LidarLocalization] = dataclasses.field(default_factory=list)


def run(messages, seconds=None, localizer=None, start_ns=START_NS, lidar=None, lidar_map=None) -> Run:
    """Steps a localizer every 20 ms through messages (arrival, topic, message) in order of arrival.

    `lidar`: lidar odometry node and function from stamp to scan and ground, or None; 10 Hz, 60 ms latency.
    `lidar_map`: lidar localization node and function from stamp to {sensor: (scan, ground)}; 5 Hz, 80 ms latency.
    """
    node = localizer or Localizer(tractor(), DATUM, configuration())
    lidar_motions = []
    odom, poses, faults, times, k, now = [], [], [], [], 0, start_ns
    localizations = []
    end = messages[-1][0] if seconds is None else start_ns + int(seconds * 1e9)
    while now <= end:
        due = []
        while k < len(messages) and messages[k][0] <= now:
            due.append(messages[k][1:])
            k += 1
        if lidar is not None and (now - start_ns) % 100_000_000 == 60_000_000:
            due += _lidar_step(lidar, now - 60_000_000, odom)
            lidar_motions += [m for _, m in due if isinstance(m, LidarOdometry)]
        if lidar_map is not None and (now - start_ns) % 200_000_000 == 80_000_000:
            due += _map_step(lidar_map, now - 80_000_000, odom, poses)
            localizations += [m for _, m in due if isinstance(m, LidarLocalization)]
        start = time.thread_time()
        for topic, message in node.step(now, StubInbox(due)):
            {"odom": odom, "map_pose": poses, "fault/localizer": faults}[topic].append(message)
        times.append(time.thread_time() - start)
        now += STEP_NS
    return Run(odom, poses, faults, np.array(times), node, lidar_motions, localizations)


def _map_step(lidar_map, stamp_ns, odom, poses):
    node, simulate = lidar_map
    scans = simulate(stamp_ns) or {}
    due = [(f"{kind}/{s}", m) for s, pair in scans.items() for kind, m in zip(("lidar", "ground"), pair, strict=True)]
    due += [("map_pose", poses[-1])] if poses else []
    return list(node.step(stamp_ns + 80_000_000, StubInbox(due, [("odom", m) for m in odom[-60:]])))


def _lidar_step(lidar, stamp_ns, odom):
    node, simulate = lidar
    pair = simulate(stamp_ns)
    if pair is None:
        return []
    box = StubInbox([("lidar/front", pair[0]), ("ground/front", pair[1])], [("odom", m) for m in odom[-60:]])
    return list(node.step(stamp_ns + 60_000_000, box))


@dataclasses.dataclass
class Errors:
    """Errors of the fused 50 Hz pose in true base axes: along, across, up (m), rotation (rad); NEES per pose."""

    t_s: np.ndarray
    p_m: np.ndarray
    turn_rad: np.ndarray
    nees: np.ndarray
    level_m: np.ndarray


def errors(result: Run, truth: Truth) -> Errors:
    """Errors of `T_map_odom @ T_odom_base` at each odometry message after the first pose."""
    rows, k, poses = [], 0, [p for p in result.poses if p.is_initialized]
    from scipy.spatial.transform import Rotation

    for odom in result.odom:
        while k + 1 < len(poses) and poses[k + 1].stamp_ns <= odom.stamp_ns:
            k += 1
        if not poses or poses[k].stamp_ns > odom.stamp_ns:
            continue
        T, T_true = poses[k].T_map_odom @ odom.T_odom_base, truth.at(odom.stamp_ns)
        D = np.linalg.inv(T_true) @ T
        turn = Rotation.from_matrix(D[:3, :3]).as_rotvec()
        e = np.concatenate([turn, D[:3, 3]])
        P = poses[k].covariance
        rows.append(
            [
                (odom.stamp_ns - START_NS) * 1e-9,
                *D[:3, 3],
                *turn,
                e[3:5] @ np.linalg.solve(P[3:5, 3:5], e[3:5]) / 2,
                e @ np.linalg.solve(P, e) / 6,
                poses[k].protection_level_m,
            ]
        )
    a = np.array(rows)
    return Errors(a[:, 0], a[:, 1:4], a[:, 4:7], a[:, 7:9], a[:, 9])
