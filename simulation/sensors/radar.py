"""Radar model: a list of detections per cycle, from static surfaces (a fan of rays) and from scatterers on actors.

Radar equation: a target of cross-section s (dBsm) at range r is detected when, with Swerling 1 fluctuation,
s + 40 log10(reference range / r) > 0; `reference_range_m` is the range of 0 dBsm. One detection per resolution cell.
Scatterers have a cross-section by class and aspect; those on limbs swing, and with them their Doppler.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field
from shapely import LineString

from configs.strict import Config
from configs.vehicle import Radar
from geometry.arrays import Float32, Float64, UInt8
from messages.message import Message
from messages.sensors import RadarScan
from simulation.actors.actors import ActorState
from simulation.environment.scene import Scene
from simulation.environment.scenery import SURFACE_KINDS, by_kind
from simulation.sensors.sensor import SensorContext, WorldState, period_ns_of

# backscatter of rough surfaces in dB (times cosine of incidence and area); specular gain at normal incidence
ROUGH_DB = {"ground": -14.0, "crop": -15.0, "fence": -4.0, "gate": 0.0, "wall": -10.0, "roof": -10.0, "post": 2.0,
            "mast": 0.0, "store": -3.0, "trees": -9.0}  # fmt: skip
MIRROR_DB = {"wall": 25.0, "roof": 25.0, "store": 10.0}
ROUGH, MIRROR = by_kind(ROUGH_DB), by_kind(MIRROR_DB)
CROP = SURFACE_KINDS.index("crop")
MIRROR_DEG = 6.0
NEAR_M = 0.3  # tolerance: a body does not occlude itself
MAX_PATCH_DEPTH_M = 1.0  # of a ray's patch on the ground, along the ray
# steps per m, rad, rad, m/s and dB of the output: a tenth of the errors
RESOLUTION = np.array([128.0, 2048.0, 2048.0, 128.0, 16.0])


class RadarConfig(Config):
    """Detection model and errors of a radar."""

    latency_s: float = Field(ge=0.0, le=0.5)
    reference_range_m: float = Field(
        gt=5.0, le=300.0, description="range at which 0 dBsm is detected in one of three cycles"
    )
    min_rcs_dbsm: float = Field(ge=-60.0, le=0.0, description="weaker targets are never output")
    ray_spacing_deg: float = Field(gt=0.2, le=10.0, description="azimuth between rays of the fan")
    ray_elevations_deg: tuple[float, ...] = Field(min_length=1, max_length=9, description="elevations of the fan")
    half_elevation_fov_deg: float = Field(gt=1.0, le=45.0, description="half the field of view in elevation")
    elevation_sigma_deg: float = Field(ge=0.0, le=10.0)
    range_resolution_m: float = Field(gt=0.05, le=5.0, description="resolution in range")
    azimuth_resolution_deg: float = Field(gt=0.2, le=20.0, description="resolution in azimuth")
    rcs_sigma_db: float = Field(ge=0.0, le=10.0)
    miss_probability: float = Field(ge=0.0, le=0.5, description="of a single detection")
    clutter_per_cycle: float = Field(ge=0.0, le=50.0, description="mean number of false detections")
    clutter_dbsm: tuple[float, float]
    clutter_doppler_mps: float = Field(ge=0.0, le=30.0, description="largest Doppler of false detections")
    ghost_probability: float = Field(ge=0.0, le=0.5, description="of a second detection by multipath")
    ghost_delay_m: tuple[float, float] = Field(description="additional range")
    ghost_attenuation_db: float = Field(ge=0.0, le=40.0, description="loss of the longer path")


@dataclass(frozen=True)
class Scatterers:
    """N scatterers: vectors from the sensor (N, 3) in its frame, Doppler (N,) and mean cross-section (N,)."""

    ray_m: Float64
    doppler_mps: Float64
    rcs_dbsm: Float64


class RadarModel:
    """One radar on one machine."""

    def __init__(
        self, name: str, radar: Radar, config: RadarConfig, random: np.random.Generator,
        plant_random: np.random.Generator,
    ) -> None:  # fmt: skip
        self.topic = f"radar/{name}"
        self.period_ns = period_ns_of(radar.rate_hz)
        self.latency_ns = round(config.latency_s * 1e9)
        self._radar, self._config, self._random, self._plant_random = radar, config, random, plant_random
        self._T_base_radar = radar.mount.T_base_sensor
        self._half = math.radians(0.5 * radar.field_of_view_deg)
        columns = max(1, round(radar.field_of_view_deg / config.ray_spacing_deg))
        azimuth, rows = (
            2.0 * self._half * ((np.arange(columns) + 0.5) / columns - 0.5),
            np.radians(config.ray_elevations_deg),
        )
        self._fan = np.tile(azimuth, len(rows)), np.repeat(rows, columns)
        angles = np.radians([radar.azimuth_sigma_deg, config.elevation_sigma_deg])
        self._sigma = np.array([radar.range_sigma_m, *angles, radar.doppler_sigma_mps, config.rcs_sigma_db])

    def sample(self, state: WorldState) -> Message:
        """The cycle that ends now."""
        T = state.poses.steps_ago(0) @ self._T_base_radar
        before = state.poses.steps_ago(2) @ self._T_base_radar
        velocity = (T[:3, 3] - before[:3, 3]) / (2e-9 * state.poses.step_ns)
        sets = [self._static_scatterers(state.scene, T, velocity), *self._actor_scatterers(state.scene, T, velocity)]
        hits = Scatterers(
            *(np.concatenate([getattr(h, key) for h in sets]) for key in ("ray_m", "doppler_mps", "rcs_dbsm"))
        )
        return self._measure(state.stamp_ns, hits)

    def _static_scatterers(self, scene: Scene, T: Float64, velocity_mps: Float64) -> Scatterers:
        """A jittered fan of rays against static surfaces; each ray is a patch as large as the fan's spacing."""
        n, step = len(self._fan[0]), math.radians(self._config.ray_spacing_deg)
        azimuth = self._fan[0] + step * self._random.uniform(-0.5, 0.5, n)
        row_height = math.radians(2.0 * self._config.half_elevation_fov_deg) / len(self._config.ray_elevations_deg)
        elevation = self._fan[1] + row_height * self._random.uniform(-0.5, 0.5, n)
        u = directions(azimuth, elevation)
        u_map = u @ T[:3, :3].T
        distance, kind, cosine = surfaces(scene, rays_from(T[:3, 3], u_map), self._plant_random)
        near, far = self._radar.range_m
        is_hit = (distance >= near) & (distance <= far)
        r, cosine = distance[is_hit].astype(np.float64), np.maximum(cosine[is_hit].astype(np.float64), 1e-3)
        patch = r * step * np.minimum(r * row_height / cosine, MAX_PATCH_DEPTH_M)
        rough, mirror = ROUGH[kind[is_hit]], MIRROR[kind[is_hit]]
        rcs, smooth = rough + 10.0 * np.log10(cosine * patch), np.flatnonzero(mirror)
        off_deg = np.degrees(np.arccos(np.minimum(cosine[smooth], 1.0)))
        rcs[smooth] += mirror[smooth] * np.exp(-((off_deg / MIRROR_DEG) ** 2))
        return Scatterers(u[is_hit] * r[:, None], -(u_map[is_hit] @ velocity_mps), rcs)

    def _actor_scatterers(self, scene: Scene, T: Float64, velocity_mps: Float64) -> list[Scatterers]:
        actors = scene.visible_to("radar")
        near = [f for f in actors if math.dist(f.p_map_m, T[:3, 3]) < self._radar.range_m[1]]
        return [self._scatterers_of(scene, f, T, velocity_mps) for f in near if not is_occluded(f, actors, T)]

    def _scatterers_of(self, scene: Scene, actor: ActorState, T: Float64, velocity_mps: Float64) -> Scatterers:
        """Unobstructed scatterers of one actor."""
        points = actor.solid.scatterers
        c, s = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        p_map = np.array([p.at_m for p in points]) @ turn.T + actor.p_map_m
        to = p_map - T[:3, 3]
        r = np.linalg.norm(to, axis=1)
        u = to / r[:, None]
        cosine = -np.einsum("ij,ij->i", np.array([[*p.normal, 0.0] for p in points]) @ turn.T, u)
        is_all_round = np.array([p.normal == (0.0, 0.0) for p in points])
        distance, _, _ = scene.static.cast_surface(rays_from(T[:3, 3], u))
        is_seen = (distance > r - NEAR_M) & (is_all_round | (cosine > 0.1))
        off_deg = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
        rcs = np.array([p.rcs_dbsm for p in points])
        rcs = rcs + np.array([p.mirror_db for p in points]) * np.exp(-((off_deg / (2.0 * MIRROR_DEG)) ** 2))
        if scene.media is not None:
            rcs = rcs - scene.media.radar_loss_db(rays_from(T[:3, 3], u), r)
        gait = np.array([1.0 + p.swing * math.sin(2.0 * math.pi * (actor.gait + p.phase)) for p in points])
        body_velocity = np.array([*actor.velocity_mps, 0.0])
        doppler = np.einsum("ij,ij->i", gait[:, None] * body_velocity - velocity_mps, u)
        return Scatterers((to @ T[:3, :3])[is_seen], doppler[is_seen], rcs[is_seen])

    def _measure(self, stamp_ns: int, hits: Scatterers) -> RadarScan:
        """Detections above the noise, with errors, ghosts and clutter."""
        config, random = self._config, self._random
        r = np.linalg.norm(hits.ray_m, axis=1)
        azimuth = np.arctan2(hits.ray_m[:, 1], hits.ray_m[:, 0])
        elevation = np.arcsin(np.clip(hits.ray_m[:, 2] / np.maximum(r, 1e-6), -1.0, 1.0))
        rcs = hits.rcs_dbsm + 10.0 * np.log10(random.exponential(1.0, len(r)) + 1e-9)
        level_db = rcs + 40.0 * np.log10(config.reference_range_m / np.maximum(r, 0.1))
        is_in = (np.abs(azimuth) <= self._half) & (np.abs(elevation) <= math.radians(config.half_elevation_fov_deg))
        found = np.flatnonzero(
            (level_db > 0.0) & (rcs > config.min_rcs_dbsm) & is_in & (random.random(len(r)) >= config.miss_probability)
        )
        found = self._resolve(found, r, azimuth, hits.doppler_mps, level_db)
        detections = np.column_stack([r, azimuth, elevation, hits.doppler_mps, rcs])[found]
        detections = np.vstack([detections, self._ghosts(detections), self._clutter()])
        detections = detections + self._sigma * random.standard_normal(detections.shape)
        detections = np.round(detections * RESOLUTION) / RESOLUTION
        low, high = self._radar.range_m
        is_out = (detections[:, 0] >= low) & (detections[:, 0] <= high) & (np.abs(detections[:, 1]) <= self._half)
        return RadarScan(stamp_ns, *(np.ascontiguousarray(column) for column in detections[is_out].T))

    def _resolve(self, found: np.ndarray[tuple[int], np.dtype[np.intp]], r: Float64, azimuth: Float64,
                 doppler: Float64, level_db: Float64) -> np.ndarray[tuple[int], np.dtype[np.intp]]:  # fmt: skip
        """The strongest per cell of range, azimuth and Doppler."""
        cells = np.floor(np.column_stack([
            r / self._config.range_resolution_m, azimuth / math.radians(self._config.azimuth_resolution_deg),
            doppler / (4.0 * self._radar.doppler_sigma_mps),
        ])[found])  # fmt: skip
        order = np.argsort(-level_db[found], kind="stable")
        numbers = (cells[order] + 1000.0) @ np.array([1e8, 1e4, 1.0])  # cell numbers are below 1000 in magnitude
        _, first = np.unique(numbers, return_index=True)
        return np.asarray(found[order[np.sort(first)]])

    def _ghosts(self, detections: Float64) -> Float64:
        """Multipath copies of detections: farther and weaker."""
        ghosts = detections[self._random.random(len(detections)) < self._config.ghost_probability].copy()
        ghosts[:, 0] += self._random.uniform(*self._config.ghost_delay_m, len(ghosts))
        ghosts[:, 4] -= self._config.ghost_attenuation_db
        return np.asarray(ghosts)

    def _clutter(self) -> Float64:
        config, random = self._config, self._random
        n, (near, far) = int(random.poisson(config.clutter_per_cycle)), self._radar.range_m
        return np.column_stack([
            random.uniform(near, far, n), random.uniform(-self._half, self._half, n), np.zeros(n),
            random.uniform(-config.clutter_doppler_mps, config.clutter_doppler_mps, n),
            random.uniform(*config.clutter_dbsm, n),
        ])  # fmt: skip


