"""A small farm and a gateway of cantools alone (nothing of interfaces/), to drive the simulated tractor in tests."""

import itertools

import can
import numpy as np

from configs.site import Site
from configs.strict import CONFIGS, find, load, parse, read_yaml
from configs.vehicle import ImplementFile, Vehicle
from messages.plan import Path, PathSection, PathSectionType
from simulation.machine.tractor_bus import load_database
from simulation.operator import SimulatedOperator
from simulation.plant import Plant, PlantModels, draw_plant
from simulation.scenario import Scenario
from simulation.world import Rendering, SimulationConfig, SimulationWorld

_CHANNELS = itertools.count()
IMPLEMENT = load(ImplementFile, find("implements", "harrow_6m")).implement
CONFIG = parse(SimulationConfig, read_yaml(CONFIGS / "stack/simulation.yaml"), "stack/simulation.yaml")
EMPTY = load(Scenario, find("scenarios", "empty"))
SITE = parse(
    Site,
    {
        "name": "test", "version": 1, "datum": {"latitude_deg": 51.5, "longitude_deg": 6.1, "height_m": 24.0},
        "boundary_m": [[-20.0, -30.0], [100.0, -30.0], [100.0, 30.0], [-20.0, 30.0]],
        "yard": {"name": "yard", "outline_m": [[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]]},
        "start": {"x_m": 0.0, "y_m": 0.0, "heading_deg": 0.0}, "is_fenced": True,
    },
    "test",
)  # fmt: skip


def flat(**sections):
    """The configuration with level ground, and values replaced by section."""
    even = {"grade": 0.0, "side_slope_deg": 0.0, "wave_amplitude_m": 0.0, "furrow_depth_m": 0.0}
    values = CONFIG.model_dump()
    values["terrain"].update(even)
    for name, changes in sections.items():
        for key, change in changes.items():
            values[name][key] = {**values[name][key], **change} if isinstance(change, dict) else change
    return parse(SimulationConfig, values, "test")


def machine_file(name="tractor_e", sensors=()):
    """A vehicle with these kinds of sensors alone."""
    vehicle = load(Vehicle, find("machines", name))
    kept = {kind: getattr(vehicle.sensors, kind) for kind in sensors}
    return vehicle.model_copy(update={"sensors": type(vehicle.sensors)(**kept)})


