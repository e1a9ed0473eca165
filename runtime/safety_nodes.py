"""Nodes of the safety process: supervisor and gateway."""

from interfaces.gateway import CanBus, Gateway
from messages.node import Node
from runtime.ablation import REMAINING_RULES, ReportedAblation
from runtime.coverage.check import require_coverage
from runtime.executor import FAULT_TOPIC
from runtime.setup import Setup, sensors_without_detector
from safety.rules import RULES
from safety.supervisor import Supervisor
from safety.zones.geofence import geofence_of
from safety.zones.known_structure import structure_of_site

FAULT_TOPICS = ("fault/localizer", "fault/gateway", "fault/orders", FAULT_TOPIC)


def safety_nodes(setup: Setup, bus: CanBus, is_ablation: bool) -> list[Node]:
    """Supervisor and gateway, from the control command to the CAN bus; `is_ablation` omits the obstacle rules.

    Raises ConfigError for a machine that can reach a place which its sensors do not cover.
    """
    stack = setup.stack
    require_coverage(setup.mission, setup.vehicle, setup.implement, stack.planning, stack.safety)
    supervisor = Supervisor(
        setup.vehicle,
        setup.implement,
        setup.stack.safety,
        geofence_of(setup.site),
        FAULT_TOPICS,
        structure_of_site(setup.site),
        sensors_without_detector(setup),
        setup.mission.consent,
        REMAINING_RULES if is_ablation else RULES,
    )
    return [
        ReportedAblation(supervisor) if is_ablation else supervisor,
        Gateway(bus, setup.vehicle, setup.stack.interfaces.gateway),
    ]
