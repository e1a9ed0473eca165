"""Shadow: share of sunlight from the shadow map, and share of the sky that is visible."""

import numpy as np

from geometry.arrays import Float32, Float64
from geometry.jit import inline_kernel, kernel

SHADOW_BIAS_M = 0.04  # along the sun: about a cell of the shadow map
BLOCK = 16  # cells a side of a block of the shadow map
AMBIENT_OCCLUSION = 0.45  # of ambient light at the foot of an actor


@kernel
def block_maxima(shadow: Float32, out: Float32) -> None:
    """Largest value of each BLOCK x BLOCK cells of the shadow map, including the next column and row."""
    out[:] = 0.0
    for j in range(shadow.shape[0]):
        for i in range(shadow.shape[1]):
            if shadow[j, i] > 0.0:
                for n in range(max(j - 1, 0) // BLOCK, j // BLOCK + 1):
                    for m in range(max(i - 1, 0) // BLOCK, i // BLOCK + 1):
                        out[n, m] = max(out[n, m], shadow[j, i])


@inline_kernel
def sunlit(x: float, y: float, z: float, S: Float64, shadow: Float32, shadow_max: Float32) -> float:
    """Share of sunlight at a point: the four nearest cells of the shadow map, blended.

    `S` (3, 4) takes a point in `map` to column, row and w of the shadow map; `shadow_max` as in `block_maxima`.
    """
    limit = shadow.shape[0] - 1
    u = S[0, 0] * x + S[0, 1] * y + S[0, 2] * z + S[0, 3]
    v = S[1, 0] * x + S[1, 1] * y + S[1, 2] * z + S[1, 3]
    if not (0.0 <= u < limit and 0.0 <= v < limit):
        return 1.0
    w = S[2, 0] * x + S[2, 1] * y + S[2, 2] * z + S[2, 3] + SHADOW_BIAS_M
    i, j = np.uint32(u), np.uint32(v)
    if shadow_max[j // BLOCK, i // BLOCK] < w:
        return 1.0
    f, g = u - i, v - j
    a = (1.0 - f) * (shadow[j, i] < w) + f * (shadow[j, i + 1] < w)
    b = (1.0 - f) * (shadow[j + 1, i] < w) + f * (shadow[j + 1, i + 1] < w)
    return float(a * (1.0 - g) + b * g)


@inline_kernel
def sky_visibility(material: int, x: float, y: float, z: float, roof: Float64, occluders: Float64) -> float:
    """Visible share of the sky: reduced below a roof, least in its centre, and close to actors.

    `roof` low x, y, high x, y and height; `occluders` (F, 3) x, y and 1 / radius².
    """
    share = 1.0
    if x > roof[0] and x < roof[2] and y > roof[1] and y < roof[3] and z < roof[4]:
        inside = min(min(x - roof[0], roof[2] - x), min(y - roof[1], roof[3] - y)) / 1.5
        share = 0.18 + 0.82 / (1.0 + inside + 0.5 * inside * inside)
    if 1 <= material <= 3:
        for k in range(occluders.shape[0]):
            d2 = ((x - occluders[k, 0]) ** 2 + (y - occluders[k, 1]) ** 2) * occluders[k, 2]
            if d2 < 9.0:
                share *= 1.0 - AMBIENT_OCCLUSION / (1.0 + d2 + d2 * d2)
    return share
