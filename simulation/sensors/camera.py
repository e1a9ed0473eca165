"""Camera model: rendered scene, lens distortion, automatic exposure, noise and JPEG.

Images are rendered through a pinhole that covers the lens, then remapped by Brown's distortion model.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from configs.site import Site
from configs.strict import Config
from configs.vehicle import Camera, Vehicle
from geometry.arrays import Float64, UInt8
from geometry.transforms import planar
from messages.sensors import CameraImage
from simulation.actors.actors import ActorState
from simulation.environment.air import draw_air
from simulation.environment.scene import Scene
from simulation.machine.body import machine_mesh
from simulation.randomness import generator
from simulation.rendering.light import SkyConfig, draw_light, in_fog
from simulation.rendering.materials import MACHINE_APPEARANCE, actor_surface, palette, static_surface
from simulation.rendering.renderer import CameraView, Renderer, exposure_factor
from simulation.rendering.scene_mesh import surface_of
from simulation.rendering.shading import add_noise
from simulation.rendering.textures import Int8
from simulation.scenario import CameraEpisode
from simulation.sensors.sensor import SensorContext, WorldState, period_ns_of

NOISE_OFFSETS = 1 << 18  # start positions in the prepared noise
BLOCKED_BGR = np.array([38, 52, 64], np.uint8)  # BGR
JPEG_QUALITY = 40  # 50 to 65 KB an image


class CameraConfig(Config):
    """Light of the day and errors of the camera."""

    latency_s: float = Field(ge=0.0, le=1.0, description="from exposure to delivery")
    sky: SkyConfig
    draw_distance_m: float = Field(ge=20.0, le=1000.0, description="for ground and scenery")
    resolution_ratio: float = Field(
        ge=0.3, le=1.0, description="lines that lens and colour filter resolve, per line of pixels"
    )
    noise_sigma: float = Field(ge=0.0, le=20.0, description="in grey levels of 255")
    blur_sigma_px: float = Field(ge=2.0, le=50.0, description="while the lens is blurred")
    target_brightness: float = Field(gt=0.02, le=0.8, description="mean brightness after automatic exposure")


@dataclass(frozen=True)
class RenderRequest:
    """Everything an image is rendered from; unaffected by later steps of the world."""

    stamp_ns: int
    elapsed_s: float
    T_map_base: Float64
    actors: list[ActorState]
    renderer: Renderer


class CameraModel:
    """One camera on one machine."""

    def __init__(
        self, name: str, camera: Camera, vehicle: Vehicle, site: Site, episodes: tuple[CameraEpisode, ...], seed: int,
        config: CameraConfig, extinction_per_m: float = 0.0,
    ) -> None:  # fmt: skip
        self.topic = f"camera/{name}"
        self.period_ns = period_ns_of(camera.rate_hz)
        self.latency_ns = round(config.latency_s * 1e9)
        self._camera, self._site, self._episodes, self._seed, self._config = camera, site, episodes, seed, config
        self._light = draw_light(config.sky, generator(seed, "sky"))  # the same sky for all cameras
        if extinction_per_m > 0.0:
            self._light = in_fog(self._light, math.log(20.0) / extinction_per_m)
        self._random = generator(seed, f"camera/{name}")
        self._noise = draw_noise(camera.size_px, config.noise_sigma, self._random)
        self._machine = surface_of(
            machine_mesh(vehicle), np.array(MACHINE_APPEARANCE[0]), MACHINE_APPEARANCE[1], is_flat=True
        )
        self._lens = Lens(camera, config.resolution_ratio)
        self._curve = tone_curve()
        self._renderer: Renderer | None = None
        self._gain: float | None = None

    def sample(self, state: WorldState) -> CameraImage:
        """The image taken now, decoded from its JPEG."""
        return self.render(self.prepare(state))

    def prepare(self, state: WorldState) -> RenderRequest:
        """The request for an image taken now."""
        actors, renderer = state.scene.visible_to("camera"), self._renderer_for(state.scene)
        return RenderRequest(state.stamp_ns, state.elapsed_s, state.poses.steps_ago(0), actors, renderer)

    def render(self, request: RenderRequest) -> CameraImage:
        """The image; requests must be rendered in the order in which they were taken."""
        T_map_base, actors = request.T_map_base, request.actors
        view = CameraView(T_map_base @ self._camera.mount.T_base_sensor, self._lens.intrinsics, self._lens.size_px)
        moving = [self._machine.transformed(T_map_base)]
        occluders = np.zeros((len(actors), 3))
        for k, f in enumerate(actors):
            appearance = palette(self._seed, f.id)
            T_map_figure = planar(f.p_map_m[0], f.p_map_m[1], f.yaw_rad)
            T_map_figure[2, 3] = f.p_map_m[2]
            moving.append(actor_surface(f.solid, f.solid.step(f.gait), appearance).transformed(T_map_figure))
            occluders[k] = *f.p_map_m[:2], (0.4 * f.ball_m[1]) ** -2
        bgr, mean, gain = request.renderer.render(view, moving, occluders, self._gain, self._curve)
        self._gain = gain * exposure_factor(mean, self._config.target_brightness)
        _, jpeg = cv2.imencode(
            ".jpg", self._apply_lens(bgr, request.elapsed_s), (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
        )
        sent = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
        return CameraImage(request.stamp_ns, sent, jpeg.tobytes())

    def warm(self, scene: Scene) -> None:
        """Builds the static scene and loads the kernels."""
        view = CameraView(self._camera.mount.T_base_sensor, self._lens.intrinsics, self._lens.size_px)
        bgr, _, _ = self._renderer_for(scene).render(view, [self._machine], np.zeros((0, 3)), None, self._curve)
        add_noise(bgr, self._noise, 0, np.empty_like(bgr))

    def _renderer_for(self, scene: Scene) -> Renderer:
        if self._renderer is None:
            static = static_surface(scene.pieces, self._site, self._seed)
            self._renderer = Renderer(static, roof_of(self._site), self._light, self._config.draw_distance_m)
        return self._renderer

    def _apply_lens(self, bgr: UInt8, elapsed_s: float) -> UInt8:
        """Distortion, lens contamination and noise."""
        states = [e.state for e in self._episodes if e.from_s <= elapsed_s < e.from_s + e.for_s]
        bgr = self._lens.distort(bgr)
        if "blocked" in states:
            bgr = np.empty_like(bgr)
            bgr[:] = BLOCKED_BGR
        elif "blurred" in states:
            bgr = np.asarray(cv2.GaussianBlur(bgr, (0, 0), self._config.blur_sigma_px), np.uint8)
        out = np.empty_like(bgr)
        add_noise(bgr, self._noise, int(self._random.integers(NOISE_OFFSETS)), out)
        return out


class Lens:
    """A pinhole that covers the lens at its resolution, and the mapping of its image to that of the lens."""

    def __init__(self, camera: Camera, resolution: float) -> None:
        self._camera = camera
        (fx, fy), (cx, cy), (width, height) = camera.focal_px, camera.center_px, camera.size_px
        self._maps: tuple[UInt8, UInt8] | None = None
        # pixel coordinates refer to pixel centres
        self.size_px = math.ceil(width * resolution), math.ceil(height * resolution)
        scale = np.array([self.size_px[0] / width, self.size_px[1] / height])
        self.intrinsics: Float64 = np.concatenate([scale * [fx, fy], scale * [cx + 0.5, cy + 0.5] - 0.5])
        if any(camera.distortion):
            # the lens's image at the rendered resolution
            y, x = np.mgrid[0 : self.size_px[1], 0 : self.size_px[0]].astype(np.float64)
            K = np.array(
                [[scale[0] * fx, 0.0, self.intrinsics[2]], [0.0, scale[1] * fy, self.intrinsics[3]], [0, 0, 1]]
            )
            flat = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), K, np.array(camera.distortion))
            place = flat.reshape(*x.shape, 2) * self.intrinsics[:2]
            low, high = np.floor(place.min(axis=(0, 1))), np.ceil(place.max(axis=(0, 1)))
            self.intrinsics[2:] = -low
            self.size_px = int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1
            place = (place - low).astype(np.float32)
            self._maps = cv2.convertMaps(place[..., 0], place[..., 1], cv2.CV_16SC2)

    def distort(self, bgr: UInt8) -> UInt8:
        """The lens's image from that of the pinhole."""
        if self._maps is not None:
            bgr = np.asarray(cv2.remap(bgr, *self._maps, cv2.INTER_LINEAR), np.uint8)
        return np.asarray(cv2.resize(bgr, self._camera.size_px, interpolation=cv2.INTER_LINEAR), np.uint8)


