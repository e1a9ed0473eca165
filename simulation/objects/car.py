"""A small car of 3.8 by 1.66 m about its centre: body, glass with pillars and roof, wheels, lights and plates."""

from functools import cache

from simulation.environment.lofting import Keys, Part, loft
from simulation.environment.meshes import Mesh

BODY: Keys = (
    (-1.90, 0.0, 0.58, 0.15, 0.60), (-1.89, 0.0, 0.58, 0.26, 0.70), (-1.80, 0.0, 0.60, 0.35, 0.78),
    (-1.40, 0.0, 0.61, 0.37, 0.81), (0.0, 0.0, 0.61, 0.37, 0.815), (0.85, 0.0, 0.60, 0.36, 0.81),
    (1.20, 0.0, 0.57, 0.33, 0.80), (1.60, 0.0, 0.54, 0.29, 0.78), (1.82, 0.0, 0.51, 0.24, 0.72),
    (1.89, 0.0, 0.49, 0.18, 0.64), (1.90, 0.0, 0.48, 0.10, 0.56),
)  # fmt: skip
# along z: centre along x, half length, half width
CABIN: Keys = ((-0.36, 0.0, 0.92, 1.42, 0.765), (-0.40, 0.0, 1.02, 1.33, 0.745), (-0.48, 0.0, 1.30, 1.12, 0.675),
               (-0.54, 0.0, 1.52, 0.93, 0.61))  # fmt: skip
ROOF: Keys = ((-0.53, 0.0, 1.50, 0.955, 0.625), (-0.55, 0.0, 1.55, 0.93, 0.60), (-0.57, 0.0, 1.60, 0.84, 0.54),
              (-0.60, 0.0, 1.64, 0.60, 0.38), (-0.60, 0.0, 1.65, 0.20, 0.12))  # fmt: skip
WHEEL_M, ARCH_M = 0.32, 0.35


@cache
def car(is_fine: bool) -> tuple[Part, ...]:
    """All parts."""
    sides, more = (40, 3) if is_fine else (20, 1)
    parts = [Part(loft(BODY, sides, 12 * more, power=4.5, axis=(1.0, 0.0, 0.0)), "paint"),
             Part(loft(CABIN, sides, 4 * more, power=5.0, axis=(0.0, 0.0, 1.0)), "glass"),
             Part(loft(ROOF, sides, 5 * more, power=5.0, axis=(0.0, 0.0, 1.0)), "paint")]  # fmt: skip
    for x in (1.2, -1.2):
        for s in (1.0, -1.0):
            parts += [Part(disc((x, 0.717 * s, WHEEL_M + 0.035), 0.10, ARCH_M, 16), "dark"),
                      Part(disc((x, 0.73 * s, WHEEL_M), 0.10, WHEEL_M, 16), "rubber")]  # fmt: skip
            if is_fine:
                parts.append(Part(disc((x, 0.824 * s, WHEEL_M), 0.01, 0.19, 16), "rim"))
    parts += _pillars() + _mirrors(more)
    return tuple(parts + _trim() if is_fine else parts)


def disc(center: tuple[float, float, float], half_width: float, radius: float, sides: int) -> Mesh:
    """A wheel about an axle across the car."""
    x, y, z = center
    keys = ((x, y - half_width, z, 0.9 * radius, 0.9 * radius), (x, y - 0.8 * half_width, z, radius, radius),
            (x, y + 0.8 * half_width, z, radius, radius),
            (x, y + half_width, z, 0.9 * radius, 0.9 * radius))  # fmt: skip
    return loft(keys, sides, 4, aside=(1.0, 0.0, 0.0))


def _pillars() -> list[Part]:
    """Painted pillars at the corners and between the doors."""
    posts = []
    for s in (1.0, -1.0):
        for (x0, y0), (x1, y1), half in (((0.83, 0.65), (0.27, 0.525), 0.03), ((-0.36, 0.755), (-0.44, 0.615), 0.045),
                                         ((-1.55, 0.665), (-1.34, 0.54), 0.07)):  # fmt: skip
            ends = ((x0, y0 * s, 0.93, half, 0.018), (x0, y0 * s, 0.94, half, 0.018), (x1, y1 * s, 1.50, half, 0.018),
                    (x1, y1 * s, 1.51, half, 0.018))  # fmt: skip
            posts.append(Part(loft(ends, 8, 4), "paint"))
    return posts


def _mirrors(more: int) -> list[Part]:
    found = []
    for s in (1.0, -1.0):
        keys = ((0.72, 0.70 * s, 1.00, 0.04, 0.04), (0.70, 0.77 * s, 1.03, 0.06, 0.07),
                (0.70, 0.82 * s, 1.03, 0.05, 0.06), (0.70, 0.83 * s, 1.03, 0.02, 0.02))  # fmt: skip
        found.append(Part(loft(keys, 8, 4 * more, axis=(0.0, s, 0.0), aside=(1.0, 0.0, 0.0)), "paint"))
    return found


def _slab(x: float, y: float, z: float, half_y: float, half_z: float, region: str) -> Part:
    """A plate on the front or the rear."""
    keys = ((x - 0.02, y, z, half_z, half_y), (x - 0.019, y, z, half_z, half_y), (x + 0.02, y, z, half_z, half_y))
    return Part(loft(keys, 16, 3, power=4.0), region)


def _trim() -> list[Part]:
    """Details for cameras alone: bumpers, plates, grille, lamps, door line and handle."""
    parts = [_slab(1.885, 0.0, 0.40, 0.45, 0.04, "dark"), _slab(-1.885, 0.0, 0.44, 0.50, 0.04, "dark"),
             _slab(1.895, 0.0, 0.47, 0.24, 0.04, "white"), _slab(-1.895, 0.0, 0.62, 0.24, 0.05, "white"),
             _slab(1.885, 0.0, 0.56, 0.36, 0.03, "dark")]  # fmt: skip
    for s in (1.0, -1.0):
        parts += [_slab(1.868, 0.52 * s, 0.58, 0.11, 0.045, "lamp"), _slab(-1.885, 0.54 * s, 0.70, 0.07, 0.08, "tail")]
        door = ((-0.39, 0.815 * s, 0.42, 0.006, 0.004), (-0.39, 0.815 * s, 0.76, 0.006, 0.004))
        handle = ((-0.30, 0.812 * s, 0.74, 0.012, 0.01), (-0.12, 0.812 * s, 0.74, 0.012, 0.01))
        parts += [Part(loft(door, 6, 3), "dark"), Part(loft(handle, 6, 3), "dark")]
    return parts
