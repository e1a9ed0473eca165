"""Renders images: shadow map from the sun, depth buffer from the camera, then shading.

triangles in range ──► shadow map (points not in it are in shadow) ──┐
                └────► depth and triangle of each pixel ─────────────┴──► light, texture ──► BGR
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from simulation.rendering.light import Light
from simulation.rendering.raster import project, project_parallel, rasterize
from simulation.rendering.scene_mesh import Material, Surface, TriangleGrid, arrays_of, merge
from simulation.rendering.shading import shade
from simulation.rendering.shadow import BLOCK, block_maxima
from simulation.rendering.skybox import render_panorama
from simulation.rendering.textures import texture_table, textures

CELL_M = 8.0
SPARE_TRIANGLES = 50_000  # allocation step for moving triangles and vertices
SHADOW_PX, SHADOW_PER_M = 640, 16.0
SHADOW_AHEAD_M, EXPOSURE_SCALE = 15.0, 16
R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TEXTURE_TABLE = texture_table()
NO_ROOF = np.array([0.0, 0.0, -1.0, -1.0, 0.0])


@dataclass(frozen=True)
class CameraView:
    """A pinhole view: pose of the body frame in `map` (4, 4), focal lengths and centre (px), size (width, height)."""

    T_map_camera: Float64
    intrinsics: Float64
    size_px: tuple[int, int]

    @property
    def R(self) -> Float64:
        """Rotation from `map` to the optical frame, (3, 3)."""
        return np.ascontiguousarray((self.T_map_camera[:3, :3] @ R_BODY_OPTICAL).T)

    def downscaled(self, by: int) -> "CameraView":
        """The view with `by` times fewer pixels a side."""
        return CameraView(
            self.T_map_camera, self.intrinsics / by, (-(-self.size_px[0] // by), -(-self.size_px[1] // by))
        )


class Renderer:
    """Static triangles sorted by ground cell, and the buffers that all images reuse."""

    def __init__(self, static: Surface, roof: Float64 | None, light: Light, reach_m: float) -> None:
        self._static, self._grid, self._reach_m = static, TriangleGrid(static, CELL_M), reach_m
        self._roof = NO_ROOF if roof is None else roof
        self._casts_shadow = (static.materials != Material.SOIL) & (static.materials != Material.GRASS)
        self._casts_shadow &= (static.materials != Material.GRAVEL) & (static.cutouts != 1)
        self._shadow: Float32 = np.zeros((SHADOW_PX, SHADOW_PX), np.float32)
        self._shadow_max: Float32 = np.zeros((SHADOW_PX // BLOCK, SHADOW_PX // BLOCK), np.float32)
        self._shadow_ids: Int32 = np.zeros((SHADOW_PX, SHADOW_PX), np.int32)
        self._no_cutouts: UInt8 = np.zeros(0, np.uint8)
        self._all = static
        self._light = light
        self._panorama = render_panorama(light.packed(), light.skyline, textures().values)

    def render(
        self, view: CameraView, moving: list[Surface], occluders: Float64, gain: float | None, curve: UInt8
    ) -> tuple[UInt8, float, float]:
        """Image (H, W, 3) BGR, its mean brightness and the gain; a gain of None is found by automatic exposure."""
        surface, moving_rows = self._with_moving(moving)
        origin = view.T_map_camera[:3, 3].copy()
        ahead = view.T_map_camera[:2, 0] / np.linalg.norm(view.T_map_camera[:2, 0])
        middle = origin + SHADOW_AHEAD_M * np.append(ahead, -0.15)
        S = self._render_shadow_map(surface, moving_rows, middle)
        half = math.atan(0.5 * view.size_px[0] / view.intrinsics[0]) + 0.03
        visible = np.concatenate([moving_rows, self._grid.within(origin, self._reach_m, ahead, min(half, 1.5))])
        if gain is None:
            gain, small = 1.0, view.downscaled(EXPOSURE_SCALE)
            for _ in range(4):
                gain *= exposure_factor(self._render_view(small, surface, visible, S, occluders, gain, curve)[1])
        return *self._render_view(view, surface, visible, S, occluders, gain, curve), gain

    def _render_view(
        self,
        view: CameraView,
        surface: Surface,
        visible: Int32,
        S: Float64,
        occluders: Float64,
        gain: float,
        curve: UInt8,
    ) -> tuple[UInt8, float]:
        """Image of the triangles `visible`, and its mean brightness."""
        width, height = view.size_px
        origin, R = view.T_map_camera[:3, 3].copy(), view.R
        w, triangle_ids = np.zeros((height, width), np.float32), np.full((height, width), -1, np.int32)
        screen, which = project(
            surface.vertices_m, surface.triangles, visible, R, origin, view.intrinsics, width, height
        )
        rasterize(screen, which, w, triangle_ids, surface.cutouts, R, origin, view.intrinsics)
        bgr = np.empty((height, width, 3), np.uint8)
        mean = shade(
            bgr, triangle_ids, surface.vertices_m, surface.normals, surface.colors, surface.triangles,
            surface.materials, R, origin, view.intrinsics, self._light.packed(), self._panorama, textures().values,
            TEXTURE_TABLE, self._shadow, self._shadow_max, S, occluders, self._roof, gain, curve,
        )  # fmt: skip
        return bgr, mean

    def _with_moving(self, moving: list[Surface]) -> tuple[Surface, Int32]:
        """Static and, behind them, moving triangles; and the rows of the moving ones."""
        added = merge(moving)
        n, m = len(self._static.vertices_m), len(self._static.triangles)
        vertices, triangles = n + len(added.vertices_m), m + len(added.triangles)
        if vertices > len(self._all.vertices_m) or triangles > len(self._all.triangles):
            room = Surface(*(np.zeros((len(a) + SPARE_TRIANGLES, *a.shape[1:]), a.dtype) for a in arrays_of(added)))
            self._all = merge([self._static, room])
        combined = self._all
        combined.vertices_m[n:vertices], combined.normals[n:vertices] = added.vertices_m, added.normals
        combined.colors[n:vertices], combined.triangles[m:triangles] = added.colors, added.triangles + np.int32(n)
        combined.materials[m:triangles], combined.cutouts[m:triangles] = added.materials, added.cutouts
        return combined, np.arange(m, triangles, dtype=np.int32)

    def _render_shadow_map(self, surface: Surface, moving_rows: Int32, middle: Float64) -> Float64:
        """Renders the shadow map around a point; returns `map` to its column, row and w, (3, 4)."""
        across = np.cross([0.0, 0.0, 1.0], self._light.sun_direction)
        across /= np.linalg.norm(across)
        L = np.stack([across, np.cross(self._light.sun_direction, across), self._light.sun_direction])
        near = self._grid.within(middle, 0.75 * SHADOW_PX / SHADOW_PER_M)
        casters = np.concatenate([moving_rows, near[self._casts_shadow[near]]])
        self._shadow[:] = 0.0
        screen, which = project_parallel(
            surface.vertices_m, surface.triangles, casters, L, middle, SHADOW_PER_M, SHADOW_PX
        )
        if len(self._no_cutouts) != len(surface.cutouts):
            self._no_cutouts = np.zeros_like(surface.cutouts)
        rasterize(screen, which, self._shadow, self._shadow_ids, self._no_cutouts, L, middle, np.ones(4))
        block_maxima(self._shadow, self._shadow_max)
        scale = np.array([SHADOW_PER_M, SHADOW_PER_M, 1.0])
        offset = np.array([0.5 * SHADOW_PX, 0.5 * SHADOW_PX, 100.0]) - scale * (L @ middle)
        return np.column_stack([scale[:, None] * L, offset])


def exposure_factor(mean: float, target: float = 0.24) -> float:
    """Factor on the gain that brings the mean brightness towards its target."""
    return float(np.clip(target / max(mean, 1e-4), 0.1, 8.0) ** 0.9)
