"""Recorded scans: part of the acceptance limits of benchmarks/perception_kitti.py."""

import numpy as np

from benchmarks.perception_kitti import add_noise
from benchmarks.perception_kitti_data import frame, labels
from benchmarks.perception_pasting import paste_trials
from benchmarks.perception_scoring import perceive, recall, strict, thin
from messages.perception import Tracks
from perception.fusion.tracker import Tracker
from tests.perception.lidar_scenes import TRACKER_CONFIG, Feed, odometry
from tests.recordings import needs

pytestmark = needs("kitti-seq-pcd", "kitti-tracking-truth")
SOME = range(0, 40, 8)


def test_objects_within_40_m_are_single_clusters():
    scores = [s for _, _, s in recall(numbers=SOME)]
    assert len(scores) > 12
    assert all(s.counts for s in scores if s.edge_m < 40.0)


def test_objects_with_quarter_of_returns():
    scores = [s.counts for _, _, s in recall(0.25, numbers=SOME)]
    assert sum(scores) >= 0.93 * len(scores)


def test_single_cluster_of_all_returns_matches_no_object():
    """Checks the matching rule: one cluster of all returns matches no object."""
    result = perceive(frame(0))
    o = result.obstacles
    complete = type(o)(
        **{
            **vars(o),
            "offsets": np.array([0, len(o.indices)], np.int32),
        }
    )
    assert not any(strict(result.points_m, complete, label).counts for label in labels()[0])


def test_inserted_persons_on_free_ground():
    assert sum(paste_trials(20)) >= 19
    assert sum(paste_trials(20, 0.5)) >= 18


def test_noise_confirms_no_additional_track():
    tracker = Tracker(["obstacles/lidar_top"], TRACKER_CONFIG)
    for i in range(4):
        # the same road, the car standing, with other noise every time
        points = add_noise(i, thin(frame(0), 0.5, np.random.default_rng(i)))
        stamp = 10**12 + i * 10**8
        result = perceive(points, stamp)
        tracks_message = dict(tracker.step(stamp, Feed(obstacles__lidar_top=result.obstacles, odom=odometry(stamp))))[
            "tracks"
        ]
    assert isinstance(tracks_message, Tracks)
    real = perceive(frame(0)).obstacles.points_base_m[:, :2]
    for track in tracks_message.tracks:
        if track.is_confirmed and np.hypot(*track.p_odom_m[:2]) < 40.0:
            assert np.hypot(*(real - track.p_odom_m[:2]).T).min() < 1.0
