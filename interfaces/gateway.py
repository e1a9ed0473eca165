"""Gateway: the only sender to the machine's bus; it transmits safe commands only.

Fail-silent: before the first safe command, and while a person drives, it sends "leave as is". 100 ms without a fresh
safe command after engagement cause a stop at full brake.
"""

import math
from collections.abc import Iterable
from typing import Protocol

import can
from pydantic import Field

from configs.strict import Config
from configs.vehicle import Vehicle
from interfaces.bus_watch import BusWatch, BusWatchConfig
from interfaces.can_receiver import CanReceiver
from interfaces.can_transmitter import ActualValues, CanTransmitter, commands_for, contested_commands
from interfaces.engagement import Engagement, Phase, Steering
from interfaces.isobus.address import AddressClaim
from interfaces.isobus.frame import Frame
from interfaces.isobus.heartbeat import GAP_NS
from interfaces.isobus.name import AGRICULTURE, Name
from messages.command import CanFrame, CanFrames, SafeCommand
from messages.fault_reporter import FaultReporter, FaultType
from messages.faults import Response, Severity
from messages.node import Every, Inbox, Latest, Node, Output

STATE_PERIOD_NS = 20_000_000
LOG_PERIOD_NS = 100_000_000
MAX_FRAMES = 64  # per step; a bus of 250 kbit/s carries 38 in 20 ms, and a flood must not delay the gateway
MAX_SPEED_MPS = 30.0
MAX_CURVATURE_RADPM = 1.0
MAX_DECELERATION_MPS2 = 12.0
_FUNCTION_NOT_AVAILABLE = 255

_STOP, _ALARM = Response.CONTROLLED_STOP, Severity.ALARM
SILENCE = FaultType("gateway.silence", _ALARM, _STOP, "No safe command received: stopping", "未收到安全指令:正在停车")
BAD_COMMAND = FaultType("gateway.bad_command", _ALARM, _STOP, "Safe command with a value that cannot be sent",
                        "安全指令含有无法发送的数值")  # fmt: skip
REFUSED = FaultType(
    "gateway.steering_refused", _ALARM, _STOP, "Steering does not accept commands", "转向系统不接受指令"
)
LOST = FaultType("gateway.steering_lost", _ALARM, _STOP, "Steering has left automatic mode", "转向系统已退出自动模式")
TRACTOR = FaultType("gateway.tractor_silent", _ALARM, _STOP, "Tractor heartbeat missing or wrong",
                    "拖拉机心跳信号缺失或错误")  # fmt: skip
ADDRESS = FaultType("gateway.address", _ALARM, _STOP, "No address obtained on the machine bus", "未能取得机器总线地址")


class GatewayConfig(Config):
    """Addresses, times and the brake demand without a safe command."""

    period_s: float = Field(ge=0.005, le=0.02)
    min_interval_s: float = Field(ge=0.01, le=0.1, description="least interval of a message with changing content")
    address: int = Field(ge=0, le=247)
    tractor_address: int = Field(ge=0, le=247)
    name_identity: int = Field(ge=0, lt=1 << 21)
    name_manufacturer: int = Field(ge=0, lt=1 << 11)
    full_brake_mps2: float = Field(ge=2.5, le=MAX_DECELERATION_MPS2)
    pto_rpm: float = Field(ge=100.0, le=1500.0)
    steering_accept_timeout_s: float = Field(
        ge=0.3, le=10.0, description="for the steering to accept the offered actual value"
    )
    steering_lost_timeout_s: float = Field(
        ge=0.1, le=1.0, description="for the supervisor to react to disengaged steering; then full brake"
    )
    watch: BusWatchConfig


class CanBus(Protocol):
    """Used part of the interface of a python-can bus."""

    def send(self, msg: can.Message) -> None:
        """Send one frame; raises CanError."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after the time-out; raises CanError."""


