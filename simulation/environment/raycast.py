"""Ray casting against triangles."""

from typing import Any

import numpy as np

from geometry.arrays import Float32, UInt8
from simulation.environment.meshes import Mesh
from simulation.environment.scenery import SURFACE_KINDS
from simulation.kernels import UInt32, signal_of


class RaycastScene:
    """Triangles for ray casting; imports open3d on first use."""

    def __init__(self, meshes: list[Mesh], reflectivity: list[float], kinds: tuple[int, ...] = ()) -> None:
        import open3d

        self._core: Any = open3d.core  # its stubs lack arrays
        self._scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._reflectivity = np.array([*reflectivity, 0.0], np.float32)
        self._kinds = np.array([*kinds, len(SURFACE_KINDS)], np.uint8)
        for mesh in meshes:
            vertices = self._core.Tensor(np.array(mesh.vertices_m, np.float32))
            self._scene.add_triangles(vertices, self._core.Tensor(mesh.triangles.astype(np.uint32)))

    def cast(self, rays: Float32) -> tuple[Float32, Float32]:
        """Distance (infinite where nothing is hit) and reflectivity times cosine of incidence, (N,) each.

        `rays` (N, 6): origin and unit direction.
        """
        distance, mesh, normals = self._hit(rays)
        return distance, signal_of(rays, normals, mesh, self._reflectivity)

    def cast_surface(self, rays: Float32) -> tuple[Float32, UInt8, Float32]:
        """Distance (infinite: no hit), index into SURFACE_KINDS (its length: no hit) and cosine of incidence, (N,)."""
        distance, mesh, normals = self._hit(rays)
        kinds = self._kinds[np.minimum(mesh, len(self._kinds) - 1)]
        return distance, kinds, np.abs(np.einsum("ij,ij->i", rays[:, 3:], normals))

    def _hit(self, rays: Float32) -> tuple[Float32, UInt32, Float32]:
        """Distance, mesh number (the largest uint32: no hit) and normal."""
        hits = self._scene.cast_rays(self._core.Tensor.from_numpy(rays), nthreads=1)
        return hits["t_hit"].numpy(), hits["geometry_ids"].numpy(), hits["primitive_normals"].numpy()