def draw_noise(size_px: tuple[int, int], sigma: float, random: np.random.Generator) -> Int8:
    """Noise in grey levels for an image that starts at any of `NOISE_OFFSETS` positions."""
    level = sigma * random.standard_normal(3 * size_px[0] * size_px[1] + NOISE_OFFSETS, np.float32)
    return np.asarray(np.clip(np.rint(level), -127, 127).astype(np.int8))


def tone_curve() -> UInt8:
    """Grey levels (4096,) for brightness 0 to 1: sRGB with compressed highlights."""
    x = np.arange(4096) / 4095.0
    x = x * (1.0 + 0.35 * x) / (1.0 + 0.35 * x * x)
    srgb = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1.0 / 2.4) - 0.055)
    return np.asarray(np.clip(np.rint(255.0 * srgb), 0, 255), np.uint8)


def roof_of(site: Site) -> Float64 | None:
    """Low and high corner of the shed's roof and its height, (5,)."""
    if site.shed is None:
        return None
    outline = np.array(site.shed.outline_m)
    return np.concatenate([outline.min(axis=0), outline.max(axis=0), [site.shed.height_m]])


def make_model(name: str, camera: Camera, config: CameraConfig, context: SensorContext) -> CameraModel:
    """Model of one camera of the vehicle."""
    scenario, seed = context.scenario, context.seed
    extinction = 0.0 if scenario.environment is None else draw_air(scenario.environment, seed).extinction_per_m
    return CameraModel(name, camera, context.vehicle, context.site, scenario.camera, seed, config, extinction)