class Gateway(Node):
    """ISO 11783 node for one tractor on `bus`, which the assembly opens and closes."""

    def __init__(self, bus: CanBus, vehicle: Vehicle, config: GatewayConfig) -> None:
        self.name = "gateway"
        self.reads = {"safe_command": Latest()}
        self.writes = ("machine", "can/rx", "can/tx", "fault/gateway")
        self.runs = Every(round(config.period_s * 1e9))
        self._bus, self._config = bus, config
        self._claim = AddressClaim(_own_name(config), config.address)
        self._receiver = CanReceiver(config.tractor_address)
        self._watch = BusWatch(config.tractor_address, config.watch)
        self._engagement = Engagement()
        self._transmitter = CanTransmitter(vehicle, config.tractor_address, round(config.min_interval_s * 1e9))
        self._faults = FaultReporter(self.name)
        self._started_ns: int | None = None
        self._last_command: SafeCommand | None = None
        self._stepped_ns = self._state_ns = self._log_ns = 0
        self._received: list[CanFrame] = []
        self._sent: list[CanFrame] = []
        self._is_bus_failed = False

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Receives frames, updates the phase and sends due frames; returns at once while there is nothing new."""
        newest = inbox.latest("safe_command", SafeCommand)
        if newest is self._last_command and now_ns - self._stepped_ns < STATE_PERIOD_NS:
            return []
        self._last_command, self._stepped_ns = newest, now_ns
        if self._started_ns is None:
            self._started_ns = now_ns
            self._send(now_ns, self._claim.start(now_ns))
        self._receive(now_ns)
        self._answer_network(now_ns)
        command = newest if newest is not None and _is_sendable(newest, now_ns) else None
        self._command(now_ns, command)
        is_bad = newest is not None and command is None
        return self._outputs(now_ns, self._fault_states(now_ns, is_bad))

    def _receive(self, now_ns: int) -> None:
        address, count = self._claim.address(now_ns), 0
        try:
            while count < MAX_FRAMES and (message := self._bus.recv(0)) is not None:
                count += 1
                self._receive_frame(now_ns, address, message)
        except can.CanError:
            self._is_bus_failed = True
        self._watch.step(now_ns, self._is_bus_failed)  # with the sending of the step before
        self._is_bus_failed = False

    def _receive_frame(self, now_ns: int, address: int | None, message: can.Message) -> None:
        if message.is_error_frame:
            self._receiver.rejected += 1
            self._watch.receive_error(message.arbitration_id)
        elif message.is_extended_id and not message.is_remote_frame:
            data, own = bytes(message.data), self._config.address if address is None else address
            self._received.append(CanFrame(now_ns, message.arbitration_id, data))
            self._watch.receive(now_ns, own, address is not None, message.arbitration_id, data)
            self._receiver.receive(now_ns, own, message.arbitration_id, data)

    def _answer_network(self, now_ns: int) -> None:
        receiver = self._receiver
        answers = [self._claim.receive_claim(now_ns, source, name) for source, name in receiver.claims]
        if receiver.is_claim_requested:
            answers.append(self._claim.answer_request())
        receiver.claims, receiver.is_claim_requested = [], False
        for frame in answers:
            if frame is not None:
                self._send(now_ns, frame)

    def _command(self, now_ns: int, command: SafeCommand | None) -> None:
        receiver = self._receiver
        before = self._engagement.phase
        phase = self._engagement.step(now_ns, command, Steering(receiver.steering, receiver.steering_ns))
        address = self._claim.address(now_ns)
        if address is None:
            return
        is_contested = self._watch.is_contested(now_ns) and phase is not Phase.RELEASED
        is_lost = now_ns - self._engagement.since_ns > self._config.steering_lost_timeout_s * 1e9
        if is_contested or (phase is Phase.LOST and is_lost):
            command = None
        commands = commands_for(
            phase, command, self._actual_values(), self._config.full_brake_mps2, self._config.pto_rpm
        )
        commands = contested_commands(commands) if is_contested else commands
        for frame in self._transmitter.step(now_ns, address, commands, is_urgent=phase is not before):
            self._send(now_ns, frame)

    def _actual_values(self) -> ActualValues:
        receiver = self._receiver
        return ActualValues(
            receiver.steering.curvature_radpm if receiver.steering_ns else math.nan,
            receiver.speed_mps,
            receiver.hitch.position if receiver.hitch_ns else math.nan,
        )

    def _send(self, now_ns: int, frame: Frame) -> None:
        message = can.Message(arbitration_id=frame.identifier, data=frame.data, is_extended_id=True)
        message.data = frame.data  # type: ignore[assignment]  # bytes: the virtual bus copies a bytearray slowly
        try:
            self._bus.send(message)
        except can.CanError:
            self._is_bus_failed = True
            return
        self._sent.append(CanFrame(now_ns, frame.identifier, frame.data))

    def _fault_states(self, now_ns: int, is_bad_command: bool) -> list[tuple[FaultType, bool]]:
        phase, in_phase_ns = self._engagement.phase, now_ns - self._engagement.since_ns
        started_ns = now_ns if self._started_ns is None else self._started_ns
        is_started = now_ns - started_ns > GAP_NS
        return [
            (SILENCE, phase is Phase.SILENT),
            (BAD_COMMAND, is_bad_command),
            (REFUSED, phase is Phase.OFFERING and in_phase_ns > self._config.steering_accept_timeout_s * 1e9),
            (LOST, phase is Phase.LOST),
            (TRACTOR, is_started and not self._receiver.heartbeat.is_good(now_ns)),
            (ADDRESS, self._claim.is_refused),
        ]

    def _outputs(self, now_ns: int, states: list[tuple[FaultType, bool]]) -> list[Output]:
        for fault, is_active, detail in self._watch.states(now_ns):
            self._faults.set(fault, is_active, detail)
        outputs: list[Output] = [("fault/gateway", fault) for fault in self._faults.update(now_ns, states)]
        if now_ns - self._state_ns >= STATE_PERIOD_NS:
            self._state_ns = now_ns
            outputs.append(("machine", self._receiver.state(now_ns)))
        if now_ns - self._log_ns >= LOG_PERIOD_NS:
            self._log_ns = now_ns
            outputs += [("can/rx", CanFrames(now_ns, "machine", tuple(self._received))),
                        ("can/tx", CanFrames(now_ns, "machine", tuple(self._sent)))]  # fmt: skip
            self._received, self._sent = [], []
        return outputs


def _own_name(config: GatewayConfig) -> Name:
    return Name(
        identity=config.name_identity,
        manufacturer=config.name_manufacturer,
        ecu_instance=0,
        function_instance=0,
        function=_FUNCTION_NOT_AVAILABLE,
        device_class=0,
        device_class_instance=0,
        industry_group=AGRICULTURE,
        self_configurable=1,
    )


def _is_sendable(command: SafeCommand, now_ns: int) -> bool:
    """Whether every value fits into its frame and the stamp is not in the future."""
    return (
        command.stamp_ns <= now_ns
        and abs(command.speed_mps) <= MAX_SPEED_MPS
        and abs(command.curvature_radpm) <= MAX_CURVATURE_RADPM
        and 0.0 <= command.deceleration_mps2 <= MAX_DECELERATION_MPS2
    )