def surfaces(scene: Scene, rays: Float32, random: np.random.Generator) -> tuple[Float32, UInt8, Float32]:
    """As `RaycastScene.cast_surface` of the static scene, with the first plants of the environment as crop."""
    distance, kind, cosine = scene.static.cast_surface(rays)
    if scene.media is None or scene.media.canopy is None:
        return distance, kind, cosine
    distance, is_plant = scene.media.canopy.first(rays, distance, random)
    return distance, np.where(is_plant, CROP, kind).astype(np.uint8), np.where(is_plant, np.float32(1.0), cosine)


def directions(azimuth_rad: Float64, elevation_rad: Float64) -> Float64:
    """Unit vectors (N, 3)."""
    flat, u = np.cos(elevation_rad), np.empty((len(elevation_rad), 3))
    u[:, 0], u[:, 1], u[:, 2] = flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)
    return u


def rays_from(origin_m: Float64, u: Float64) -> Float32:
    """Rays (N, 6) from one point."""
    rays = np.empty((len(u), 6), np.float32)
    rays[:, :3], rays[:, 3:] = origin_m, u
    return rays


def is_occluded(actor: ActorState, others: list[ActorState], T_map_sensor: Float64) -> bool:
    """True if another actor is between it and the sensor and reaches the height of the line between them."""
    (x, y, height), (center, _) = T_map_sensor[:3, 3], actor.ball_m
    line = LineString([(x, y), actor.p_map_m[:2]])
    for other in others:
        share = math.dist((x, y), other.p_map_m[:2]) / max(line.length, 1e-9)
        if other is actor or share >= 1.0 or not other.solid.is_radar_opaque:
            continue
        low, high = other.vertices_map_m[:, 2].min(), other.vertices_map_m[:, 2].max()
        if low <= height + share * (center[2] - height) <= high and line.intersects(other.footprint):
            return True
    return False


def make_model(name: str, radar: Radar, config: RadarConfig, context: SensorContext) -> RadarModel:
    """Model of one radar of the vehicle."""
    plant_random = context.generator(f"environment/radar/{name}")
    return RadarModel(name, radar, config, context.generator(f"radar/{name}"), plant_random)
