"""Synthetic drive over slopes with all sensor messages, independent of the simulator."""

import dataclasses
import functools
import math

import numpy as np
from scipy.spatial.transform import Rotation

from configs.strict import find, load
from configs.vehicle import Vehicle
from geometry.geodesy import Datum
from messages.message import Message
from messages.sensors import GnssFix, GnssSolution, ImuSample, WheelSample

DATUM = Datum(math.radians(52.2), math.radians(10.5), 80.0)
FINE_S = 0.002
START_NS = 1_700_000_000_000_000_000
GRAVITY_MPS2 = 9.8129


@dataclasses.dataclass(frozen=True)
class SensorErrors:
    """Systematic errors of the sensors; noise is taken from the machine file."""

    seed: int = 1
    slip: float = 0.04
    slip_swing: float = 0.01
    slip_per_force: float = 0.3
    drift: float = 0.004
    slip_angle_per_force: float = 0.2
    soil_side: float = 0.002
    steering_offset_rad: float = math.radians(0.3)
    gnss_slow_share: float = 0.7
    gnss_slow_s: float = 60.0
    gnss_latency_s: float = 0.05
    furrow_m: float = 0.01


@dataclasses.dataclass(frozen=True)
class Truth:
    """True `T_map_base` (N, 4, 4) and forward speed (N,) every `FINE_S`, and the messages by topic."""

    T_map_base: np.ndarray
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray
    messages: list[tuple[int, str, Message]]

    def at(self, stamp_ns: int) -> np.ndarray:
        """True pose: orientation of the nearest step, interpolated position."""
        x = (stamp_ns - START_NS) * 1e-9 / FINE_S
        k = min(int(x), len(self.T_map_base) - 2)
        T = self.T_map_base[k].copy()
        T[:3, 3] += (x - k) * (self.T_map_base[k + 1][:3, 3] - T[:3, 3])
        return T


@functools.cache
def tractor() -> Vehicle:
    return load(Vehicle, find("machines", "tractor_e"))


def field(seconds: float, stand_s: float = 4.0, speed_mps: float = 10 / 3.6) -> list[tuple[float, float, float]]:
    """Sections (duration, speed, curvature): standstill, then straights of 25 s with half turns of R = 6 m."""
    legs, left, sign = [(stand_s, 0.0, 0.0)], seconds - stand_s, 1.0
    while left > 0:
        legs += [(25.0, speed_mps, 0.0), (math.pi * 6.0 / 1.6, 1.6, sign / 6.0)]
        left -= 25.0 + math.pi * 6.0 / 1.6
        sign = -sign
    return legs


def drive(
    seconds: float, legs: list[tuple[float, float, float]] | None = None, sensor_errors: SensorErrors = SensorErrors(),
    begin: tuple[float, float, float] = (3.0, -2.0, 0.4), is_flat: bool = False,
) -> Truth:  # fmt: skip
    """Drive from a pose (x, y, yaw) with sensor messages in order of arrival."""
    rng = np.random.default_rng(sensor_errors.seed)
    n = int(seconds / FINE_S) + 1
    t = np.arange(n) * FINE_S
    speed, curvature = _profile(legs if legs is not None else field(seconds), t)
    T, yaw = _poses(t, speed, curvature, sensor_errors, begin, 0.0 if is_flat else 1.0)
    v = tractor()
    imu = _imu(v, t, T, rng)
    wheels = _wheels(v, t, T, speed, curvature, sensor_errors, rng)
    fixes = _fixes(v, t, T, yaw, sensor_errors, rng)
    messages = sorted([*imu, *wheels, *fixes], key=lambda m: m[0])
    return Truth(T, speed, np.gradient(yaw, FINE_S), messages)


def _profile(legs, t):
    ends = np.cumsum([leg[0] for leg in legs])
    index = np.minimum(np.searchsorted(ends, t, side="right"), len(legs) - 1)
    speed, curvature = np.array([leg[1] for leg in legs])[index], np.array([leg[2] for leg in legs])[index]
    for width_s in (1.5, 0.8):  # neither speed nor steering steps
        w = int(width_s / FINE_S)
        kernel = np.full(w, 1.0 / w)
        speed, curvature = (
            np.convolve(np.pad(x, (w - 1, 0), mode="edge"), kernel, "valid") for x in (speed, curvature)
        )
    return speed, curvature


