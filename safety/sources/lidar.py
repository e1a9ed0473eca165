"""Lidar source: confirmed obstacle returns in odom, and detection range by direction of travel."""

import math
import zlib
from collections.abc import Sequence

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Bool, Float32, Float64, Int64
from geometry.ground_surface import (
    above_cells,
    broad_tops,
    cells_in_grid,
    envelope,
    heights_above_ground,
    heights_above_planes,
    low_levels,
    lowest_of_cells,
    plane_sums,
    plant_heights,
    stand_out_of_cell,
    typical_of_blocks,
)
from geometry.near_points import groups_of, is_near
from geometry.negative_obstacle import negative_obstacles
from geometry.pose2 import from_frame, to_frame
from geometry.range_image import (
    RangeImage,
    ScatterMemory,
    beam_grid,
    clear_beneath,
    dust,
    floating,
    points_of,
    range_image,
    scattered,
)
from messages.sensors import LidarScan
from safety.config import SafetyConfig
from safety.sources.detection_range import (
    covers,
    down_beams,
    expected_density,
    min_range_towards,
    nominal_range_m,
    range_by_ratio,
    return_ratios,
    sector_edges,
)
from safety.sources.ground_filter import Motion, crop, deskew, mark_obstacles, to_base
from safety.sources.ground_heights import NO_GROUND, ground_heights
from safety.sources.measured_ground import level, stands_out
from safety.sources.multiple_evaluation import (
    Returns,
    Streaks,
    by_cell,
    cell_keys,
    evaluate,
    floats_as_a_whole,
    is_among,
)
from safety.sources.near_field import NearField, mark_low_obstacles, near_box
from safety.sources.plant_memory import PlantMemory
from safety.zones.footprint import Box, Footprint, enclosing, is_own

NO_CELLS: tuple[Int64, Int64] = (np.empty(0, np.int64), np.empty(0, np.int64))
NO_STREAKS = Streaks(*NO_CELLS)
BEYOND_EDGE_M = 8.0  # in which returns show that the ground at the edge of the area falls away
CONTENT_EVERY = 16  # points of a list: a checksum of all takes over a millisecond


