"""Compiled kernels: a lidar beam of finite width, in parts, through dust, fog and rain, and the return that it gives.

A beam is a cone whose cross-section is evenly lit; its parts lie on a spiral of equal areas, turned at random (Vogel
1979). Each part returns an equal share of the energy. Returns closer than a pulse are one, at their mean range
weighted by power; the strongest return of a beam counts, as in the usual mode of spinning lidars. Power ~ signal /
range².
"""

import math

import numpy as np

from geometry.arrays import Float32, Float64, UInt8
from geometry.jit import kernel

PARTS = 8  # rays per beam where its parts can differ
DRAWS = 7  # random numbers per beam of `strongest_returns`
MAX_PUFFS = 24  # that one beam meets
GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))
REACH = 3.0  # sigmas of a puff


@kernel
def parts_of(rays: Float32, turns: Float32, divergence: float) -> Float32:
    """Rays (N * PARTS, 6) in the beams about `rays` (N, 6); `turns` (N, 2): uniform random numbers."""
    out = np.empty((rays.shape[0] * PARTS, 6), np.float32)
    for n in range(rays.shape[0]):
        dx, dy, dz = rays[n, 3], rays[n, 4], rays[n, 5]
        flat = math.sqrt(dx * dx + dy * dy)
        ax, ay = (-dy / flat, dx / flat) if flat > 1e-6 else (1.0, 0.0)
        bx, by, bz = -dz * ay, dz * ax, dx * ay - dy * ax
        for p in range(PARTS):
            r = 0.5 * divergence * math.sqrt((p + turns[n, 0]) / PARTS)
            angle = 2.0 * math.pi * turns[n, 1] + p * GOLDEN_RAD
            u, v = r * math.cos(angle), r * math.sin(angle)
            k = n * PARTS + p
            for i in range(3):
                out[k, i] = rays[n, i]
            out[k, 3], out[k, 4], out[k, 5] = dx + u * ax + v * bx, dy + u * ay + v * by, dz + v * bz
    return out


@kernel
def is_uneven(distance: Float32, elevation: Float64) -> UInt8:
    """Rays of a sweep (rings, columns) next to an edge: 1 / range differs more than on ground of moderate slope."""
    rings, columns = distance.shape
    out = np.zeros((rings, columns), np.uint8)
    for r in range(rings):
        for k in range(columns):
            here = 1.0 / distance[r, k]
            if k + 1 < columns and abs(here - 1.0 / distance[r, k + 1]) > 0.004:
                out[r, k] = out[r, k + 1] = 1
            if r + 1 < rings:
                turn = abs(elevation[r + 1] - elevation[r])
                if abs(here - 1.0 / distance[r + 1, k]) > 0.004 + 1.2 * turn:
                    out[r, k] = out[r + 1, k] = 1
    return out


@kernel
def normal_share(x: float) -> float:
    """Share of a normal distribution below x."""
    return 0.5 * (1.0 + math.erf(x * 0.7071067811865476))


@kernel
def dust_depth(t: float, found: int, met: Float64) -> float:
    """Optical depth of the first `found` puffs up to range t; `met` (MAX_PUFFS, 3): range, sigma, depth of the line."""
    depth = 0.0
    for i in range(found):
        depth += met[i, 2] * (normal_share((t - met[i, 0]) / met[i, 1]) - normal_share(-met[i, 0] / met[i, 1]))
    return depth


@kernel
def meet_puffs(ray: Float32, puffs: Float64, met: Float64) -> int:
    """Writes the puffs that a ray meets to `met`; returns their number."""
    found = 0
    for i in range(puffs.shape[0]):
        x, y, z = puffs[i, 0] - ray[0], puffs[i, 1] - ray[1], puffs[i, 2] - ray[2]
        sigma = puffs[i, 3]
        along = x * ray[3] + y * ray[4] + z * ray[5]
        aside = x * x + y * y + z * z - along * along
        if aside < REACH * REACH * sigma * sigma and along > -REACH * sigma and found < MAX_PUFFS:
            square = sigma * sigma
            met[found, 0], met[found, 1] = along, sigma
            met[found, 2] = puffs[i, 4] / (2.0 * math.pi * square) * math.exp(-0.5 * aside / square)
            found += 1
    return found


