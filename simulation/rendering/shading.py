"""Light, texture and shadow of each pixel: what the buffer's triangle looks like there, or the sky."""

import math

import numpy as np

from messages.message import Float32, Float64, Int32, UInt8
from simulation.rendering.raster import painted
from simulation.rendering.textures import CLOUD, GRAIN, GRASS, LEVELS, SIDE, UNIT, Int8

FURTHEST = LEVELS - 1
SHADOW_BIAS_M, OFF_M = 0.04, 0.06  # along the sun and off the surface: about a cell of the sun's picture
BLOCK = 8  # columns between which the sky is blended
WOODS_M, MEADOWS_M = 350.0, 500.0  # how far off they count as being
SOFT = 0.45  # of the ambient light is left where something stands close above the ground


@painted
def sample(planes: UInt8, which: int, u: float, v: float, step: float) -> float:
    """A texture at (u, v) in texels of its finest level, seen with pixels of `step` texels."""
    side, start, level = SIDE, 0, 0
    while step > 1.4 and level < FURTHEST:
        start += side * side
        side >>= 1
        u *= 0.5
        v *= 0.5
        step *= 0.5
        level += 1
    i, j = math.floor(u), math.floor(v)
    f, g = u - i, v - j
    mask = side - 1
    a, b = start + (j & mask) * side, start + ((j + 1) & mask) * side
    i, k = i & mask, (i + 1) & mask
    low = planes[which, a + i] * (1.0 - f) + planes[which, a + k] * f
    high = planes[which, b + i] * (1.0 - f) + planes[which, b + k] * f
    return float((low * (1.0 - g) + high * g) * (1.0 / UNIT))


@painted
def far_color(
    dx: float, dy: float, dz: float, light: Float64, skyline: Float64, planes: UInt8, height_m: float, pixel: float
) -> tuple[float, float, float]:
    """What is seen low in a direction where nothing near stands: meadows to the horizon, woods far off, or the sky."""
    flat = max(math.sqrt(dx * dx + dy * dy), 1e-6)
    rise = dz / flat
    haze_r, haze_g, haze_b = 0.8 * light[12], 0.8 * light[13], 0.8 * light[14]
    if rise < 0.0:
        z = min(max(height_m, 0.5) / -rise, MEADOWS_M)
        u, v = z * dx / flat, z * dy / flat
        t = sample(planes, GRASS, 2.0 * u, 2.0 * v, 3.0 * z * pixel) * sample(
            planes, CLOUD, 0.6 * u, 0.6 * v, z * pixel
        )
        near = math.exp(-z / light[16])
        red, green, blue, lit = 0.115 * t, 0.138 * t, 0.04 * t, light[2]
    else:
        place = (math.atan2(dy, dx) / (2.0 * math.pi) + 0.5) * skyline.shape[0]
        k = int(place)
        low, high = skyline[k % skyline.shape[0]], skyline[(k + 1) % skyline.shape[0]]
        edge = low + (place - k) * (high - low)
        if rise >= edge:
            return sky_color(dx, dy, dz, light, planes)
        # crowns in the light, and dark below them
        t = sample(planes, GRAIN, 1.3 * place, 420.0 * rise, 420.0 * pixel) * (0.5 + 0.6 * rise / edge)
        near = math.exp(-WOODS_M / light[16])
        red, green, blue, lit = 0.045 * t, 0.070 * t, 0.030 * t, 0.5 * light[2]
    return (
        haze_r + near * (red * (light[6] + lit * light[3]) - haze_r),
        haze_g + near * (green * (light[7] + lit * light[4]) - haze_g),
        haze_b + near * (blue * (light[8] + lit * light[5]) - haze_b),
    )


@painted
def sky_color(dx: float, dy: float, dz: float, light: Float64, planes: UInt8) -> tuple[float, float, float]:
    """The sky in a direction: from horizon to zenith, clouds, and the sun with what shines around it."""
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


