"""The supervisor in shadow mode: it judges as if engaged, and its commands go nowhere."""

from configs.vehicle import Implement, Vehicle
from safety.config import SafetyConfig
from safety.rules import OBSTACLE_RULES, RULES
from safety.supervisor import Observation, Supervisor
from safety.zones.known_structure import KnownStructure

NOT_JUDGED = frozenset(RULES) - OBSTACLE_RULES  # hand, machine, bus, fence: a log driven by hand has none of it


class Shadow(Supervisor):
    """The supervisor looking on: nothing that it says reaches a machine, so nothing would change its mode back.

    `half_width_m` is that of the way judged when a person drove: it takes the place of the body's width and of the
    field's margins to the sides, and the arc of the present steering (which stands for a steering that fails) is left
    out. None judges machine and implement as they are, beside their planned path. `known_structure` is the shed,
    `idle` names sensors that detect nothing.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        implement: Implement | None,
        config: SafetyConfig,
        half_width_m: float | None,
        known_structure: KnownStructure | None = None,
        idle: frozenset[str] = frozenset(),
    ) -> None:
        if half_width_m is not None:
            vehicle = vehicle.model_copy(
                update={"body": vehicle.body.model_copy(update={"width_m": 2.0 * half_width_m})}
            )
            config = config.model_copy(
                update={
                    "field": config.field.model_copy(update={"lateral_margin_near_m": 0.0, "lateral_margin_far_m": 0.0})
                }
            )
        observation = Observation(is_arc_checked=half_width_m is None)
        super().__init__(vehicle, implement, config, None, (), NOT_JUDGED, known_structure, idle, observation)
