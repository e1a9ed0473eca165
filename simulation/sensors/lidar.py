"""Spinning lidar model by ray casting: each column is cast at its own time from its own pose.

Columns run from -fov/2 to +fov/2 (left positive) over one period that ends at the stamp. Returns from the machine's own
body are computed once per hitch and fold position; actors are cast only in rays that pass near them.
"""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Lidar, MountedImplement, TrailedImplement, Vehicle
from geometry.arrays import Float32, Float64, UInt16
from geometry.transforms import invert
from messages.message import Message
from messages.sensors import LidarScan
from simulation.environment.media import Media
from simulation.environment.raycast import RaycastScene
from simulation.kernels import ranges_mm, rays_near_ball, sweep_rays
from simulation.machine.body import LIFT_M, T_base_implement, implement_mesh, machine_mesh
from simulation.machine.implement import at_fold
from simulation.sensors.lidar_beams import Beams
from simulation.sensors.sensor import SensorContext, WorldState, period_ns_of

MAX_RANGE_M = 65.5  # uint16 in mm
BODY_REFLECTIVITY = 0.3
SELF_MASK_STEPS = 8  # positions of hitch and fold with stored returns of the body


class LidarConfig(Config):
    """Errors of a lidar beyond its range noise."""

    range_at_10_percent_m: float = Field(
        gt=1.0, le=500.0, description="range of a target of reflectivity 0.1 at normal incidence"
    )
    dropout_probability: float = Field(ge=0.0, le=0.5, description="of a single return")
    dust_probability: float = Field(ge=0.0, le=0.1, description="of a dust return, per ray")
    dust_range_m: tuple[float, float]
    range_resolution_mm: int = Field(ge=1, le=100, description="quantisation of the range")