class Farm:
    """World and gateway on one bus; the gateway sends the values of its attributes."""

    def __init__(
        self, vehicle=None, config=None, scenario=EMPTY, paths=(), seed=1, site=SITE, implement=IMPLEMENT, start=None,
        is_folded=False, rendering=Rendering.IN_STEP,
    ):  # fmt: skip
        channel = f"farm-{next(_CHANNELS)}"
        tractor = can.Bus(interface="virtual", channel=channel)
        self.vehicle = vehicle or machine_file()
        config = config or flat()
        start = start or site.start
        models = PlantModels(config.machine, config.gnss, config.imu)
        configured = Plant(site, self.vehicle, implement, models, start)
        self.plant = draw_plant(scenario.plant, configured, config.plant, seed)
        self.world = SimulationWorld(
            self.plant, scenario, paths, tractor, seed, config, is_folded, SimulatedOperator(seed, "farm", "00"),
            rendering,
        )  # fmt: skip
        self.machine = self.world.machine
        self.start_ns = self.now_ns = config.start_stamp_ns
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.dbc = load_database()
        self.frames = {}
        self.outputs = []
        self.silent = set()
        self.speed_mps, self.curvature_radpm, self.brake_mps2 = 0.0, 0.0, 0.0
        self.is_lowered, self.is_pto_on, self.is_drive_enabled, self.permit = False, False, True, 1
        self.is_folded = None
        self._beats, self._counts = 250, 0

    def close(self):
        self.bus.shutdown()
        self.world.close()

    @property
    def elapsed_s(self):
        return (self.now_ns - self.start_ns) * 1e-9

    def send(self, name, values):
        if name in self.silent:
            return
        message = self.dbc.get_message_by_name(name)
        ones = {s.name: (1 << s.length) - 1 for s in message.signals}
        data = bytearray(message.encode({**ones, **values}, scaling=False, strict=False))
        if "Checksum" in ones:
            total = sum(data[:7]) + (data[7] & 15) + sum(message.frame_id.to_bytes(4, "big"))
            data[7] = (data[7] & 15) | ((((total >> 4) + total) & 15) << 4)
        self.bus.send(can.Message(arbitration_id=message.frame_id, data=bytes(data), is_extended_id=True))

    def send_commands(self):
        """Sends all frames, as the gateway does at 50 Hz."""
        self._counts += 1
        self.send("GuidanceSystemCommand", {"Curvature": 32128 - round(self.curvature_radpm * 4000), "Intent": 1})
        speed = round(abs(self.speed_mps) * 1000)
        self.send("MachineSelectedSpeedCommand", {"SetPoint": speed, "Direction": int(self.speed_mps >= 0)})
        acceleration = round((15.687 - self.brake_mps2) * 2048)
        mode = 2 if self.brake_mps2 > 0 else 0
        counter = self._counts % 16
        self.send("ExternalBrakeRequest", {"Acceleration": acceleration, "ControlMode": mode, "Counter": counter})
        switches = {"DriveEnable": int(self.is_drive_enabled), "ParkBrake": 0, "Horn": 0, "Beacon": 1}
        switches["Fold"] = 3 if self.is_folded is None else int(self.is_folded)
        self.send("AuxiliaryCommand", {"Group": 16, **switches, "Counter": counter})
        if self._counts % 5 == 1:
            hitch = 0 if self.is_lowered else 250
            self.send("HitchAndPtoCommands", {"RearHitchPosition": hitch, "RearPtoEngage": int(self.is_pto_on)})
            self.send("StopAllImplements", {"TransitionCount": 0, "Permit": self.permit})
            self._beats = (self._beats + 1) % 252 if self._counts > 1 else 251
            self._beats = 0 if self._beats == 251 and self._counts > 1 else self._beats
            self.send("HeartbeatGateway", {"Sequence": self._beats})

    def receive_status(self):
        while (frame := self.bus.recv(0)) is not None:
            message = self.dbc.get_message_by_frame_id(frame.arbitration_id)
            values = message.decode(bytes(frame.data), decode_choices=False)
            self.frames.setdefault(message.name, []).append((self.now_ns, values))

    def drive(self, seconds, each=None):
        """Advances for some time; returns the world's outputs."""
        out = []
        for _ in range(round(seconds * 100)):
            if (self.now_ns - self.start_ns) % 20_000_000 == 0:
                self.send_commands()
            self.now_ns = self.world.next_ns()
            out += self.world.step(self.now_ns)
            self.receive_status()
            if each is not None:
                each(self)
        self.outputs += out
        return out

    def drive_at(self, speed_mps, seconds=None):
        """Enables the drive and drives at a speed."""
        self.is_drive_enabled = False
        self.drive(0.2)
        self.is_drive_enabled, self.speed_mps = True, speed_mps
        self.drive(abs(speed_mps) / 0.6 + 4.0 if seconds is None else seconds)


def straight_paths(count=5, length_m=56.0, spacing_m=5.0, speed_mps=10.0 / 3.6):
    """A plan of parallel swaths in alternating directions, without connections (encounters use swaths only)."""
    s = np.arange(0.0, length_m + 0.05, 0.1)
    paths = []
    for line in range(count):
        heading = 0.0 if line % 2 == 0 else np.pi
        x = s if line % 2 == 0 else length_m - s
        n = len(s)
        paths.append(Path(
            0, line, 1, np.column_stack([x, np.full(n, line * spacing_m)]), np.full(n, heading), np.zeros(n), s.copy(),
            np.full(n, speed_mps), np.ones(n, np.uint8), (PathSection(PathSectionType.SWATH, line, 0, n - 1),),
            np.zeros(n, np.int32), line == count - 1,
        ))  # fmt: skip
    return tuple(paths)
