"""True states, from simulation or labels; read only by validation and viewers."""

from dataclasses import dataclass
from enum import IntEnum

from geometry.arrays import Float64, Int32, Int64
from messages.message import Message, MessagePart
from messages.perception import ObstacleClass


@dataclass(frozen=True)
class TrueMachine(Message):
    """True machine state: `T_map_base` (4, 4), signed speed, front-wheel angle, working point, implement state.

    `p_implement_map_m` (3,) is the working point of the implement; `hitch` 0 (lowest) to 1 (highest); `contacts` and
    `zone_exits` are counts since the start.
    """

    T_map_base: Float64
    speed_mps: float
    acceleration_mps2: float
    yaw_rate_radps: float
    steering_angle_rad: float
    p_implement_map_m: Float64
    implement_yaw_rad: float
    hitch: float
    is_working: bool
    contacts: int
    zone_exits: int


class Occlusion(IntEnum):
    """How far other things hide an object from the sensors, as a label says; `UNKNOWN` says nothing."""

    UNKNOWN = 0
    NONE = 1
    PARTLY = 2
    LARGELY = 3


@dataclass(frozen=True)
class TrueObject(MessagePart):
    """True object: box centre and size, yaw and velocity in `map`; `role` is its name in the scenario ("" = scenery).

    `clearance_m` is the distance from its outline to machine and implement; `kind` its name in the catalogue of the
    simulation ("" = unknown). One that not `must_avoid` (a gull, a puddle) may be touched.
    """

    id: int
    label: ObstacleClass
    role: str
    center_map_m: Float64
    size_m: Float64
    yaw_rad: float
    velocity_mps: Float64
    clearance_m: float
    occlusion: Occlusion = Occlusion.UNKNOWN
    kind: str = ""
    must_avoid: bool = True


@dataclass(frozen=True)
class TrueObjects(Message):
    """All true objects that count as obstacles."""

    objects: tuple[TrueObject, ...]


@dataclass(frozen=True)
class TrueShapes(Message):
    """Shapes of the objects of a scenario as upright prisms in `map`, and the implement's state that no outline shows.

    Prism k of K belongs to object `object_id[k]`, extends over the heights `z_m[k]` (K, 2) and has the outline
    `outline_map_m[offsets[k]:offsets[k + 1]]` (M, 2). `fold` is 0 at working width, 1 at transport width.
    """

    object_id: Int64
    z_m: Float64
    offsets: Int32
    outline_map_m: Float64
    pto_radps: float
    fold: float
