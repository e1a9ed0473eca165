"""Runs the entire stack in simulated time until a condition holds."""

from collections.abc import Callable
from typing import Any, TypeVar

from configs.strict import find, load
from messages.faults import Fault
from messages.message import Envelope, Message
from runtime.assembly import assemble, fault_injection_for
from runtime.executor import FAULT_TOPIC, Executor
from runtime.setup import Setup
from simulation.faults.config import InjectedFault
from simulation.scenario import Scenario

M = TypeVar("M", bound=Message)


def starting_early(name: str) -> Scenario:
    """A scenario with its first start after half a second, when the localizer is ready, instead of three."""
    found = load(Scenario, find("scenarios", name))
    commands = tuple(command.model_copy(update={"at_s": 0.5}) for command in found.operator_commands)
    return found.model_copy(update={"operator_commands": commands})


class Drive:
    """Sink of a drive; `newest` holds the last message of each topic."""

    def __init__(self) -> None:
        self.newest: dict[str, Message] = {}
        self.modes: list[str] = []
        self.failure: str | None = None

    def __call__(self, envelope: Envelope) -> None:
        self.newest[envelope.topic] = envelope.message
        if envelope.topic == FAULT_TOPIC and isinstance(envelope.message, Fault):
            self.failure = envelope.message.text_en
        mode = getattr(envelope.message, "mode", None) if envelope.topic == "supervisor" else None
        if mode is not None and mode.value not in self.modes[-1:]:
            self.modes.append(mode.value)

    def last(self, topic: str, kind: type[M]) -> M:
        message = self.newest[topic]
        assert isinstance(message, kind)
        return message


def forward(
    setup: Setup, until: Callable[[Drive], bool], timeout_s: float, scenario: Scenario | str = "empty", *,
    sinks: tuple[Any, ...] = (), is_ablation: bool = False, faults: tuple[InjectedFault, ...] = (),
) -> Drive:  # fmt: skip
    """Advances until `until`; a node's exception or the time limit fails the test with its text."""
    drive = Drive()
    named = load(Scenario, find("scenarios", scenario)) if isinstance(scenario, str) else scenario
    chosen = named.model_copy(update={"faults": (*named.faults, *faults)})
    injection = fault_injection_for(setup, chosen)
    with assemble(setup, chosen, is_ablation, injection) as (world, nodes):
        executor = Executor(world, nodes, (drive, *sinks), injection)
        start_ns = executor.now_ns

        def is_over() -> bool:
            return until(drive) or drive.failure is not None or executor.now_ns - start_ns > timeout_s * 1e9

        executor.run(is_over)
        seconds = (executor.now_ns - start_ns) * 1e-9
    assert drive.failure is None, drive.failure
    assert until(drive), f"not reached within {seconds:.0f} s; modes {drive.modes}, topics {sorted(drive.newest)}"
    return drive
