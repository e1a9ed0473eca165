"""Background panorama beyond the scene: meadows to the horizon, distant woods, sky.

Rendered once per run. Columns are linear in dx / (|dx| + |dy|), which needs no angle; rows, dense at the horizon, in
rise / (SPREAD + |rise|), where rise is the tangent of the elevation.
"""

import math

import numpy as np

from geometry.arrays import Float32, Float64, UInt8
from geometry.jit import inline_kernel, kernel
from simulation.rendering.textures import CLOUD, GRAIN, GRASS, bilinear, mip_level

QUARTER = 1024  # columns from east to north
ABOVE, BELOW, SPREAD = 220, 80, 0.3  # rows above and below the horizon; rise at half of those above
PIXEL = 0.0014  # radians per row or column at the horizon
VIEW_HEIGHT_M, WOODS_M, MEADOWS_M = 3.0, 350.0, 500.0  # nominal height of the camera and distances of woods and meadows


@inline_kernel
def texel_of(dx: float, dy: float, dz: float) -> tuple[int, int]:
    """Row and column of a direction in the panorama."""
    inverse = 1.0 / (abs(dx) + abs(dy) + 1e-12)
    column = 1.0 + dy * inverse if dx >= 0.0 else 3.0 - dy * inverse
    rise = dz * inverse
    row = BELOW + ABOVE * rise / (SPREAD + abs(rise))
    return max(min(int(row), BELOW + ABOVE - 1), 0), max(min(int(QUARTER * column), 4 * QUARTER - 1), 0)


@inline_kernel
def background_run(row: Float32, begin: int, end: int, ray: Float64, panorama: Float32) -> None:
    """Columns `begin` to `end` of a row into `row` (W, 3), linear."""
    for x in range(begin, end):
        i, j = texel_of(ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2])
        row[x, 0], row[x, 1], row[x, 2] = panorama[i, j, 0], panorama[i, j, 1], panorama[i, j, 2]


@kernel
def render_panorama(light: Float64, skyline: Float64, planes: UInt8) -> Float32:
    """Panorama in linear colours (BELOW + ABOVE, 4 QUARTER, 3); `light` as `Light.packed`, `planes` of `Textures`."""
    out = np.empty((BELOW + ABOVE, 4 * QUARTER, 3), np.float32)
    for i in range(BELOW + ABOVE):
        part = (i + 0.5 - BELOW) / ABOVE
        rise = SPREAD * part / (1.0 - abs(part))
        for j in range(4 * QUARTER):
            turn = (j + 0.5) / QUARTER - 1.0
            dy = turn if turn < 1.0 else 2.0 - turn
            dx = 1.0 - abs(dy) if turn < 1.0 else abs(dy) - 1.0
            n = 1.0 / math.sqrt(dx * dx + dy * dy + rise * rise)
            # single elements: assigning a tuple to a row costs numba seconds of compilation
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = background_color(
                dx * n, dy * n, rise * n, light, skyline, planes
            )
    return out


@kernel
def background_color(
    dx: float, dy: float, dz: float, light: Float64, skyline: Float64, planes: UInt8
) -> tuple[float, float, float]:
    """Colour in a unit direction: meadows, distant woods or sky."""
    flat = max(math.sqrt(dx * dx + dy * dy), 1e-6)
    rise = dz / flat
    if rise < 0.0:
        z = min(VIEW_HEIGHT_M / -rise, MEADOWS_M)
        u, v = z * dx / flat, z * dy / flat
        t = sample(planes, GRASS, 2.0 * u, 2.0 * v, 3.0 * z * PIXEL) * sample(
            planes, CLOUD, 0.6 * u, 0.6 * v, z * PIXEL
        )
        return with_haze(0.115 * t, 0.138 * t, 0.04 * t, light[2], z, light)
    place = (math.atan2(dy, dx) / (2.0 * math.pi) + 0.5) * skyline.shape[0]
    k = int(place)
    low, high = skyline[k % skyline.shape[0]], skyline[(k + 1) % skyline.shape[0]]
    edge = low + (place - k) * (high - low)
    if rise >= edge:
        return sky_color(dx, dy, dz, light, planes)
    # bright crowns, dark below them
    t = sample(planes, GRAIN, 1.3 * place, 420.0 * rise, 420.0 * PIXEL) * (0.5 + 0.6 * rise / edge)
    return with_haze(0.045 * t, 0.070 * t, 0.030 * t, 0.5 * light[2], WOODS_M, light)


@kernel
def with_haze(r: float, g: float, b: float, sun_share: float, z: float, light: Float64) -> tuple[float, float, float]:
    """A colour under sky and sun, seen through haze `z` metres thick."""
    near = math.exp(-z / light[16])
    haze_r, haze_g, haze_b = 0.8 * light[12], 0.8 * light[13], 0.8 * light[14]
    return (
        haze_r + near * (r * (light[6] + sun_share * light[3]) - haze_r),
        haze_g + near * (g * (light[7] + sun_share * light[4]) - haze_g),
        haze_b + near * (b * (light[8] + sun_share * light[5]) - haze_b),
    )


@kernel
def sky_color(dx: float, dy: float, dz: float, light: Float64, planes: UInt8) -> tuple[float, float, float]:
    """Colour of the sky in a direction: horizon to zenith, clouds, and the sun with its glow."""
    share = 1.0 - math.exp(-4.0 * dz)
    r = light[12] + share * (light[9] - light[12])
    g = light[13] + share * (light[10] - light[13])
    b = light[14] + share * (light[11] - light[14])
    t = sample(planes, CLOUD, 70.0 * dx / (dz + 0.1) + light[17], 70.0 * dy / (dz + 0.1) + light[18], 0.0)
    t = min(max((t - 1.65 + light[15]) * 1.6, 0.0), 1.0) * min(1.0, 12.0 * dz)
    white = 1.0 + 0.25 * light[2]
    r, g, b = r + t * (white * 0.95 - r), g + t * (white * 0.96 - g), b + t * (white - b)
    cosine = dx * light[0] + dy * light[1] + dz * light[2]
    if cosine > 0.7:
        glow = 40.0 if cosine > 0.9998 else ((cosine - 0.7) / 0.3) ** 6 * 0.6
        r, g, b = r + glow * light[3], g + glow * light[4], b + glow * light[5]
    return r, g, b


@kernel
def sample(planes: UInt8, which: int, u: float, v: float, pixel_texels: float) -> float:
    """A texture at (u, v) in texels, for pixels `pixel_texels` texels wide."""
    start, mask, scale = mip_level(1.0, pixel_texels)
    return float(bilinear(planes, which, start, mask, scale * u, scale * v))
