"""All that the rules may know, at one moment."""

from dataclasses import dataclass

from messages.command import MachineState, Mode, Wish
from messages.faults import Fault
from messages.motion import MapPose, Odometry
from safety.config import SafetyConfig
from safety.field import Gap
from safety.stopping import Braking
from safety.tracked import Threat


@dataclass(frozen=True)
class Situation:
    """Everything is a value: a message that is missing or stale is None, and a rule must say what follows from that.

    `direction` is that of travel (+1 forward), `speed_mps` ≥ 0 the highest that any source measures, `braking` that on
    this grade. `gap` is None when no lidar has looked yet; `proven_m` is the proven range ahead; `fence_m` the way that
    stays inside (None: not known; below 0: outside now). Times of held conditions are in seconds, 0 when
    the condition does not hold.
    """

    now_ns: int
    config: SafetyConfig
    mode: Mode
    direction: int
    speed_mps: float
    is_speed_known: bool
    max_speed_mps: float
    braking: Braking
    allowance_m: float
    odom: Odometry | None
    machine: MachineState | None
    map_pose: MapPose | None
    wish: Wish | None
    silent: tuple[str, ...]
    frozen: tuple[str, ...]
    faults: tuple[Fault, ...]
    gap: Gap | None
    is_planned: bool
    threat: Threat
    proven_m: float
    fence_m: float | None
    position_sigma_m: float
    hand_forced_s: float
    steering_off_s: float
    steering_lost_s: float
    brake_weak_s: float

    @property
    def is_moving(self) -> bool:
        """Whether any source says that the machine moves, or said so last."""
        return self.speed_mps > self.config.modes.standstill_mps
