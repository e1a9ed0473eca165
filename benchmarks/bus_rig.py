"""Rigs of `benchmarks.bus_attacks`: gateway and simulated tractor on a loopback bus, and the order gate at its port."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from configs.site import PoseConfig, Site
from configs.strict import find, load, parse
from configs.vehicle import ImplementFile, Sensors, Vehicle
from interfaces.engagement import Phase
from interfaces.gateway import Gateway
from interfaces.orders.config import OrderKey, OrdersConfig
from interfaces.orders.gate import OrderGate
from interfaces.orders.port import OrderPort
from interfaces.orders.sequence import SequenceStore
from interfaces.orders.verifier import OrderVerifier
from messages.command import Mode, OperatorCommand, OrderStatus, SafeCommand
from messages.faults import Fault, Response
from runtime.live.can_bus import LOOPBACK, named_bus, open_bus
from runtime.stack import load_stack
from safety.stopping_distance import stopping_distance
from simulation.operator import SimulatedOperator, public_bytes
from simulation.plant import Plant, PlantModels
from simulation.scenario import Scenario
from simulation.world import SimulationWorld

MS = 1_000_000
STEP_NS = 20 * MS
REACTION_NS = 100 * MS  # of the supervisor's stand-in
START = PoseConfig(x_m=20.0, y_m=20.0, heading_deg=0.0)


class BusRig:
    """Gateway and tractor; the gateway's safe commands ask for `target_mps`, and for a stop after a fault."""

    def __init__(self) -> None:
        stack = load_stack()
        self._braking = stack.safety.braking.flat
        site, vehicle = load(Site, find("sites", "demo")), load(Vehicle, find("machines", "tractor_e"))
        implement = load(ImplementFile, find("implements", "harrow_6m")).implement
        config = stack.simulation
        models = PlantModels(config.machine, config.gnss, config.imu)
        plant = Plant(site, vehicle.model_copy(update={"sensors": Sensors()}), implement, models, START)
        scenario = parse(Scenario, {"name": "bus", "operator_commands": []}, "bus")
        self.bus_name = named_bus(LOOPBACK)
        self._bus = open_bus(self.bus_name)
        operator = SimulatedOperator(1, "bus", "00")
        self._world = SimulationWorld(plant, scenario, (), open_bus(self.bus_name), 1, config, False, operator)
        self._vehicle, self._config = vehicle, stack.interfaces.gateway
        self._gateway = Gateway(self._bus, vehicle, self._config)
        self.now_ns = config.start_stamp_ns
        self._command: SafeCommand | None = None
        self._target_mps = 0.0
        self.faults: dict[str, int] = {}
        self.first_ns: dict[str, int] = {}
        self.travelled_m = 0.0

    @property
    def speed_mps(self) -> float:
        """True speed."""
        return abs(self._world.machine.speed_mps)

    @property
    def is_standing(self) -> bool:
        """Whether the machine is at standstill."""
        return self.speed_mps < 0.01

    def stopping_distance_m(self) -> float:
        """S at the present speed, as the supervisor counts it on level ground."""
        return stopping_distance(self.speed_mps, self._braking)

    def latest(self, topic: str, kind: type[Any]) -> Any:
        """The gateway's input."""
        return self._command

    def drive(self, speed_mps: float) -> None:
        """Waits for a quiet bus, engages and sets off at full speed from the start."""
        self._target_mps = 0.0
        self._wait(lambda: self.is_standing)
        if self._gateway._claim.address(self.now_ns) != self._config.address:  # lost to a replayed claim
            self._gateway, self.faults = Gateway(self._bus, self._vehicle, self._config), {}
        self._wait(lambda: not self.faults and self._gateway._claim.address(self.now_ns) is not None)
        for _ in range(60):  # the tractor leaves its safe state: 8 heartbeats without a drive request
            self.step()
        self.first_ns = {}
        self._target_mps = speed_mps
        self._wait(lambda: self._gateway._engagement.phase is Phase.ACTIVE)
        machine = self._world.machine
        machine.x_m, machine.y_m, machine.yaw_rad = START.x_m, START.y_m, 0.0
        machine.speed_mps = machine.wheel_speed_mps = machine.drive._reference_mps = speed_mps
        for _ in range(10):
            self.step()

    def _wait(self, is_ready: Any) -> None:
        for _ in range(1000):
            self.step()
            if is_ready():
                return
        raise SystemExit(f"the rig is not ready: {self.faults}, {self.first_ns}, {self._gateway._engagement.phase}")

    def step(self) -> None:
        """20 ms of tractor and gateway."""
        self.now_ns += STEP_NS
        before = np.array([self._world.machine.x_m, self._world.machine.y_m])
        list(self._world.step(self.now_ns))
        after = np.array([self._world.machine.x_m, self._world.machine.y_m])
        self.travelled_m += float(np.linalg.norm(after - before)) if np.linalg.norm(after - before) < 1.0 else 0.0
        self._command = self._safe_command()
        for _, message in self._gateway.step(self.now_ns, self):  # type: ignore[arg-type]
            if isinstance(message, Fault):
                self._take(message)

    def _take(self, fault: Fault) -> None:
        if not fault.is_active:
            self.faults.pop(fault.code, None)
        elif fault.response >= Response.CONTROLLED_STOP:
            self.faults[fault.code] = self.now_ns
            self.first_ns.setdefault(fault.code, self.now_ns)

    def _safe_command(self) -> SafeCommand:
        command = SafeCommand(
            self.now_ns, Mode.STANDBY, False, 0.0, 1.0, 0.0, False, False, False, False, False, ""
        )  # fmt: skip
        first_ns = min(self.first_ns.values(), default=self.now_ns)
        if self._target_mps == 0.0:
            return command
        if self.now_ns - first_ns > REACTION_NS:
            return replace(command, mode=Mode.FAULT_STOP, deceleration_mps2=self._braking.deceleration_mps2)
        return replace(
            command, mode=Mode.AUTOMATIC, is_drive_enabled=True, speed_mps=self._target_mps, deceleration_mps2=0.0
        )

    def close(self) -> None:
        """Closes both ends of the bus."""
        self._world.close()
        self._bus.shutdown()


