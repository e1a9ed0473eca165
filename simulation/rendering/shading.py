"""Light, texture and shadow of each pixel: what the buffer's triangle looks like there, or what lies far off.

A row of the picture is painted in runs of one triangle: within a run nearly everything grows evenly from column to
column, but for the depth that it is multiplied with.
"""

import math

import numpy as np

from geometry.jit import inline_kernel, kernel
from messages.message import Float32, Float64, Int32, UInt8
from simulation.rendering.skybox import background_run, texel_of
from simulation.rendering.textures import Int8, mip_level, nearest_texel

SHADOW_BIAS_M, NORMAL_OFFSET_M = 0.04, 0.06  # along the sun and off the surface: about a cell of the sun's picture
BLOCK = 16  # cells of the sun's picture, a side, that are looked at together
LIGHT_STEP_PX = 6  # columns between which light is blended
AMBIENT_OCCLUSION = 0.45  # of the ambient light is left where something stands close above the ground
MAX_FOOTPRINT_RATIO = 5.0  # times its width a pixel covers at most along the view
RED, SUN, NORMAL, DEPTH, ATTRIBUTES = 0, 3, 4, 7, 8
GROUND_ALBEDO = np.array([0.20, 0.17, 0.12])  # the ground gives back a fifth of what falls on it, least of the blue


@kernel
def shade(
    bgr: UInt8, triangle_ids: Int32, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32,
    materials: UInt8, R: Float64, origin: Float64, intrinsics: Float64, light: Float64, panorama: Float32,
    planes: UInt8, layers: Float64, shadow: Float32, tops: Float32, S: Float64, occluders: Float64, roof: Float64,
    gain: float, curve: UInt8,
) -> float:  # fmt: skip
    """Paint `bgr` (H, W, 3); gives the mean brightness, 1 where it is clipped.

    `owner` is -1 where nothing near stands. `R`, `origin`, `intrinsics` as of `project`; `light` as `Light.packed`;
    `panorama` as of `draw_panorama`; `layers` as `texture_layers`; `shadow`, `S` as of `sunlit`; `feet`, `roof` as of
    `open_sky`; `curve` (4096,) takes brightness times `gain` to grey levels.
    """
    height, width = triangle_ids.shape
    ray, slopes, scratch, normal = np.zeros((2, 3)), np.zeros((ATTRIBUTES, 2)), np.zeros((6, 3)), np.zeros(3)
    light_left, light_right = np.zeros(4), np.zeros(4)
    row, bounce = np.zeros((width, 3), np.float32), np.zeros(3)
    for k in range(3):
        bounce[k] = GROUND_ALBEDO[k] * (light[6 + k] + light[2] * light[3 + k])
    brightness, pixel, total = np.zeros((width, 3), np.int32), 1.0 / intrinsics[0], 0
    for y in range(height):
        for k in range(3):
            ray[1, k] = R[0, k] * pixel
            ray[0, k] = R[1, k] * (y - intrinsics[3]) / intrinsics[1] + R[2, k] - ray[1, k] * intrinsics[2]
        begin = 0
        while begin < width:
            t, end = triangle_ids[y, begin], begin + 1
            while end < width and triangle_ids[y, end] == t:
                end += 1
            if t < 0:
                background_run(row, begin, end, ray, panorama)
            else:
                interpolate_row(t, vertices, normals, colors, triangles, origin, ray, light, scratch, slopes)
                kind = materials[t]
                shade_run(row, begin, end, kind, slopes, ray, origin, pixel, light, bounce, planes, layers, shadow,
                          tops, S, occluders, roof, normal, light_left, light_right)  # fmt: skip
                if kind == 7 or kind == 8:
                    reflect_run(row, begin, end, kind, slopes, ray, origin, roof, occluders, panorama)
            begin = end
        total += tone_map(row, bgr[y], gain, curve, brightness)
    return float(total / (16.0 * 4095.0 * height * width))


@inline_kernel
def tone_map(row: Float32, bgr: UInt8, gain: float, curve: UInt8, brightness: Int32) -> int:
    """A row of linear colours to grey levels; gives the sum of its brightness, in 16 * 4095ths. `levels` is room."""
    total = 0
    flat, flat_brightness = row.reshape(-1), brightness.reshape(-1)
    most, factor = np.float32(4095.0), np.float32(gain * 4095.0)
    for i in range(flat.size):
        level = flat[i] * factor
        flat_brightness[i] = np.int32(min(level, most)) if level > 0.0 else 0  # 0 also for what is no number
    for x in range(brightness.shape[0]):
        r, g, b = brightness[x, 0], brightness[x, 1], brightness[x, 2]
        total += 4 * r + 10 * g + 2 * b
        bgr[x, 0], bgr[x, 1], bgr[x, 2] = curve[np.uint32(b)], curve[np.uint32(g)], curve[np.uint32(r)]
    return total