@kernel
def strongest_returns(
    rays: Float32, distance: Float32, signal: Float32, draws: Float32, air: Float64, fog_ranges: Float32, puffs: Float64
) -> tuple[Float32, Float32]:
    """Range (infinite: none) and signal of the strongest return of each beam (N, 6), (N,) each.

    `distance`, `signal` (N, S): of its parts, each with the signal of the whole beam. `draws` (N, DRAWS): uniform,
    exponential (fog); exponential, exponential (rain); uniform, exponential, normal (dust). `air` as packed by
    `simulation.environment.media`; `puffs` as in `DustClouds`.
    """
    n, parts = distance.shape
    out, strength = np.full(n, np.inf, np.float32), np.zeros(n, np.float32)
    at, power, met = np.empty(parts + 3), np.empty(parts + 3), np.empty((MAX_PUFFS, 3))
    alpha, pulse = air[0], air[1]
    for m in range(n):
        found = meet_puffs(rays[m], puffs, met)
        count, d, depth = 0, -1.0, 0.0
        for p in range(parts):
            if distance[m, p] < np.inf:
                if distance[m, p] != d:  # parts often meet the same surface
                    d = float(distance[m, p])
                    depth = alpha * d + dust_depth(d, found, met)
                at[count], power[count] = d, signal[m, p] / parts * math.exp(-2.0 * depth) / (d * d)
                count += 1
        count = add_fog(at, power, count, draws[m], air, fog_ranges, found, met)
        count = add_rain(at, power, count, draws[m], air, found, met)
        count = add_dust(at, power, count, draws[m], air, found, met)
        best = 0.0
        for i in range(count):
            total, mean = 0.0, 0.0
            for j in range(count):
                if abs(at[j] - at[i]) < pulse:
                    total += power[j]
                    mean += power[j] * at[j]
            if total > best:
                best = total
                out[m] = mean / total
        if best > 0.0:
            strength[m] = best * out[m] * out[m]
    return out, strength


@kernel
def add_fog(
    at: Float64, power: Float64, count: int, draws: Float32, air: Float64, fog_ranges: Float32, found: int, met: Float64
) -> int:
    """Adds a return of fog; returns the number of returns."""
    if fog_ranges.shape[0] > 0:
        place = draws[0] * (fog_ranges.shape[0] - 1)
        k = min(int(place), fog_ranges.shape[0] - 2)
        r = fog_ranges[k] + (place - k) * (fog_ranges[k + 1] - fog_ranges[k])
        overlap = min(max((r - air[3]) / (air[4] - air[3]), 0.0), 1.0)
        depth = air[0] * r + dust_depth(r, found, met)
        at[count], power[count] = r, draws[1] * air[2] * overlap * math.exp(-2.0 * depth) / (r * r)
        return count + 1
    return count


@kernel
def add_rain(at: Float64, power: Float64, count: int, draws: Float32, air: Float64, found: int, met: Float64) -> int:
    """Adds the first drop in the beam, a cone from the aperture on; returns the number of returns."""
    if air[5] > 0.0:
        aperture, spread = air[8], max(air[9], 1e-6)
        wide = (12.0 * spread * draws[2] / (math.pi * air[5]) + aperture**3) ** (1.0 / 3.0)
        r = max((wide - aperture) / spread, 0.1)
        drop = air[7] + air[6] * draws[3]
        share = min((drop / wide) ** 2, 1.0)
        overlap = min(max((r - air[3]) / (air[4] - air[3]), 0.0), 1.0)
        depth = air[0] * r + dust_depth(r, found, met)
        # cross-section over the lidar ratio, against 1 / pi of a white target of the same area
        at[count], power[count] = r, 2.0 * math.pi / air[10] * share * overlap * math.exp(-2.0 * depth) / (r * r)
        return count + 1
    return count


@kernel
def add_dust(at: Float64, power: Float64, count: int, draws: Float32, air: Float64, found: int, met: Float64) -> int:
    """Adds a return of dust at a place drawn in proportion to the extinction; returns the number of returns."""
    total = 0.0
    for i in range(found):
        total += met[i, 2]
    if total <= 0.0:
        return count
    rest, k = draws[4] * total, 0
    while k < found - 1 and rest > met[k, 2]:
        rest -= met[k, 2]
        k += 1
    r = met[k, 0] + met[k, 1] * draws[6]
    if r <= 0.5:
        return count
    extinction = 0.0
    for i in range(found):
        off = (r - met[i, 0]) / met[i, 1]
        extinction += met[i, 2] * math.exp(-0.5 * off * off) / (met[i, 1] * 2.5066282746310002)
    overlap = min(max((r - air[3]) / (air[4] - air[3]), 0.0), 1.0)
    depth = air[0] * r + dust_depth(r, found, met)
    target = math.pi / air[11] * extinction * air[1] * overlap * draws[5]
    at[count], power[count] = r, target * math.exp(-2.0 * depth) / (r * r)
    return count + 1