@painted
def sunlit(x: float, y: float, z: float, S: Float64, shadow: Float32) -> float:
    """Share of the sun that reaches a point: the four nearest cells of the sun's own picture, blended.

    `S` (3, 4) takes a point in `map` to column, row and w of that picture.
    """
    size = shadow.shape[0]
    u = S[0, 0] * x + S[0, 1] * y + S[0, 2] * z + S[0, 3]
    v = S[1, 0] * x + S[1, 1] * y + S[1, 2] * z + S[1, 3]
    w = S[2, 0] * x + S[2, 1] * y + S[2, 2] * z + S[2, 3] + SHADOW_BIAS_M
    i, j = math.floor(u), math.floor(v)
    if i < 0 or j < 0 or i >= size - 1 or j >= size - 1:
        return 1.0
    f, g = u - i, v - j
    a = (1.0 - f) * (shadow[j, i] < w) + f * (shadow[j, i + 1] < w)
    b = (1.0 - f) * (shadow[j + 1, i] < w) + f * (shadow[j + 1, i + 1] < w)
    return float(a * (1.0 - g) + b * g)


@painted
def open_sky(kind: int, x: float, y: float, z: float, roof: Float64, feet: Float64) -> float:
    """Share of the sky that is left at a point: less below a roof, least in its middle, and where somebody stands.

    `roof` low x, y, high x, y and height; `feet` (F, 3) x, y and one over the square of a radius.
    """
    share = 1.0
    inside = min(min(x - roof[0], roof[2] - x), min(y - roof[1], roof[3] - y))
    if inside > 0.0 and z < roof[4]:
        share = 0.18 + 0.82 * math.exp(-inside / 1.5)
    if 1 <= kind <= 3:
        for k in range(feet.shape[0]):
            d2 = ((x - feet[k, 0]) ** 2 + (y - feet[k, 1]) ** 2) * feet[k, 2]
            if d2 < 9.0:
                share *= 1.0 - SOFT / (1.0 + d2 + d2 * d2)
    return share


@painted
def grain_of(kind: int, x: float, y: float, z: float, wide: float, planes: UInt8, layers: Float64) -> float:
    """What the texture of a material multiplies the colour with at a point, seen with pixels `wide` metres wide."""
    grain = 1.0
    for k in range(2):
        if layers[kind, k, 0] < 0.0:
            break
        scale = layers[kind, k, 1]
        u = scale * (x + layers[kind, k, 2] * (y + z))
        v = scale * layers[kind, k, 4] * (z + layers[kind, k, 3] * (y - 0.4 * x))
        value = sample(planes, int(layers[kind, k, 0]), u, v, scale * wide)
        grain *= max(1.0 + layers[kind, k, 5] * (value - 1.0), 0.08)
    return grain


