"""Separation of bodies that one cluster joins."""

from dataclasses import replace

import numpy as np
import pytest

from configs.strict import CONFIGS, parse, read_yaml
from messages.perception import ObstacleClass, Obstacles
from perception.config import PerceptionConfig
from perception.fusion.separation import SeparationConfig, distance_to_boxes_m, separate
from tests.perception.test_tracker import START, message, new_tracker, run

NS, CAR, PERSON = 1_000_000_000, (4.5, 1.8, 1.6), (0.5, 0.5, 1.7)
CAR_AT = (10.0, 5.0, 0.8)


@pytest.fixture(scope="module")
def config() -> SeparationConfig:
    values = read_yaml(CONFIGS / "stack/perception.yaml")
    return parse(PerceptionConfig, values, "stack/perception.yaml").tracker.separation


def scene(stamp_ns: int, person: tuple[float, float], is_joined: bool, seed: int = 1) -> Obstacles:
    """A parked car and a person, as two clusters or as one."""
    apart = message(stamp_ns, [CAR_AT, (*person, 0.8)], sizes=[CAR, PERSON], returns=200, seed=seed)
    if not is_joined:
        return apart
    low, high = apart.points_base_m.min(axis=0), apart.points_base_m.max(axis=0)
    center, size = 0.5 * (low + high).astype(float)[None], (high - low).astype(float)[None]
    return replace(
        apart, center_base_m=center, size_m=size, yaw_rad=np.zeros(1), nearest_base_m=center,
        velocity_mps=np.full((1, 2), np.nan), class_scores=apart.class_scores[:1],
        offsets=np.array([0, 400], np.int32),
    )  # fmt: skip


def divided(obstacles: Obstacles, config: SeparationConfig, may_move=(False, True), person=(13.0, 4.0)) -> Obstacles:
    p, size = np.array([CAR_AT[:2], person]), np.array([CAR, PERSON])
    return separate(obstacles, np.eye(4), p, size, np.zeros(2), np.array(may_move), config)


def test_distance_to_boxes() -> None:
    points = np.array([(0.0, 0.0), (3.0, 0.0), (5.0, 4.0)])
    found = distance_to_boxes_m(points, np.array([(0.0, 0.0)]), np.array([(4.0, 2.0, 1.0)]), np.array([0.0]))
    assert found[:, 0] == pytest.approx([0.0, 1.0, np.hypot(3.0, 3.0)])
    turned = distance_to_boxes_m(points, np.array([(0.0, 0.0)]), np.array([(4.0, 2.0, 1.0)]), np.array([np.pi / 2]))
    assert turned[1, 0] == pytest.approx(2.0)


def test_each_body_gets_its_returns(config: SeparationConfig) -> None:
    joined = scene(START, (13.0, 4.0), is_joined=True)
    parts = divided(joined, config)
    order = np.argsort(parts.center_base_m[:, 0])
    car, person = parts.center_base_m[order], parts.size_m[order]
    assert car[:, :2] == pytest.approx(np.array([CAR_AT[:2], (13.0, 4.0)]), abs=0.1)
    assert person[:, 0] == pytest.approx([CAR[0], PERSON[0]], abs=0.2)
    assert sorted(parts.indices.tolist()) == list(range(400))
    assert parts.points_base_m == pytest.approx(joined.points_base_m[parts.indices])
    assert parts.class_scores == pytest.approx(1.0 / len(ObstacleClass))  # neither has one of its own


def test_what_is_not_divided(config: SeparationConfig) -> None:
    joined = scene(START, (13.0, 4.0), is_joined=True)
    assert divided(joined, config, may_move=(False, False)) is joined  # two posts
    assert divided(joined, config, person=(30.0, 4.0)) is joined  # the only track in it
    fence = config.model_copy(update={"max_length_m": 4.0})
    assert divided(joined, fence) is joined
    alone = config.model_copy(update={"max_size_share": 0.5})
    assert divided(joined, alone) is joined  # the cluster is the car
    few = config.model_copy(update={"min_returns": 201})
    assert len(divided(joined, few).yaw_rad) == 1
    apart = scene(START, (13.0, 4.0), is_joined=False)
    assert divided(apart, config) is apart


def test_a_person_who_walks_out_from_behind_a_car_keeps_their_track() -> None:
    """One cluster with the car from 1 s on, in which the person begins to walk past its front at 1.5 m/s."""
    scans, joined_at = [], 10
    for k in range(20):
        y = 6.5 - 0.15 * max(0, k - joined_at)
        scans.append(scene(START + k * NS // 10, (12.8, y), k >= joined_at, seed=k))
    published = run(new_tracker(), scans)
    before = min(published[joined_at - 1].tracks, key=lambda track: track.size_m[0])
    after = {track.id: track for track in published[-1].tracks}
    assert len(after) == 2
    person = after[before.id]
    assert person.velocity_mps[:2] == pytest.approx([0.0, -1.5], abs=0.3)
    assert person.p_odom_m[1] == pytest.approx(6.5 - 0.15 * 9, abs=0.3)
    (car,) = (track for number, track in after.items() if number != before.id)
    assert not car.velocity_mps.any()
    assert car.size_m[0] == pytest.approx(CAR[0], abs=0.4)
