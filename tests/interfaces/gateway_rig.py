"""Gateway on a virtual bus with a tractor implemented by cantools."""

from dataclasses import replace

import can
import pytest

from configs.strict import CONFIGS, load, parse, read_yaml
from configs.vehicle import Vehicle
from interfaces.gateway import Gateway, GatewayConfig
from interfaces.isobus.checksum import protect
from messages.command import Mode, SafeCommand
from messages.faults import Fault
from tests.interfaces import dbc

MS = 1_000_000
TICK = 10 * MS
START = 77_000 * MS
VEHICLE = load(Vehicle, CONFIGS / "machines" / "tractor_e.yaml")
CONFIG = parse(GatewayConfig, read_yaml(CONFIGS / "stack/interfaces.yaml")["gateway"], "stack/interfaces.yaml")
DRIVE = SafeCommand(
    stamp_ns=0,
    mode=Mode.AUTOMATIC,
    is_drive_enabled=True,
    speed_mps=2.0,
    deceleration_mps2=0.0,
    curvature_radpm=0.1,
    is_implement_lowered=True,
    is_pto_on=True,
    is_park_brake_set=False,
    is_horn_on=False,
    is_beacon_on=True,
    reason="",
)
HOLD = replace(DRIVE, mode=Mode.STANDBY, is_drive_enabled=False, speed_mps=0.0, deceleration_mps2=1.0)


class Inbox:
    def __init__(self, command, now_ns):
        self.command, self.now_ns = command, now_ns

    def latest(self, topic, kind):
        assert topic == "safe_command"
        command = self.command
        return None if command is None or abs(self.now_ns - command.stamp_ns) > 100 * MS else command


class Rig:
    """Gateway, bus and tractor; `values` are the values sent by the tractor, by message."""

    def __init__(self, **changes):
        self.bus = can.Bus(f"rig{id(self)}", interface="virtual")
        self.tractor = can.Bus(f"rig{id(self)}", interface="virtual")
        self.gateway = Gateway(self.bus, VEHICLE, CONFIG.model_copy(update=changes))
        self.now_ns = START
        self.sent: list[tuple[int, int, bytes]] = []
        self.outputs = []
        self.command = None
        self.counter = 0
        self.is_talking = True
        self.values = {
            "GuidanceMachineStatus": {
                "EstimatedCurvature": -50,
                "MechanicalLockout": 0,
                "SteeringReady": 1,
                "LimitStatus": 0,
                "ExitCode": 0,
            },
            "WheelBasedSpeed": {"Speed": 0.0, "Direction": 1},
            "RearHitchStatus": {"Position": 100, "InWork": 0, "LimitStatus": 0},
            "RearPtoStatus": {"Speed": 0, "Engaged": 0, "LimitStatus": 0},
        }
        self.driver_steering = {"Group": 1, "HandTorque": 0, "HandAngle": 0, "HandRate": 0}
        self.cab = {
            "Group": 2,
            "BrakePedal": 0,
            "ClutchPedal": 0,
            "SupplyVoltage": 13.8,
            "Seat": 0,
            "EmergencyButton": 0,
            "ParkBrakeState": 1,
            "HornState": 0,
            "BeaconState": 0,
        }
        self.fold = None
        self.beat = 250

    def close(self):
        self.bus.shutdown()
        self.tractor.shutdown()

    def send(self, name, data):
        self.tractor.send(can.Message(arbitration_id=dbc.identifier(name), data=data, is_extended_id=True))

    def talk(self):
        for name, values in self.values.items():
            self.send(name, dbc.encode(name, **values))
        self.counter += 1
        for values in (
            (self.driver_steering, self.cab) if self.fold is None else (self.driver_steering, self.cab, self.fold)
        ):
            body = dbc.encode("CabState", Counter=0, Checksum=0, **values)[:7]
            self.send("CabState", protect(dbc.identifier("CabState"), body, self.counter))
        self.beat = (self.beat + 1) % 251
        self.send("HeartbeatTractor", bytes([self.beat]))

    def step(self, command=None):
        """One step; a command is stamped now."""
        if command is not None:
            self.command = replace(command, stamp_ns=self.now_ns)
        if self.is_talking and (self.now_ns - START) % (100 * MS) == 0:
            self.talk()
        self.outputs += self.gateway.step(self.now_ns, Inbox(self.command, self.now_ns))
        while (m := self.tractor.recv(0)) is not None:
            self.sent.append((self.now_ns, m.arbitration_id, bytes(m.data)))
        self.now_ns += TICK

    def forward(self, ms, command=None):
        """Advances the time with a command every 20 ms."""
        for k in range(ms // 10):
            self.step(command if k % 2 == 0 else None)

    def read(self, name):
        """All frames of one message: (time, values)."""
        return [(t, dbc.decode(name, d)) for t, i, d in self.sent if i == dbc.identifier(name)]

    def newest(self, name):
        return self.read(name)[-1][1]

    @property
    def state(self):
        return [m for topic, m in self.outputs if topic == "machine"][-1]

    @property
    def faults(self):
        on = {}
        for _, m in self.outputs:
            if isinstance(m, Fault):
                on[m.code] = m.is_active
        return {code for code, is_active in on.items() if is_active}


def engaged(rig, command=DRIVE):
    rig.forward(400, HOLD)
    rig.forward(400, command)
    return rig


def is_released(rig):
    return (
        rig.newest("GuidanceSystemCommand")["Intent"] == 3
        and rig.newest("MachineSelectedSpeedCommand")["SetPoint"] > 64.255
        and rig.newest("ExternalBrakeRequest")["ControlMode"] == 0
        and rig.newest("AuxiliaryCommand")["DriveEnable"] == 0
        and rig.newest("HitchAndPtoCommands")["RearPtoEngage"] == 3
        and rig.newest("StopAllImplements")["Permit"] == 3
    )


def is_stopped(rig):
    return (
        rig.newest("GuidanceSystemCommand")["Intent"] == 0
        and rig.newest("MachineSelectedSpeedCommand")["SetPoint"] == 0
        and rig.newest("ExternalBrakeRequest")["Acceleration"] == pytest.approx(-CONFIG.full_brake_mps2, abs=1e-3)
        and rig.newest("ExternalBrakeRequest")["ControlMode"] == 2
        and rig.newest("AuxiliaryCommand")["DriveEnable"] == 0
        and rig.newest("HitchAndPtoCommands")["RearPtoEngage"] == 0
        and rig.newest("StopAllImplements")["Permit"] == 0
    )
