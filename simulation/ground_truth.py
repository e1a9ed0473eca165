"""Ground truth: contacts, zone exits and the truth messages."""

import numpy as np
import shapely
from pydantic import Field
from shapely import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from configs.site import Site
from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from messages.truth import TrueMachine, TrueObject, TrueObjects
from simulation.actors.actors import ActorState
from simulation.environment.scenery import surveyed_area
from simulation.environment.shed import shed_solids
from simulation.machine.body import implement_outline_m, machine_outline_m
from simulation.machine.implement import working_point_m
from simulation.machine.machine import Machine


class GroundTruthConfig(Config):
    """Tolerances of the evaluation."""

    tolerance_m: float = Field(ge=0.0, le=0.1, description="of the boundary")


class GroundTruth:
    """Counts one contact per object (actor id; shed solids from -1 downwards) and one zone exit per departure."""

    def __init__(
        self,
        site: Site,
        vehicle: Vehicle,
        implement: MountedImplement | TrailedImplement,
        seed: int,
        config: GroundTruthConfig,
    ) -> None:
        self.zone_exits = 0
        self.contact_ids: tuple[int, ...] = ()
        self._vehicle, self._implement = vehicle, implement
        self._allowed = allowed_area(site).buffer(config.tolerance_m)
        shapely.prepare(self._allowed)
        self._was_inside = True
        self._solids = [] if site.shed is None else [s.ground for s in shed_solids(site.shed, seed)]
        self._structures = shapely.union_all(self._solids)
        shapely.prepare(self._structures)

    def update(self, outline: BaseGeometry, actors: tuple[ActorState, ...]) -> None:
        """Counts contacts and zone exits of the outline since the last update."""
        is_inside = bool(self._allowed.covers(outline))
        self.zone_exits += int(self._was_inside and not is_inside)
        self._was_inside = is_inside
        hit = [actor.id for actor in actors if actor.solid.must_avoid and outline.intersects(actor.footprint)]
        if self._structures.intersects(outline):
            hit += [-1 - k for k, solid in enumerate(self._solids) if solid.intersects(outline)]
        self.contact_ids += tuple(id for id in hit if id not in self.contact_ids)

    def outline(self, machine: Machine) -> BaseGeometry:
        """Ground covered by machine and implement."""
        base = (machine.x_m, machine.y_m, machine.yaw_rad)
        implement = implement_outline_m(machine.attached.current, base, machine.attached.yaw_rad)
        return machine_outline_m(self._vehicle, base).union(implement)

    def machine_message(self, stamp_ns: int, machine: Machine) -> TrueMachine:
        """Builds the TrueMachine message."""
        base = (machine.x_m, machine.y_m, machine.yaw_rad)
        point = working_point_m(self._implement, base, machine.attached.yaw_rad)
        T = machine.T_map_base
        height = T[2, 3] + (point - T[:2, 3]) @ T[:2, :2] @ T[2, :2]
        return TrueMachine(
            stamp_ns, T.copy(), machine.speed_mps, machine.acceleration_mps2, machine.yaw_rate_radps,
            machine.steering.angle_rad, np.array([*point, height]), machine.attached.yaw_rad, machine.attached.hitch,
            machine.attached.is_working, len(self.contact_ids), self.zone_exits,
        )  # fmt: skip

    def objects_message(self, stamp_ns: int, outline: BaseGeometry, actors: tuple[ActorState, ...]) -> TrueObjects:
        """Builds the TrueObjects message, with the clearance of each object to the covered ground."""
        objects = []
        for f in actors:
            center, size = f.box_m()
            gap = float(outline.distance(f.footprint))
            velocity = np.array([*f.velocity_mps, 0.0])
            solid = f.solid
            objects.append(TrueObject(f.id, solid.label, f.role, center, size, f.yaw_rad, velocity, gap,
                                      kind=solid.kind, must_avoid=solid.must_avoid))  # fmt: skip
        return TrueObjects(stamp_ns, tuple(objects))


def allowed_area(site: Site) -> BaseGeometry:
    """Permitted area: surveyed area, gates and shed, without no-go areas."""
    gates = [LineString(gate.posts_m).buffer(1.0, cap_style="flat") for gate in site.gates]
    shed = [] if site.shed is None else [Polygon(site.shed.outline_m)]
    area = shapely.union_all([surveyed_area(site), *gates, *shed])
    return area.difference(shapely.union_all([Polygon(a.outline_m) for a in site.no_go]))
