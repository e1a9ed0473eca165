"""Shading: light, texture and shadow of each pixel from the triangle buffer, or the far background.

A row is shaded in runs of one triangle: attributes divided by depth are linear in the column.
"""

import math

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.jit import inline_kernel, kernel
from simulation.rendering.shadow import sky_visibility, sunlit
from simulation.rendering.skybox import background_run, texel_of
from simulation.rendering.textures import Int8, mip_level, nearest_texel

NORMAL_OFFSET_M = 0.06  # of a shadow test off the surface: about a cell of the shadow map
LIGHT_STEP_PX = 6  # columns between computed light values
MAX_FOOTPRINT_RATIO = 5.0  # largest length to width of a pixel on the ground
RED, SUN, NORMAL, DEPTH, ATTRIBUTES = 0, 3, 4, 7, 8
GROUND_ALBEDO = np.array([0.20, 0.17, 0.12])  # a fifth of the incident light, least of blue


@kernel
def shade(
    bgr: UInt8, triangle_ids: Int32, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32,
    materials: UInt8, R: Float64, origin: Float64, intrinsics: Float64, light: Float64, panorama: Float32,
    planes: UInt8, layers: Float64, shadow: Float32, shadow_max: Float32, S: Float64, occluders: Float64, roof: Float64,
    gain: float, curve: UInt8,
) -> float:  # fmt: skip
    """Shades `bgr` (H, W, 3); returns the mean brightness, 1 where clipped.

    `triangle_ids` is -1 in the background. `R`, `origin`, `intrinsics` as in `project`; `light` as in `Light.packed`;
    `panorama` as in `render_panorama`; `layers` as in `texture_table`; `shadow`, `S` as in `sunlit`; `occluders`,
    `roof` as in `sky_visibility`; `curve` (4096,) maps brightness times `gain` to grey levels.
    """
    height, width = triangle_ids.shape
    ray, linear, scratch, normal = np.zeros((2, 3)), np.zeros((ATTRIBUTES, 2)), np.zeros((6, 3)), np.zeros(3)
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
                interpolate_row(t, vertices, normals, colors, triangles, origin, ray, light, scratch, linear)
                material = materials[t]
                shade_run(row, begin, end, material, linear, ray, origin, pixel, light, bounce, planes, layers, shadow,
                          shadow_max, S, occluders, roof, normal, light_left, light_right)  # fmt: skip
                if material == 7 or material == 8:
                    reflect_run(row, begin, end, material, linear, ray, origin, roof, occluders, panorama)
            begin = end
        total += tone_map(row, bgr[y], gain, curve, brightness)
    return float(total / (16.0 * 4095.0 * height * width))


@inline_kernel
def tone_map(row: Float32, bgr: UInt8, gain: float, curve: UInt8, brightness: Int32) -> int:
    """A row of linear colours to grey levels; returns the sum of 16 * 4095 * brightness. `brightness`: scratch."""
    total = 0
    flat, flat_brightness = row.reshape(-1), brightness.reshape(-1)
    most, factor = np.float32(4095.0), np.float32(gain * 4095.0)
    for i in range(flat.size):
        level = flat[i] * factor
        flat_brightness[i] = np.int32(min(level, most)) if level > 0.0 else 0  # NaN becomes 0
    for x in range(brightness.shape[0]):
        r, g, b = brightness[x, 0], brightness[x, 1], brightness[x, 2]
        total += 4 * r + 10 * g + 2 * b
        bgr[x, 0], bgr[x, 1], bgr[x, 2] = curve[np.uint32(b)], curve[np.uint32(g)], curve[np.uint32(r)]
    return total


