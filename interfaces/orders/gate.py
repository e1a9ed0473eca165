"""Order gate: the only writer of operator commands; what it does not accept reaches neither supervisor nor mission."""

from collections import Counter
from collections.abc import Iterable

from interfaces.orders.port import OrderPort
from interfaces.orders.verifier import OrderVerifier, Reason, Refusal, unsigned_stop
from messages.command import (
    Mode,
    OperatorCommand,
    OperatorCommandKind,
    OrderStatus,
    RefusedOrders,
    SignedOrder,
    SupervisorState,
)
from messages.fault_reporter import FaultReporter, FaultType
from messages.faults import Response, Severity
from messages.node import All, Every, Inbox, Latest, Node, Output, Read
from messages.plan import MissionStatus, PathSectionType

PERIOD_NS = 10_000_000
STATUS_NS = 100_000_000
MAX_ORDERS = 400  # read in a step: an emergency stop is found behind a flood of others
MAX_VERIFIED = 8  # in a step: a signature takes 0.2 ms
TOPIC = "order/operator"
ENGAGED = (Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP)

TEXTS = {
    Reason.MALFORMED: ("Order refused: not readable", "指令被拒绝:无法读取"),
    Reason.UNKNOWN_KEY: ("Order refused: key not known", "指令被拒绝:未知密钥"),
    Reason.FORGED: ("Order refused: signature wrong", "指令被拒绝:签名错误"),
    Reason.WRONG_MACHINE: ("Order refused: for another machine", "指令被拒绝:属于其他机器"),
    Reason.WRONG_SESSION: ("Order refused: from before the last start", "指令被拒绝:早于本次启动"),
    Reason.NOT_PERMITTED: ("Order refused: not permitted to this key", "指令被拒绝:该密钥无权限"),
    Reason.STALE: ("Order refused: expired, or valid for too long", "指令被拒绝:已过期或有效期过长"),
    Reason.REPLAYED: ("Order refused: repeated", "指令被拒绝:重复"),
    Reason.REORDERED: ("Order refused: older than the last one", "指令被拒绝:早于上一条指令"),
    Reason.TOO_FREQUENT: ("Orders refused: too many", "指令被拒绝:过于频繁"),
    Reason.NOT_STORED: ("Order refused: its number cannot be stored", "指令被拒绝:无法保存序号"),
    Reason.FORBIDDEN: ("Order refused: operation is forbidden", "指令被拒绝:已禁止作业"),
    Reason.NOT_ON_SWATH: (
        "Nudge refused: no row is driven in automatic operation",
        "微调被拒绝:未在自动模式下沿作业行行驶",
    ),
    Reason.OUT_OF_RANGE: ("Nudge refused: largest shift of the line reached", "微调被拒绝:已达最大横移量"),
}
FAULTS = {
    reason: FaultType(f"orders.{reason}", Severity.WARNING, Response.NONE, *texts) for reason, texts in TEXTS.items()
}
LOST = FaultType(
    "orders.lost_operator", Severity.ALARM, Response.CONTROLLED_STOP, "The operator's page no longer answers",
    "操作员页面不再应答", is_latched=True,
)  # fmt: skip


