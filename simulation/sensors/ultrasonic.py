"""Ultrasonic sensor model: the first detected echo in its cone, beyond the dead zone.

loudness = target strength × beam pattern × (maximum range / range)²; the detection threshold is 1. Smooth walls reflect
specularly, cloth and fur absorb, and level ground gives no echo.
"""

import math

import numpy as np
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Ultrasonic
from geometry.arrays import Float32, Float64
from messages.message import Message
from messages.sensors import UltrasonicRange
from simulation.environment.scenery import by_kind
from simulation.machine.body import LIFT_M
from simulation.sensors.radar import CROP, directions, rays_from, surfaces
from simulation.sensors.sensor import SensorContext, WorldState, period_ns_of

STRENGTH = {"wall": 1.5, "roof": 1.5, "store": 1.0, "post": 0.7, "mast": 0.4, "gate": 0.6, "fence": 0.5, "trees": 0.3,
            "crop": 0.02, "ground": 0.0}  # fmt: skip
SURFACE_STRENGTH, IS_SMOOTH = by_kind(STRENGTH), by_kind({"wall": 1.0, "roof": 1.0}) > 0.0
MIRROR_DEG, ROUGH = 25.0, 0.1  # 1/e angle of the specular lobe of a corrugated wall; diffuse share
EDGE = 0.5  # beam pattern at the edge of the cone
COLUMNS, ROWS = 31, 5
NEAR_M = 0.1
PLANT_STRENGTH = 0.05  # on the axis up to 1.1 m (assumed; cereals are measured from 1 m, Scotford and Miller 2004)


class UltrasonicConfig(Config):
    """Errors of an ultrasonic sensor."""

    latency_s: float = Field(ge=0.0, le=0.5)
    amplitude_sigma: float = Field(ge=0.0, le=1.0, description="relative, of the loudness")
    miss_probability: float = Field(ge=0.0, le=0.5, description="of a measurement without echo")
    cross_talk_probability: float = Field(ge=0.0, le=0.5, description="of a stray pulse, per neighbour")
    sound_speed_sigma: float = Field(ge=0.0, le=0.1, description="relative, after temperature compensation")


