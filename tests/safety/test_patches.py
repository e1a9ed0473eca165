"""Returns above the ground, patch by patch, against a slow reference; boxes, deskewing and what is beyond them."""

import math

import numpy as np
import pytest

from configs.vehicle import TrailedImplement, Vehicle
from geometry.pose2 import to_frame
from safety.config import FieldConfig, SafetyConfig
from safety.sources.ground_filter import Motion, bound_ground, crop, deskew, estimate_ground, mark_obstacles, to_base
from safety.zones.footprint import Box, footprint_of, is_own

AREA = Box((-4.0, 20.0), (-7.0, 5.0))


def test_a_box_holds_its_edges_and_what_is_no_number() -> None:
    inside = [(-4.0, 0.0), (20.0, 0.0), (0.0, -7.0), (0.0, 5.0), (math.nan, 0.0), (0.0, math.nan)]
    outside = [(-4.01, 0.0), (20.01, 0.0), (0.0, -7.01), (0.0, 5.01), (math.nan, 6.0)]
    assert AREA.contains(np.array(inside + outside)).tolist() == [True] * 6 + [False] * 5


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.8, -2.5, 3.0])
def test_a_box_seen_from_another_frame_is_that_about_its_corners(yaw: float) -> None:
    pose, area = np.array([5.0, -3.0, yaw]), Box((-4.0, 20.0), (-9.0, 5.0))
    corners = to_frame(pose, np.array([(x, y) for x in area.x_m for y in area.y_m]))
    found = area.in_parent(pose)
    assert (*found.x_m, *found.y_m) == pytest.approx(
        (corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max())
    )


def test_returns_are_turned_and_moved_into_base() -> None:
    T = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]])
    found = to_base(np.array([[4.0, 1.0, -2.0], [0.0, 0.0, 0.0]], np.float32), T)
    assert found.T.tolist() == [[2.0, 6.0, -0.5], [3.0, 2.0, 1.5]]
    assert found.dtype == np.float32


def test_a_return_is_moved_by_what_the_machine_did_since() -> None:
    xyz = np.array([[10.0, 10.0], [4.0, 4.0], [1.0, 2.0]], np.float32)
    found = deskew(xyz, np.array([-0.1, 0.0], np.float32), Motion(8.0, 0.5))
    moved = found.T
    assert moved == pytest.approx(np.array([(10.0 + 0.05 * 4.0 - 0.8, 4.0 - 0.05 * 10.0, 1.0), (10.0, 4.0, 2.0)]))


def test_within_is_inside_the_box_and_below_the_top() -> None:
    inside = [(0.0, 0.0, 1.0), (19.9, 4.9, 2.9), (-3.9, -6.9, -9.0)]
    outside = [(-4.0, 0.0, 1.0), (20.0, 0.0, 1.0), (0.0, -7.0, 1.0), (0.0, 5.0, 1.0), (0.0, 0.0, 3.0)]
    points = np.array(outside + inside, np.float32).T
    assert crop(points, AREA, 3.0).tolist() == [5, 6, 7]


def test_the_ground_of_a_patch_is_its_so_many_th_lowest_return() -> None:
    heights = {0: [0.02, 0.07, 0.12, 0.52], 1: [0.02, 0.07], 2: [], 3: [-9.0, -1.98, 9.0], 4: [0.02] * 2 + [0.12] * 18}
    patch = np.concatenate([np.full(len(z), k) for k, z in heights.items()]).astype(np.int64)
    z = np.concatenate([np.array(some, np.float32) for some in heights.values()])
    for order, share, expected in (
        (3, 0.0, [0.1, math.inf, math.inf, 1.95, 0.1]),
        (2, 0.0, [0.05, 0.05, math.inf, -2.0, 0.0]),
        (1, 0.0, [0.0, 0.0, math.inf, -2.0, 0.0]),
        (1, 0.5, [0.05, 0.0, math.inf, -2.0, 0.1]),
        (1, 0.1, [0.0, 0.0, math.inf, -2.0, 0.0]),
        (1, 0.101, [0.0, 0.0, math.inf, -2.0, 0.1]),
    ):
        assert estimate_ground(patch, z, 5, order, share) == pytest.approx(np.array(expected)), (order, share)