@inline_kernel
def interpolate_row(
    t: int, vertices: Float32, normals: Float32, colors: Float32, triangles: Int32, origin: Float64, ray: Float64,
    light: Float64, scratch: Float64, linear: Float64,
) -> None:  # fmt: skip
    """Colour, cosine to the sun and normal along a row of a triangle, per depth: `linear` (ATTRIBUTES, 2).

    `linear` and `ray` (2, 3) hold the value at column 0 and the change per column. The share of a corner is the volume
    spanned by the ray and the two other corners. `scratch` (6, 3).
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
        linear[k, 0], linear[k, 1] = 0.0, 0.0
    for i in range(3):
        c = triangles[t, i]
        sun = normals[c, 0] * light[0] + normals[c, 1] * light[1] + normals[c, 2] * light[2]
        for end in range(2):
            share = inverse * (
                scratch[3 + i, 0] * ray[end, 0] + scratch[3 + i, 1] * ray[end, 1] + scratch[3 + i, 2] * ray[end, 2]
            )
            linear[DEPTH, end] += share
            linear[SUN, end] += share * sun
            for j in range(3):
                linear[RED + j, end] += share * colors[c, j]
                linear[NORMAL + j, end] += share * normals[c, j]


@inline_kernel
def facing_normal(x: float, linear: Float64, ray: Float64, normal: Float64) -> tuple[float, float]:
    """Writes the unit `normal` (3,) at column x, facing the viewer; returns cosine of incidence and side (1, -1)."""
    dx, dy, dz = ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2]
    nx, ny, nz = linear[4, 0] + x * linear[4, 1], linear[5, 0] + x * linear[5, 1], linear[6, 0] + x * linear[6, 1]
    inverse = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
    facing = -(nx * dx + ny * dy + nz * dz) * inverse / math.sqrt(dx * dx + dy * dy + dz * dz)
    side = 1.0 if facing >= 0.0 else -1.0
    inverse *= side
    normal[0], normal[1], normal[2] = nx * inverse, ny * inverse, nz * inverse
    return abs(facing), side


@inline_kernel
def light_at(
    x: float, material: int, side: float, linear: Float64, ray: Float64, origin: Float64, normal: Float64,
    light: Float64, bounce: Float64, shadow: Float32, shadow_max: Float32, S: Float64, occluders: Float64,
    roof: Float64, light_out: Float64,
) -> None:  # fmt: skip
    """Light towards the camera from column x: `light_out` (4,) red, green, blue, and the transmission of the haze."""
    z = 1.0 / max(linear[DEPTH, 0] + x * linear[DEPTH, 1], 1e-4)
    px = origin[0] + (ray[0, 0] + x * ray[1, 0]) * z
    py = origin[1] + (ray[0, 1] + x * ray[1, 1]) * z
    pz = origin[2] + (ray[0, 2] + x * ray[1, 2]) * z
    direct = side * (linear[SUN, 0] + x * linear[SUN, 1]) * z
    if material == 4:
        direct = 0.35 + 0.65 * abs(direct)  # leaves transmit light
    if direct > 0.0:
        direct *= sunlit(
            px + NORMAL_OFFSET_M * normal[0],
            py + NORMAL_OFFSET_M * normal[1],
            pz + NORMAL_OFFSET_M * normal[2],
            S,
            shadow,
            shadow_max,
        )
    else:
        direct = 0.0
    free, nz = (
        sky_visibility(material, px, py, pz, roof, occluders),
        side * (linear[NORMAL + 2, 0] + x * linear[NORMAL + 2, 1]) * z,
    )
    up, down, far = free * (0.5 + 0.5 * nz), free * (0.5 - 0.5 * nz), z / light[16]
    light_out[3] = 1.0 / (1.0 + far + 0.5 * far * far)
    for k in range(3):
        color = max((linear[RED + k, 0] + x * linear[RED + k, 1]) * z, 0.0)
        light_out[k] = light_out[3] * color * (direct * light[3 + k] + up * light[6 + k] + down * bounce[k])


@inline_kernel
def shade_run(
    row: Float32, begin: int, end: int, material: int, linear: Float64, ray: Float64, origin: Float64, pixel: float,
    light: Float64, bounce: Float64, planes: UInt8, layers: Float64, shadow: Float32, shadow_max: Float32,
    S: Float64, occluders: Float64, roof: Float64, normal: Float64, light_left: Float64, light_right: Float64,
) -> None:  # fmt: skip
    """Shades columns `begin` to `end` of a row, all of one triangle, into `row` (W, 3), linear.

    Light is computed every `LIGHT_STEP_PX` columns and interpolated. `normal` (3,), `light_left`, `light_right` (4,):
    scratch.
    """
    middle = 0.5 * (begin + end - 1)
    facing, side = facing_normal(middle, linear, ray, normal)
    # a pixel covers more of the ground at grazing incidence
    pixel_m = pixel / max(linear[DEPTH, 0] + middle * linear[DEPTH, 1], 1e-4)
    pixel_m *= min(1.0 / math.sqrt(facing + 1e-3), MAX_FOOTPRINT_RATIO) if 1 <= material <= 3 else 1.0
    # a short run takes the light of its centre
    parts = (end - begin - 1) // LIGHT_STEP_PX + 1 if end - begin >= LIGHT_STEP_PX else 0
    for n in range(parts + 1):
        x = min(begin + n * LIGHT_STEP_PX, end)
        for k in range(4):
            light_left[k] = light_right[k]
        light_at(x if parts else middle, material, side, linear, ray, origin, normal, light, bounce, shadow, shadow_max,
                 S, occluders, roof, light_right)  # fmt: skip
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
                material,
                pixel_m,
                linear,
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
    row: Float32, begin: int, end: int, material: int, pixel_m: float, linear: Float64, ray: Float64,
    origin: Float64, normal: Float64, light: Float64, planes: UInt8, layers: Float64, light_left: Float64,
    light_right: Float64,
) -> None:  # fmt: skip
    """Part of a run between the light at its left and right end, with texture."""
    texture, strength = int(layers[material, 0]), layers[material, 5]
    start, mask, scale = mip_level(layers[material, 1], pixel_m)
    along, across, stretch = layers[material, 2], layers[material, 3], scale * layers[material, 4]
    ox, oy, oz, inverse = origin[0], origin[1], origin[2], 1.0 / (end - begin)
    haze_r, haze_g, haze_b = 0.8 * light[12], 0.8 * light[13], 0.8 * light[14]
    for x in range(begin, end):
        z, texture_value = 1.0 / (linear[DEPTH, 0] + x * linear[DEPTH, 1]), 1.0
        px, py = ox + (ray[0, 0] + x * ray[1, 0]) * z, oy + (ray[0, 1] + x * ray[1, 1]) * z
        pz = oz + (ray[0, 2] + x * ray[1, 2]) * z
        if texture >= 0:
            u, v = scale * (px + along * (py + pz)), stretch * (pz + across * (py - 0.4 * px))
            texture_value = max(1.0 + strength * (nearest_texel(planes, texture, start, mask, u, v) - 1.0), 0.08)
        if material == 6 and pixel_m < 0.05:  # corrugated sheet
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
    row: Float32, begin: int, end: int, material: int, linear: Float64, ray: Float64,
    origin: Float64, roof: Float64, occluders: Float64, panorama: Float32,
) -> None:  # fmt: skip
    """Adds the reflection of the background on paint (GLOSS) or glass."""
    least, most, power = (0.05, 0.6, 4) if material == 7 else (0.12, 0.7, 3)
    for x in range(begin, end):
        z = 1.0 / (linear[DEPTH, 0] + x * linear[DEPTH, 1])
        dx, dy, dz = ray[0, 0] + x * ray[1, 0], ray[0, 1] + x * ray[1, 1], ray[0, 2] + x * ray[1, 2]
        nx, ny, nz = linear[4, 0] + x * linear[4, 1], linear[5, 0] + x * linear[5, 1], linear[6, 0] + x * linear[6, 1]
        twice = -2.0 * (nx * dx + ny * dy + nz * dz) / (nx * nx + ny * ny + nz * nz + 1e-30)
        facing = abs(nx * dx + ny * dy + nz * dz) / math.sqrt(
            (nx * nx + ny * ny + nz * nz) * (dx * dx + dy * dy + dz * dz) + 1e-30
        )
        shine = least + most * (1.0 - facing) ** power
        shine *= sky_visibility(material, origin[0] + dx * z, origin[1] + dy * z, origin[2] + dz * z, roof, occluders)
        i, j = texel_of(dx + twice * nx, dy + twice * ny, dz + twice * nz)
        for k in range(3):
            row[x, k] += shine * (min(panorama[i, j, k], 2.0) - row[x, k])


@kernel
def add_noise(bgr: UInt8, noise: Int8, start: int, out: UInt8) -> None:
    """`bgr` plus prepared noise from `start`, grey levels, into `out`."""
    flat, to, over = bgr.reshape(-1), out.reshape(-1), noise[start:]
    for i in range(flat.size):
        level = np.int16(flat[i]) + np.int16(over[i])
        to[i] = np.uint8(min(max(level, np.int16(0)), np.int16(255)))