class OrderRig:
    """Order gate at a port, with one key; `folder` keeps the sequence numbers over the runs of the benchmark."""

    def __init__(self, folder: Path) -> None:
        self._key = Ed25519PrivateKey.generate()
        self._session = "benchmark"
        key = OrderKey(public_key=public_bytes(self._key).hex(), authority="remote", orders=("start", "pause"))
        config = load_stack().interfaces.orders.model_copy(update={"keys": {"remote": key}})
        verifier = OrderVerifier("bench-1", self._session, OrdersConfig.model_validate(config), SequenceStore(folder))
        self._port = OrderPort(0)
        self._gate = OrderGate("bench-1", self._session, verifier, config.report_s, 0.0, self._port)
        self.port, self.now_ns, self._sequence = self._port.number, 10**18, 0
        self._sent: list[bytes] = []
        self.accepted = self.refused = 0
        self.faults: set[str] = set()

    def all(self, topic: str, kind: type[Any]) -> tuple[()]:
        """The topic carries nothing here."""
        return ()

    def latest(self, topic: str, kind: type[Any]) -> None:
        """There is no supervisor here."""

    def step(self, seconds: float = 0.01) -> None:
        """Steps of 10 ms."""
        for _ in range(max(1, round(seconds * 100))):
            self.now_ns += 10 * MS
            for _, message in self._gate.step(self.now_ns, self):  # type: ignore[arg-type]
                self._take(message)

    def _take(self, message: Any) -> None:
        if isinstance(message, OperatorCommand):
            self.accepted += 1
        elif isinstance(message, OrderStatus):
            self.refused = sum(one.count for one in message.refused)
        elif isinstance(message, Fault):
            (self.faults.add if message.is_active else self.faults.discard)(message.code)

    def content(self, **changes: Any) -> dict[str, Any]:
        """Payload of a new order."""
        self._sequence += 1
        content = {
            "machine": "bench-1", "session": self._session, "authority": "remote", "sequence": self._sequence,
            "order": "start", "signed_ns": self.now_ns, "expires_ns": self.now_ns + 10**10,
        }  # fmt: skip
        return content | changes

    def signed(self, **changes: Any) -> bytes:
        """Datagram of an order that the key's owner signed."""
        payload = json.dumps(self.content(**changes)).encode()
        datagram = self._key.sign(payload) + public_bytes(self._key) + payload
        if not changes:
            self._sent.append(datagram)
        return datagram

    def earlier(self, random: np.random.Generator) -> bytes:
        """One of the orders sent before."""
        return self._sent[int(random.integers(len(self._sent)))]

    def close(self) -> None:
        """Closes the port."""
        self._port.close()
