"""Self-test of the controls: each order goes its way to the order gate, which verifies it and does nothing."""

from hmi.drive_view.controls import NUDGES, ORDERS
from hmi.orders import OrderSender, SentOrder, outcome
from hmi.page_state import PageState
from messages.command import OrderStatus

TESTED = (*ORDERS, "nudge")
GAP_NS = 300_000_000  # between two orders: the gate takes five in a second


class SelfTest:
    """Results by order, as of `outcome`; "" while one waits."""

    def __init__(self) -> None:
        self.results: dict[str, str] = {}
        self._sent: SentOrder | None = None
        self._sent_ns = 0  # by the clock of the order gate, which counts the orders in a second

    def begin(self) -> None:
        """Begins with the first control."""
        self.results, self._sent = dict.fromkeys(TESTED, ""), None

    def step(self, state: PageState, sender: OrderSender, valid_s: float) -> None:
        """Takes an answer, and sends the next order."""
        sent = self._sent
        if sent is not None and not self.results[sent.order]:
            self.results[sent.order] = outcome(sent, state) or ""
            return
        order = next((one for one in self.results if not self.results[one]), None)
        status = state.fresh("order_status", OrderStatus)
        if order is None:
            return
        if status is None:
            self.results[order] = "unanswered"
            return
        if sent is not None and 0 <= status.stamp_ns - self._sent_ns < GAP_NS:
            return
        self._sent_ns = status.stamp_ns
        left_m = NUDGES["nudge_left"] if order == "nudge" else None
        self._sent = sender.send(order, status, state.now_ns, valid_s, left_m, is_check=True)
