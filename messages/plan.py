"""The path to drive and the state of the mission."""

from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np

from geometry.arrays import Float64, Int32, UInt8
from messages.message import Message, MessagePart


class PathSectionType(StrEnum):
    """Purpose of a path section."""

    LANE = "lane"
    HEADLAND = "headland"
    SWATH = "swath"
    TURN = "turn"
    DETOUR = "detour"
    DOCK = "dock"


@dataclass(frozen=True)
class PathSection(MessagePart):
    """A part of a path: points `first` up to and including `last`; `line` numbers round or swath (else -1)."""

    section_type: PathSectionType
    line: int
    first: int
    last: int


@dataclass(frozen=True)
class Path(Message):
    """A path of `base` in `map` driven in one direction (+1 forward, -1 reverse), from standstill to standstill.

    N points about 0.1 m apart: `p_map_m` (N, 2), `heading_rad` (N,) of the machine, `curvature_radpm` (N,) (left
    positive, of the machine's forward motion), `s_m` (N,) arc length, `speed_mps` (N,) upper limit ≥ 0 (0 only at the
    end), `is_working` (N,) 1 where the implement works. `is_last` ends the mission. `is_transport`: the implement is
    brought into transport width before the path is driven (else into working width).
    """

    path_id: int
    direction: int
    p_map_m: Float64
    heading_rad: Float64
    curvature_radpm: Float64
    s_m: Float64
    speed_mps: Float64
    is_working: UInt8
    sections: tuple[PathSection, ...]
    section_index: Int32
    is_last: bool
    is_transport: bool = False

    def index_at(self, s_m: float) -> int:
        """First point at or beyond an arc length; the last one beyond the end."""
        return min(int(np.searchsorted(self.s_m, s_m)), len(self.s_m) - 1)

    def section_at(self, s_m: float) -> PathSection:
        """Section at an arc length; the last one beyond the end."""
        return self.sections[int(self.section_index[self.index_at(s_m)])]


class MissionState(IntEnum):
    """Progress of the mission as a whole."""

    WAITING = 0
    DRIVING = 1
    REPLANNING = 2
    FINISHED = 3
    ABORTED = 4


@dataclass(frozen=True)
class UncoveredArea(MessagePart):
    """Area that is not worked, with reason and outline (N, 2)."""

    reason: str
    area_m2: float
    outline_map_m: Float64


@dataclass(frozen=True)
class MissionStatus(Message):
    """State of the mission; `path_s_m` is the position on path `path_id`, `uncovered_areas` will not be worked.

    The driven line is the path shifted by (`shift_x_m`, `shift_y_m`) in `map`; `shift_left_m` is the part to the left
    of the machine.
    """

    state: MissionState
    section_type: PathSectionType
    line: int
    path_id: int
    path_s_m: float
    driven_m: float
    total_m: float
    text: str
    uncovered_areas: tuple[UncoveredArea, ...]
    shift_x_m: float = 0.0
    shift_y_m: float = 0.0
    shift_left_m: float = 0.0