class LidarModel:
    """One lidar on one machine."""

    def __init__(
        self, name: str, lidar: Lidar, vehicle: Vehicle, implement: MountedImplement | TrailedImplement,
        config: LidarConfig, random: np.random.Generator, beam_random: np.random.Generator,
    ) -> None:  # fmt: skip
        self.topic = f"lidar/{name}"
        self.period_ns = period_ns_of(lidar.rate_hz)
        self.latency_ns = 0
        self._lidar, self._vehicle, self._implement, self._config, self._random = (
            lidar,
            vehicle,
            implement,
            config,
            random,
        )
        self._T_base_raised, self._is_on_implement = lidar.mount.T_base_sensor, lidar.mount.sinks_m > 0.0
        fov = math.radians(lidar.field_of_view_deg)
        self._elevation = np.radians(np.array(lidar.elevation_deg, np.float64))
        self._azimuth = fov * ((np.arange(lidar.columns) + 0.5) / lidar.columns - 0.5)
        self._offset_s = (((np.arange(lidar.columns) + 1.0) / lidar.columns - 1.0) / lidar.rate_hz).astype(np.float32)
        self._directions = directions_of(self._elevation, self._azimuth)
        (low, high), step_mm = lidar.range_m, config.range_resolution_mm
        parameters = [config.range_at_10_percent_m, 1.0 - config.dropout_probability, lidar.range_sigma_m, low,
                      min(high, MAX_RANGE_M), 1000.0 / step_mm, step_mm]  # fmt: skip
        self._parameters = np.array(parameters, np.float32)
        self._beam_random = beam_random
        self._beams: Beams | None = None
        self._self_masks: dict[tuple[int, int, int], tuple[Float32, Float32]] = {}

    def sample(self, state: WorldState) -> Message:
        """The sweep that ends now."""
        distance, signal = (a.copy() for a in self._self_returns(state))
        is_open = np.isinf(distance)
        open_rays = np.flatnonzero(is_open)
        T_base_lidar = self._T_base_lidar(state.machine.attached.hitch)
        T_map_lidar = state.poses.interpolate(-self._offset_s.astype(np.float64)) @ T_base_lidar
        rays = sweep_rays(T_map_lidar, self._directions, is_open.reshape(len(self._elevation), -1).view(np.uint8))
        found = state.scene.static.cast(rays)
        if state.scene.media is None:
            found = self._add_actors(state, rays, found)
        else:
            beams = self._beams_in(state.scene.media)
            found = beams.returns(state.scene, rays, found, distance.copy(), is_open)
        distance[open_rays], signal[open_rays] = found
        measured = self._measure(state, distance, signal).reshape(len(self._elevation), -1)
        return LidarScan(
            state.stamp_ns, measured, self._elevation.copy(),
            self._azimuth.copy(), np.zeros((0, 3), np.float32), np.zeros(0, np.uint8), self._offset_s.copy(),
        )  # fmt: skip

    def _T_base_lidar(self, hitch: float) -> Float64:
        """Pose in base, (4, 4); on an implement it moves with the hitch."""
        T = self._T_base_raised
        if self._is_on_implement:
            T = T.copy()
            T[2, 3] -= LIFT_M * (1.0 - hitch)
        return T

    def _beams_in(self, media: Media) -> Beams:
        if self._beams is None:
            far, age_s = self._lidar.range_m[1], 0.5 / self._lidar.rate_hz
            self._beams = Beams(media, self._elevation, far, age_s, self._beam_random)
        return self._beams

    def _self_returns(self, state: WorldState) -> tuple[Float32, Float32]:
        """Distance and signal of the machine's own body, infinite where the view is free."""
        attached = state.machine.attached
        articulation = attached.yaw_rad - state.machine.yaw_rad
        key = (
            round(attached.hitch * SELF_MASK_STEPS),
            round(math.degrees(articulation)),
            round(attached.fold * SELF_MASK_STEPS),
        )
        if key not in self._self_masks:
            T_lidar_base = invert(self._T_base_lidar(key[0] / SELF_MASK_STEPS))
            T_lidar_implement = T_lidar_base @ T_base_implement(self._implement, math.radians(key[1]))
            body = RaycastScene([machine_mesh(self._vehicle).transformed(T_lidar_base)], [BODY_REFLECTIVITY])
            shape = implement_mesh(at_fold(self._implement, key[2] / SELF_MASK_STEPS), key[0] / SELF_MASK_STEPS)
            tool = RaycastScene([shape.transformed(T_lidar_implement)], [BODY_REFLECTIVITY])
            rays = np.zeros((self._directions[..., 0].size, 6), np.float32)
            rays[:, 3:] = self._directions.reshape(-1, 3)
            self._self_masks[key] = nearer_hit(body.cast(rays), tool.cast(rays))
        return self._self_masks[key]

    def _add_actors(self, state: WorldState, rays: Float32, static: tuple[Float32, Float32]) -> tuple[Float32, Float32]:
        """Nearest of static returns and actors, placed at the middle of the sweep."""
        origin = rays[0, :2].astype(np.float64)
        visible = state.scene.visible_to("lidar")
        near = [f for f in visible if math.dist(f.p_map_m[:2], origin) < self._lidar.range_m[1]]
        if not near:
            return static
        is_candidate = np.zeros(len(rays), bool)
        for actor in near:
            center, radius = actor.ball_m
            is_candidate |= rays_near_ball(rays, center, radius + 0.5).view(bool)
        scene = state.scene.actor_scene(near, 0.5 / self._lidar.rate_hz)
        found = nearer_hit((static[0][is_candidate], static[1][is_candidate]), scene.cast(rays[is_candidate]))
        distance, signal = static[0].copy(), static[1].copy()
        distance[is_candidate], signal[is_candidate] = found
        return distance, signal

    def _measure(self, state: WorldState, distance: Float32, signal: Float32) -> UInt16:
        """Measured ranges: dropout, noise, dust, resolution; 0 without a return."""
        random, n, dust_probability = self._random, len(distance), self._config.dust_probability
        if state.scene.media is not None and state.scene.media.dust_ray_share is not None:
            dust_probability = state.scene.media.dust_ray_share
        detection_draw = random.random(n, np.float32)
        is_dust = random.random(n, np.float32) < dust_probability
        noise, dust_m = random.standard_normal(n, np.float32), np.full(n, np.inf, np.float32)
        dust_m[is_dust] = random.uniform(*self._config.dust_range_m, np.count_nonzero(is_dust))
        return ranges_mm(distance, signal, detection_draw, dust_m, noise, self._parameters)


def directions_of(elevation_rad: Float64, azimuth_rad: Float64) -> Float32:
    """Unit vectors of all rays in the sensor frame, (rings, columns, 3)."""
    el, az = elevation_rad[:, None], azimuth_rad[None, :]
    parts = [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) * np.ones_like(az)]
    return np.stack(parts, axis=-1).astype(np.float32)


def nearer_hit(a: tuple[Float32, Float32], b: tuple[Float32, Float32]) -> tuple[Float32, Float32]:
    """Distance and signal of the nearer hit."""
    is_b = b[0] < a[0]
    return np.where(is_b, b[0], a[0]), np.where(is_b, b[1], a[1])


def make_model(name: str, lidar: Lidar, config: LidarConfig, context: SensorContext) -> LidarModel:
    """Model of one lidar of the vehicle."""
    random, beam_random = context.generator(f"lidar/{name}"), context.generator(f"environment/lidar/{name}")
    return LidarModel(name, lidar, context.vehicle, context.implement, config, random, beam_random)
