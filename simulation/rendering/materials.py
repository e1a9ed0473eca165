"""Colours and materials of scenery, machine, people, animals and vehicles."""

from functools import cache

import numpy as np
import shapely
from shapely import LineString, Polygon

from configs.site import Site
from geometry.arrays import Float64
from simulation.environment.meshes import Mesh
from simulation.environment.scenery import Piece
from simulation.objects.encountered import ENCOUNTERED
from simulation.objects.solid import GAIT_STEPS, Solid
from simulation.randomness import generator
from simulation.rendering.scene_mesh import Material, Surface, merge, surface_of

Appearance = tuple[tuple[float, float, float], Material]

# linear RGB
SOIL, GRASS_A, GRASS_B, GRAVEL = (0.145, 0.095, 0.058), (0.09, 0.125, 0.03), (0.14, 0.15, 0.05), (0.24, 0.21, 0.17)
PIECE_APPEARANCE: dict[str, tuple[Appearance, int]] = {
    "crop": (((0.075, 0.15, 0.03), Material.LEAF), 1),
    "grass": (((0.11, 0.16, 0.035), Material.LEAF), 1),
    "stubble": (((0.36, 0.28, 0.12), Material.LEAF), 1),
    "fence": (((0.26, 0.19, 0.12), Material.WOOD), 0),
    "gate": (((0.20, 0.14, 0.09), Material.BARK), 0),
    "roof": (((0.22, 0.23, 0.24), Material.METAL), 0),
    "wall": (((0.25, 0.28, 0.26), Material.METAL), 0),
    "post": (((0.24, 0.18, 0.12), Material.BARK), 0),
    "mast": (((0.40, 0.40, 0.41), Material.SMOOTH), 0),
    "store": (((0.28, 0.20, 0.12), Material.WOOD), 0),
    "trees": (((0.05, 0.085, 0.022), Material.LEAF), 2),
    "crowns": (((0.05, 0.085, 0.022), Material.LEAF), 2),
    "trunks": (((0.11, 0.085, 0.06), Material.BARK), 0),
}
DEFAULT_APPEARANCE: tuple[Appearance, int] = (((0.35, 0.33, 0.30), Material.SMOOTH), 0)
MACHINE_APPEARANCE: Appearance = ((0.03, 0.16, 0.045), Material.GLOSS)

SKINS = ((0.58, 0.36, 0.26), (0.50, 0.29, 0.20), (0.36, 0.20, 0.13), (0.20, 0.105, 0.065), (0.09, 0.05, 0.033))
HAIRS = ((0.015, 0.011, 0.009), (0.05, 0.028, 0.015), (0.16, 0.09, 0.04), (0.38, 0.27, 0.13), (0.28, 0.28, 0.28))
JACKETS = (
    (0.03, 0.06, 0.18), (0.45, 0.05, 0.04), (0.05, 0.14, 0.07), (0.55, 0.55, 0.53), (0.035, 0.035, 0.04),
    (0.65, 0.20, 0.02), (0.55, 0.42, 0.08), (0.18, 0.30, 0.50), (0.22, 0.13, 0.08), (0.30, 0.32, 0.34),
)  # fmt: skip
TROUSERS = ((0.03, 0.045, 0.10), (0.02, 0.02, 0.022), (0.10, 0.11, 0.12), (0.22, 0.17, 0.11), (0.05, 0.07, 0.04))
SHOES = ((0.02, 0.018, 0.016), (0.09, 0.05, 0.025), (0.35, 0.35, 0.35))
COATS = ((0.20, 0.11, 0.055), (0.15, 0.09, 0.05), (0.24, 0.15, 0.085))
PAINTS = ((0.50, 0.02, 0.02), (0.55, 0.55, 0.56), (0.02, 0.05, 0.22), (0.012, 0.012, 0.014), (0.22, 0.23, 0.24),
          (0.03, 0.12, 0.06), (0.62, 0.61, 0.58))  # fmt: skip
FIXED_APPEARANCE: dict[str, Appearance] = {
    "dark": ((0.012, 0.011, 0.011), Material.SMOOTH), "white": ((0.6, 0.59, 0.56), Material.SMOOTH),
    "glass": ((0.012, 0.014, 0.016), Material.GLASS), "rubber": ((0.018, 0.018, 0.018), Material.SMOOTH),
    "rim": ((0.38, 0.38, 0.39), Material.GLOSS), "lamp": ((0.62, 0.62, 0.60), Material.GLOSS),
    "tail": ((0.35, 0.015, 0.015), Material.GLOSS), "wood": ((0.24, 0.18, 0.12), Material.WOOD),
    "steel": ((0.30, 0.31, 0.32), Material.METAL), "stone": ((0.24, 0.23, 0.21), Material.GRAVEL),
    "straw": ((0.42, 0.33, 0.15), Material.GRASS), "water": ((0.05, 0.06, 0.07), Material.GLOSS),
}  # fmt: skip


