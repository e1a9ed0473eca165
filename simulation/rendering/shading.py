"""Light, texture and shadow of each pixel: what the buffer's triangle looks like there, or what lies far off.

A row of the picture is painted in runs of one triangle: within a run nearly everything grows evenly from column to
column, but for the depth that it is multiplied with.
"""

import math

import numpy as np

from geometry.jit import inline_kernel, kernel
from messages.message import Float32, Float64, Int32, UInt8
from simulation.rendering.skybox import far_run, place_of
from simulation.rendering.textures import Int8, coarse, nearest

SHADOW_BIAS_M, OFF_M = 0.04, 0.06  # along the sun and off the surface: about a cell of the sun's picture
BLOCK = 16  # cells of the sun's picture, a side, that are looked at together
APART = 6  # columns between which light is blended
SOFT = 0.45  # of the ambient light is left where something stands close above the ground
WIDEST = 5.0  # times its width a pixel covers at most along the view
RED, SUN, NORMAL, DEPTH, FLOWS = 0, 3, 4, 7, 8
BACK = np.array([0.20, 0.17, 0.12])  # the ground gives back a fifth of what falls on it, least of the blue


@kernel
def shade(
    bgr: UInt8, owner: Int32, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32,
    materials: UInt8, R: Float64, origin: Float64, intrinsics: Float64, light: Float64, panorama: Float32,
    planes: UInt8, layers: Float64, shadow: Float32, tops: Float32, S: Float64, feet: Float64, roof: Float64,
    gain: float, curve: UInt8,
) -> float:  # fmt: skip
    """Paint `bgr` (H, W, 3); gives the mean brightness, 1 where it is clipped.

    `owner` is -1 where nothing near stands. `R`, `origin`, `intrinsics` as of `project`; `light` as `Light.packed`;
    `panorama` as of `draw_panorama`; `layers` as `texture_layers`; `shadow`, `S` as of `sunlit`; `feet`, `roof` as of
    `open_sky`; `curve` (4096,) takes brightness times `gain` to grey levels.
    """
    height, width = owner.shape
    ray, flow, room, normal = np.zeros((2, 3)), np.zeros((FLOWS, 2)), np.zeros((6, 3)), np.zeros(3)
    here, there = np.zeros(4), np.zeros(4)
    row, back = np.zeros((width, 3), np.float32), np.zeros(3)
    for k in range(3):
        back[k] = BACK[k] * (light[6 + k] + light[2] * light[3 + k])
    levels, pixel, total = np.zeros((width, 3), np.int32), 1.0 / intrinsics[0], 0
    for y in range(height):
        for k in range(3):
            ray[1, k] = R[0, k] * pixel
            ray[0, k] = R[1, k] * (y - intrinsics[3]) / intrinsics[1] + R[2, k] - ray[1, k] * intrinsics[2]
        begin = 0
        while begin < width:
            t, end = owner[y, begin], begin + 1
            while end < width and owner[y, end] == t:
                end += 1
            if t < 0:
                far_run(row, begin, end, ray, panorama)
            else:
                span(t, vertices, normals, colors, triangles, origin, ray, light, room, flow)
                kind = materials[t]
                paint_run(row, begin, end, kind, flow, ray, origin, pixel, light, back, planes, layers, shadow,
                          tops, S, feet, roof, normal, here, there)  # fmt: skip
                if kind == 7 or kind == 8:
                    shine_run(row, begin, end, kind, flow, ray, origin, roof, feet, panorama)
            begin = end
        total += develop(row, bgr[y], gain, curve, levels)
    return float(total / (16.0 * 4095.0 * height * width))