class OrderGate(Node):
    """Verifies the orders of topic and port; a refused order is counted and reported with its reason.

    In automatic operation whose operator is lost the machine is stopped by a fault.
    """

    def __init__(
        self, machine: str, session: str, verifier: OrderVerifier, report_s: float, max_shift_m: float,
        port: OrderPort | None = None,
    ) -> None:  # fmt: skip
        self.name = "orders"
        self.reads: dict[str, Read] = {TOPIC: All(MAX_ORDERS), "supervisor": Latest(), "mission": Latest()}
        self.writes = ("operator_command", "order_status", "fault/orders")
        self.runs = Every(PERIOD_NS)
        self._machine, self._session = machine, session
        self._verifier, self._port = verifier, port
        self._max_shift_m = max_shift_m
        self._report_ns = round(report_s * 1e9)
        self._faults = FaultReporter(self.name)
        self._accepted = 0
        self._refused: Counter[Reason] = Counter()
        self._refused_ns: dict[Reason, int] = {}
        self._status: OrderStatus | None = None

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Verifies what has come; emergency stops first."""
        orders = list(inbox.all(TOPIC, SignedOrder))
        if self._port is not None:
            orders += self._port.receive(now_ns, MAX_ORDERS, self._newest_status(now_ns))
        stops: list[OperatorCommand] = []
        others: list[SignedOrder] = []
        for order in orders:
            stop = unsigned_stop(now_ns, order)
            if stop is None:
                others.append(order)
            else:
                stops.append(stop)
        commands = [*stops[:1], *(c for order in others[:MAX_VERIFIED] if (c := self._verified(now_ns, order, inbox)))]
        if others[MAX_VERIFIED:]:
            self._refuse(now_ns, Reason.TOO_FREQUENT, f"{len(others)} at once", len(others) - MAX_VERIFIED)
        self._watch_operator(now_ns, inbox)
        self._accepted += len(commands)
        outputs: list[Output] = [("operator_command", command) for command in commands]
        return outputs + self._reports(now_ns)

    def _verified(self, now_ns: int, order: SignedOrder, inbox: Inbox) -> OperatorCommand | None:
        try:
            command = self._verifier.command(now_ns, order)
            if command is not None and command.kind is OperatorCommandKind.NUDGE:
                self._check_nudge(command, inbox)
        except Refusal as refusal:
            self._refuse(now_ns, refusal.reason, str(refusal))
            return None
        return command

    def _check_nudge(self, command: OperatorCommand, inbox: Inbox) -> None:
        """Raises Refusal unless a swath is driven and its line stays within the largest shift."""
        supervisor, mission = inbox.latest("supervisor", SupervisorState), inbox.latest("mission", MissionStatus)
        is_driven = supervisor is not None and supervisor.mode is Mode.AUTOMATIC
        if mission is None or not is_driven or mission.section_type is not PathSectionType.SWATH:
            raise Refusal(Reason.NOT_ON_SWATH, f"{command.left_m:+.3f} m")
        if abs(mission.shift_left_m + command.left_m) > self._max_shift_m + 1e-6:
            raise Refusal(Reason.OUT_OF_RANGE, f"{mission.shift_left_m:+.3f} {command.left_m:+.3f} m")

    def _watch_operator(self, now_ns: int, inbox: Inbox) -> None:
        """Reports a lost operator while the machine is in automatic operation, until an order comes again."""
        supervisor = inbox.latest("supervisor", SupervisorState)
        if not self._verifier.attendance.is_lost(now_ns):
            self._faults.clear(LOST.code)
        elif supervisor is not None and supervisor.mode in ENGAGED:
            self._faults.set(LOST)

    def _refuse(self, now_ns: int, reason: Reason, detail: str, count: int = 1) -> None:
        self._refused[reason] += count
        self._refused_ns[reason] = now_ns
        self._faults.set(FAULTS[reason], True, detail)

    def _reports(self, now_ns: int) -> list[Output]:
        for reason, at_ns in self._refused_ns.items():
            if abs(now_ns - at_ns) > self._report_ns:
                self._faults.clear(FAULTS[reason].code)
        outputs: list[Output] = [("fault/orders", fault) for fault in self._faults.take(now_ns)]
        before, status = self._status, self._newest_status(now_ns)
        is_due = before is None or outputs or abs(now_ns - before.stamp_ns) >= STATUS_NS
        if is_due:
            self._status = status
            outputs.append(("order_status", status))
        return outputs

    def _newest_status(self, now_ns: int) -> OrderStatus:
        refused = tuple(RefusedOrders(reason.value, count) for reason, count in sorted(self._refused.items()))
        verifier = self._verifier
        return OrderStatus(
            now_ns, self._machine, self._session, self._accepted, refused, verifier.is_forbidden, verifier.checked
        )