def palette(seed: int, id: int) -> dict[str, Appearance]:
    """Appearance of each region of an actor: clothes, coat and paint drawn by its id."""
    random = generator(seed, f"looks/{id}")

    def one_of(colors: tuple[tuple[float, float, float], ...]) -> tuple[float, float, float]:
        r, g, b = np.array(colors[int(random.integers(len(colors)))]) * random.uniform(0.8, 1.2)
        return float(r), float(g), float(b)

    skin = one_of(SKINS)
    return FIXED_APPEARANCE | {
        "skin": (skin, Material.SMOOTH), "lips": ((0.8 * skin[0], 0.5 * skin[1], 0.5 * skin[2]), Material.SMOOTH),
        "hair": (one_of(HAIRS), Material.FUR), "jacket": (one_of(JACKETS), Material.CLOTH),
        "trousers": (one_of(TROUSERS), Material.CLOTH), "shoes": (one_of(SHOES), Material.SMOOTH),
        "coat": (one_of(COATS), Material.FUR), "paint": (one_of(PAINTS), Material.GLOSS),
    }  # fmt: skip


@cache
def _uncolored(solid: Solid, step: int) -> tuple[tuple[str, Surface], ...]:
    """Surfaces without colour, with normals; computed once per gait step."""
    parts = solid.parts(step, True)
    return tuple((part.region, surface_of(part.mesh, np.zeros(3), Material.SMOOTH)) for part in parts)


def actor_surface(solid: Solid, step: int, appearance: dict[str, Appearance]) -> Surface:
    """An actor about its own origin."""
    colored = []
    for region, uncolored in _uncolored(solid, step):
        color, material = appearance[region]
        colors = np.broadcast_to(np.array(color, np.float32), uncolored.vertices_m.shape)
        kinds = np.full(len(uncolored.triangles), material, np.uint8)
        colored.append(
            Surface(uncolored.vertices_m, uncolored.normals, colors, uncolored.triangles, kinds, uncolored.cutouts)
        )
    return merge(colored)


def build_actor_surfaces() -> None:
    """Builds every actor at every gait step: each takes about 40 ms at first use."""
    for solid in ENCOUNTERED.values():
        for step in range(-1, 0 if solid.stride_m is None else GAIT_STEPS):
            solid.mesh(step / GAIT_STEPS)
            _uncolored(solid, step)


def static_surface(pieces: list[Piece], site: Site, seed: int) -> Surface:
    """All static pieces, in `map`."""
    return merge([_ground(p.mesh, site, seed) if p.name == "ground" else _piece(p) for p in pieces])


def _piece(piece: Piece) -> Surface:
    (color, material), cutout = PIECE_APPEARANCE.get(piece.name, DEFAULT_APPEARANCE)
    is_flat = material is not Material.LEAF
    surface = surface_of(piece.mesh, np.array(color), material, cutout, is_flat)
    if cutout == 1:  # plants are lit from above, independent of their strip's normal
        surface.normals[:] = (0.0, 0.0, 1.0)
    return surface


def _ground(mesh: Mesh, site: Site, seed: int) -> Surface:
    """Soil in the field, gravel on lanes, yard and in the shed, grass elsewhere; brightness varies in large patches."""
    random = generator(seed, "ground")
    xy = mesh.vertices_m[:, :2].astype(np.float64)
    patches = np.zeros(len(xy))
    for _ in range(8):
        k, phase = random.uniform(-0.6, 0.6, 2), random.uniform(0.0, 6.28)
        patches += np.sin(xy @ k + phase) / 8.0
    patches += 0.25 * random.standard_normal(len(xy))
    in_field, on_gravel = _inside(Polygon(site.boundary_m), xy), _inside(_gravel_area(site), xy)
    blend = np.clip(0.5 + patches, 0.0, 1.0)[:, None]
    colors = (1.0 - blend) * np.array(GRASS_A) + blend * np.array(GRASS_B)
    colors[in_field] = (np.array(SOIL) * (1.0 + 0.5 * patches[:, None]))[in_field]
    colors[on_gravel] = (np.array(GRAVEL) * (1.0 + 0.3 * patches[:, None]))[on_gravel]
    surface = surface_of(mesh, colors, Material.GRASS)
    first = mesh.triangles[:, 0]
    surface.materials[in_field[first]] = Material.SOIL
    surface.materials[on_gravel[first]] = Material.GRAVEL
    return surface


def _gravel_area(site: Site) -> shapely.Geometry:
    lanes = [LineString(lane.center_m).buffer(0.5 * lane.width_m) for lane in site.lanes]
    yards = [Polygon(site.yard.outline_m)] + ([Polygon(site.shed.outline_m)] if site.shed is not None else [])
    return shapely.union_all([*lanes, *yards]).difference(Polygon(site.boundary_m))


def _inside(area: shapely.Geometry, xy: Float64) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(shapely.contains_xy(area, xy), np.bool_)
