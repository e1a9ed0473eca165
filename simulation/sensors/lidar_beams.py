"""Lidar beams of finite width through the media of a scenario's environment.

Budget: one ray per beam, `PARTS` more for beams near an edge of the static scene or an object (a few percent of a
sweep).
"""

import math

import numpy as np

from geometry.arrays import Float32, Float64
from simulation.actors.actors import ActorState
from simulation.environment.media import Media
from simulation.environment.scene import Scene
from simulation.kernels import rays_near_ball
from simulation.sensors.beams import DRAWS, PARTS, is_uneven, parts_of, strongest_returns

NEAR_BALL_M = 0.5  # about an object, for its motion during the sweep

Hits = tuple[Float32, Float32]
Mask = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


class Beams:
    """Returns of the beams of one lidar; `sweep_s`: age of the middle of a sweep."""

    def __init__(self, media: Media, elevation_rad: Float64, range_m: float, sweep_s: float,
                 random: np.random.Generator) -> None:  # fmt: skip
        self._media, self._elevation, self._range_m = media, elevation_rad, range_m
        self._sweep_s, self._random, self._air = sweep_s, random, media.packed_air()

    def returns(self, scene: Scene, rays: Float32, static: Hits, sweep_m: Float32, is_open: Mask) -> Hits:
        """Range and signal of the open beams (N, 6).

        `static`: hits of their axes in the static scene; `sweep_m` (rings * columns,): ranges of the whole sweep, to
        which they are added where `is_open` (rings * columns,).
        """
        sweep_m[is_open] = static[0]
        uneven = is_uneven(sweep_m.reshape(len(self._elevation), -1), self._elevation).ravel()[is_open]
        actors = self._near(scene, rays)
        is_wide = uneven.view(bool) | self._passes(actors, rays)
        distance, signal = (np.repeat(a[:, None], PARTS, axis=1) for a in static)
        distance[is_wide], signal[is_wide] = self._cast_parts(scene, rays[is_wide], actors)
        is_mixed = is_wide
        if self._media.canopy is not None:
            is_mixed = is_wide | self._add_plants(rays, distance, signal)
        if self._media.has_returns:
            is_mixed = np.ones_like(is_wide)
        out = distance[:, 0].copy(), signal[:, 0].copy()
        mixed = np.flatnonzero(is_mixed)
        out[0][mixed], out[1][mixed] = strongest_returns(
            rays[mixed], distance[mixed], signal[mixed], self._draws(len(mixed)), self._air,
            self._media.air.fog_ranges_m, self._media.puffs(),
        )  # fmt: skip
        return out

    def _near(self, scene: Scene, rays: Float32) -> list[ActorState]:
        origin = rays[0, :2].astype(np.float64)
        return [f for f in scene.visible_to("lidar") if math.dist(f.p_map_m[:2], origin) < self._range_m]

    def _passes(self, actors: list[ActorState], rays: Float32) -> Mask:
        near = np.zeros(len(rays), bool)
        for actor in actors:
            center, radius = actor.ball_m
            near |= rays_near_ball(rays, center, radius + NEAR_BALL_M).view(bool)
        return near

    def _cast_parts(self, scene: Scene, rays: Float32, actors: list[ActorState]) -> Hits:
        turns = self._random.random((len(rays), 2), np.float32)
        parts = parts_of(rays, turns, self._media.divergence_rad)
        distance, signal = scene.static.cast(parts)
        if actors and len(parts):
            nearer, brighter = scene.actor_scene(actors, self._sweep_s).cast(parts)
            is_actor = nearer < distance
            distance, signal = np.where(is_actor, nearer, distance), np.where(is_actor, brighter, signal)
        return distance.reshape(-1, PARTS), signal.reshape(-1, PARTS)

    def _add_plants(self, rays: Float32, distance: Float32, signal: Float32) -> Mask:
        """Replaces hits behind plants by hits on plants; returns which beams have any."""
        canopy = self._media.canopy
        assert canopy is not None
        depths = self._random.standard_exponential(distance.shape, np.float32)
        far = np.minimum(distance, np.float32(self._range_m))
        found, stand = canopy.hits(rays, far, depths, self._media.divergence_rad)
        is_plant = stand > 0
        distance[is_plant] = found[is_plant]
        signal[is_plant] = canopy.stands[stand[is_plant] - 1, 4].astype(np.float32)
        return np.asarray(is_plant.any(axis=1))

    def _draws(self, n: int) -> Float32:
        random = self._random
        draws = np.empty((n, DRAWS), np.float32)
        if self._media.has_returns:
            draws[:, [0, 4]] = random.random((n, 2), np.float32)
            draws[:, [1, 2, 3, 5]] = random.standard_exponential((n, 4), np.float32)
            draws[:, 6] = random.standard_normal(n, np.float32)
        return draws


def warm_beams(media: Media) -> None:
    """Compiles or loads the kernels, and builds what the first sweep would wait for."""
    up = np.array([[0.0, 0.0, 50.0, 0.0, 0.0, 1.0]], np.float32)
    none, one = np.full((1, PARTS), np.inf, np.float32), np.ones((1, PARTS), np.float32)
    parts_of(up, np.zeros((1, 2), np.float32), media.divergence_rad)
    is_uneven(none, np.zeros(1))
    if media.canopy is not None:
        media.canopy.hits(up, none, one, media.divergence_rad)
        media.canopy.optical_depth(up, none[:, 0].copy())
    draws = np.ones((1, DRAWS), np.float32)
    strongest_returns(up, none, one, draws, media.packed_air(), media.air.fog_ranges_m, media.puffs())