def test_ground_is_believed_as_far_as_it_can_bend(config: SafetyConfig) -> None:
    far = np.array([2.0, 4.0, 7.0, 50.0])
    for ground, expected in (
        (0.1, (0.0, 0.1, 0.1, 0.1)), (0.3, (0.0, 0.16, 0.3, 0.3)), (9.0, (0.0, 0.16, 0.4, 0.5)),
        (0.0, (0.0, 0.0, 0.0, 0.0)), (-0.1, (0.0, 0.0, 0.0, 0.0)), (-0.2, (0.0, -0.1, -0.1, -0.1)),
        (-9.0, (0.0, -0.16, -0.4, -3.84)),
    ):  # fmt: skip
        assert bound_ground(np.full(4, ground), far, config.field) == pytest.approx(np.array(expected)), ground


def limits_of(xyz: np.ndarray, box: Box, field: FieldConfig) -> np.ndarray:
    """The height from which on each return counts, one by one."""
    size = field.ground_patch_m

    def index(value: float, ends: tuple[float, float]) -> int:
        return min(max(math.floor(value / size), math.floor(ends[0] / size)), math.floor(ends[1] / size))

    patch = [(index(x, box.x_m), index(y, box.y_m)) for x, y in xyz[:2].T]
    heights: dict[tuple[int, int], list[float]] = {}
    for own, z in zip(patch, xyz[2], strict=True):
        heights.setdefault(own, []).append(z)
    limits = []
    for own, (x, y, _) in zip(patch, xyz.T, strict=True):
        some = sorted(heights[own])
        order = max(field.ground_returns, math.ceil(field.ground_ratio * len(some)))
        lowest = some[order - 1] if len(some) >= field.ground_returns else math.inf
        ground = 0.05 * math.floor(lowest / 0.05) if math.isfinite(lowest) else math.inf
        away = math.hypot((own[0] + 0.5) * size - 1.3, (own[1] + 0.5) * size)
        lift = float(bound_ground(np.array([ground]), np.array([away]), field)[0])
        limits.append(lift + field.min_height_m + field.min_height_slope * math.hypot(x, y))
    return np.array(limits)


@pytest.mark.parametrize("share", [0.0, 0.09])
@pytest.mark.parametrize("box", [AREA, Box((-4.0, 20.0), (1.0, 13.0)), Box((3.0, 8.9), (-13.0, 9.0))])
def test_returns_stand_out_from_the_ground_of_their_patch(config: SafetyConfig, box: Box, share: float) -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(box.x_m[0] - 6.0, box.x_m[1] + 6.0, 900), rng.uniform(box.y_m[0] - 6.0, box.y_m[1] + 6.0, 900)
    slope = 0.08 * np.maximum(x, 0.0) * np.sign(y)
    z = slope + rng.choice([0.0, 0.2, 0.4, 0.7], 900) + rng.uniform(-0.1, 0.1, 900)
    xyz = np.stack([x, y, np.clip(z, -1.9, 1.9)]).astype(np.float32)
    field = config.field.model_copy(update={"ground_ratio": share})
    limits = limits_of(xyz.astype(np.float64), box, field)
    is_clear = np.abs(xyz[2] - limits) > 1e-4
    assert is_clear.sum() > 880
    assert (mark_obstacles(xyz, box, field) == (xyz[2] > limits))[is_clear].all()


def test_the_own_trailer_is_masked_where_the_bend_puts_it(vehicle: Vehicle) -> None:
    wagon = TrailedImplement(
        kind="trailed", name="wagon", working_width_m=3.0, width_m=3.0, lift_s=1.0, lower_s=1.0, uses_pto=False,
        hitch_m=-1.2, axle_length_m=4.0, working_length_m=4.0, total_length_m=5.5,
    )  # fmt: skip
    footprint = footprint_of(vehicle, wagon)
    yaw = math.atan(0.2 * -1.2) - math.asin(4.0 * 0.2 * math.cos(math.atan(0.2 * -1.2)))
    hitch = np.array([-1.2, 0.0, yaw])
    for x, y, is_on in ((-5.6, 0.0, True), (-5.61, 0.0, False), (-3.0, 1.6, True), (-3.0, 1.61, False),
                        (-3.0, -1.6, True), (-3.0, -1.61, False), (-5.5, 1.5, True)):  # fmt: skip
        inner = np.array([[x + (1e-6 if is_on else 0.0), y - math.copysign(1e-6, y) if is_on else y]])
        point = to_frame(hitch, inner)[0]
        assert is_own(np.array([[point[0]], [point[1]], [1.0]]), footprint, 0.2, 0.1)[0] == is_on, (x, y)
    assert is_own(np.array([[0.0], [0.0], [1.0]]), footprint, 0.2, 0.1)[0]
    assert not is_own(np.array([[-3.0], [3.0], [1.0]]), footprint_of(vehicle, None), 0.2, 0.1)[0]