@inline_kernel
def develop(row: Float32, bgr: UInt8, gain: float, curve: UInt8, levels: Int32) -> int:
    """A row of linear colours to grey levels; gives the sum of its brightness, in 16 * 4095ths. `levels` is room."""
    total = 0
    flat, bright = row.reshape(-1), levels.reshape(-1)
    most, factor = np.float32(4095.0), np.float32(gain * 4095.0)
    for i in range(flat.size):
        level = flat[i] * factor
        bright[i] = np.int32(min(level, most)) if level > 0.0 else 0  # 0 also for what is no number
    for x in range(levels.shape[0]):
        r, g, b = levels[x, 0], levels[x, 1], levels[x, 2]
        total += 4 * r + 10 * g + 2 * b
        bgr[x, 0], bgr[x, 1], bgr[x, 2] = curve[np.uint32(b)], curve[np.uint32(g)], curve[np.uint32(r)]
    return total


@inline_kernel
def span(
    t: int, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32, origin: Float64, ray: Float64,
    light: Float64, room: Float64, flow: Float64,
) -> None:  # fmt: skip
    """How colour, cosine to the sun and normal grow along a row on a triangle: `flow` (FLOWS, 2), per depth.

    `ray` (2, 3) is the direction at column 0 and what each column adds. The share of a corner is the volume that the
    direction spans with the two others. `room` (6, 3) is there to reckon in.
    """
    for i in range(3):
        for j in range(3):
            room[i, j] = vertices[triangles[t, i], j] - origin[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        room[3 + i, 0] = room[j, 1] * room[k, 2] - room[j, 2] * room[k, 1]
        room[3 + i, 1] = room[j, 2] * room[k, 0] - room[j, 0] * room[k, 2]
        room[3 + i, 2] = room[j, 0] * room[k, 1] - room[j, 1] * room[k, 0]
    volume = room[0, 0] * room[3, 0] + room[0, 1] * room[3, 1] + room[0, 2] * room[3, 2]
    per = 1.0 / volume if abs(volume) > 1e-12 else 0.0
    for k in range(FLOWS):
        flow[k, 0], flow[k, 1] = 0.0, 0.0
    for i in range(3):
        c = triangles[t, i]
        sun = normals[c, 0] * light[0] + normals[c, 1] * light[1] + normals[c, 2] * light[2]
        for end in range(2):
            share = per * (room[3 + i, 0] * ray[end, 0] + room[3 + i, 1] * ray[end, 1] + room[3 + i, 2] * ray[end, 2])
            flow[DEPTH, end] += share
            flow[SUN, end] += share * sun
            for j in range(3):
                flow[RED + j, end] += share * colors[c, j]
                flow[NORMAL + j, end] += share * normals[c, j]


@kernel
def highest(shadow: Float32, out: Float32) -> None:
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
def open_sky(kind: int, x: float, y: float, z: float, roof: Float64, feet: Float64) -> float:
    """Share of the sky that is left at a point: less below a roof, least in its middle, and where somebody stands.

    `roof` low x, y, high x, y and height; `feet` (F, 3) x, y and one over the square of a radius.
    """
    share = 1.0
    if x > roof[0] and x < roof[2] and y > roof[1] and y < roof[3] and z < roof[4]:
        inside = min(min(x - roof[0], roof[2] - x), min(y - roof[1], roof[3] - y)) / 1.5
        share = 0.18 + 0.82 / (1.0 + inside + 0.5 * inside * inside)
    if 1 <= kind <= 3:
        for k in range(feet.shape[0]):
            d2 = ((x - feet[k, 0]) ** 2 + (y - feet[k, 1]) ** 2) * feet[k, 2]
            if d2 < 9.0:
                share *= 1.0 - SOFT / (1.0 + d2 + d2 * d2)
    return share


@inline_kernel
def turned(x: float, flow: Float64, ray: Float64, normal: Float64) -> tuple[float, float]:
    """The unit `normal` (3,) at column x on the side that is seen; gives how straight one looks at it, and its side."""
    dx, dy, dz = ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2]
    nx, ny, nz = flow[4, 0] + x * flow[4, 1], flow[5, 0] + x * flow[5, 1], flow[6, 0] + x * flow[6, 1]
    per = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
    facing = -(nx * dx + ny * dy + nz * dz) * per / math.sqrt(dx * dx + dy * dy + dz * dz)
    side = 1.0 if facing >= 0.0 else -1.0
    per *= side
    normal[0], normal[1], normal[2] = nx * per, ny * per, nz * per
    return abs(facing), side


