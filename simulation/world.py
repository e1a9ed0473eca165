"""The simulated world as the stack meets it: it goes on in steps, obeys the bus and gives what sensors measure."""

import heapq
import math
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import can
import numpy as np
from pydantic import Field
from shapely import Polygon

from configs.site import PoseConfig, Site
from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from messages.command import OperatorCommand
from messages.message import Message
from messages.node import Output, World
from messages.plan import Path
from messages.sensors import CameraImage
from messages.topics import TOPICS
from simulation.actors.actors import Actor
from simulation.actors.encounter import Setting
from simulation.actors.placement import place_encounters
from simulation.environment.scene import Scene
from simulation.environment.scenery import SceneryConfig, build_scenery
from simulation.environment.terrain import Terrain, TerrainConfig
from simulation.ground_truth import Judge, JudgeConfig
from simulation.kernels import warm
from simulation.machine.machine import Machine, MachineConfig
from simulation.machine.pose_buffer import Track
from simulation.machine.tractor_bus import BusConfig, TractorBus, load_database
from simulation.machine.tractor_status import TractorStatus
from simulation.randomness import generator
from simulation.scenario import Bystander, Scenario
from simulation.sensors.camera import CameraConfig, CameraModel
from simulation.sensors.gnss import GnssConfig, GnssModel
from simulation.sensors.imu import ImuConfig, ImuModel
from simulation.sensors.lidar import LidarConfig, LidarModel
from simulation.sensors.radar import RadarConfig, RadarModel
from simulation.sensors.sensor import Moment, Sensor
from simulation.sensors.ultrasonic import UltrasonicConfig, UltrasonicModel
from simulation.sensors.uwb import UwbConfig, UwbModel
from simulation.sensors.wheels import WheelModel

Sent = Message | Future[CameraImage]

STEP_NS = 5_000_000  # of the dynamics
TICK_NS = 10_000_000  # of bus and sensors: two steps
TRACK_S = 0.25


class SimulationConfig(Config):
    """The section `simulation` of the stack's configuration."""

    start_stamp_ns: int = Field(ge=0)
    terrain: TerrainConfig
    scenery: SceneryConfig
    machine: MachineConfig
    bus: BusConfig
    lidar: LidarConfig
    camera: CameraConfig
    radar: RadarConfig
    ultrasonic: UltrasonicConfig
    uwb: UwbConfig
    gnss: GnssConfig
    imu: ImuConfig
    judge: JudgeConfig


