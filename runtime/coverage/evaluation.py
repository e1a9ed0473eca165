"""Coverage of the places that machine and implement reach within the stopping distance, by state and body height.

A place is *covered* when a body there gives enough returns of one lidar, *enclosed* when every way to it crosses a band
of covered places, and *uncovered* otherwise (definitions and reasons: docs/coverage.md).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from configs.vehicle import Implement, Lidar, Vehicle
from geometry.arrays import Bool, Float64
from runtime.coverage.config import CoverageConfig
from runtime.coverage.kernels import count_returns, mark_reached
from runtime.coverage.rays import free_range_m, rays_of, solids_of
from runtime.coverage.states import DriveState
from safety.config import SafetyConfig
from safety.sources.near_field import ground_lidars, near_box
from safety.stopping_distance import stopping_distance
from safety.zones.footprint import Footprint, carriers, footprint_of
from safety.zones.swept_area import arc_poses

POSE_STEP_M = 0.1
EIGHT = np.ones((3, 3), bool)


@dataclass(frozen=True)
class Places:
    """Places at the coordinates (X,) and (Y,) in base."""

    x_m: Float64
    y_m: Float64

    @property
    def area_m2(self) -> float:
        """Area of one place."""
        return float((self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0]))


@dataclass(frozen=True)
class Coverage:
    """Places (X, Y) of one state and body height; `is_reached` by the machine, then covered, enclosed or neither."""

    state: DriveState
    height_m: float
    stopping_m: float
    places: Places
    is_reached: Bool
    is_covered: Bool
    is_enclosed: Bool

    @property
    def is_uncovered(self) -> Bool:
        """Reached places that are neither covered nor enclosed."""
        return self.is_reached & ~self.is_covered & ~self.is_enclosed

    @property
    def worst_m(self) -> tuple[float, float] | None:
        """The uncovered place farthest inside the largest uncovered area; None without any."""
        regions, count = ndimage.label(self.is_uncovered, EIGHT)
        if not count:
            return None
        largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
        depth = ndimage.distance_transform_edt(np.pad(regions == largest, 1))[1:-1, 1:-1]
        i, j = np.unravel_index(int(np.argmax(depth)), depth.shape)
        return round(float(self.places.x_m[i]), 2), round(float(self.places.y_m[j]), 2)

    def row(self) -> dict[str, object]:
        """Row of the table."""

        def m2(mask: Bool) -> float:
            return round(float(np.count_nonzero(mask)) * self.places.area_m2, 2)

        return {
            "state": self.state.name, "speed_mps": round(self.state.speed_mps, 2), "height_m": self.height_m,
            "stopping_m": round(self.stopping_m, 2), "reached_m2": m2(self.is_reached),
            "covered_m2": m2(self.is_reached & self.is_covered),
            "enclosed_m2": m2(self.is_reached & ~self.is_covered & self.is_enclosed),
            "uncovered_m2": m2(self.is_uncovered), "worst_m": self.worst_m,
        }  # fmt: skip


def evaluate(
    vehicle: Vehicle, implement: Implement | None, states: Iterable[DriveState], safety: SafetyConfig,
    config: CoverageConfig,
) -> list[Coverage]:  # fmt: skip
    """Coverage for each state and height; `vehicle` has the sensors of its implement too."""
    found, seen = list[Coverage](), dict[tuple[bool, bool], Bool]()
    states = tuple(states)
    footprints = {one: footprint_of(vehicle, implement and (implement.folded if one else implement)) for one in (0, 1)}
    stops_m = [stopping_distance(one.speed_mps, safety.braking.flat) for one in states]
    places = _window([footprints[s.is_folded] for s in states], max(stops_m), config)
    for state, stop_m in zip(states, stops_m, strict=True):
        key = state.is_raised, state.is_folded
        if key not in seen:
            solids = solids_of(vehicle, implement, *key)
            ground = ground_lidars(vehicle.sensors.lidar, footprints[key[1]])
            rays = [
                (one, rays_of(one, float(state.is_raised)), name in ground)
                for name, one in vehicle.sensors.lidar.items()
            ]
            seen[key] = covered(rays, solids, footprints[key[1]], places, safety, config)
        reached = reached_places(footprints[state.is_folded], state, stop_m, places, config)
        slowest_s = max((1.0 / one.rate_hz for one in vehicle.sensors.lidar.values()), default=math.inf)
        band_m = (state.speed_mps + config.person_mps) * 2.0 * slowest_s
        for height_m, is_covered in zip(config.heights_m, seen[key], strict=True):
            enclosed = enclosed_places(is_covered, band_m, config.place_m)
            found.append(Coverage(state, height_m, stop_m, places, reached, is_covered, enclosed))
    return found


def covered(
    lidars: Iterable[tuple[Lidar, Float64, bool]], solids: Float64, footprint: Footprint, places: Places,
    safety: SafetyConfig, config: CoverageConfig,
) -> Bool:  # fmt: skip
    """Whether a body of each height at each place gives enough returns of one of the lidars with their rays, (H, X, Y).

    At rest `min_returns_multiple_scan` returns repeat in the next scan, and are fewer than for a single scan.
    """
    field = safety.field
    heights = np.array(config.heights_m)
    own = _own(footprint, field.mask_m)
    enough = np.zeros((len(heights), len(places.x_m), len(places.y_m)), bool)
    for lidar, rays, measures_ground in lidars:
        low_m = counted_from_m(measures_ground, footprint, places, safety)
        reach = np.column_stack([np.full(len(rays), lidar.range_m[0]), free_range_m(rays, solids)])
        reach[:, 1] = np.minimum(reach[:, 1], lidar.range_m[1])
        counts = np.zeros(enough.shape, np.int64)
        some = reach[:, 1] > reach[:, 0]
        count_returns(
            rays[some], reach[some], places.x_m, places.y_m, low_m, heights, 0.5 * config.body_width_m, own, counts
        )
        enough |= counts >= min(field.min_returns_multiple_scan, field.min_returns_single_scan)
    return enough


def counted_from_m(measures_ground: bool, footprint: Footprint, places: Places, safety: SafetyConfig) -> Float64:
    """Height (X, Y) from which the supervisor counts a return of a lidar over smooth ground."""
    field, near = safety.field, safety.near_field
    x, y = np.meshgrid(places.x_m, places.y_m, indexing="ij")
    low_m = field.min_height_m + field.min_height_slope * np.hypot(x, y)
    if not measures_ground:
        return low_m
    box = near_box(footprint, near)
    is_near = box.contains(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    return np.where(is_near, np.minimum(low_m, near.min_height_m), low_m)


def _own(footprint: Footprint, mask_m: float) -> Float64:
    """Rectangles (K, 4) of the self filter, a trailed implement straight behind."""
    sides = [(r.rear_m, r.front_m, r.half_width_m) for r in footprint.rigid]
    if footprint.trailed is not None and footprint.drawbar is not None:
        hitch_m, body = footprint.drawbar.hitch_m, footprint.trailed
        sides.append((hitch_m + body.rear_m, hitch_m + body.front_m, body.half_width_m))
    return np.array([(rear - mask_m, front + mask_m, -half - mask_m, half + mask_m) for rear, front, half in sides])


def reached_places(
    footprint: Footprint, state: DriveState, stop_m: float, places: Places, config: CoverageConfig
) -> Bool:
    """Places (X, Y) that the outlines cover on any arc of the state within the stopping distance, from now on."""
    s_m = np.linspace(0.0, stop_m, 2 + int(stop_m / POSE_STEP_M))
    reached = np.zeros((len(places.x_m), len(places.y_m)), bool)
    sharpest = state.max_curvature_radpm
    for curvature in np.linspace(-sharpest, sharpest, config.curvatures):
        poses = arc_poses(float(curvature), state.direction, s_m)
        for body, carrier in carriers(footprint, poses, float(curvature)):
            mark_reached(
                places.x_m, places.y_m, np.ascontiguousarray(carrier), body.rear_m, body.front_m, body.half_width_m,
                reached,
            )  # fmt: skip
    return reached


def enclosed_places(is_covered: Bool, band_m: float, place_m: float) -> Bool:
    """Places (X, Y) which nobody reaches from the rim without crossing covered places for `band_m`."""
    if not is_covered.any():
        return np.zeros_like(is_covered)
    padded = np.pad(is_covered, 1)
    is_open = ndimage.distance_transform_edt(padded) * place_m <= 0.5 * band_m + 0.5 * place_m
    regions, _ = ndimage.label(is_open, EIGHT)
    return np.asarray((regions != regions[0, 0])[1:-1, 1:-1] & ~is_covered)


def _window(footprints: list[Footprint], stop_m: float, config: CoverageConfig) -> Places:
    """Places about all footprints, with the greatest stopping distance and the surroundings on every side."""
    own = np.concatenate([_own(one, 0.0) for one in footprints])
    more = stop_m + config.surroundings_m
    return Places(
        _spaced(float(own[:, 0].min()) - more, float(own[:, 1].max()) + more, config.place_m),
        _spaced(float(own[:, 2].min()) - more, float(own[:, 3].max()) + more, config.place_m),
    )


def _spaced(low: float, high: float, step: float) -> Float64:
    """Multiples of `step` that contain both limits, half a step off 0 so that mirrored places exist."""
    return np.asarray(step * (np.arange(math.floor(low / step), math.ceil(high / step)) + 0.5), np.float64)