@inline_kernel
def light_at(
    x: float, kind: int, side: float, flow: Float64, ray: Float64, origin: Float64, normal: Float64, light: Float64,
    back: Float64, shadow: Float32, tops: Float32, S: Float64, feet: Float64, roof: Float64, lit: Float64,
) -> None:  # fmt: skip
    """What a run sends to the eye from column x: `lit` (4,) red, green and blue, and the share that haze leaves."""
    z = 1.0 / max(flow[DEPTH, 0] + x * flow[DEPTH, 1], 1e-4)
    px = origin[0] + (ray[0, 0] + x * ray[1, 0]) * z
    py = origin[1] + (ray[0, 1] + x * ray[1, 1]) * z
    pz = origin[2] + (ray[0, 2] + x * ray[1, 2]) * z
    direct = side * (flow[SUN, 0] + x * flow[SUN, 1]) * z
    if kind == 4:
        direct = 0.35 + 0.65 * abs(direct)  # leaves let light through
    if direct > 0.0:
        direct *= sunlit(px + OFF_M * normal[0], py + OFF_M * normal[1], pz + OFF_M * normal[2], S, shadow, tops)
    else:
        direct = 0.0
    free, nz = open_sky(kind, px, py, pz, roof, feet), side * (flow[NORMAL + 2, 0] + x * flow[NORMAL + 2, 1]) * z
    up, down, far = free * (0.5 + 0.5 * nz), free * (0.5 - 0.5 * nz), z / light[16]
    lit[3] = 1.0 / (1.0 + far + 0.5 * far * far)
    for k in range(3):
        color = max((flow[RED + k, 0] + x * flow[RED + k, 1]) * z, 0.0)
        lit[k] = lit[3] * color * (direct * light[3 + k] + up * light[6 + k] + down * back[k])


@inline_kernel
def paint_run(
    row: Float32, begin: int, end: int, kind: int, flow: Float64, ray: Float64, origin: Float64, pixel: float,
    light: Float64, back: Float64, planes: UInt8, layers: Float64, shadow: Float32, tops: Float32,
    S: Float64, feet: Float64, roof: Float64, normal: Float64, here: Float64, there: Float64,
) -> None:  # fmt: skip
    """Columns `begin` to `end` of a row, all of one triangle, into `row` (W, 3), linear.

    The light is found every `APART` columns and blended between them. `normal` (3,), `here` and `there` (4,) are room.
    """
    middle = 0.5 * (begin + end - 1)
    facing, side = turned(middle, flow, ray, normal)
    # the ground lies flat: along the view a pixel covers more of it
    wide = pixel / max(flow[DEPTH, 0] + middle * flow[DEPTH, 1], 1e-4)
    wide *= min(1.0 / math.sqrt(facing + 1e-3), WIDEST) if 1 <= kind <= 3 else 1.0
    # a short run has the light of its middle
    parts = (end - begin - 1) // APART + 1 if end - begin >= APART else 0
    for n in range(parts + 1):
        x = min(begin + n * APART, end)
        for k in range(4):
            here[k] = there[k]
        light_at(x if parts else middle, kind, side, flow, ray, origin, normal, light, back, shadow, tops, S, feet,
                 roof, there)  # fmt: skip
        if not parts:
            x = end
            for k in range(4):
                here[k] = there[k]
        if x > begin:
            first = begin + max(n - 1, 0) * APART
            lay(row, first, x, kind, wide, flow, ray, origin, normal, light, planes, layers, here, there)


