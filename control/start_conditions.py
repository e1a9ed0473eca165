"""What is seen to at standstill before a path is driven: the implement folded as it wants, and the wheels turned."""

from pydantic import Field

from configs.strict import Config
from configs.vehicle import FOLDED, MountedImplement, TrailedImplement
from control.lateral_controller import Sample
from control.longitudinal_controller import STANDING_MPS
from messages.command import MachineState


class DepartureConfig(Config):
    """When the wheels are turned well enough to start off."""

    align_radpm: float = Field(gt=0.0, le=0.2, description="wheels off by more are waited for")
    align_most_s: float = Field(ge=0.0, le=20.0, description="at most")


class Departure:
    """Holds the machine at the beginning of each path; `is_folded` is the wish, without a path what is measured."""

    def __init__(self, implement: MountedImplement | TrailedImplement, config: DepartureConfig) -> None:
        self._can_fold = isinstance(implement, MountedImplement) and implement.fold is not None
        self._config = config
        self._fold: float | None = None
        self._wants_folded: bool | None = None
        self._is_held, self._aligned_s = False, 0.0

    @property
    def is_folded(self) -> bool:
        """What is wished of the implement."""
        if self._wants_folded is not None:
            return self._wants_folded
        return self._fold is not None and self._fold > 0.5

    def start(self, is_folded: bool) -> None:
        """A new path begins."""
        self._wants_folded = is_folded and self._can_fold
        self._is_held, self._aligned_s = True, 0.0

    def observe(self, machine: MachineState | None) -> None:
        """Take the measured fold; silence leaves it unknown."""
        self._fold = machine.fold_position if machine is not None and machine.implement_stamp_ns else None

    def is_held(self, sample: Sample, command_radpm: float, is_steering: bool, elapsed_s: float) -> bool:
        """Whether the machine must still stand."""
        if self._is_held and self._is_fold_right:
            self._aligned_s += elapsed_s if is_steering else 0.0
            is_turned = abs(command_radpm - sample.curvature_radpm) <= self._config.align_radpm
            is_moving = abs(sample.speed_mps) > STANDING_MPS  # taken up under way
            self._is_held = not (is_turned or is_moving or self._aligned_s > self._config.align_most_s)
        return self._is_held

    @property
    def _is_fold_right(self) -> bool:
        if not self._can_fold:
            return True
        if self._fold is None:
            return False
        return self._fold >= FOLDED if self._wants_folded else self._fold <= 1.0 - FOLDED
