"""Triangle rasterisation to a depth buffer: perspective (camera) and parallel (sun) projection, one fill.

`w` grows towards the viewer and is linear on the screen: 1 / depth in perspective, height along the sun direction in
parallel projection. A buffer holds the largest w of each pixel and its triangle; 0 is empty.
"""

import math

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.jit import inline_kernel, kernel

NEAR_PLANE_M = 0.15


@kernel
def project(
    vertices: Float32, triangles: Int32, selected: Int32, R: Float64, origin: Float64, intrinsics: Float64,
    width: int, height: int,
) -> tuple[Float32, Int32]:  # fmt: skip
    """Projected corners (T, 3, 3) (x, y in pixels, w) of the visible triangles, and their rows, (T,).

    `selected` are rows of `triangles`; `R` (3, 3) takes `map` to x right, y down, z ahead; `intrinsics` fx, fy, cx, cy.
    A triangle that crosses the near plane is clipped to one or two.
    """
    out = np.empty((2 * selected.shape[0], 3, 3), np.float32)
    which = np.empty(2 * selected.shape[0], np.int32)
    fx, fy, cx, cy = intrinsics
    n = 0
    p = np.empty((3, 3))
    for k in range(selected.shape[0]):
        t = selected[k]
        nearest, farthest = 1e9, -1e9
        low_x, high_x, low_y, high_y = 1e9, -1e9, 1e9, -1e9
        for i in range(3):
            v = triangles[t, i]
            dx, dy, dz = vertices[v, 0] - origin[0], vertices[v, 1] - origin[1], vertices[v, 2] - origin[2]
            x = R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz
            y = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
            z = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
            p[i, 0], p[i, 1], p[i, 2] = x, y, z
            nearest, farthest = min(nearest, z), max(farthest, z)
            w = 1.0 / max(z, NEAR_PLANE_M)
            x, y = fx * x * w + cx, fy * y * w + cy
            out[n, i, 0], out[n, i, 1], out[n, i, 2] = x, y, w
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
        if farthest < NEAR_PLANE_M:
            continue
        if nearest < NEAR_PLANE_M:
            parts = _clip_near_plane(p, out[n : n + 2], fx, fy, cx, cy)
            which[n : n + parts] = t
            n += parts
        # skips triangles between two rows or columns of pixels
        elif high_x >= 0.0 and high_y >= 0.0 and low_x <= width - 1 and low_y <= height - 1 and (
            math.ceil(low_x) <= high_x and math.ceil(low_y) <= high_y
        ):  # fmt: skip
            which[n] = t
            n += 1
    return out[:n], which[:n]


@kernel
def _clip_near_plane(p: Float64, out: Float32, fx: float, fy: float, cx: float, cy: float) -> int:
    """Clips a triangle (3, 3) in the optical frame at the near plane; writes and counts one or two triangles."""
    q = np.empty((4, 3))
    m = 0
    for i in range(3):
        j = (i + 1) % 3
        if p[i, 2] >= NEAR_PLANE_M:
            q[m, 0], q[m, 1], q[m, 2] = p[i, 0], p[i, 1], p[i, 2]
            m += 1
        if (p[i, 2] >= NEAR_PLANE_M) != (p[j, 2] >= NEAR_PLANE_M):
            f = (NEAR_PLANE_M - p[i, 2]) / (p[j, 2] - p[i, 2])
            for k in range(3):
                q[m, k] = p[i, k] + f * (p[j, k] - p[i, k])
            m += 1
    for i in range(m):
        w = 1.0 / q[i, 2]
        q[i, 0], q[i, 1], q[i, 2] = fx * q[i, 0] * w + cx, fy * q[i, 1] * w + cy, w
    for i in range(m - 2):
        for k in range(3):
            out[i, 0, k], out[i, 1, k], out[i, 2, k] = q[0, k], q[i + 1, k], q[i + 2, k]
    return m - 2


@kernel
def project_parallel(
    vertices: Float32, triangles: Int32, selected: Int32, R: Float64, origin: Float64, per_m: float, size: int
) -> tuple[Float32, Int32]:
    """Parallel projection along the sun; `origin` is the centre of a square screen, `w` 100 m plus height above it."""
    out = np.empty((selected.shape[0], 3, 3), np.float32)
    which = np.empty(selected.shape[0], np.int32)
    n = 0
    for k in range(selected.shape[0]):
        t = selected[k]
        low_x, high_x, low_y, high_y = 1e9, -1e9, 1e9, -1e9
        for i in range(3):
            v = triangles[t, i]
            dx, dy, dz = vertices[v, 0] - origin[0], vertices[v, 1] - origin[1], vertices[v, 2] - origin[2]
            x = (R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz) * per_m + 0.5 * size
            y = (R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz) * per_m + 0.5 * size
            out[n, i, 0], out[n, i, 1] = x, y
            out[n, i, 2] = 100.0 + R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
        if high_x >= 0.0 and high_y >= 0.0 and low_x <= size - 1 and low_y <= size - 1:
            which[n] = t
            n += 1
    return out[:n], which[:n]