@inline_kernel
def lay(
    row: Float32, begin: int, end: int, kind: int, wide: float, flow: Float64, ray: Float64,
    origin: Float64, normal: Float64, light: Float64, planes: UInt8, layers: Float64, here: Float64, there: Float64,
) -> None:  # fmt: skip
    """A stretch of a run between the light `here` and `there`, with the fine texture on it."""
    texture, strength = int(layers[kind, 0]), layers[kind, 5]
    start, mask, scale = coarse(layers[kind, 1], wide)
    along, across, stretch = layers[kind, 2], layers[kind, 3], scale * layers[kind, 4]
    ox, oy, oz, per = origin[0], origin[1], origin[2], 1.0 / (end - begin)
    haze_r, haze_g, haze_b = 0.8 * light[12], 0.8 * light[13], 0.8 * light[14]
    for x in range(begin, end):
        z, grain = 1.0 / (flow[DEPTH, 0] + x * flow[DEPTH, 1]), 1.0
        px, py = ox + (ray[0, 0] + x * ray[1, 0]) * z, oy + (ray[0, 1] + x * ray[1, 1]) * z
        pz = oz + (ray[0, 2] + x * ray[1, 2]) * z
        if texture >= 0:
            u, v = scale * (px + along * (py + pz)), stretch * (pz + across * (py - 0.4 * px))
            grain = max(1.0 + strength * (nearest(planes, texture, start, mask, u, v) - 1.0), 0.08)
        if kind == 6 and wide < 0.05:  # corrugated sheet
            wave = 5.57 * (py * normal[0] - px * normal[1])
            wave -= math.floor(wave)
            grain *= 1.0 - 1.2 * wave * (1.0 - wave)
        f = (x - begin) * per
        veil = 1.0 - here[3] - f * (there[3] - here[3])
        row[x, 0] = veil * haze_r + grain * (here[0] + f * (there[0] - here[0]))
        row[x, 1] = veil * haze_g + grain * (here[1] + f * (there[1] - here[1]))
        row[x, 2] = veil * haze_b + grain * (here[2] + f * (there[2] - here[2]))


@inline_kernel
def shine_run(
    row: Float32, begin: int, end: int, kind: int, flow: Float64, ray: Float64,
    origin: Float64, roof: Float64, feet: Float64, panorama: Float32,
) -> None:  # fmt: skip
    """What lies far off, mirrored on paint (GLOSS) or glass."""
    least, most, power = (0.05, 0.6, 4) if kind == 7 else (0.12, 0.7, 3)
    for x in range(begin, end):
        z = 1.0 / (flow[DEPTH, 0] + x * flow[DEPTH, 1])
        dx, dy, dz = ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2]
        nx, ny, nz = flow[4, 0] + x * flow[4, 1], flow[5, 0] + x * flow[5, 1], flow[6, 0] + x * flow[6, 1]
        twice = -2.0 * (nx * dx + ny * dy + nz * dz) / (nx * nx + ny * ny + nz * nz + 1e-30)
        facing = abs(nx * dx + ny * dy + nz * dz) / math.sqrt(
            (nx * nx + ny * ny + nz * nz) * (dx * dx + dy * dy + dz * dz) + 1e-30
        )
        shine = least + most * (1.0 - facing) ** power
        shine *= open_sky(kind, origin[0] + dx * z, origin[1] + dy * z, origin[2] + dz * z, roof, feet)
        i, j = place_of(dx + twice * nx, dy + twice * ny, dz + twice * nz)
        for k in range(3):
            row[x, k] += shine * (min(panorama[i, j, k], 2.0) - row[x, k])


@kernel
def add_noise(bgr: UInt8, noise: Int8, start: int, out: UInt8) -> None:
    """`bgr` with a stretch of prepared noise laid over it from `start`, grey levels, into `out`."""
    flat, to, over = bgr.reshape(-1), out.reshape(-1), noise[start:]
    for i in range(flat.size):
        level = np.int16(flat[i]) + np.int16(over[i])
        to[i] = np.uint8(min(max(level, np.int16(0)), np.int16(255)))
