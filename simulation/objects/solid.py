"""Body of an object with the signatures that sensor models need."""

from collections.abc import Callable
from dataclasses import dataclass, field

from messages.perception import ObstacleClass
from simulation.environment.lofting import Part
from simulation.environment.meshes import Mesh, join

GAIT_STEPS = 16  # of a gait cycle
# gait step (-1: standing), is fine (for cameras) -> parts about the object's origin on the ground, facing x
BuildParts = Callable[[int, bool], tuple[Part, ...]]


@dataclass(frozen=True)
class Scatterer:
    """A scatterer: position, horizontal normal ((0, 0): omnidirectional), cross-section and its gain at normal
    incidence, and swing of its speed with the gait (share of the walking speed, phase of the cycle).
    """

    at_m: tuple[float, float, float]
    normal: tuple[float, float] = (0.0, 0.0)
    rcs_dbsm: float = 0.0
    mirror_db: float = 0.0
    swing: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True, eq=False)
class Solid:
    """An object in one posture: parts by gait, lidar reflectivity, radar scatterers, strength of an ultrasonic echo.

    `kind` is its name in the catalogue. `stride_m` is the length of one gait cycle, None without gait. One that
    `is_radar_opaque` hides what is behind it from radars. Compared by identity: the catalogue builds each once.
    """

    kind: str
    label: ObstacleClass
    parts: BuildParts
    reflectivity: float
    scatterers: tuple[Scatterer, ...]
    ultrasonic_strength: float
    stride_m: float | None = None
    must_avoid: bool = True
    is_radar_opaque: bool = True
    _meshes: dict[int, Mesh] = field(default_factory=dict, repr=False)

    def step(self, gait: float) -> int:
        """Gait step of a gait phase (0 to 1); -1 for standing, which is a negative phase or an object without gait."""
        return -1 if gait < 0.0 or self.stride_m is None else int(gait % 1.0 * GAIT_STEPS)

    def mesh(self, gait: float) -> Mesh:
        """Mesh at a gait phase, quantised to `GAIT_STEPS`, about the object's origin."""
        step = self.step(gait)
        if step not in self._meshes:
            self._meshes[step] = join([part.mesh for part in self.parts(step, False)])
        return self._meshes[step]