@painted
def shade(
    bgr: UInt8, w: Float32, owner: Int32, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32,
    materials: UInt8, R: Float64, origin: Float64, intrinsics: Float64, light: Float64, skyline: Float64,
    planes: UInt8, layers: Float64, shadow: Float32, S: Float64, feet: Float64, roof: Float64, ground_m: float,
    gain: float, curve: UInt8, step: int,
) -> float:  # fmt: skip
    """Paint every `step`-th row and column of `bgr` (H, W, 3); gives the mean brightness, 1 where it is clipped.

    `R`, `origin`, `intrinsics` as of `project`; `light` as `Light.packed`; `layers` as `texture_layers`; `shadow`, `S`
    as of `sunlit`; `feet`, `roof` as of `open_sky`; `ground_m` is the height of the land far off; `curve` (4096,) takes
    brightness times `gain` to grey levels. One long loop: as functions of their own its parts take twice the time.
    """
    height, width = w.shape
    fx, fy, cx, cy = intrinsics
    pixel, block, clear = 1.0 / fx, max(BLOCK, step), skyline.max() + 0.01
    ox, oy, oz = origin
    sun_x, sun_y, sun_z, sun_r, sun_g, sun_b = light[0], light[1], light[2], light[3], light[4], light[5]
    sky_r, sky_g, sky_b = light[6], light[7], light[8]
    haze_r, haze_g, haze_b, per_haze = 0.8 * light[12], 0.8 * light[13], 0.8 * light[14], 1.0 / light[16]
    # the ground gives back a fifth of what falls on it, least of the blue
    back_r, back_g, back_b = (
        0.20 * (sky_r + sun_z * sun_r),
        0.17 * (sky_g + sun_z * sun_g),
        0.12 * (sky_b + sun_z * sun_b),
    )
    total, count, last, kind = 0.0, 0, -1, 0
    corner, to_normal, to_color, to_whole = np.zeros((6, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    ends = np.zeros((2, 3))
    for y in range(0, height, step):
        v = (y - cy) / fy
        row_x, row_y, row_z = R[1, 0] * v + R[2, 0], R[1, 1] * v + R[2, 1], R[1, 2] * v + R[2, 2]
        for x0 in range(0, width, block):
            middle = (x0 + 0.5 * block - cx) / fx
            per_length = 1.0 / math.sqrt(middle * middle + v * v + 1.0)
            is_known = False
            for x in range(x0, min(x0 + block, width), step):
                u = (x - cx) / fx
                dx, dy, dz = R[0, 0] * u + row_x, R[0, 1] * u + row_y, R[0, 2] * u + row_z
                value = w[y, x]
                if value > 0.0:
                    t = owner[y, x]
                    if t != last:
                        last, kind = t, materials[t]
                        span(t, vertices, normals, colors, triangles, origin, corner, to_normal, to_color, to_whole)
                    z = 1.0 / value
                    px, py, pz = ox + dx * z, oy + dy * z, oz + dz * z
                    nx = to_normal[0, 0] * dx + to_normal[0, 1] * dy + to_normal[0, 2] * dz
                    ny = to_normal[1, 0] * dx + to_normal[1, 1] * dy + to_normal[1, 2] * dz
                    nz = to_normal[2, 0] * dx + to_normal[2, 1] * dy + to_normal[2, 2] * dz
                    size = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
                    facing = -(nx * dx + ny * dy + nz * dz) * per_length / size
                    if facing < 0.0:  # seen from behind
                        size, facing = -size, -facing
                    size = 1.0 / size
                    nx, ny, nz = nx * size, ny * size, nz * size
                    foot = z * pixel
                    # the ground lies flat: along the view a pixel covers more of it
                    wide = foot if kind > 3 else foot * min(1.0 / math.sqrt(facing + 1e-3), 5.0)
                    grain = grain_of(kind, px, py, pz, wide, planes, layers)
                    if kind == 6 and foot < 0.05:  # corrugated sheet
                        grain *= 0.85 + 0.15 * math.cos(35.0 * (py * nx - px * ny))
                    cosine = nx * sun_x + ny * sun_y + nz * sun_z
                    if kind == 4:
                        cosine = 0.35 + 0.65 * abs(cosine)  # leaves let light through
                    direct = 0.0
                    if cosine > 0.0:
                        direct = grain * cosine * sunlit(px + OFF_M * nx, py + OFF_M * ny, pz + OFF_M * nz, S, shadow)
                    free = open_sky(kind, px, py, pz, roof, feet)
                    up, back = grain * free * (0.5 + 0.5 * nz), grain * free * (0.5 - 0.5 * nz)
                    share = 1.0 / (to_whole[0] * dx + to_whole[1] * dy + to_whole[2] * dz + 1e-12)
                    r = max((to_color[0, 0] * dx + to_color[0, 1] * dy + to_color[0, 2] * dz) * share, 0.0)
                    g = max((to_color[1, 0] * dx + to_color[1, 1] * dy + to_color[1, 2] * dz) * share, 0.0)
                    b = max((to_color[2, 0] * dx + to_color[2, 1] * dy + to_color[2, 2] * dz) * share, 0.0)
                    r *= direct * sun_r + up * sky_r + back * back_r
                    g *= direct * sun_g + up * sky_g + back * back_g
                    b *= direct * sun_b + up * sky_b + back * back_b
                    if kind == 7 or kind == 8:
                        f = 2.0 * facing
                        sx, sy, sz = dx * per_length + f * nx, dy * per_length + f * ny, dz * per_length + f * nz
                        sr, sg, sb = far_color(sx, sy, sz, light, skyline, planes, 2.0, 0.02)
                        shine = 0.05 + 0.6 * (1.0 - facing) ** 4
                        if kind == 8:
                            shine = 0.12 + 0.7 * (1.0 - facing) ** 3
                        shine *= free
                        r += shine * (min(sr, 2.0) - r)
                        g += shine * (min(sg, 2.0) - g)
                        b += shine * (min(sb, 2.0) - b)
                    far = z * per_haze
                    near = 1.0 / (1.0 + far + 0.5 * far * far)
                    r, g, b = haze_r + near * (r - haze_r), haze_g + near * (g - haze_g), haze_b + near * (b - haze_b)
                elif dz * per_length < clear:
                    n = 1.0 / math.sqrt(u * u + v * v + 1.0)
                    r, g, b = far_color(dx * n, dy * n, dz * n, light, skyline, planes, oz - ground_m, pixel)
                else:
                    if not is_known:
                        is_known = True
                        for k in range(2):
                            q = (x0 + k * block - cx) / fx
                            n = 1.0 / math.sqrt(q * q + v * v + 1.0)
                            ends[k, 0], ends[k, 1], ends[k, 2] = sky_color(
                                (R[0, 0] * q + row_x) * n,
                                (R[0, 1] * q + row_y) * n,
                                (R[0, 2] * q + row_z) * n,
                                light,
                                planes,
                            )
                    f = (x - x0) / block
                    r = ends[0, 0] + f * (ends[1, 0] - ends[0, 0])
                    g = ends[0, 1] + f * (ends[1, 1] - ends[0, 1])
                    b = ends[0, 2] + f * (ends[1, 2] - ends[0, 2])
                r, g, b = min(r * gain, 1.0), min(g * gain, 1.0), min(b * gain, 1.0)
                total += 0.25 * r + 0.6 * g + 0.15 * b
                count += 1
                bgr[y, x, 0] = curve[int(b * 4095.0)]
                bgr[y, x, 1] = curve[int(g * 4095.0)]
                bgr[y, x, 2] = curve[int(r * 4095.0)]
    return total / count


@painted
def span(
    t: int, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32, origin: Float64, corner: Float64,
    to_normal: Float64, to_color: Float64, to_whole: Float64,
) -> None:  # fmt: skip
    """What takes a direction to normal and colour on a triangle, both times what `to_whole` gives.

    The share of a corner in a direction is the volume that the direction spans with the two others. `corner` (6, 3)
    is room to reckon in.
    """
    for i in range(3):
        for j in range(3):
            corner[i, j] = vertices[triangles[t, i], j] - origin[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        corner[3 + i, 0] = corner[j, 1] * corner[k, 2] - corner[j, 2] * corner[k, 1]
        corner[3 + i, 1] = corner[j, 2] * corner[k, 0] - corner[j, 0] * corner[k, 2]
        corner[3 + i, 2] = corner[j, 0] * corner[k, 1] - corner[j, 1] * corner[k, 0]
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    for j in range(3):
        to_whole[j] = corner[3, j] + corner[4, j] + corner[5, j]
        for i in range(3):
            to_normal[i, j] = normals[a, i] * corner[3, j] + normals[b, i] * corner[4, j] + normals[c, i] * corner[5, j]
            to_color[i, j] = colors[a, i] * corner[3, j] + colors[b, i] * corner[4, j] + colors[c, i] * corner[5, j]


@painted
def add_noise(bgr: UInt8, noise: Int8, start: int, out: UInt8) -> None:
    """`bgr` with a stretch of prepared noise laid over it from `start`, grey levels, into `out`."""
    flat, to, over = bgr.reshape(-1), out.reshape(-1), noise[start:]
    for i in range(flat.size):
        level = np.int16(flat[i]) + np.int16(over[i])
        to[i] = np.uint8(min(max(level, np.int16(0)), np.int16(255)))