@kernel
def rasterize(
    screen: Float32, which: Int32, w: Float32, triangle_ids: Int32, cutouts: UInt8, R: Float64, origin: Float64,
    intrinsics: Float64,
) -> None:  # fmt: skip
    """Fills triangles into `w` and `triangle_ids` (H, W); those with a cutout only where `_is_leaf`."""
    height, width = w.shape
    fx, fy, cx, cy = intrinsics
    for k in range(screen.shape[0]):
        x0, y0, w0 = float(screen[k, 0, 0]), float(screen[k, 0, 1]), float(screen[k, 0, 2])
        x1, y1, w1 = float(screen[k, 1, 0]), float(screen[k, 1, 1]), float(screen[k, 1, 2])
        x2, y2, w2 = float(screen[k, 2, 0]), float(screen[k, 2, 1]), float(screen[k, 2, 2])
        top, bottom = max(0, math.ceil(min(y0, y1, y2))), min(height - 1, math.floor(max(y0, y1, y2)))
        left, right = max(0, math.ceil(min(x0, x1, x2))), min(width - 1, math.floor(max(x0, x1, x2)))
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if top > bottom or left > right or abs(area) < 1e-9:
            continue
        inverse = 1.0 / area
        # w and barycentric shares are linear on the screen
        b_x, b_y = (y2 - y0) * inverse, (x0 - x2) * inverse
        c_x, c_y = (y0 - y1) * inverse, (x1 - x0) * inverse
        a_x = -b_x - c_x
        w_x, w_y = b_x * (w1 - w0) + c_x * (w2 - w0), b_y * (w1 - w0) + c_y * (w2 - w0)
        # a share grows to the right (its root is the first column) or falls (the last); constant ones are rare
        b_zero, c_zero = 1.0 / (b_x if b_x != 0.0 else 1e-12), 1.0 / (c_x if c_x != 0.0 else 1e-12)
        a_zero = 1.0 / (a_x if a_x != 0.0 else 1e-12)
        cutout = cutouts[which[k]]
        for y in range(top, bottom + 1):
            b0 = b_x * (left - x0) + b_y * (y - y0)
            c0 = c_x * (left - x0) + c_y * (y - y0)
            first, last = float(left), float(right)
            first, last = _clip_columns(first, last, left - b0 * b_zero, b_zero)
            first, last = _clip_columns(first, last, left - c0 * c_zero, c_zero)
            first, last = _clip_columns(first, last, left - (1.0 - b0 - c0) * a_zero, a_zero)
            start = math.ceil(first)
            value = w0 + w_x * (start - x0) + w_y * (y - y0)
            for x in range(start, math.floor(last) + 1):
                if value > w[y, x]:
                    is_there = True
                    if cutout:
                        z = 1.0 / value
                        is_there = _is_leaf_in_view((x - cx) / fx * z, (y - cy) / fy * z, z, R, origin, cutout)
                    if is_there:
                        w[y, x] = value
                        triangle_ids[y, x] = which[k]
                value += w_x


@inline_kernel
def _clip_columns(first: float, last: float, zero: float, inverse: float) -> tuple[float, float]:
    """Columns `first` to `last` where a barycentric share with root `zero` and slope 1 / `inverse` is not negative."""
    if inverse > 0.0:
        return max(first, zero), last
    return first, min(last, zero)


@inline_kernel
def _is_leaf_in_view(x: float, y: float, z: float, R: Float64, origin: Float64, cutout: int) -> bool:
    """`_is_leaf` for a point in the optical frame: x right, y down, z ahead."""
    return bool(
        _is_leaf(
            origin[0] + R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
            origin[1] + R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
            origin[2] + R[0, 2] * x + R[1, 2] * y + R[2, 2] * z, cutout,
        )
    )  # fmt: skip


@kernel
def _is_leaf(x: float, y: float, z: float, cutout: int) -> bool:
    """Procedural cutout, True inside a plant: blades in rows (1) or clusters of leaves (2)."""
    if cutout == 1:
        s = 37.0 * (x + y) + 3.0 * math.sin(9.0 * (x - y)) + 20.0 * z * math.sin(5.3 * (x + y))
        return math.sin(s) + 0.5 * math.sin(2.7 * s + 1.0) > -0.1
    s = math.sin(7.3 * x + 2.1 * z) * math.sin(6.7 * y - 1.7 * z) + math.sin(8.1 * z + 1.3 * x + 0.9 * y)
    s += 0.6 * math.sin(23.0 * x + 5.0 * y) * math.sin(21.0 * z - 7.0 * y)
    return s > -0.9
