"""`headland shadow --bus`: logs every frame of a machine's CAN bus without sending."""

import argparse
import json
import sys
import time
from typing import Any

import can

from datasets.log import LogWriter
from interfaces.can_receiver import CanReceiver
from messages.command import CanFrame, CanFrames, MachineState
from messages.errors import HeadlandError
from messages.message import Envelope, Message
from runtime.interruption import Interruption
from runtime.live.clock import Clock
from runtime.run_folder import RunFolder, versions
from runtime.stack import load_stack

STATE_NS, FRAMES_NS, LINE_NS = 20_000_000, 100_000_000, 1_000_000_000
WAIT_S = 0.01


class Listener:
    """Converts CAN frames into log messages; has no access to a transmitter."""

    def __init__(self, tractor_address: int, own_address: int) -> None:
        self.receiver = CanReceiver(tractor_address)
        self.count = 0
        self._own_address = own_address
        self._frames: list[CanFrame] = []
        self._state_ns = self._frames_ns = 0

    def receive(self, now_ns: int, frame: can.Message) -> None:
        """Decodes and stores one frame."""
        self.count += 1
        if frame.is_error_frame or frame.is_remote_frame or not frame.is_extended_id:
            self.receiver.rejected += frame.is_error_frame
            return
        data = bytes(frame.data)
        self._frames.append(CanFrame(now_ns, frame.arbitration_id, data))
        self.receiver.receive(now_ns, self._own_address, frame.arbitration_id, data)
        self.receiver.claims, self.receiver.is_claim_requested = (
            [],
            False,
        )  # never answered

    def due(self, now_ns: int) -> list[tuple[str, Message]]:
        """Messages to log at `now_ns`: machine state at 50 Hz, frames at 10 Hz."""
        outputs: list[tuple[str, Message]] = []
        if now_ns - self._state_ns >= STATE_NS:
            self._state_ns = now_ns
            outputs.append(("machine", self.receiver.state(now_ns)))
        if now_ns - self._frames_ns >= FRAMES_NS:
            self._frames_ns = now_ns
            outputs.append(("can/rx", CanFrames(now_ns, "machine", tuple(self._frames))))
            self._frames = []
        return outputs


def log_bus(
    arguments: argparse.Namespace, folder: RunFolder, interruption: Interruption, bus: can.BusABC, name: str
) -> int:
    """Logs until interrupted or for the given time; 0 if a frame was received."""
    stack = load_stack()
    addresses = stack.interfaces.gateway
    listener = Listener(addresses.tractor_address, addresses.address)
    conditions = versions()
    folder.record("conditions", conditions | {"bus": name})
    with LogWriter(folder.file("log.mcap"), {"run": conditions}, stack.datasets.log, rotates=True) as log:
        _record(bus, listener, log, arguments.duration, interruption)
    state = listener.receiver.state(0)
    result: dict[str, Any] = {
        "frames": listener.count, "rejected": state.rejected_frames, "run_dir": str(folder.path),
    }  # fmt: skip
    folder.record("result", {"result": result})
    folder.finish()
    sys.stdout.write(json.dumps(result) + "\n" if arguments.json else _summary(result))
    return 0 if listener.count else 1


def _record(
    bus: can.BusABC, listener: Listener, log: LogWriter, duration_s: float | None, interruption: Interruption
) -> None:
    clock = Clock(time.time_ns(), time.monotonic_ns())
    began_ns = printed_ns = clock()
    sequence: dict[str, int] = {}
    while not interruption.is_requested and (duration_s is None or clock() - began_ns < duration_s * 1e9):
        frame = _receive(bus)
        now_ns = clock()
        if frame is not None:
            listener.receive(now_ns, frame)
        for topic, message in listener.due(now_ns):
            sequence[topic] = sequence.get(topic, -1) + 1
            log.write(Envelope(topic, sequence[topic], now_ns, message))
        if now_ns - printed_ns >= LINE_NS:
            printed_ns = now_ns
            sys.stderr.write(_status_line(listener.count, listener.receiver.state(now_ns)))


def _receive(bus: can.BusABC) -> can.Message | None:
    try:
        return bus.recv(WAIT_S)
    except can.CanError as error:
        raise HeadlandError(f"CAN bus error: {error}") from error


def _status_line(count: int, state: MachineState) -> str:
    return (
        f"{count} frames, {state.rejected_frames} rejected; {3.6 * state.speed_mps:.1f} km/h, curvature "
        f"{state.curvature_radpm:+.3f} 1/m, hitch {state.hitch:.0%}, {state.supply_v:.1f} V\n"
    )


def _summary(result: dict[str, Any]) -> str:
    return f"{result['frames']} frames received, {result['rejected']} rejected, none sent; {result['run_dir']}\n"
