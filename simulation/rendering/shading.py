"""Light, texture and shadow of each pixel: what the buffer's triangle looks like there, or the sky."""

import math

import numpy as np

from messages.message import Float32, Float64, Int32, UInt8
from simulation.kernels import compiled
from simulation.rendering.textures import CLOUD, GRAIN, GRASS, LEVELS, SIDE, SOIL

FURTHEST = LEVELS - 1
SHADOW_BIAS_M = 0.05
SOFT = 0.45  # of the ambient light is left where something stands close above the ground


@compiled
def sample(planes: Float32, which: int, u: float, v: float, step: float) -> float:
    """A texture at (u, v) in texels of its finest level, seen with pixels of `step` texels."""
    side, start, level = SIDE, 0, 0
    while step > 1.4 and level < FURTHEST:
        start += side * side
        side >>= 1
        u *= 0.5
        v *= 0.5
        step *= 0.5
        level += 1
    i, j = int(math.floor(u)), int(math.floor(v))
    f, g = u - i, v - j
    mask = side - 1
    a, b = start + (j & mask) * side, start + ((j + 1) & mask) * side
    i, k = i & mask, (i + 1) & mask
    low = planes[which, a + i] * (1.0 - f) + planes[which, a + k] * f
    high = planes[which, b + i] * (1.0 - f) + planes[which, b + k] * f
    return float(low * (1.0 - g) + high * g)


@compiled
def sky_color(
    dx: float, dy: float, dz: float, light: Float64, skyline: Float64, planes: Float32, height_m: float, pixel: float
) -> tuple[float, float, float]:
    """What is seen in a direction where nothing near stands: sky, clouds, woods far off, meadows to the horizon."""
    edge = 0.0
    if dz < 0.12:
        place = (math.atan2(dy, dx) / (2.0 * math.pi) + 0.5) * skyline.shape[0]
        k = int(place)
        edge = skyline[k % skyline.shape[0]] + (place - k) * (
            skyline[(k + 1) % skyline.shape[0]] - skyline[k % skyline.shape[0]]
        )
    flat = max(math.sqrt(dx * dx + dy * dy), 1e-6)
    rise = dz / flat
    if rise < 0.0:
        z = min(max(height_m, 0.5) / -rise, 4000.0)
        u, v = z * dx / flat, z * dy / flat
        t = sample(planes, GRASS, 2.0 * u, 2.0 * v, 3.0 * z * pixel) * sample(planes, CLOUD, 0.6 * u, 0.6 * v, z * pixel)
        lit = 0.35 * light[2]
        r, g, b = 0.085 * t, 0.125 * t, 0.035 * t
        r, g, b = r * (light[6] + lit * light[3]), g * (light[7] + lit * light[4]), b * (light[8] + lit * light[5])
        near = math.exp(-z / light[16])
        return r * near + 0.8 * light[12] * (1 - near), g * near + 0.8 * light[13] * (1 - near), b * near + 0.8 * light[14] * (1 - near)
    if rise < edge:
        t = sample(planes, GRAIN, 2600.0 * math.atan2(dy, dx) / 6.2831853, 420.0 * rise, 420.0 * pixel)
        t *= 0.6 + 0.4 * rise / edge
        lit = 0.5 * light[2]
        near = 0.62
        r = 0.045 * t * (light[6] + lit * light[3]) * near + 0.75 * light[12] * (1.0 - near)
        g = 0.070 * t * (light[7] + lit * light[4]) * near + 0.75 * light[13] * (1.0 - near)
        b = 0.035 * t * (light[8] + lit * light[5]) * near + 0.75 * light[14] * (1.0 - near)
        return r, g, b
    share = 1.0 - math.exp(-4.0 * dz)
    r = light[12] + share * (light[9] - light[12])
    g = light[13] + share * (light[10] - light[13])
    b = light[14] + share * (light[11] - light[14])
    t = sample(planes, CLOUD, 70.0 * dx / (dz + 0.1), 70.0 * dy / (dz + 0.1), 0.0)
    t = min(max((t - 1.5 + 1.1 * light[15]) * 1.6, 0.0), 1.0) * min(1.0, 12.0 * dz)
    white = 1.0 + 0.25 * light[2]
    r, g, b = r + t * (white * 0.95 - r), g + t * (white * 0.96 - g), b + t * (white - b)
    cosine = dx * light[0] + dy * light[1] + dz * light[2]
    if cosine > 0.7:
        glow = ((cosine - 0.7) / 0.3) ** 6 * 0.6
        if cosine > 0.9998:
            glow = 40.0
        r, g, b = r + glow * light[3], g + glow * light[4], b + glow * light[5]
    return r, g, b