def _height(x, y, furrow_m):
    """Hills with slopes up to about 8 %, a constant side slope of 2°, and furrows."""
    k = 2 * np.pi / 120.0
    z = 0.6 * np.sin(k * x) + 0.5 * np.cos(k * y * 0.8) + 0.035 * y
    zx = 0.6 * k * np.cos(k * x)
    zy = -0.5 * k * 0.8 * np.sin(k * y * 0.8) + 0.035
    for length, phase in ((6.3, 0.3), (17.0, 1.1)):
        q = 2 * np.pi / length
        z = z + furrow_m * np.sin(q * (x + 0.4 * y) + phase)
        zx = zx + furrow_m * q * np.cos(q * (x + 0.4 * y) + phase)
        zy = zy + furrow_m * q * 0.4 * np.cos(q * (x + 0.4 * y) + phase)
    return z, zx, zy


def _poses(t, speed, curvature, sensor_errors, begin, hills):
    """Integrates on the surface; `speed` is along x of base, with lateral drift by side force and soil."""
    n, furrow_m = len(t), sensor_errors.furrow_m
    soil, rng = np.zeros(n), np.random.default_rng(sensor_errors.seed + 1000)
    keep, white = math.exp(-FINE_S / 0.5), rng.normal(0, sensor_errors.soil_side, n)
    for k in range(1, n):
        soil[k] = keep * soil[k - 1] + math.sqrt(1 - keep**2) * white[k]
    xy = np.zeros((n, 2))
    yaw = np.zeros(n)
    turn = curvature * speed
    yaw[1:] = np.cumsum(0.5 * (turn[1:] + turn[:-1]) * FINE_S)
    yaw += begin[2]
    R = np.empty((n, 3, 3))
    x, y = begin[:2]
    c, s = np.cos(yaw).tolist(), np.sin(yaw).tolist()
    v, d = (
        speed.tolist(),
        (sensor_errors.drift + soil - sensor_errors.slip_angle_per_force * turn * speed / GRAVITY_MPS2).tolist(),
    )

    def velocity(k, x, y):
        _, zx, zy = (hills * h for h in _height_fast(x, y, furrow_m))
        along = c[k] * zx + s[k] * zy
        ex = 1.0 / math.sqrt(1.0 + along * along)
        nx, ny, nz = -zx, -zy, 1.0
        nn = math.sqrt(nx * nx + ny * ny + 1.0)
        nx, ny, nz = nx / nn, ny / nn, nz / nn
        fx, fy, fz = c[k] * ex, s[k] * ex, along * ex
        lx, ly = ny * fz - nz * fy, nz * fx - nx * fz
        lz = nx * fy - ny * fx
        share = d[k] - sensor_errors.slip_angle_per_force * lz
        return v[k] * (fx + share * lx), v[k] * (fy + share * ly)

    for k in range(n):
        xy[k] = x, y
        if k + 1 < n:
            ax, ay = velocity(k, x, y)
            bx, by = velocity(k + 1, x + ax * FINE_S, y + ay * FINE_S)
            x, y = x + 0.5 * (ax + bx) * FINE_S, y + 0.5 * (ay + by) * FINE_S
    z, zx, zy = (hills * h for h in _height(xy[:, 0], xy[:, 1], furrow_m))
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.cos(yaw) * zx + np.sin(yaw) * zy], axis=1)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    up = np.stack([-zx, -zy, np.ones(n)], axis=1)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    R[:, :, 0], R[:, :, 1], R[:, :, 2] = forward, np.cross(up, forward), up
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, np.column_stack([xy, z])
    return T, yaw


def _height_fast(x, y, furrow_m):
    k = 2 * math.pi / 120.0
    zx = 0.6 * k * math.cos(k * x)
    zy = -0.5 * k * 0.8 * math.sin(k * y * 0.8) + 0.035
    for length, phase in ((6.3, 0.3), (17.0, 1.1)):
        q = 2 * math.pi / length
        slope = furrow_m * q * math.cos(q * (x + 0.4 * y) + phase)
        zx, zy = zx + slope, zy + 0.4 * slope
    return 0.0, zx, zy


def _ns(t):
    return START_NS + round(t * 1e9)


