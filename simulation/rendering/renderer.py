"""From a scene to a picture: what is near is drawn, first as the sun sees it, then as the camera does.

triangles near ──► sun's picture (what is not in it lies in shadow) ──┐
              └──► depth and owner of each pixel ─────────────────────┴──► light, texture ──► BGR
"""

import math
from dataclasses import dataclass

import numpy as np

from messages.message import Float32, Float64, Int32, UInt8
from simulation.rendering.light import Light
from simulation.rendering.raster import fill, project, project_parallel
from simulation.rendering.scene_mesh import Cells, Material, Surface, arrays_of, merge
from simulation.rendering.shading import BLOCK, highest, shade
from simulation.rendering.skybox import draw_panorama
from simulation.rendering.textures import texture_layers, textures

CELL_M = 8.0
SPARE = 50_000  # triangles of what moves for which room is made at once
SHADOW_PX, SHADOW_PER_M = 640, 16.0
SHADOW_AHEAD_M, METER_STEP = 15.0, 16
R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
LAYERS = texture_layers()
NO_ROOF = np.array([0.0, 0.0, -1.0, -1.0, 0.0])


@dataclass(frozen=True)
class Eye:
    """A pinhole: pose of the body frame in `map` (4, 4), focal lengths and centre in pixels, size (width, height)."""

    T_map_camera: Float64
    intrinsics: Float64
    size_px: tuple[int, int]

    @property
    def R(self) -> Float64:
        """From `map` to the optical frame, (3, 3)."""
        return np.ascontiguousarray((self.T_map_camera[:3, :3] @ R_BODY_OPTICAL).T)

    def shrunk(self, by: int) -> "Eye":
        """The same with fewer pixels."""
        return Eye(self.T_map_camera, self.intrinsics / by, (-(-self.size_px[0] // by), -(-self.size_px[1] // by)))


class Stage:
    """What stands still, sorted; and the buffers that every picture uses again."""

    def __init__(self, still: Surface, roof: Float64 | None, light: Light, reach_m: float) -> None:
        self._still, self._cells, self._reach_m = still, Cells(still, CELL_M), reach_m
        self._roof = NO_ROOF if roof is None else roof
        self._casts = (still.materials != Material.SOIL) & (still.materials != Material.GRASS)
        self._casts &= (still.materials != Material.GRAVEL) & (still.cuts != 1)
        self._shadow: Float32 = np.zeros((SHADOW_PX, SHADOW_PX), np.float32)
        self._tops: Float32 = np.zeros((SHADOW_PX // BLOCK, SHADOW_PX // BLOCK), np.float32)
        self._shadow_owner: Int32 = np.zeros((SHADOW_PX, SHADOW_PX), np.int32)
        self._uncut: UInt8 = np.zeros(0, np.uint8)
        self._all = still
        self._light = light
        self._panorama = draw_panorama(light.packed(), light.skyline, textures().values)

    def look(
        self, eye: Eye, moving: list[Surface], feet: Float64, gain: float | None, curve: UInt8
    ) -> tuple[UInt8, float, float]:
        """The picture (H, W, 3), its mean brightness and the gain used; without a gain one is found for it."""
        everything, extra = self._with(moving)
        origin = eye.T_map_camera[:3, 3].copy()
        ahead = eye.T_map_camera[:2, 0] / np.linalg.norm(eye.T_map_camera[:2, 0])
        middle = origin + SHADOW_AHEAD_M * np.append(ahead, -0.15)
        S = self._light_up(everything, extra, middle)
        half = math.atan(0.5 * eye.size_px[0] / eye.intrinsics[0]) + 0.03
        seen = np.concatenate([extra, self._cells.near(origin, self._reach_m, ahead, min(half, 1.5))])
        if gain is None:
            gain, small = 1.0, eye.shrunk(METER_STEP)
            for _ in range(4):
                gain *= metered(self._paint(small, everything, seen, S, feet, gain, curve)[1])
        return *self._paint(eye, everything, seen, S, feet, gain, curve), gain

    def _paint(
        self, eye: Eye, everything: Surface, seen: Int32, S: Float64, feet: Float64, gain: float, curve: UInt8
    ) -> tuple[UInt8, float]:
        """The picture of the triangles `seen`, and its mean brightness."""
        width, height = eye.size_px
        origin, R = eye.T_map_camera[:3, 3].copy(), eye.R
        w, owner = np.zeros((height, width), np.float32), np.full((height, width), -1, np.int32)
        screen, which = project(
            everything.vertices_m, everything.triangles, seen, R, origin, eye.intrinsics, width, height
        )
        fill(screen, which, w, owner, everything.cuts, R, origin, eye.intrinsics)
        bgr = np.empty((height, width, 3), np.uint8)
        mean = shade(
            bgr, owner, everything.vertices_m, everything.normals, everything.colors, everything.triangles,
            everything.materials, R, origin, eye.intrinsics, self._light.packed(), self._panorama, textures().values,
            LAYERS, self._shadow, self._tops, S, feet, self._roof, gain, curve,
        )  # fmt: skip
        return bgr, mean

    def _with(self, moving: list[Surface]) -> tuple[Surface, Int32]:
        """All triangles, the moving ones behind those that stand still, and which these are."""
        added = merge(moving)
        n, m = len(self._still.vertices_m), len(self._still.triangles)
        vertices, triangles = n + len(added.vertices_m), m + len(added.triangles)
        if vertices > len(self._all.vertices_m) or triangles > len(self._all.triangles):
            room = Surface(*(np.zeros((len(a) + SPARE, *a.shape[1:]), a.dtype) for a in arrays_of(added)))
            self._all = merge([self._still, room])
        whole = self._all
        whole.vertices_m[n:vertices], whole.normals[n:vertices] = added.vertices_m, added.normals
        whole.colors[n:vertices], whole.triangles[m:triangles] = added.colors, added.triangles + np.int32(n)
        whole.materials[m:triangles], whole.cuts[m:triangles] = added.materials, added.cuts
        return whole, np.arange(m, triangles, dtype=np.int32)

    def _light_up(self, everything: Surface, extra: Int32, middle: Float64) -> Float64:
        """Draw the sun's picture round a point; gives what takes `map` to its columns, rows and w, (3, 4)."""
        across = np.cross([0.0, 0.0, 1.0], self._light.to_sun)
        across /= np.linalg.norm(across)
        L = np.stack([across, np.cross(self._light.to_sun, across), self._light.to_sun])
        near = self._cells.near(middle, 0.75 * SHADOW_PX / SHADOW_PER_M)
        casting = np.concatenate([extra, near[self._casts[near]]])
        self._shadow[:] = 0.0
        screen, which = project_parallel(
            everything.vertices_m, everything.triangles, casting, L, middle, SHADOW_PER_M, SHADOW_PX
        )
        if len(self._uncut) != len(everything.cuts):
            self._uncut = np.zeros_like(everything.cuts)
        fill(screen, which, self._shadow, self._shadow_owner, self._uncut, L, middle, np.ones(4))
        highest(self._shadow, self._tops)
        scale = np.array([SHADOW_PER_M, SHADOW_PER_M, 1.0])
        offset = np.array([0.5 * SHADOW_PX, 0.5 * SHADOW_PX, 100.0]) - scale * (L @ middle)
        return np.column_stack([scale[:, None] * L, offset])


def metered(mean: float, target: float = 0.24) -> float:
    """What to multiply the gain with, so that the mean brightness comes near its target."""
    return float(np.clip(target / max(mean, 1e-4), 0.1, 8.0) ** 0.9)