class UltrasonicModel:
    """One sensor; `neighbours` others face the same direction; with `is_on_implement` it rises with the hitch."""

    def __init__(
        self, name: str, sensor: Ultrasonic, neighbours: int, is_on_implement: bool, config: UltrasonicConfig,
        random: np.random.Generator, plant_random: np.random.Generator,
    ) -> None:  # fmt: skip
        self._plant_random = plant_random
        self.topic = f"ultrasonic/{name}"
        self.period_ns = period_ns_of(sensor.rate_hz)
        self.latency_ns = round(config.latency_s * 1e9)
        self._sensor, self._is_on_implement, self._config, self._random = sensor, is_on_implement, config, random
        self._T_base_sensor = sensor.mount.T_base_sensor
        self._stray = config.cross_talk_probability * neighbours
        self._scale = 1.0 + config.sound_speed_sigma * float(random.standard_normal())
        self._half = math.radians(0.5 * sensor.cone_deg)
        self._u = cone_rays(self._half)
        self._beam = np.power(EDGE, (np.arccos(np.clip(self._u[:, 0], -1.0, 1.0)) / self._half) ** 2)

    def sample(self, state: WorldState) -> Message:
        """Range of the first echo, or NaN."""
        near, far = self._sensor.range_m
        T = self._pose(state)
        range_m, loudness = (
            np.concatenate(pair)
            for pair in zip(self._static_returns(state, T), self._actor_returns(state, T), strict=True)
        )
        amplitude = 1.0 + self._config.amplitude_sigma * self._random.standard_normal(len(range_m))
        is_detected = (loudness * amplitude * (far / np.maximum(range_m, near)) ** 2 >= 1.0) & (range_m >= near)
        is_lost = self._random.random() < self._config.miss_probability
        first = float(range_m[is_detected].min()) if is_detected.any() and not is_lost else math.inf
        measured = first * self._scale + self._sensor.range_sigma_m * float(self._random.standard_normal())
        stray, chance = self._random.uniform(near, far), self._random.random()
        measured = min(measured, stray) if chance < self._stray else measured
        return UltrasonicRange(state.stamp_ns, max(measured, near) if measured <= far else math.nan)

    def _pose(self, state: WorldState) -> Float64:
        T = state.poses.steps_ago(0) @ self._T_base_sensor
        if self._is_on_implement:  # the mount is given for the raised implement
            T = T.copy()
            T[2, 3] -= LIFT_M * (1.0 - state.machine.attached.hitch)
        return T

    def _static_returns(self, state: WorldState, T: Float64) -> tuple[Float64, Float64]:
        """Range and loudness at the maximum range of static surfaces, per ray."""
        rays = rays_from(T[:3, 3], self._u @ T[:3, :3].T)
        distance, kind, cosine = surfaces(state.scene, rays, self._plant_random)
        if not (SURFACE_STRENGTH[kind] > 0.0).any():
            return distance.astype(np.float64), np.zeros(len(distance))
        off = np.degrees(np.arccos(np.minimum(cosine, 1.0))) / MIRROR_DEG
        mirrored = np.where(IS_SMOOTH[kind], np.maximum(np.exp(-(off**2)), ROUGH), 1.0)
        strength = SURFACE_STRENGTH[kind]
        if state.scene.media is not None and state.scene.media.canopy is not None:  # then all crop is canopy
            strength = np.where(kind == CROP, PLANT_STRENGTH, strength)
        return distance.astype(np.float64), strength * mirrored * self._beam

    def _actor_returns(self, state: WorldState, T: Float64) -> tuple[Float64, Float64]:
        """Range and loudness of each actor's nearest vertex in the cone."""
        far = self._sensor.range_m[1]
        found: list[tuple[float, float]] = []
        for actor in state.scene.visible_to("ultrasonic"):
            if math.dist(actor.p_map_m[:2], T[:2, 3]) > far + max(3.0, 1.2 * actor.ball_m[1]):
                continue
            echo = self._nearest(actor.vertices_map_m, T)
            if echo is not None and not self._is_occluded(state, T, echo):
                loudness = actor.solid.ultrasonic_strength * EDGE ** ((math.acos(echo[0] / echo[3]) / self._half) ** 2)
                found.append((echo[3], loudness * self._transmission(state, T, echo)))
        pairs = np.array(found).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def _nearest(self, vertices_map_m: Float32, T: Float64) -> tuple[float, float, float, float] | None:
        """Position in the sensor frame and range of the nearest vertex in the cone."""
        p = (vertices_map_m - T[:3, 3]) @ T[:3, :3]
        r = np.linalg.norm(p, axis=1)
        inside = np.flatnonzero(p[:, 0] >= r * math.cos(self._half))
        if len(inside) == 0:
            return None
        k = int(inside[np.argmin(r[inside])])
        return float(p[k, 0]), float(p[k, 1]), float(p[k, 2]), max(float(r[k]), 1e-3)

    def _transmission(self, state: WorldState, T: Float64, echo: tuple[float, float, float, float]) -> float:
        """Share of the sound that comes back through the plants of the environment."""
        if state.scene.media is None or state.scene.media.canopy is None:
            return 1.0
        rays = rays_from(T[:3, 3], np.array([echo[:3]]) / echo[3] @ T[:3, :3].T)
        return math.exp(-2.0 * float(state.scene.media.canopy.optical_depth(rays, np.array([echo[3]], np.float32))[0]))

    def _is_occluded(self, state: WorldState, T: Float64, echo: tuple[float, float, float, float]) -> bool:
        u = np.array([echo[:3]]) / echo[3]
        distance, _, _ = state.scene.static.cast_surface(rays_from(T[:3, 3], u @ T[:3, :3].T))
        return bool(distance[0] < echo[3] - NEAR_M)


def cone_rays(half_rad: float) -> Float64:
    """Unit vectors (N, 3) in a cone about x, denser in azimuth, for posts."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-half_rad, half_rad, COLUMNS), np.linspace(-half_rad, half_rad, ROWS), indexing="ij"
    )
    u = directions(azimuth.ravel(), elevation.ravel())
    return np.asarray(u[u[:, 0] >= math.cos(half_rad) - 1e-9])


def make_model(name: str, sensor: Ultrasonic, config: UltrasonicConfig, context: SensorContext) -> UltrasonicModel:
    """Model of one ultrasonic sensor of vehicle or implement; its neighbours face the same half-space."""
    is_on_implement = sensor.mount.sinks_m > 0.0
    x = sensor.mount.T_base_sensor[:3, 0]
    axes = [one.mount.T_base_sensor[:3, 0] for one in context.vehicle.sensors.ultrasonic.values()]
    neighbours = sum(float(x @ other) > 0.0 for other in axes) - 1
    random = context.generator(f"ultrasonic/{name}")
    plant_random = context.generator(f"environment/ultrasonic/{name}")
    return UltrasonicModel(name, sensor, neighbours, is_on_implement, config, random, plant_random)