@inline_kernel
def interpolate_row(
    t: int, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32, origin: Float64, ray: Float64,
    light: Float64, scratch: Float64, slopes: Float64,
) -> None:  # fmt: skip
    """How colour, cosine to the sun and normal grow along a row on a triangle: `flow` (FLOWS, 2), per depth.

    `ray` (2, 3) is the direction at column 0 and what each column adds. The share of a corner is the volume that the
    direction spans with the two others. `room` (6, 3) is there to reckon in.
    """
    for i in range(3):
        for j in range(3):
            scratch[i, j] = vertices[triangles[t, i], j] - origin[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        scratch[3 + i, 0] = scratch[j, 1] * scratch[k, 2] - scratch[j, 2] * scratch[k, 1]
        scratch[3 + i, 1] = scratch[j, 2] * scratch[k, 0] - scratch[j, 0] * scratch[k, 2]
        scratch[3 + i, 2] = scratch[j, 0] * scratch[k, 1] - scratch[j, 1] * scratch[k, 0]
    volume = scratch[0, 0] * scratch[3, 0] + scratch[0, 1] * scratch[3, 1] + scratch[0, 2] * scratch[3, 2]
    inverse = 1.0 / volume if abs(volume) > 1e-12 else 0.0
    for k in range(ATTRIBUTES):
        slopes[k, 0], slopes[k, 1] = 0.0, 0.0
    for i in range(3):
        c = triangles[t, i]
        sun = normals[c, 0] * light[0] + normals[c, 1] * light[1] + normals[c, 2] * light[2]
        for end in range(2):
            share = inverse * (
                scratch[3 + i, 0] * ray[end, 0] + scratch[3 + i, 1] * ray[end, 1] + scratch[3 + i, 2] * ray[end, 2]
            )
            slopes[DEPTH, end] += share
            slopes[SUN, end] += share * sun
            for j in range(3):
                slopes[RED + j, end] += share * colors[c, j]
                slopes[NORMAL + j, end] += share * normals[c, j]


@kernel
def block_maxima(shadow: Float32, out: Float32) -> None:
    """The greatest value of each BLOCK x BLOCK cells of the sun's picture, and of the next column and row."""
    out[:] = 0.0
    for j in range(shadow.shape[0]):
        for i in range(shadow.shape[1]):
            if shadow[j, i] > 0.0:
                for n in range(max(j - 1, 0) // BLOCK, j // BLOCK + 1):
                    for m in range(max(i - 1, 0) // BLOCK, i // BLOCK + 1):
                        out[n, m] = max(out[n, m], shadow[j, i])


@inline_kernel
def sunlit(x: float, y: float, z: float, S: Float64, shadow: Float32, tops: Float32) -> float:
    """Share of the sun that reaches a point: the four nearest cells of the sun's own picture, blended.

    `S` (3, 4) takes a point in `map` to column, row and w of that picture; `tops` as of `highest`.
    """
    limit = shadow.shape[0] - 1
    u = S[0, 0] * x + S[0, 1] * y + S[0, 2] * z + S[0, 3]
    v = S[1, 0] * x + S[1, 1] * y + S[1, 2] * z + S[1, 3]
    if not (0.0 <= u < limit and 0.0 <= v < limit):
        return 1.0
    w = S[2, 0] * x + S[2, 1] * y + S[2, 2] * z + S[2, 3] + SHADOW_BIAS_M
    i, j = np.uint32(u), np.uint32(v)
    if tops[j // BLOCK, i // BLOCK] < w:
        return 1.0
    f, g = u - i, v - j
    a = (1.0 - f) * (shadow[j, i] < w) + f * (shadow[j, i + 1] < w)
    b = (1.0 - f) * (shadow[j + 1, i] < w) + f * (shadow[j + 1, i + 1] < w)
    return float(a * (1.0 - g) + b * g)


@inline_kernel
def sky_visibility(kind: int, x: float, y: float, z: float, roof: Float64, occluders: Float64) -> float:
    """Share of the sky that is left at a point: less below a roof, least in its middle, and where somebody stands.

    `roof` low x, y, high x, y and height; `feet` (F, 3) x, y and one over the square of a radius.
    """
    share = 1.0
    if x > roof[0] and x < roof[2] and y > roof[1] and y < roof[3] and z < roof[4]:
        inside = min(min(x - roof[0], roof[2] - x), min(y - roof[1], roof[3] - y)) / 1.5
        share = 0.18 + 0.82 / (1.0 + inside + 0.5 * inside * inside)
    if 1 <= kind <= 3:
        for k in range(occluders.shape[0]):
            d2 = ((x - occluders[k, 0]) ** 2 + (y - occluders[k, 1]) ** 2) * occluders[k, 2]
            if d2 < 9.0:
                share *= 1.0 - AMBIENT_OCCLUSION / (1.0 + d2 + d2 * d2)
    return share


@inline_kernel
def facing_normal(x: float, slopes: Float64, ray: Float64, normal: Float64) -> tuple[float, float]:
    """The unit `normal` (3,) at column x on the side that is seen; gives how straight one looks at it, and its side."""
    dx, dy, dz = ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2]
    nx, ny, nz = slopes[4, 0] + x * slopes[4, 1], slopes[5, 0] + x * slopes[5, 1], slopes[6, 0] + x * slopes[6, 1]
    inverse = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
    facing = -(nx * dx + ny * dy + nz * dz) * inverse / math.sqrt(dx * dx + dy * dy + dz * dz)
    side = 1.0 if facing >= 0.0 else -1.0
    inverse *= side
    normal[0], normal[1], normal[2] = nx * inverse, ny * inverse, nz * inverse
    return abs(facing), side


@inline_kernel
def light_at(
    x: float, kind: int, side: float, slopes: Float64, ray: Float64, origin: Float64, normal: Float64, light: Float64,
    bounce: Float64, shadow: Float32, tops: Float32, S: Float64, occluders: Float64, roof: Float64, light_out: Float64,
) -> None:  # fmt: skip
    """What a run sends to the eye from column x: `lit` (4,) red, green and blue, and the share that haze leaves."""
    z = 1.0 / max(slopes[DEPTH, 0] + x * slopes[DEPTH, 1], 1e-4)
    px = origin[0] + (ray[0, 0] + x * ray[1, 0]) * z
    py = origin[1] + (ray[0, 1] + x * ray[1, 1]) * z
    pz = origin[2] + (ray[0, 2] + x * ray[1, 2]) * z
    direct = side * (slopes[SUN, 0] + x * slopes[SUN, 1]) * z
    if kind == 4:
        direct = 0.35 + 0.65 * abs(direct)  # leaves let light through
    if direct > 0.0:
        direct *= sunlit(
            px + NORMAL_OFFSET_M * normal[0],
            py + NORMAL_OFFSET_M * normal[1],
            pz + NORMAL_OFFSET_M * normal[2],
            S,
            shadow,
            tops,
        )
    else:
        direct = 0.0
    free, nz = (
        sky_visibility(kind, px, py, pz, roof, occluders),
        side * (slopes[NORMAL + 2, 0] + x * slopes[NORMAL + 2, 1]) * z,
    )
    up, down, far = free * (0.5 + 0.5 * nz), free * (0.5 - 0.5 * nz), z / light[16]
    light_out[3] = 1.0 / (1.0 + far + 0.5 * far * far)
    for k in range(3):
        color = max((slopes[RED + k, 0] + x * slopes[RED + k, 1]) * z, 0.0)
        light_out[k] = light_out[3] * color * (direct * light[3 + k] + up * light[6 + k] + down * bounce[k])


@inline_kernel
def shade_run(
    row: Float32, begin: int, end: int, kind: int, slopes: Float64, ray: Float64, origin: Float64, pixel: float,
    light: Float64, bounce: Float64, planes: UInt8, layers: Float64, shadow: Float32, tops: Float32,
    S: Float64, occluders: Float64, roof: Float64, normal: Float64, light_left: Float64, light_right: Float64,
) -> None:  # fmt: skip
    """Columns `begin` to `end` of a row, all of one triangle, into `row` (W, 3), linear.

    The light is found every `APART` columns and blended between them. `normal` (3,), `here` and `there` (4,) are room.
    """
    middle = 0.5 * (begin + end - 1)
    facing, side = facing_normal(middle, slopes, ray, normal)
    # the ground lies flat: along the view a pixel covers more of it
    texel_m = pixel / max(slopes[DEPTH, 0] + middle * slopes[DEPTH, 1], 1e-4)
    texel_m *= min(1.0 / math.sqrt(facing + 1e-3), MAX_FOOTPRINT_RATIO) if 1 <= kind <= 3 else 1.0
    # a short run has the light of its middle
    parts = (end - begin - 1) // LIGHT_STEP_PX + 1 if end - begin >= LIGHT_STEP_PX else 0
    for n in range(parts + 1):
        x = min(begin + n * LIGHT_STEP_PX, end)
        for k in range(4):
            light_left[k] = light_right[k]
        light_at(x if parts else middle, kind, side, slopes, ray, origin, normal, light, bounce, shadow, tops, S,
                 occluders, roof, light_right)  # fmt: skip
        if not parts:
            x = end
            for k in range(4):
                light_left[k] = light_right[k]
        if x > begin:
            first = begin + max(n - 1, 0) * LIGHT_STEP_PX
            apply_texture(
                row,
                first,
                x,
                kind,
                texel_m,
                slopes,
                ray,
                origin,
                normal,
                light,
                planes,
                layers,
                light_left,
                light_right,
            )


@inline_kernel
def apply_texture(
    row: Float32, begin: int, end: int, kind: int, texel_m: float, slopes: Float64, ray: Float64,
    origin: Float64, normal: Float64, light: Float64, planes: UInt8, layers: Float64, light_left: Float64,
    light_right: Float64,
) -> None:  # fmt: skip
    """A stretch of a run between the light `here` and `there`, with the fine texture on it."""
    texture, strength = int(layers[kind, 0]), layers[kind, 5]
    start, mask, scale = mip_level(layers[kind, 1], texel_m)
    along, across, stretch = layers[kind, 2], layers[kind, 3], scale * layers[kind, 4]
    ox, oy, oz, inverse = origin[0], origin[1], origin[2], 1.0 / (end - begin)
    haze_r, haze_g, haze_b = 0.8 * light[12], 0.8 * light[13], 0.8 * light[14]
    for x in range(begin, end):
        z, texture_value = 1.0 / (slopes[DEPTH, 0] + x * slopes[DEPTH, 1]), 1.0
        px, py = ox + (ray[0, 0] + x * ray[1, 0]) * z, oy + (ray[0, 1] + x * ray[1, 1]) * z
        pz = oz + (ray[0, 2] + x * ray[1, 2]) * z
        if texture >= 0:
            u, v = scale * (px + along * (py + pz)), stretch * (pz + across * (py - 0.4 * px))
            texture_value = max(1.0 + strength * (nearest_texel(planes, texture, start, mask, u, v) - 1.0), 0.08)
        if kind == 6 and texel_m < 0.05:  # corrugated sheet
            wave = 5.57 * (py * normal[0] - px * normal[1])
            wave -= math.floor(wave)
            texture_value *= 1.0 - 1.2 * wave * (1.0 - wave)
        f = (x - begin) * inverse
        veil = 1.0 - light_left[3] - f * (light_right[3] - light_left[3])
        row[x, 0] = veil * haze_r + texture_value * (light_left[0] + f * (light_right[0] - light_left[0]))
        row[x, 1] = veil * haze_g + texture_value * (light_left[1] + f * (light_right[1] - light_left[1]))
        row[x, 2] = veil * haze_b + texture_value * (light_left[2] + f * (light_right[2] - light_left[2]))


@inline_kernel
def reflect_run(
    row: Float32, begin: int, end: int, kind: int, slopes: Float64, ray: Float64,
    origin: Float64, roof: Float64, occluders: Float64, panorama: Float32,
) -> None:  # fmt: skip
    """What lies far off, mirrored on paint (GLOSS) or glass."""
    least, most, power = (0.05, 0.6, 4) if kind == 7 else (0.12, 0.7, 3)
    for x in range(begin, end):
        z = 1.0 / (slopes[DEPTH, 0] + x * slopes[DEPTH, 1])
        dx, dy, dz = ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2]
        nx, ny, nz = slopes[4, 0] + x * slopes[4, 1], slopes[5, 0] + x * slopes[5, 1], slopes[6, 0] + x * slopes[6, 1]
        twice = -2.0 * (nx * dx + ny * dy + nz * dz) / (nx * nx + ny * ny + nz * nz + 1e-30)
        facing = abs(nx * dx + ny * dy + nz * dz) / math.sqrt(
            (nx * nx + ny * ny + nz * nz) * (dx * dx + dy * dy + dz * dz) + 1e-30
        )
        shine = least + most * (1.0 - facing) ** power
        shine *= sky_visibility(kind, origin[0] + dx * z, origin[1] + dy * z, origin[2] + dz * z, roof, occluders)
        i, j = texel_of(dx + twice * nx, dy + twice * ny, dz + twice * nz)
        for k in range(3):
            row[x, k] += shine * (min(panorama[i, j, k], 2.0) - row[x, k])


@kernel
def add_noise(bgr: UInt8, noise: Int8, start: int, out: UInt8) -> None:
    """`bgr` with a stretch of prepared noise laid over it from `start`, grey levels, into `out`."""
    flat, to, over = bgr.reshape(-1), out.reshape(-1), noise[start:]
    for i in range(flat.size):
        level = np.int16(flat[i]) + np.int16(over[i])
        to[i] = np.uint8(min(max(level, np.int16(0)), np.int16(255)))