class LidarSource:
    """Processes the scans of one lidar; `hits_odom_m` (N, 3) are the confirmed returns above the ground;
    `holes_odom_m` (H, 2) are those of them that are edges of negative obstacles in the last scan. `floated` has the
    stamps of the last scans with the returns (F, 3) in odom that had clear space beneath them.

    `footprint` is that of the self mask, set on a change of fold position; `hitch` moves a lidar on the implement.
    `consented_m`: height of plants up to which the mission consents to objects that they hide; `vegetation_m` is that
    of the plants around, `floor_m` the least height above rough ground that counts. `ground` is that near the lidar;
    `has_other_rings`: the last range image is not one of the configured lidar. A lidar that looks down or
    `measures_ground` detects low objects in the near field.
    """

    def __init__(
        self, name: str, lidar: Lidar, footprint: Footprint, config: SafetyConfig, consented_m: float = 0.0,
        measures_ground: bool = False,
    ) -> None:  # fmt: skip
        self.name = name
        self.stamp_ns: int | None = None
        self.scan: LidarScan | None = None
        self._image: RangeImage | None = None
        self._pose_odom: Float64 = np.zeros(3)
        self.hits_odom_m: Float64 = np.empty((0, 3))
        self.holes_odom_m: Float64 = np.empty((0, 2))
        self.floated: tuple[tuple[int, Float64], ...] = ()
        self.nominal_range_m = nominal_range_m(lidar, config.field, config.detection_range)
        self.footprint, self._config, self._consented_m = footprint, config, consented_m
        least_m = config.measured_ground.near_min_height_m
        self._on_slopes = config.near_field.model_copy(update={"min_height_m": least_m})
        self.hitch, self._mount = 1.0, lidar.mount
        self._looks_down = lidar.looks_down
        self._measures_ground = measures_ground or lidar.looks_down
        self._plants = PlantMemory(config.near_field.cell_m, config.vegetation.memory_s)
        self._T_base_sensor = lidar.mount.T_base_sensor
        self._min_slope = math.tan(math.radians(min(lidar.elevation_deg)))
        self._slopes, self._density = expected_density(lidar, config.detection_range)
        column_rad = math.radians(lidar.field_of_view_deg) / lidar.columns
        self._scatter, self._is_body, self._is_in_fog = ScatterMemory(), np.empty(0, np.bool_), False
        self._beam_grid = beam_grid(np.radians(np.array(lidar.elevation_deg)), column_rad)
        self._directions = tuple(d for d in (1, -1) if covers(lidar, footprint, d))
        self._edges = sector_edges(config.detection_range.sectors)
        self._detection_range_m = dict.fromkeys(self._directions, 0.0)
        self._cells, self._streaks = NO_CELLS, NO_STREAKS
        self._kept: tuple[Float64, Int64] = (np.empty((0, 3)), np.empty(0, np.int64))
        self._contents: dict[int, int] = {}  # number of the last scan with each content, oldest first
        self._scans = self._equal_scans = 0
        self.ground, self.vegetation_m, self.floor_m = NO_GROUND, 0.0, 0.0
        self.has_other_rings, self._rings = False, len(lidar.elevation_deg)
        warm(self._T_base_sensor)

    def covers(self, direction: int) -> bool:
        """Whether the lidar covers a direction of travel."""
        return direction in self._directions

    def detection_range_m(self, direction: int) -> float:
        """Detection range of the last scan in a direction of travel; 0 while frozen."""
        return 0.0 if self.is_frozen else self._detection_range_m.get(direction, 0.0)

    @property
    def is_frozen(self) -> bool:
        """Whether the last scans repeat earlier ones."""
        return self._equal_scans >= self._config.detection_range.frozen_scans

    def update(
        self, scan: LidarScan, pose_odom: Float64, motion: Motion, curvature_radpm: float, box: Box,
        others: Sequence["LidarSource"] = (),
    ) -> None:  # fmt: skip
        """Processes a scan; `pose_odom` (3,) is base at its stamp, `box` the area of interest in base at that time.

        `others`: lidars that may show what this one cannot see below a return.

        The last scan may be processed again for another box; the cells of the scan before it are then dropped.
        """
        is_new = scan is not self.scan
        if not is_new:
            self._cells = NO_CELLS
        else:
            self._count_repetition(content_of(scan))
            is_list = scan.ranges_mm.size == 0
            self._image = None if is_list else range_image(scan.ranges_mm, scan.elevation_rad, scan.azimuth_rad)
            self._is_body = ~self._is_scattered(scan)
            scattered_share = 1.0 - float(np.mean(self._is_body)) if len(self._is_body) else 0.0
            self._is_in_fog = scattered_share > self._config.airborne.fog_share
        self.scan, self.stamp_ns, self._pose_odom = scan, scan.stamp_ns, pose_odom
        self.has_other_rings = scan.ranges_mm.size > 0 and len(scan.ranges_mm) != self._rings
        self._T_base_sensor = self._mount.at_hitch(self.hitch)
        xyz, is_body = to_base(scan.points_m, self._T_base_sensor), self._is_body
        body = xyz if is_body.all() else xyz.compress(is_body, axis=1)
        down = self._down_returns(body, curvature_radpm)
        self._update_detection_range(down)
        agreement, origin = self._config.lidar_agreement, self._T_base_sensor[:3, 3]
        self.ground = ground_heights(down, origin, agreement.range_m, pose_odom, agreement.cell_m)
        field = self._config.field
        needs_near_field = self._measures_ground or self._consented_m > 0.0
        near_field = near_box(self.footprint, self._config.near_field) if needs_near_field else None
        area = box if near_field is None or not self._measures_ground else enclosing(box, near_field)
        top_m = self.footprint.height_m + field.overhead_margin_m
        near = crop(xyz, area.enlarged(BEYOND_EDGE_M), top_m)
        is_machine = is_own(xyz.take(near, axis=1), self.footprint, curvature_radpm, field.mask_m)
        if self._image is not None:  # a beam that ends on the machine proves nothing of what is above it
            self._image = self._image.without(scan.pixels[near[is_machine]])
        near = near[~is_machine & is_body[near]]  # before deskewing: the machine moves with the sensor
        near_xyz, is_hole = self._at_edge_of_hole(scan, near, xyz.take(near, axis=1))
        inside = crop(near_xyz, area, top_m)
        near, near_xyz, is_hole = near[inside], near_xyz.take(inside, axis=1), is_hole[inside]
        near_xyz = deskew(near_xyz, scan.point_offset_s.take(near), motion)
        is_obstacle, is_high, is_dense = self._mark(near_xyz, area, near_field)
        marked = np.flatnonzero(is_obstacle | is_hole)
        is_dust, is_floating, is_standing = self._in_air(scan, near[marked])
        marked, is_floating, is_standing = (some[~is_dust] for some in (marked, is_floating, is_standing))
        obstacles = near_xyz.take(marked, axis=1).astype(np.float64)
        points_odom = np.column_stack([to_frame(pose_odom, obstacles[:2].T), obstacles[2]])
        returns = by_cell(cell_keys(points_odom, field.cell_m))
        self._ask(others, points_odom, returns, is_floating, is_standing)
        is_floating |= floats_as_a_whole(returns, is_floating, is_standing)
        self._keep_floated(points_odom[is_floating])
        is_floating |= self._follows_floating(others, points_odom, returns, is_standing)
        is_doubtful = is_floating | (is_dense | is_hole)[marked]
        single, multiple = field.min_returns_single_scan, field.min_returns_multiple_scan
        at_once = is_high[marked] & (is_standing | (not self._is_in_fog))  # dust above the implement stands on nothing
        is_hit, cells = evaluate(returns, at_once, is_doubtful, self._cells, single, multiple)
        if self._is_in_fog:  # what is left of it is in the same cell in three scans by chance
            is_hit &= ~is_floating | (returns.counts >= field.min_returns_in_fog)[returns.which]
        self._cells = (cells, self._cells[0])
        if is_new:
            self._continue_streaks(returns.cells[returns.number(~is_doubtful) > 0], motion)
        lasting = self._streaks.longer_than(field.scans_at_rest)
        is_hit |= ~is_doubtful & is_among(returns.cells, lasting)[returns.which]
        self.holes_odom_m = points_odom[is_hit & is_hole[marked], :2]
        self._hold_in_blind_zone(points_odom[is_hit], pose_odom, curvature_radpm, scan.stamp_ns)

    def _continue_streaks(self, cells: Int64, motion: Motion) -> None:
        """Takes the sorted cells in which something stands; a machine that moves, and fog, start again."""
        is_at_rest = abs(motion.speed_mps) <= self._config.modes.standstill_mps
        self._streaks = (self._streaks if is_at_rest and not self._is_in_fog else NO_STREAKS).continued(cells)

    def _mark(self, xyz: Float32, area: Box, near_field: Box | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which returns (3, N) are obstacles, and which of them are high, or hardly stand out, (N,) bool."""
        config = self._config
        is_above_plane = mark_obstacles(xyz, area, config.field)
        is_high = stands_out(xyz, is_above_plane, area, config.field, config.measured_ground)
        none = np.zeros_like(is_high)
        if near_field is None:
            return is_high, is_high, none
        plants = config.vegetation, self._consented_m
        near = mark_low_obstacles(xyz, near_field, config.near_field, *plants)
        is_high &= ~near.is_plant
        if not self._measures_ground:
            return is_high, is_high, none
        self.vegetation_m, self.floor_m = near.vegetation_m, near.min_height_m
        is_low, is_dense, is_hidden = near.is_obstacle, near.is_dense, is_above_plane & ~is_high
        if near.min_height_m > config.field.min_height_m:
            is_hidden |= near.is_hidden  # on such ground the near field misses what the plane may not reach
        if is_hidden.any():
            level_xyz = level(xyz, area, config.near_field.ground_quantile, config.measured_ground)
            level_near = mark_low_obstacles(level_xyz, near_field, self._on_slopes, *plants)
            self.floor_m = min(self.floor_m, level_near.min_height_m)
            is_more = is_hidden & level_near.is_obstacle & ~near.is_plant
            is_dense = (is_low & is_dense & ~is_more) | (is_more & level_near.is_dense & (~is_low | is_dense))
            is_low |= is_more
        if self._consented_m > 0.0:
            is_low &= ~self._is_where_plants_stood(xyz, near, is_low)
        return is_high | is_low, is_high, is_dense & ~is_high

    def _is_where_plants_stood(self, xyz: Float32, near: NearField, is_low: Bool) -> Bool:
        """Which returns (3, N), (N,), of these low ones do not stand out of the plants that stood there; remembers
        those of this scan."""
        stood = np.zeros_like(is_low)
        plants, low = np.flatnonzero(near.is_plant), np.flatnonzero(is_low & ~near.is_plant)
        plants_odom_m, low_odom_m = (
            to_frame(self._pose_odom, xyz[:2, some].T.astype(np.float64)) for some in (plants, low)
        )
        self._plants.add(self.stamp_ns or 0, plants_odom_m, near.height_m[plants])
        top_m = self._plants.height_m(low_odom_m)
        stood[low] = (top_m > 0.0) & (near.height_m[low] <= top_m + self._config.vegetation.uncertainty_m)
        return stood

    def _at_edge_of_hole(self, scan: LidarScan, which: Int64, xyz: Float32) -> tuple[Float32, Bool]:
        """Returns `which` (K,) of a scan at xyz (3, K), and which are of negative obstacles, (K,): these are moved to
        where the ground ends before them. Lists of points show none, and lidars that do not look down have rings too
        far apart.
        """
        image, config = self._image, self._config.negative_obstacle
        if image is None or not self._looks_down:
            return xyz, np.zeros(len(which), bool)
        x_m, y_m, z_m = self._T_base_sensor[:3, 3]
        row, column = np.divmod(scan.pixels[which], image.ranges_mm.shape[1])
        order = np.argsort(column * len(image.rows) + image.rank[row])
        run_m = np.hypot(xyz[0] - x_m, xyz[1] - y_m)
        edge_m = np.empty(len(which))
        edge_m[order] = negative_obstacles(
            column[order], run_m[order].astype(np.float64), xyz[2][order].astype(np.float64), z_m,
            config.depth_m + self.vegetation_m, config.beneath_m, config.fall,
        )  # fmt: skip
        is_hole = edge_m > 0.0
        if is_hole.any():
            share = edge_m[is_hole] / run_m[is_hole]
            xyz[0, is_hole], xyz[1, is_hole] = (
                x_m + share * (xyz[0, is_hole] - x_m),
                y_m + share * (xyz[1, is_hole] - y_m),
            )
            xyz[2, is_hole] = 0.0
        return xyz, is_hole

    def _is_scattered(self, scan: LidarScan) -> np.ndarray:
        """Which returns of a scan are of fog, rain or dense dust, (N,) bool."""
        if self._image is None:
            return scattered(*self._beam_grid.place(scan.points_m), self._scatter)
        return scattered(self._image, scan.pixels, self._scatter)

    def _in_air(self, scan: LidarScan, which: Int64) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which of the obstacle returns `which` (K,) of a scan are dust, which float, and which stand, (K,) bool.

        A list of points is no evidence of the first two: it does not show what the beams passed.
        """
        none, ones = np.zeros(len(which), bool), np.ones(len(which), bool)
        image = self._image
        if image is None:
            return none, none, ones
        field, config = self._config.field, self._config.airborne
        pixels = scan.pixels[which]
        is_dust = dust(image, pixels, config.dust_range_m, config.dust_returns)
        ground = (field.min_height_m, field.min_height_slope)
        return is_dust, *floating(image, pixels, self._T_base_sensor, *ground, config.clear_m)

    def _ask(
        self, others: Sequence["LidarSource"], points_odom: Float64, returns: Returns, is_floating: np.ndarray,
        is_standing: np.ndarray,
    ) -> None:  # fmt: skip
        """Adds to `is_floating` (N,) the returns of cells, above the ground, below which only other lidars see."""
        which = returns.which
        lowest_m = np.full(len(returns.cells), np.inf)
        np.minimum.at(lowest_m, which, points_odom[:, 2])
        is_open = (returns.number(~is_floating) > 0) & (returns.number(is_standing) == 0)
        is_open &= lowest_m > self._config.field.min_height_m + self._config.airborne.clear_m
        if not is_open.any():
            return
        x, y = (np.bincount(which, points_odom[:, k], len(returns.cells)) / returns.counts for k in range(2))
        below, is_clear = np.column_stack([x, y, lowest_m])[is_open], np.zeros(len(returns.cells), bool)
        for other in others:
            is_clear[is_open] |= other.shows_clear_beneath(below, self.stamp_ns)
        is_floating |= is_clear[which]

    def _keep_floated(self, points_odom: Float64) -> None:
        now_ns, kept_ns = self.stamp_ns or 0, self._config.airborne.follow_s * 1e9
        last = tuple(seen for seen in self.floated if 0 < now_ns - seen[0] <= kept_ns)
        self.floated = (*last, (now_ns, points_odom)) if len(points_odom) else last

    def _follows_floating(
        self, others: Sequence["LidarSource"], points_odom: Float64, returns: Returns, is_standing: np.ndarray
    ) -> np.ndarray:
        """Which returns (N,) are in cells where nothing stands, as near to what floated in the last scans as a bird
        flies, (N,) bool."""
        follows, config = np.zeros(len(points_odom), bool), self._config.airborne
        is_open = (returns.number(is_standing) == 0)[returns.which]
        seen = (entry for one in (self, *others) if not one.is_frozen for entry in one.floated)
        for stamp_ns, floated_odom_m in seen:
            age_s = abs((self.stamp_ns or 0) - stamp_ns) * 1e-9
            which = np.flatnonzero(is_open & ~follows)
            if age_s <= config.follow_s and len(which):
                reach_m = config.follow_m + config.follow_mps * age_s
                follows[which] = is_near(points_odom[which], floated_odom_m, reach_m)
        return follows

    def is_recent(self, stamp_ns: int | None) -> bool:
        """Whether the last scan was taken about `stamp_ns`."""
        interval_ns = self._config.lidar_agreement.max_interval_s * 1e9
        return self.stamp_ns is not None and stamp_ns is not None and abs(self.stamp_ns - stamp_ns) <= interval_ns

    def shows_clear_beneath(self, points_odom: Float64, stamp_ns: int | None) -> np.ndarray:
        """Whether the last scan, if taken about `stamp_ns`, shows clear space below points (N, 3), (N,) bool."""
        image, field = self._image, self._config.field
        if image is None or self.is_frozen or not self.is_recent(stamp_ns):
            return np.zeros(len(points_odom), bool)
        base = np.column_stack([from_frame(self._pose_odom, points_odom[:, :2]), points_odom[:, 2]])
        return clear_beneath(image, base, self._T_base_sensor, field.min_height_m, field.min_height_slope)

    def _count_repetition(self, content: int | None) -> None:
        """Counts scans in a row whose ranges an earlier one had bit for bit: frozen, or a replayed recording."""
        memory = self._config.detection_range.repeat_memory_scans
        last = None if content is None else self._contents.pop(content, None)
        is_repeated = last is not None and self._scans - last < memory
        self._equal_scans = self._equal_scans + 1 if is_repeated else 0
        if content is not None:
            self._contents[content] = self._scans = self._scans + 1
            if len(self._contents) > memory:
                del self._contents[next(iter(self._contents))]

    def _down_returns(self, xyz: Float32, curvature_radpm: float) -> Float32:
        """Returns (3, K) of beams that meet level ground, without those of the machine."""
        some = down_beams(xyz, self._T_base_sensor[:3, 3], self._slopes)
        is_machine = is_own(some, self.footprint, curvature_radpm, self._config.field.mask_m)
        return np.asarray(some.compress(~is_machine, axis=1))

    def _update_detection_range(self, down: Float32) -> None:
        config = self._config.detection_range
        ratios = return_ratios(down, self._T_base_sensor[:3, 3], self._slopes, self._density, config.sectors)
        ranges, half_rad = range_by_ratio(ratios, self.nominal_range_m, config), math.radians(config.half_cone_deg)
        self._detection_range_m = {d: min_range_towards(self._edges, ranges, d, half_rad) for d in self._directions}

    def _hold_in_blind_zone(
        self, hits_odom: Float64, pose_odom: Float64, curvature_radpm: float, stamp_ns: int
    ) -> None:
        """Holds hits that entered the blind zone below the lowest beam, right before the bumper.

        At its edge, where noise decides what is visible, they are held for a time; farther below until the machine has
        moved on, because nothing shows there whether they have left.
        """
        old, seen_ns = self._kept
        base = np.vstack([from_frame(pose_odom, old[:, :2]).T, old[:, 2]])
        is_young = stamp_ns - seen_ns < self._config.field.blind_zone_hold_s * 1e9
        depth_m = self._depth_in_blind_zone_m(base)
        hidden = np.flatnonzero((depth_m > self._config.field.blind_zone_edge_m) | (is_young & (depth_m > 0.0)))
        keep = hidden[~is_own(base[:, hidden], self.footprint, curvature_radpm, self._config.field.mask_m)]
        self.hits_odom_m = np.concatenate([hits_odom, old[keep]])
        stamps = np.concatenate([np.full(len(hits_odom), stamp_ns, np.int64), seen_ns[keep]])
        self._kept = (self.hits_odom_m, stamps)

    def forget_held(self) -> None:
        """Drops the held hits: an operator has confirmed that nobody is there."""
        self.hits_odom_m, self._kept = np.empty((0, 3)), (np.empty((0, 3)), np.empty(0, np.int64))

    def _depth_in_blind_zone_m(self, base: Float64) -> Float64:
        """Depth of each point (3, N) below the lowest beam, (N,); below 0 above it."""
        x, y, z = base - self._T_base_sensor[:3, 3:]
        return np.asarray(self._min_slope * np.hypot(x, y) - z)


def warm(T_base_sensor: Float64) -> None:
    """Compiles or loads the kernels of range images, of the ground and of near points, so that no scan waits for it."""
    none, two = np.empty(0, np.float32), np.ones((1, 2), np.uint16)
    scan = LidarScan(0, two, np.zeros(1), np.zeros(2), np.empty((0, 3), np.float32), np.empty(0, np.uint8), none)
    image, pixels = range_image(scan.ranges_mm, scan.elevation_rad, scan.azimuth_rad), scan.pixels[scan.pixels]
    points_of(scan.ranges_mm, scan.elevation_rad, scan.azimuth_rad)
    dust(image, pixels, 0.0, 1)
    scattered(image, pixels)
    floating(image, pixels, T_base_sensor, 0.0, 0.0, 1.0)
    clear_beneath(image, np.zeros((1, 3)), T_base_sensor, 0.0, 0.0)
    negative_obstacles(np.zeros(1, np.int64), np.ones(1), np.zeros(1), 1.0, 1.0, 1.0, 1.0)
    low_levels(np.zeros(1, np.int64), np.zeros(1, np.int32), (1, 1), 1, 0.0)
    lowest_of_cells(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1))
    envelope(np.zeros((1, 1)), 0.0, 1)
    xyz, corner, shape = np.zeros((3, 1), np.float32), (0.0, 0.0), (2, 2)
    heights_above_ground(xyz, corner, shape, 1.0, 0.0, 0.0, 0.0, 1.0)
    zero = np.zeros(1)
    stand_out_of_cell(xyz, zero, np.zeros(shape), corner, 1.0, zero, zero, 0.0, (0.0, 0.0), 1, 0.0)
    typical_of_blocks(np.zeros(shape), 1, 0.5, 1)
    broad_tops(np.zeros(shape))
    plane_sums(np.zeros(shape), np.ones(shape, bool), 1)
    cell = cells_in_grid(xyz, corner, shape, 1.0)
    above_cells(xyz, cell, np.zeros(4, np.float32), np.float32(0.0), np.float32(0.0))
    heights_above_planes(xyz, cell, np.zeros((4, 3)), corner, 1.0)
    plant_heights(np.zeros((1, 1)), 1, np.ones(1, np.int64), 0.0, 1.0, 0.5)
    is_near(np.zeros((1, 2)), np.zeros((1, 2)), 1.0)
    groups_of(np.zeros((1, 2)), 1.0)


def content_of(scan: LidarScan) -> int | None:
    """Checksum of the ranges, or of number and every `CONTENT_EVERY`-th point of a list; None of an empty scan."""
    if scan.ranges_mm.size == 0 and scan.xyz_m.size == 0:
        return None
    return zlib.crc32(scan.xyz_m[::CONTENT_EVERY].tobytes(), zlib.crc32(scan.ranges_mm.tobytes(), len(scan.xyz_m)))
