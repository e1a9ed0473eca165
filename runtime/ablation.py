"""Ablation: a supervisor without the obstacle rules, to show what they are for."""

from collections.abc import Iterable

from messages.faults import Fault, Response, Severity
from messages.node import Inbox, Node, Output
from safety.rules import RULES
from safety.rules.rule import Effect
from safety.supervisor import Supervisor

REMAINING_RULES = {name: rule for name, rule in RULES.items() if Effect.OBSTACLE not in rule.effect}
TEXT_EN, TEXT_ZH = "obstacle rules switched off for a trial", "注意：障碍物安全规则已关闭（试验）"


class ReportedAblation(Node):
    """Runs a supervisor and reports, in its name and as a warning that stays, that rules are switched off."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self.name, self.runs = supervisor.name, supervisor.runs
        self.reads, self.writes = supervisor.reads, supervisor.writes
        self._is_reported = False

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """The outputs of the supervisor, the first time with the report."""
        outputs = [*self._supervisor.step(now_ns, inbox)]
        if not self._is_reported:
            fault = Fault(
                now_ns, "safety.ablation", "supervisor", Severity.WARNING, False, Response.NONE, True, TEXT_EN, TEXT_ZH
            )
            outputs.append(("fault/supervisor", fault))
        self._is_reported = True
        return outputs