@compiled
def sunlit(x: float, y: float, z: float, L: Float64, middle: Float64, per_m: float, shadow: Float32) -> float:
    """Share of the sun that reaches a point: the four nearest cells of the sun's own picture, blended."""
    size = shadow.shape[0]
    dx, dy, dz = x - middle[0], y - middle[1], z - middle[2]
    u = (L[0, 0] * dx + L[0, 1] * dy + L[0, 2] * dz) * per_m + 0.5 * size
    v = (L[1, 0] * dx + L[1, 1] * dy + L[1, 2] * dz) * per_m + 0.5 * size
    w = 100.0 + L[2, 0] * dx + L[2, 1] * dy + L[2, 2] * dz + SHADOW_BIAS_M
    i, j = int(math.floor(u)), int(math.floor(v))
    if i < 0 or j < 0 or i >= size - 1 or j >= size - 1:
        return 1.0
    f, g = u - i, v - j
    a = (1.0 - f) * (shadow[j, i] < w) + f * (shadow[j, i + 1] < w)
    b = (1.0 - f) * (shadow[j + 1, i] < w) + f * (shadow[j + 1, i + 1] < w)
    return a * (1.0 - g) + b * g


@compiled
def roofed(x: float, y: float, z: float, roof: Float64) -> float:
    """Share of the sky that is left at a point below a roof (low x, y, high x, y, height): least in its middle."""
    inside = min(min(x - roof[0], roof[2] - x), min(y - roof[1], roof[3] - y))
    if inside <= 0.0 or z > roof[4]:
        return 1.0
    return 0.18 + 0.82 * math.exp(-inside / 1.5)


