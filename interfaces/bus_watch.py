"""Bus watch: recognizes other senders that act as the gateway or the tractor, foreign commands, floods and bus-off.

A CAN bus has no authentication: whoever is on it can send anything. What it cannot do is send unseen.
"""

from collections import Counter, deque

from pydantic import Field

from configs.strict import Config
from interfaces.isobus import address, brake, cab, guidance, heartbeat, implement, speed
from interfaces.isobus.frame import decode_identifier
from messages.fault_reporter import FaultType
from messages.faults import Response, Severity

BUS_OFF, RESTARTED = 0x40, 0x100  # error classes of SocketCAN
CATCH_UP = 3  # windows after a halt of this process in which its backlog is read
TRACTOR_GROUPS = (
    guidance.STATUS_GROUP, speed.WHEEL_GROUP, implement.REAR_HITCH_GROUP, implement.REAR_PTO_GROUP, cab.GROUP,
    heartbeat.GROUP,
)  # fmt: skip
MAX_BEAT_AGE_NS = 150_000_000  # one and a half periods of the heartbeat
COMMANDS = {
    guidance.COMMAND_GROUP: "guidance",
    speed.COMMAND_GROUP: "speed",
    implement.COMMAND_GROUP: "hitch and PTO",
    brake.GROUP: "brake",
}

_ALARM, _STOP = Severity.ALARM, Response.CONTROLLED_STOP
FOREIGN_SOURCE = FaultType("gateway.foreign_source", _ALARM, _STOP, "Another sender uses the gateway's address",
                           "其他节点使用网关地址发送")  # fmt: skip
FOREIGN_COMMAND = FaultType("gateway.foreign_command", _ALARM, _STOP, "Another sender commands the machine",
                            "其他节点向机器发送指令")  # fmt: skip
SECOND_TRACTOR = FaultType("gateway.second_tractor", _ALARM, _STOP, "Another sender uses the tractor's address",
                           "其他节点使用拖拉机地址发送")  # fmt: skip
FLOOD = FaultType("gateway.flood", _ALARM, _STOP, "More frames than the machine bus carries in regular operation",
                  "机器总线帧数超出正常范围")  # fmt: skip
BUS = FaultType("gateway.bus", _ALARM, _STOP, "Machine bus failed", "机器总线故障")
FAULTS = (FOREIGN_SOURCE, FOREIGN_COMMAND, SECOND_TRACTOR, FLOOD, BUS)


class BusWatchConfig(Config):
    """What is regular on the bus."""

    max_frames: int = Field(
        ge=10, le=10_000, description="error frames, and frames other than the tractor's known ones, within window_s"
    )
    window_s: float = Field(ge=0.02, le=0.2)
    tractor_frames: int = Field(ge=2, le=100, description="frames of one message within two heartbeats of the tractor")
    cab_frames: int = Field(ge=3, le=100, description="the same for each group of the cab message")
    hold_s: float = Field(ge=0.2, le=10.0, description="a fault lasts for this long after its last sign")


