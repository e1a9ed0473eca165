"""True shapes of machine, implement, static solids and objects as upright prisms, to judge contacts in 3-D."""

import json
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from shapely import Polygon

from configs.site import Site
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from geometry.arrays import Float64, Int32
from geometry.prism import Prism, slabs_of
from geometry.transforms import apply, planar
from messages.truth import TrueShapes
from simulation.actors.actors import ActorState
from simulation.environment.meshes import Mesh
from simulation.environment.scenery import Piece
from simulation.environment.shed import shed_solids
from simulation.machine.body import LIFT_M, implement_parts, machine_parts
from simulation.machine.implement import AttachedImplement
from simulation.objects.solid import GAIT_STEPS, Solid

PIECE_M, TALL_M = 0.5, 100.0
STATIC_KINDS = ("fence", "gate", "trees")  # pieces that are solid; those of the shed have outlines of their own


def shapes_text(
    vehicle: Vehicle, implement: MountedImplement | TrailedImplement, site: Site, pieces: Sequence[Piece],
    negative: Sequence[tuple[str, Polygon]], seed: int,
) -> str:  # fmt: skip
    """JSON with the prisms of machine (`base`), lowered implement (about its origin) and static solids (`map`).

    `negative`: kind and area of ditches and banks, which count at all heights.
    """
    machine = [p for name, mesh in machine_parts(vehicle).items() for p in _slabs(name, mesh)]
    attached = [piece for name, mesh in implement_parts(implement, 0.0).items()
                for p in _slabs(name, mesh) for piece in _across(p)]  # fmt: skip
    shed = [] if site.shed is None else shed_solids(site.shed, seed)
    static = [Prism(s.kind, np.asarray(s.ground.exterior.coords)[:-1], 0.0, s.top_m) for s in shed]
    static += [p for one in pieces if one.name in STATIC_KINDS for p in _components(one)]
    static += [Prism(kind, np.asarray(area.exterior.coords)[:-1], -TALL_M, TALL_M) for kind, area in negative]
    origin_m = implement.hitch_m if isinstance(implement, TrailedImplement) else 0.0
    values = {
        "machine": [_as_dict(p) for p in machine],
        "implement": [_as_dict(p) for p in attached],
        "static": [_as_dict(p) for p in static],
        "machine_width_m": vehicle.body.width_m,
        "implement_origin_m": origin_m,
        "lift_m": LIFT_M,
        "width_m": [implement.width_m, implement.folded.width_m],
    }
    return json.dumps(values)


def _as_dict(p: Prism) -> dict[str, object]:
    return {"name": p.name, "outline_m": np.round(p.outline_m, 4).tolist(), "z_m": [p.low_m, p.high_m]}


def _slabs(name: str, mesh: Mesh) -> list[Prism]:
    """Slabs of a part: all but the wheels are boxes."""
    return slabs_of(name, mesh.vertices_m, mesh.triangles, 0.2 if name.startswith("wheel") else TALL_M)


def _across(part: Prism) -> list[Prism]:
    """Pieces of a part, at most `PIECE_M` wide across, so that each follows the roll of the machine."""
    low, high = float(part.outline_m[:, 1].min()), float(part.outline_m[:, 1].max())
    edges = np.linspace(low, high, max(1, round((high - low) / PIECE_M)) + 1)
    whole, (x0, x1) = Polygon(part.outline_m), (part.outline_m[:, 0].min(), part.outline_m[:, 0].max())
    pieces = [whole.intersection(shapely.box(x0, a, x1, b)) for a, b in pairwise(edges.tolist())]
    return [Prism(part.name, np.asarray(p.exterior.coords)[:-1], part.low_m, part.high_m) for p in pieces]


def _components(piece: Piece) -> list[Prism]:
    """Each connected part of a piece as slabs."""
    t, n = piece.mesh.triangles, len(piece.mesh.vertices_m)
    links = coo_matrix((np.ones(2 * len(t)), (np.r_[t[:, 0], t[:, 1]], np.r_[t[:, 1], t[:, 2]])), shape=(n, n))
    count, owner = connected_components(links, directed=False)
    by_owner = np.argsort(owner[t[:, 0]], kind="stable")
    bounds = np.searchsorted(owner[t[:, 0]][by_owner], np.arange(count + 1))
    found = []
    for k in range(count):
        mine = t[by_owner[bounds[k] : bounds[k + 1]]]
        if len(mine):
            vertices, triangles = _compact(piece.mesh, mine)
            found += slabs_of(piece.name, vertices, triangles)
    return found


def _compact(mesh: Mesh, triangles: Int32) -> tuple[Float64, Int32]:
    used, renumbered = np.unique(triangles, return_inverse=True)
    return mesh.vertices_m[used].astype(np.float64), renumbered.reshape(-1, 3).astype(np.int32)


@cache
def _local_slabs(solid: Solid, step: int) -> tuple[Prism, ...]:
    mesh = solid.mesh(-1.0 if step < 0 else (step + 0.5) / GAIT_STEPS)
    return tuple(slabs_of(solid.kind, mesh.vertices_m, mesh.triangles))


def shapes_message(stamp_ns: int, actors: Sequence[ActorState], attached: AttachedImplement) -> TrueShapes:
    """Builds the TrueShapes message of the actors present."""
    ids, heights, outlines = [], [], []
    for actor in actors:
        x, y, z = actor.p_map_m
        T = planar(x, y, actor.yaw_rad)
        for prism in _local_slabs(actor.solid, actor.solid.step(actor.gait)):
            ring = np.column_stack([prism.outline_m, np.zeros(len(prism.outline_m))])
            ids.append(actor.id)
            heights.append((prism.low_m + z, prism.high_m + z))
            outlines.append(apply(T, ring)[:, :2])
    offsets = np.cumsum([0, *map(len, outlines)]).astype(np.int32)
    flat = np.concatenate([np.zeros((0, 2)), *outlines])
    return TrueShapes(
        stamp_ns, np.array(ids, np.int64), np.array(heights, np.float64).reshape(-1, 2), offsets, flat,
        attached.pto_radps, attached.fold,
    )  # fmt: skip
