"""Known structure: the surveyed shed. Returns on its walls and posts are expected; the swept area must not reach them.

          roof outline
┌───────────────────────┐ wall     returns within a tolerance of wall or post are filtered out;
│  ·    bay         ·   · posts    the swept bodies, enlarged by the pose uncertainty,
└───────────────────────┘          must not reach the surface of either
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from configs.site import Shed, Site
from geometry.arrays import Float64
from geometry.pose2 import from_frame, to_frame
from safety.zones.geofence import is_within
from safety.zones.swept_area import SweptArea, distance_to_contact_m, outline_points

SPACING_M = 0.15  # of the discs that represent a wall: between two discs its surface lies 0.04 m farther out
REACH_M = 15.0  # discs farther from base are beyond every swept area in docking
OUTLINE_M = 0.5  # spacing of the poses whose outline is tested against the roof


@dataclass(frozen=True)
class KnownStructure:
    """Walls as segments (S, 4: ends) of one thickness, posts (P, 3: x, y, radius) and roof outline (R, 2), in map."""

    walls: Float64
    half_thickness_m: float
    posts: Float64
    roof: Float64

    def distance_m(self, points_map: Float64) -> Float64:
        """Distance of points (N, 2) from the nearest surface, (N,); below 0 inside wall or post."""
        x, y = points_map[:, :1], points_map[:, 1:]  # points by segments or posts, of which there are few
        x0, y0, x1, y1 = self.walls.T
        ahead, aside = x1 - x0, y1 - y0
        share = ((x - x0) * ahead + (y - y0) * aside) / np.maximum(ahead * ahead + aside * aside, 1e-9)
        share = np.clip(share, 0.0, 1.0)
        wall = np.hypot(x - x0 - share * ahead, y - y0 - share * aside).min(axis=1, initial=np.inf)
        post = (np.hypot(x - self.posts[:, 0], y - self.posts[:, 1]) - self.posts[:, 2]).min(axis=1, initial=np.inf)
        return np.asarray(np.minimum(wall - self.half_thickness_m, post))

    def is_near(self, pose_map: Float64, near_m: float) -> bool:
        """Whether a pose is under the roof or within `near_m` of its edge."""
        middle, reach_m = self._circle
        if math.hypot(pose_map[0] - middle[0], pose_map[1] - middle[1]) > reach_m + near_m:
            return False
        point = pose_map[None, :2]
        if is_within(point, self.roof)[0]:
            return True
        edges = replace(self, walls=edges_of(self.roof), half_thickness_m=0.0, posts=self.posts[:0])
        return float(edges.distance_m(point)[0]) <= near_m

    def is_under_roof(self, area: SweptArea, pose_map: Float64) -> bool:
        """Whether any body is under the roof anywhere in the swept area."""
        points, _ = outline_points(area, OUTLINE_M)
        return bool(is_within(to_frame(pose_map, points), self.roof).any())

    def clear_distance_m(self, area: SweptArea, pose_map: Float64, clearance_m: float) -> float:
        """Distance until a body comes within `clearance_m` of wall or post; infinite when none does."""
        discs = self._discs
        xy = from_frame(pose_map, discs[:, :2])
        near = np.hypot(*xy.T) <= REACH_M
        bare = replace(area, lateral_m=np.zeros_like(area.lateral_m))
        return float(np.min(distance_to_contact_m(xy[near], bare, discs[near, 2] + clearance_m), initial=math.inf))

    @cached_property
    def _circle(self) -> tuple[Float64, float]:
        middle = self.roof.mean(axis=0)
        return middle, float(np.hypot(*(self.roof - middle).T).max())

    @cached_property
    def _discs(self) -> Float64:
        walls = [discs_along(wall, self.half_thickness_m) for wall in self.walls]
        return np.concatenate([self.posts, *walls])


def structure_of_site(site: Site) -> KnownStructure | None:
    """Known structure of a site; None without a shed."""
    return None if site.shed is None else structure_of_shed(site.shed)


def structure_of_shed(shed: Shed) -> KnownStructure:
    """Known structure of a shed: walls, posts and roof."""
    walls = [(*a, *b) for line in shed.walls_m for a, b in pairwise(line)]
    posts = [(*post.at_m, post.radius_m) for post in shed.posts]
    return KnownStructure(
        np.array(walls, np.float64).reshape(-1, 4),
        0.5 * shed.wall_thickness_m,
        np.array(posts, np.float64).reshape(-1, 3),
        np.array(shed.outline_m),
    )


def edges_of(ring: Float64) -> Float64:
    """Sides of a polygon (R, 2) as segments (R, 4)."""
    return np.column_stack([ring, np.roll(ring, -1, axis=0)])


def discs_along(wall: Float64, radius_m: float) -> Float64:
    """Discs (K, 3: x, y, radius) whose union is a wall (4,) from end to end."""
    count = max(2, math.ceil(math.hypot(wall[2] - wall[0], wall[3] - wall[1]) / SPACING_M) + 1)
    share = np.linspace(0.0, 1.0, count)[:, None]
    centers = wall[:2] + share * (wall[2:] - wall[:2])
    return np.column_stack([centers, np.full(count, radius_m)])