class BusWatch:
    """Times and details of the last sign of each fault."""

    def __init__(self, tractor_address: int, config: BusWatchConfig) -> None:
        self._config = config
        self._seen: dict[str, tuple[int, str]] = {}
        self._count = 0  # frames of this step
        self._steps: deque[tuple[int, int, int]] = deque()  # time of a step, time since the one before, frames
        self._tractor = TractorFrames(tractor_address, config)
        self._is_bus_off = False

    def receive(self, now_ns: int, own_address: int, is_claimed: bool, identifier: int, data: bytes) -> None:
        """Judges one frame that another node sent."""
        group, source = decode_identifier(identifier)[1:3]
        self._count += not self._tractor.is_counted(group, source)
        is_claim = group == address.CLAIM_GROUP
        if source == own_address and (is_claimed or not is_claim):  # before, a claim is regular contention
            self._see(now_ns, FOREIGN_SOURCE, f"PGN {group}")
        elif group in COMMANDS:
            self._see(now_ns, FOREIGN_COMMAND, f"{COMMANDS[group]}, PGN {group} from address {source}")
        elif (excess := self._tractor.receive(now_ns, group, source, data)) is not None:
            self._see(now_ns, SECOND_TRACTOR, excess)

    def receive_error(self, error_class: int) -> None:
        """Processes an error frame of the controller."""
        self._count += 1
        if error_class & (BUS_OFF | RESTARTED):
            self._is_bus_off = bool(error_class & BUS_OFF)

    def step(self, now_ns: int, is_failed: bool) -> None:
        """Ends the reception of one step; `is_failed`: sending or receiving was refused.

        After a halt of this process the frames of its duration come at once.
        """
        if self._is_bus_off or is_failed:
            self._see(now_ns, BUS, "bus-off" if self._is_bus_off else "")
        since_ns = abs(now_ns - self._steps[-1][0]) if self._steps else 0
        self._steps.append((now_ns, since_ns, self._count))
        self._count = 0
        window_ns = round(self._config.window_s * 1e9)
        while abs(now_ns - self._steps[0][0]) >= CATCH_UP * window_ns:
            self._steps.popleft()
        total = sum(count for at_ns, _, count in self._steps if now_ns - at_ns < window_ns)
        span_ns = max(window_ns, *(since for _, since, _ in self._steps))
        if total * window_ns > self._config.max_frames * span_ns:
            self._see(now_ns, FLOOD, f"{total} in {span_ns * 1e-9:.1f} s")

    def states(self, now_ns: int) -> list[tuple[FaultType, bool, str]]:
        """State and detail of every fault."""
        hold_ns = self._config.hold_s * 1e9
        seen = {code: detail for code, (at_ns, detail) in self._seen.items() if abs(now_ns - at_ns) <= hold_ns}
        return [(fault, fault.code in seen, seen.get(fault.code, "")) for fault in FAULTS]

    def is_contested(self, now_ns: int) -> bool:
        """Whether the bus cannot be trusted now: the machine must stop."""
        return any(is_active for _, is_active, _ in self.states(now_ns))

    def _see(self, now_ns: int, fault: FaultType, detail: str) -> None:
        self._seen[fault.code] = (now_ns, detail)


class TractorFrames:
    """Counts the tractor's frames by its own clock, the heartbeat.

    A halted computer or bus therefore delays frames without making them too many. Nothing is judged without heartbeat.
    """

    def __init__(self, tractor_address: int, config: BusWatchConfig) -> None:
        self._address, self._config = tractor_address, config
        self._name: bytes | None = None
        self._beat, self._beat_ns = heartbeat.ERROR, 0
        self._before: Counter[tuple[int, int]] = Counter()
        self._now: Counter[tuple[int, int]] = Counter()

    def is_counted(self, group: int, source: int) -> bool:
        """Whether it is a frame of the tractor that is judged by the heartbeat, and so belongs to no flood."""
        return source == self._address and group in TRACTOR_GROUPS

    def receive(self, now_ns: int, group: int, source: int, data: bytes) -> str | None:
        """Processes a frame; what shows a second sender, or None."""
        if source != self._address:
            return None
        if group == address.CLAIM_GROUP:
            before, self._name = self._name, data
            return None if before in (None, data) else "address claim with another NAME"
        if group == heartbeat.GROUP:
            self._take_beat(now_ns, data)
            return None
        key = group, data[0] if group == cab.GROUP and data else 0
        self._now[key] += 1
        count = self._now[key] + self._before[key]
        most = self._config.cab_frames if group == cab.GROUP else self._config.tractor_frames
        is_excess = count > most and abs(now_ns - self._beat_ns) <= MAX_BEAT_AGE_NS
        return f"{count} frames of PGN {group} within two heartbeats" if is_excess else None

    def _take_beat(self, now_ns: int, data: bytes) -> None:
        """Starts an interval; after a lost or late heartbeat both counts start at 0."""
        beat = data[0] if data else heartbeat.ERROR
        is_next = beat == heartbeat.after(self._beat) and abs(now_ns - self._beat_ns) <= MAX_BEAT_AGE_NS
        self._before, self._now = self._now if is_next else Counter(), Counter()
        self._beat, self._beat_ns = beat, now_ns
