"""Persons close to a wall, a car or a fence: clusters and tracks of their own; what is no body stays whole."""

import numpy as np
import pytest

from configs.strict import find, load
from configs.vehicle import Vehicle
from messages.perception import ObstacleClass
from perception.fusion.tracker import Tracker
from perception.lidar.airborne import OBSTACLE, UNUSED
from perception.lidar.bodies import BODY, MAY_HOLD_BODY
from perception.lidar.classes import class_scores
from perception.lidar.clusters import Clusters
from perception.lidar.obstacles import LidarObstacles
from tests.perception.lidar_scenes import LIDAR_CONFIG, TRACKER_CONFIG, Feed, box, cast, odometry, person

VEHICLE = load(Vehicle, find("machines", "tractor_e"))
LIDAR = VEHICLE.sensors.lidar["front"].model_copy(
    update={"elevation_deg": tuple(np.linspace(-25.0, 3.0, 64)), "columns": 2048}
)
CAR = (box(0.0, 0.0, 1.8, 4.3, 0.8, low=0.25), box(0.1, 0.0, 1.5, 2.2, 1.45))
WALL = (box(0.0, 0.0, 0.2, 6.0, 2.2),)


@pytest.fixture(scope="module")
def node():
    return LidarObstacles("front", LIDAR, VEHICLE, None, LIDAR_CONFIG)


def moved(boxes, x):
    return [corners + np.array([x, 0.0, 0.0]) for corners in boxes]


def tracks_of(node, *scenes):
    """Confirmed tracks after four scans of each scene."""
    tracker = Tracker(["obstacles/lidar_front"], TRACKER_CONFIG)
    for k in range(4 * len(scenes)):
        stamp_ns = 10**9 + k * 10**8
        _, obstacles, _ = node._pipeline.run(cast(scenes[k // 4], LIDAR, seed=k, stamp_ns=stamp_ns), None, node.name, 0)
        feed = Feed(obstacles__lidar_front=obstacles, odom=odometry(stamp_ns))
        tracks = dict(tracker.step(stamp_ns, feed))["tracks"].tracks
    return [one for one in tracks if one.is_confirmed]


@pytest.mark.parametrize("gap_m", [0.2, 0.4])
@pytest.mark.parametrize("x", [8.0, 14.0, 19.0])
@pytest.mark.parametrize("structure", [CAR, WALL], ids=["car", "wall"])
def test_person_before_a_structure_has_a_track(node, structure, x, gap_m):
    front_m = x + min(corners[0, 0] for corners in structure)
    tracks = tracks_of(node, [*moved(structure, x), person(front_m - gap_m - 0.15, 0.4)])
    own = [one for one in tracks if np.hypot(*(one.p_odom_m[:2] - [front_m - gap_m - 0.25, 0.4])) < 0.4]
    assert any(one.size_m[0] < 1.0 and one.size_m[2] > 1.2 for one in own)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 60.0])
def test_a_slanted_wall_is_one_cluster(node, turn_deg):
    """A row of boxes along a line, as seen at a flat angle."""
    s = np.linspace(-3.0, 3.0, 61)
    c, n = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    wall = [box(14.0 + n * at, c * at, 0.12, 0.12, 2.0) for at in s]
    _, obstacles, _ = node._pipeline.run(cast(wall, LIDAR), None, node.name, 0)
    assert len(obstacles.yaw_rad) == 1


def test_a_rider_stays_on_the_bicycle(node):
    bicycle = [box(10.0, 0.0, 0.1, 1.7, 0.6, low=0.3), box(10.0, 0.05, 0.4, 0.45, 1.0, low=0.75)]
    _, obstacles, _ = node._pipeline.run(cast(bicycle, LIDAR), None, node.name, 0)
    assert len(obstacles.yaw_rad) == 1


def fence(x, spacing_m=4.0):
    """Posts 0.12 m thick with two boards along y."""
    posts = [box(x, at, 0.12, 0.12, 1.2) for at in np.arange(-8.0, 8.1, spacing_m)]
    return [*posts, *(box(x, 0.0, 0.03, 16.0, 0.14, low=low) for low in (0.47, 1.01))]


def test_posts_of_a_fence_are_no_persons(node):
    """Boards at mid height and below the tops join the posts; a taller gate post stands 0.2 m beside the end."""
    tracks = tracks_of(node, [*fence(10.0), box(10.0, 8.4, 0.24, 0.24, 1.5)])
    assert tracks
    assert all(one.label is not ObstacleClass.PERSON for one in tracks)


def test_person_before_a_fence_is_possibly_a_person(node):
    tracks = tracks_of(node, [*fence(10.0), person(9.5, 1.6)])
    own = [one for one in tracks if np.hypot(*(one.p_odom_m[:2] - [9.4, 1.6])) < 0.4 and one.size_m[0] < 1.0]
    assert [one.label for one in own] == [ObstacleClass.UNKNOWN]


def test_who_was_a_person_before_stays_one_beside_a_wall(node):
    wall = moved(WALL, 10.0)
    tracks = tracks_of(node, [*wall, person(8.4, 0.4)], [*wall, person(9.0, 0.4)], [*wall, person(9.4, 0.4)])
    own = [one for one in tracks if np.hypot(*(one.p_odom_m[:2] - [9.3, 0.4])) < 0.5 and one.size_m[0] < 1.5]
    assert [one.label for one in own] == [ObstacleClass.PERSON]


def test_a_cluster_of_bodies_alone_leaves_no_empty_one(node):
    """Their feet are hidden by stubble: before, the box of the empty cluster was read from anywhere in memory."""
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-0.2, 0.2, 12), np.linspace(0.7, 1.6, 12)))
    points = np.concatenate([np.stack([np.full(144, 8.0), y + side, z], axis=1) for side in (-1.5, 0.0, 1.5)])
    points, several = points.astype(np.float32), 100  # the splitter skips scans with few returns
    points = np.concatenate([points, np.full((several * len(points), 3), 40.0, np.float32)])
    point_class = np.where(np.arange(len(points)) < 432, OBSTACLE, UNUSED).astype(np.uint8)
    joined = Clusters(np.array([0, 432], np.int32), np.arange(432, dtype=np.int32))
    found, kinds = node._pipeline._splitter.split(joined, points, points[:, 2].copy(), point_class, np.zeros(2))
    assert np.diff(found.offsets).tolist() == [144, 144, 144]
    assert kinds.tolist() == [BODY, BODY, BODY]


def test_scores_of_bodies_and_of_what_may_hold_one():
    size_m, kinds = np.array([[0.5, 0.4, 1.7], [4.3, 1.8, 1.5]]), np.array([BODY, MAY_HOLD_BODY], np.uint8)
    body, vehicle = class_scores(size_m, size_m[:, 2], np.zeros(2, bool), kinds)
    classes = list(ObstacleClass)
    assert body[classes.index(ObstacleClass.PERSON)] == body[0] == 0.5
    assert vehicle[classes.index(ObstacleClass.VEHICLE)] == vehicle[0] > 0.0