def _imu(v, t, T, rng):
    imu = v.sensors.imu
    p = T[:, :3, 3] + T[:, :3, :3] @ np.array(imu.mount.xyz_m)
    acceleration = np.gradient(np.gradient(p, FINE_S, axis=0), FINE_S, axis=0)
    force = np.einsum("nji,nj->ni", T[:, :3, :3], acceleration + np.array([0, 0, GRAVITY_MPS2]))
    every = round(1 / imu.rate_hz / FINE_S)
    index = np.arange(5 * every, len(t) - 5, every)
    R, before = T[index, :3, :3], T[index - every, :3, :3]
    rate = Rotation.from_matrix(np.einsum("nji,njk->nik", before, R)).as_rotvec() * imu.rate_hz
    total = np.cumsum(0.5 * (force[1:] + force[:-1]), axis=0)
    force = (total[index - 1] - total[index - 1 - every]) / every
    m = len(index)
    bias_a = rng.normal(0, imu.accelerometer_bias_mg * 9.8e-3, 3)
    bias_g = rng.normal(0, math.radians(imu.gyro_bias_dph) / 3600, 3) + rng.normal(0, math.radians(0.05), 3)
    root = math.sqrt(imu.rate_hz)
    force = force + bias_a + rng.normal(0, imu.accelerometer_noise_ug_rthz * 9.8e-6 * root, (m, 3))
    rate = rate + bias_g + rng.normal(0, math.radians(imu.gyro_noise_dps_rthz) * root, (m, 3))
    return [
        (_ns(t[k]) + 2_000_000, "imu", ImuSample(_ns(t[k]), f.copy(), w.copy()))
        for k, f, w in zip(index, force, rate, strict=True)
    ]


def _wheels(v, t, T, speed, curvature, sensor_errors, rng):
    wheels = v.sensors.wheels
    every = int(1 / wheels.rate_hz / FINE_S)
    index = np.arange(0, len(t) - 5, every)
    pull = np.gradient(speed, FINE_S) / GRAVITY_MPS2 + T[:, 2, 0]
    slip = sensor_errors.slip + sensor_errors.slip_swing * np.sin(t / 11.0) + sensor_errors.slip_per_force * pull
    out = []
    for k in index:
        angle = math.atan(v.drivetrain.wheelbase_m * curvature[k]) + sensor_errors.steering_offset_rad
        noisy = speed[k] * (1 + slip[k]) + (rng.normal(0, wheels.speed_sigma_mps) if abs(speed[k]) > 1e-3 else 0.0)
        sample = WheelSample(
            _ns(t[k]), float(noisy), float(angle + rng.normal(0, math.radians(wheels.angle_sigma_deg)))
        )
        out.append((_ns(t[k]) + 3_000_000, "wheel", sample))
    return out


def _fixes(v, t, T, yaw, sensor_errors, rng):
    gnss = v.sensors.gnss["main"]
    every = int(1 / gnss.rate_hz / FINE_S)
    index = np.arange(every, len(t) - 5, every)
    antenna = T[:, :3, 3] + T[:, :3, :3] @ np.array(gnss.mount.xyz_m)
    velocity = np.gradient(antenna, FINE_S, axis=0)
    sigma = np.array([gnss.sigma_horizontal_m, gnss.sigma_horizontal_m, gnss.sigma_vertical_m])
    keep = math.exp(-1 / gnss.rate_hz / sensor_errors.gnss_slow_s)
    slow = rng.normal(0, 1, 3)
    out = []
    for k in index:
        slow = keep * slow + math.sqrt(1 - keep**2) * rng.normal(0, 1, 3)
        noise = sensor_errors.gnss_slow_share * slow + math.sqrt(1 - sensor_errors.gnss_slow_share**2) * rng.normal(
            0, 1, 3
        )
        lat, lon, h = DATUM.to_ellipsoid(*(antenna[k] + sigma * noise))
        heading = yaw[k] + rng.normal(0, math.radians(gnss.sigma_heading_deg))
        fix = GnssFix(
            _ns(t[k]),
            lat,
            lon,
            h,
            sigma.copy(),
            velocity[k] + rng.normal(0, 0.03, 3),
            0.03,
            math.remainder(heading, 2 * math.pi),
            math.radians(gnss.sigma_heading_deg),
            GnssSolution.RTK_FIXED,
            18,
            0.8,
            1.0,
            "BDS+GPS",
        )
        out.append((_ns(t[k]) + int(sensor_errors.gnss_latency_s * 1e9), "gnss/main", fix))
    return out
