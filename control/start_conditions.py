"""Conditions at standstill before a path is driven: implement folded or unfolded, wheels aligned."""

from pydantic import Field

from configs.strict import Config
from configs.vehicle import FOLDED, MountedImplement, TrailedImplement
from control.lateral_controller import VehicleSample
from control.longitudinal_controller import STANDING_MPS
from messages.command import MachineState


class StartConditionsConfig(Config):
    """Alignment of the wheels before starting."""

    alignment_radpm: float = Field(gt=0.0, le=0.2, description="maximum curvature error of the wheels")
    alignment_timeout_s: float = Field(ge=0.0, le=20.0, description="maximum wait for the wheels")


class StartConditions:
    """Holds the machine at the beginning of a path; `is_folded` is the command, without a path the measured state."""

    def __init__(self, implement: MountedImplement | TrailedImplement, config: StartConditionsConfig) -> None:
        self._can_fold = isinstance(implement, MountedImplement) and implement.fold is not None
        self._config = config
        self._fold: float | None = None
        self._folded_target: bool | None = None
        self._is_held, self._aligned_s = False, 0.0

    @property
    def is_folded(self) -> bool:
        """Fold command of the implement."""
        if self._folded_target is not None:
            return self._folded_target
        return self._fold is not None and self._fold > 0.5

    def start(self, is_folded: bool) -> None:
        """Starts a path."""
        self._folded_target = is_folded and self._can_fold
        self._is_held, self._aligned_s = True, 0.0

    def observe(self, machine: MachineState | None) -> None:
        """Takes the measured fold position; unknown without a message."""
        self._fold = machine.fold_position if machine is not None and machine.implement_stamp_ns else None

    def is_held(self, sample: VehicleSample, command_radpm: float, is_steering: bool, elapsed_s: float) -> bool:
        """True while the machine must remain at standstill."""
        if self._is_held and self._is_fold_reached:
            self._aligned_s += elapsed_s if is_steering else 0.0
            is_turned = abs(command_radpm - sample.curvature_radpm) <= self._config.alignment_radpm
            is_moving = abs(sample.speed_mps) > STANDING_MPS  # path started while moving
            self._is_held = not (is_turned or is_moving or self._aligned_s > self._config.alignment_timeout_s)
        return self._is_held

    @property
    def _is_fold_reached(self) -> bool:
        if not self._can_fold:
            return True
        if self._fold is None:
            return False
        return self._fold >= FOLDED if self._folded_target else self._fold <= 1.0 - FOLDED