@compiled
def shade(
    bgr: UInt8, w: Float32, owner: Int32, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32,
    materials: UInt8, R: Float64, origin: Float64, intrinsics: Float64, light: Float64, skyline: Float64,
    planes: Float32, shadow: Float32, L: Float64, middle: Float64, per_m: float, feet: Float64, roof: Float64,
    ground_m: float, gain: float, curve: UInt8, step: int,
) -> float:  # fmt: skip
    """Paint every `step`-th row and column of `bgr` (H, W, 3); gives the mean brightness, 1 where it is clipped.

    `R`, `origin`, `intrinsics` as of `project`; `light` as `Light.packed`; `shadow` (S, S) with `L`, `middle`, `per_m` the
    sun's picture; `feet` (F, 3) where figures touch the ground, with a radius; `ground_m` is the height of the land
    far off; `curve` (4096,) takes linear brightness times `gain` to grey levels.
    """
    height, width = w.shape
    fx, fy, cx, cy = intrinsics
    pixel = 1.0 / fx
    total = 0.0
    count = 0
    last = -1
    e = np.zeros((3, 3))
    p = np.zeros((3, 3))
    n3 = np.zeros((3, 3))
    c3 = np.zeros((3, 3))
    kind = 0
    for y in range(0, height, step):
        v = (y - cy) / fy
        for x in range(0, width, step):
            u = (x - cx) / fx
            dx = R[0, 0] * u + R[1, 0] * v + R[2, 0]
            dy = R[0, 1] * u + R[1, 1] * v + R[2, 1]
            dz = R[0, 2] * u + R[1, 2] * v + R[2, 2]
            length = math.sqrt(u * u + v * v + 1.0)
            value = w[y, x]
            if value <= 0.0:
                r, g, b = sky_color(
                    dx / length, dy / length, dz / length, light, skyline, planes, origin[2] - ground_m, pixel
                )
            else:
                t = owner[y, x]
                if t != last:
                    last = t
                    kind = materials[t]
                    for i in range(3):
                        k = triangles[t, i]
                        for j in range(3):
                            p[i, j] = vertices[k, j] - origin[j]
                            n3[i, j] = normals[k, j]
                            c3[i, j] = colors[k, j]
                    # the share of a corner in a direction is the volume that it spans with the two others
                    for i in range(3):
                        q, s = p[(i + 1) % 3], p[(i + 2) % 3]
                        e[i, 0] = q[1] * s[2] - q[2] * s[1]
                        e[i, 1] = q[2] * s[0] - q[0] * s[2]
                        e[i, 2] = q[0] * s[1] - q[1] * s[0]
                a0 = e[0, 0] * dx + e[0, 1] * dy + e[0, 2] * dz
                a1 = e[1, 0] * dx + e[1, 1] * dy + e[1, 2] * dz
                a2 = e[2, 0] * dx + e[2, 1] * dy + e[2, 2] * dz
                whole = a0 + a1 + a2
                if whole == 0.0:
                    a0, a1, a2, whole = 1.0, 1.0, 1.0, 3.0
                a0, a1, a2 = a0 / whole, a1 / whole, a2 / whole
                z = 1.0 / value
                px, py, pz = origin[0] + dx * z, origin[1] + dy * z, origin[2] + dz * z
                nx = a0 * n3[0, 0] + a1 * n3[1, 0] + a2 * n3[2, 0]
                ny = a0 * n3[0, 1] + a1 * n3[1, 1] + a2 * n3[2, 1]
                nz = a0 * n3[0, 2] + a1 * n3[1, 2] + a2 * n3[2, 2]
                r = a0 * c3[0, 0] + a1 * c3[1, 0] + a2 * c3[2, 0]
                g = a0 * c3[0, 1] + a1 * c3[1, 1] + a2 * c3[2, 1]
                b = a0 * c3[0, 2] + a1 * c3[1, 2] + a2 * c3[2, 2]
                size = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-9
                facing = -(nx * dx + ny * dy + nz * dz) / (size * length)
                if facing < 0.0:
                    size, facing = -size, -facing
                nx, ny, nz = nx / size, ny / size, nz / size
                foot = z * pixel
                grain = 1.0
                wide = foot / math.sqrt(max(facing, 0.04))
                if kind == 1:
                    grain = sample(planes, SOIL, 150.0 * px, 150.0 * py, 150.0 * wide)
                    grain *= sample(planes, SOIL, 19.0 * px, 17.0 * py, 19.0 * wide)
                elif kind == 2:
                    grain = sample(planes, GRASS, 110.0 * px, 110.0 * py, 110.0 * wide)
                    tint = sample(planes, CLOUD, 11.0 * px, 9.0 * py, 10.0 * wide)
                    r *= 0.75 + 0.35 * tint
                    grain *= 0.8 + 0.2 * tint
                elif kind == 3:
                    grain = sample(planes, GRAIN, 90.0 * px, 90.0 * py, 90.0 * wide)
                    grain *= 0.6 + 0.4 * sample(planes, SOIL, 14.0 * px, 16.0 * py, 15.0 * wide)
                elif kind == 4:
                    grain = sample(planes, GRASS, 60.0 * (px + 0.6 * pz), 60.0 * (py - 0.8 * pz), 60.0 * foot)
                    grain *= grain
                elif kind == 5:
                    grain = sample(planes, GRAIN, 26.0 * (px + py), 190.0 * pz, 190.0 * foot)
                elif kind == 6:
                    along = py * nx - px * ny
                    grain = 0.6 + 0.4 * sample(planes, GRAIN, 30.0 * along, 8.0 * pz, 30.0 * foot)
                    if foot < 0.05 and abs(nz) < 0.7:
                        tilt = 0.5 * math.cos(35.0 * along)
                        nx, ny = nx - tilt * ny, ny + tilt * nx
                        size = math.sqrt(nx * nx + ny * ny + nz * nz)
                        nx, ny, nz = nx / size, ny / size, nz / size
                elif kind == 9:
                    grain = 0.84 + 0.16 * sample(planes, GRAIN, 70.0 * (px + 0.5 * pz), 70.0 * (py + 0.4 * pz), 70.0 * foot)
                elif kind == 10:
                    grain = 0.6 + 0.4 * sample(planes, GRASS, 90.0 * (px + py), 90.0 * pz, 90.0 * foot)
                cosine = nx * light[0] + ny * light[1] + nz * light[2]
                if kind == 4:
                    cosine = 0.35 + 0.65 * abs(cosine)  # leaves let light through
                direct = 0.0
                if cosine > 0.0:
                    direct = cosine * sunlit(px, py, pz, L, middle, per_m, shadow)
                above = 0.5 + 0.5 * nz
                open_sky = roofed(px, py, pz, roof)
                if 1 <= kind <= 3:
                    for k in range(feet.shape[0]):
                        d2 = (px - feet[k, 0]) ** 2 + (py - feet[k, 1]) ** 2
                        r2 = feet[k, 2] * feet[k, 2]
                        if d2 < 9.0 * r2:
                            open_sky *= 1.0 - SOFT * math.exp(-d2 / r2)
                # the ground gives back a fifth of what falls on it
                up = open_sky * above
                back = 0.20 * open_sky * (1.0 - above)
                r *= grain * (direct * light[3] + up * light[6] + back * (light[6] + light[2] * light[3]))
                g *= grain * (direct * light[4] + up * light[7] + 0.85 * back * (light[7] + light[2] * light[4]))
                b *= grain * (direct * light[5] + up * light[8] + 0.60 * back * (light[8] + light[2] * light[5]))
                if kind == 7 or kind == 8:
                    sx, sy, sz = dx / length + 2.0 * facing * nx, dy / length + 2.0 * facing * ny, dz / length + 2.0 * facing * nz
                    fresnel = 0.05 + 0.6 * (1.0 - facing) ** 4
                    if kind == 8:
                        fresnel = 0.12 + 0.7 * (1.0 - facing) ** 3
                    sr, sg, sb = sky_color(sx, sy, sz, light, skyline, planes, 2.0, 0.02)
                    r += open_sky * fresnel * (min(sr, 2.0) - r)
                    g += open_sky * fresnel * (min(sg, 2.0) - g)
                    b += open_sky * fresnel * (min(sb, 2.0) - b)
                near = math.exp(-z / light[16])
                r = r * near + 0.8 * light[12] * (1.0 - near)
                g = g * near + 0.8 * light[13] * (1.0 - near)
                b = b * near + 0.8 * light[14] * (1.0 - near)
            r, g, b = min(r * gain, 1.0), min(g * gain, 1.0), min(b * gain, 1.0)
            total += 0.25 * r + 0.6 * g + 0.15 * b
            count += 1
            bgr[y, x, 0] = curve[int(b * 4095.0)]
            bgr[y, x, 1] = curve[int(g * 4095.0)]
            bgr[y, x, 2] = curve[int(r * 4095.0)]
    return total / count


@compiled
def add_noise(bgr: UInt8, noise: Float32, start: int, out: UInt8) -> None:
    """`bgr` with a stretch of prepared noise laid over it from `start`, grey levels, into `out`."""
    flat, to = bgr.reshape(-1), out.reshape(-1)
    k = start
    for i in range(flat.size):
        value = flat[i] + noise[k]
        to[i] = np.uint8(min(max(value, 0.0), 255.0))
        k += 1
        if k == noise.size:
            k = 0