class SimulationWorld(World):
    """Deterministic: the same arguments and the same frames on the bus give the same messages, to the bit.

    `bus` is the tractor's end of its bus; the world closes it. `paints_aside` has a thread paint the cameras' pictures:
    the same ones, but they come when they are painted, and the process must not fork.
    """

    def __init__(
        self, site: Site, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, scenario: Scenario,
        plan_paths: tuple[Path, ...], bus: can.BusABC, seed: int, config: SimulationConfig, start: PoseConfig,
        is_folded: bool, paints_aside: bool = False,
    ) -> None:  # fmt: skip
        self._now_ns = self._start_ns = config.start_stamp_ns
        self._terrain = Terrain(site, config.terrain, seed)
        self.machine = Machine(
            vehicle, implement, self._terrain, start, is_folded, config.machine, STEP_NS * 1e-9,
            generator(seed, "machine"),
        )  # fmt: skip
        self._vehicle, self._scenario = vehicle, scenario
        self._ends_m = vehicle.body.front_m, min(-vehicle.body.rear_m, implement.ends_m[1])
        self._track = Track(STEP_NS, TRACK_S)
        self._track.append(self.machine.T_map_base)
        database = load_database()
        brake = vehicle.brake.deceleration_mps2
        self._bus = TractorBus(bus, database, vehicle.drivetrain.wheelbase_m, brake, config.bus)
        self._status = TractorStatus(self.machine, self._bus, database, generator(seed, "cab"))
        self._judge = Judge(site, vehicle, implement, seed, config.judge)
        docks = {} if site.shed is None else {bay.name: bay.dock for bay in site.shed.bays}
        setting = Setting(Polygon(site.boundary_m), 0.5 * max(implement.width_m, vehicle.body.width_m), docks)
        self._actors = self._cast(plan_paths, setting, seed)
        self._scene = Scene(lambda: build_scenery(site, self._terrain, config.scenery, seed))
        self._sensors = make_sensors(site, vehicle, implement, scenario, seed, config)
        self._painter = ThreadPoolExecutor(1) if paints_aside else None
        self._waiting: list[tuple[int, int, str, Sent]] = []
        self._sent = 0
        self.writes = (*(s.topic for s in self._sensors), "operator_command", "truth_machine", "truth_objects")

    def next_ns(self) -> int | None:
        """One tick on; the simulated world has no end."""
        return self._now_ns + TICK_NS

    def step(self, now_ns: int) -> Iterable[Output]:
        """Go on to `now_ns` in ticks, and give what is received by then in order of its arrival."""
        while self._now_ns + TICK_NS <= now_ns:
            self._tick(self._now_ns + TICK_NS)
        received = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            _, _, topic, message = heapq.heappop(self._waiting)
            if not isinstance(message, Future):
                received.append((topic, message))
            elif message.done():
                received.append((topic, message.result()))
            else:  # a picture that is late must not make the rest of the world so
                self._put(now_ns + TICK_NS, topic, message)
        return received

    def warm(self) -> None:
        """Load and build what the first scan would wait for."""
        warm()
        found = self._vehicle.sensors
        if found.lidar or found.radar or found.ultrasonic or found.uwb:
            up = np.array([[0.0, 0.0, 50.0, 0.0, 0.0, 1.0]], np.float32)
            self._scene.still.cast(up)  # open3d sorts its triangles at the first one
        for sensor in self._sensors:
            if isinstance(sensor, CameraModel):
                sensor.warm(self._scene)

    def add(self, actor: Actor) -> None:
        """One actor more, from now on."""
        self._actors.append(actor)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()
        if self._painter is not None:
            self._painter.shutdown()

    def _tick(self, now_ns: int) -> None:
        elapsed_ns = now_ns - self._start_ns
        self._bus.receive(self._now_ns)
        command = self._bus.command(self._now_ns)
        for _ in range(TICK_NS // STEP_NS):
            self.machine.step(command)
            self._track.append(self.machine.T_map_base)
        self._now_ns = now_ns
        self._play(elapsed_ns * 1e-9)
        self._measure(now_ns, elapsed_ns)
        self._order(now_ns, elapsed_ns)
        self._tell_truth(now_ns, elapsed_ns)
        self._status.send(elapsed_ns)

    def _cast(self, plan_paths: tuple[Path, ...], setting: Setting, seed: int) -> list[Actor]:
        is_field = bool(plan_paths)  # without a plan nobody is on the field
        encounters = tuple(e for e in self._scenario.encounters if is_field or isinstance(e, Bystander))
        drawn = place_encounters(encounters, plan_paths, setting, generator(seed, "scenario"))
        return [Actor(k, e, d, self._terrain) for k, (e, d) in enumerate(zip(encounters, drawn, strict=True))]

    def _play(self, elapsed_s: float) -> None:
        T, is_reversing = self.machine.T_map_base, self.machine.speed_mps < 0.0
        tip = T[:3, 3] + self._ends_m[is_reversing] * T[:3, 0]
        heading = self.machine.yaw_rad + math.pi * is_reversing
        figures = (actor.play(elapsed_s, tip, heading) for actor in self._actors)
        self._scene.figures = tuple(f for f in figures if f is not None)

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        moment = Moment(now_ns, elapsed_ns * 1e-9, self._track, self.machine, self._scene)
        for sensor in self._sensors:
            is_due = elapsed_ns // sensor.period_ns > (elapsed_ns - TICK_NS) // sensor.period_ns
            message = self._sample(sensor, moment) if is_due else None
            if message is not None:
                self._put(now_ns + sensor.latency_ns, sensor.topic, message)

    def _sample(self, sensor: Sensor, moment: Moment) -> Sent | None:
        if self._painter is not None and isinstance(sensor, CameraModel):
            return self._painter.submit(sensor.paint, sensor.expose(moment))
        return sensor.sample(moment)

    def _order(self, now_ns: int, elapsed_ns: int) -> None:
        for sequence, order in enumerate(self._scenario.operator_commands):
            if elapsed_ns - TICK_NS < order.at_s * 1e9 <= elapsed_ns:
                expires_ns = now_ns + round(order.expires_s * 1e9)
                self._put(
                    now_ns, "operator_command", OperatorCommand(now_ns, order.code, "remote", sequence, expires_ns)
                )

    def _tell_truth(self, now_ns: int, elapsed_ns: int) -> None:
        topics = ("truth_machine", "truth_objects")
        due = [topic for topic in topics if elapsed_ns % round(TOPICS[topic].period_s * 1e9) == 0]
        if not due:
            return
        outline, figures = self._judge.outline(self.machine), self._scene.figures
        if "truth_machine" in due:
            self._judge.look(outline, figures)
            self._put(now_ns, "truth_machine", self._judge.machine_message(now_ns, self.machine))
        if "truth_objects" in due:
            self._put(now_ns, "truth_objects", self._judge.objects_message(now_ns, outline, figures))

    def _put(self, receive_ns: int, topic: str, message: Sent) -> None:
        self._sent += 1
        heapq.heappush(self._waiting, (receive_ns, self._sent, topic, message))


def make_sensors(
    site: Site, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, scenario: Scenario, seed: int,
    config: SimulationConfig,
) -> list[Sensor]:  # fmt: skip
    """All sensors of a vehicle, each with a generator of its own."""
    found = vehicle.sensors
    sensors: list[Sensor] = []
    if found.imu is not None:
        sensors.append(ImuModel(found.imu, config.imu, generator(seed, "imu")))
    if found.wheels is not None:
        sensors.append(WheelModel(found.wheels, generator(seed, "wheel")))
    for name, gnss in found.gnss.items():
        random = generator(seed, f"gnss/{name}")
        sensors.append(GnssModel(name, gnss, site.datum.datum, site.shed, scenario.gnss, config.gnss, random))
    for name, lidar in found.lidar.items():
        sensors.append(LidarModel(name, lidar, vehicle, implement, config.lidar, generator(seed, f"lidar/{name}")))
    for name, camera in found.camera.items():
        sensors.append(CameraModel(name, camera, vehicle, site, scenario.camera, seed, config.camera))
    for name, radar in found.radar.items():
        sensors.append(RadarModel(name, radar, config.radar, generator(seed, f"radar/{name}")))
    for name, tag in found.uwb.items():
        anchors = {} if site.shed is None else site.shed.anchors
        sensors.append(UwbModel(name, tag, anchors, config.uwb, generator(seed, f"uwb/{name}")))
    return sensors + make_ultrasonics(vehicle, implement, seed, config.ultrasonic)


def make_ultrasonics(
    vehicle: Vehicle, implement: MountedImplement | TrailedImplement, seed: int, config: UltrasonicConfig
) -> list[Sensor]:
    """The ultrasonic sensors of a vehicle with those that its implement carries; who looks the same way is heard."""
    found = vehicle.sensors.ultrasonic
    carried = implement.ultrasonic if isinstance(implement, MountedImplement) else {}
    axes = {name: sensor.mount.T_base_sensor[:3, 0] for name, sensor in found.items()}
    neighbours = {name: sum(float(x @ axes[other]) > 0.0 for other in axes) - 1 for name, x in axes.items()}
    return [
        UltrasonicModel(name, s, neighbours[name], name in carried, config, generator(seed, f"ultrasonic/{name}"))
        for name, s in found.items()
    ]
