"""The fold of an implement: a width narrower than the full one counts only while it is measured."""

from dataclasses import dataclass

from configs.vehicle import FOLDED, MountedImplement, TrailedImplement, Vehicle
from messages.command import MachineState
from safety.zones.footprint import Footprint, footprint_of


@dataclass(frozen=True)
class FootprintSet:
    """The outline with the implement in working and in transport width; the same when it does not fold."""

    wide: Footprint
    narrow: Footprint

    @property
    def is_foldable(self) -> bool:
        """Whether there are two."""
        return self.wide is not self.narrow

    def at(self, fold: float | None) -> Footprint:
        """The outline that counts at a measured fold; the full width when it is not known."""
        return self.narrow if fold is not None and fold >= FOLDED else self.wide


def footprints_of(vehicle: Vehicle, implement: MountedImplement | TrailedImplement | None) -> FootprintSet:
    """Both outlines of a vehicle with what it carries or pulls."""
    wide = footprint_of(vehicle, implement)
    narrow = wide if implement is None else footprint_of(vehicle, implement.folded)
    return FootprintSet(wide, wide if narrow == wide else narrow)


def fold_of(machine: MachineState | None, max_group_age_s: float) -> float | None:
    """The measured fold; None when its group is too old."""
    if machine is None or machine.stamp_ns - machine.implement_stamp_ns > max_group_age_s * 1e9:
        return None
    return machine.fold_position


def is_between(fold: float) -> bool:
    """Whether an implement is locked at neither end of its fold."""
    return not (fold <= 1.0 - FOLDED or fold >= FOLDED)
