"""The simulated world: advances in fixed steps, obeys the bus and outputs sensor and truth messages."""

import heapq
import math
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from enum import Enum, auto

import can
import numpy as np
from pydantic import Field
from shapely import Polygon

from configs.sensor_kinds import sensors_of
from configs.strict import Config
from messages.message import Message
from messages.node import Output, World
from messages.plan import Path
from messages.sensors import CameraImage
from messages.topics import TOPICS
from simulation.actors.actors import Actor
from simulation.actors.background import Background
from simulation.actors.encounter import EncounterSite
from simulation.actors.placement import place_encounters
from simulation.actors.scripted import ScriptedObjects
from simulation.environment.media import Media
from simulation.environment.scenario_scenery import scenery_of
from simulation.environment.scene import Scene
from simulation.environment.scenery import SceneryConfig
from simulation.environment.terrain import Terrain, TerrainConfig
from simulation.ground_truth import GroundTruth, GroundTruthConfig
from simulation.kernels import warm
from simulation.machine.body_motion import BodyMotion
from simulation.machine.machine import Machine, MachineConfig
from simulation.machine.pose_buffer import PoseBuffer
from simulation.machine.tractor_bus import BusConfig, TractorBus, load_database
from simulation.machine.tractor_status import TractorStatus
from simulation.operator import SimulatedOperator
from simulation.plant import Clock, Plant, PlantConfig
from simulation.randomness import generator
from simulation.scenario import Bystander, Scenario
from simulation.sensor_registry import MODELS
from simulation.sensors.camera import CameraConfig, CameraModel
from simulation.sensors.gnss import GnssConfig, GnssModel
from simulation.sensors.imu import ImuConfig, ImuModel
from simulation.sensors.lidar import LidarConfig
from simulation.sensors.lidar_beams import warm_beams
from simulation.sensors.radar import RadarConfig
from simulation.sensors.sensor import Sensor, SensorContext, WorldState
from simulation.sensors.ultrasonic import UltrasonicConfig
from simulation.sensors.uwb import UwbConfig, UwbModel
from simulation.sensors.wheels import WheelModel
from simulation.true_shapes import shapes_message, shapes_text

Pending = Message | Future[CameraImage]

STEP_NS = 5_000_000  # of the dynamics
TICK_NS = 10_000_000  # of bus and sensors: two steps
POSE_BUFFER_S = 0.25
ORDERS_TOPIC = "order/operator"


class SimulationConfig(Config):
    """Section `simulation` of the stack configuration."""

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
    ground_truth: GroundTruthConfig
    plant: PlantConfig


class SensorLink:
    """Clock and link of one sensor: stamps with an offset, and delivery in order with a random additional delay."""

    def __init__(self, clock: Clock, random: np.random.Generator) -> None:
        self._offset_ns, self._jitter_s, self._random = round(clock.offset_s * 1e9), clock.jitter_s, random
        self._last_ns = 0

    def stamp_ns(self, now_ns: int) -> int:
        """Stamp of a measurement now."""
        return now_ns + self._offset_ns

    def receive_ns(self, at_ns: int) -> int:
        """Time of delivery of a message that leaves the sensor at `at_ns`."""
        self._last_ns = max(self._last_ns, at_ns + round(self._random.exponential(self._jitter_s) * 1e9))
        return self._last_ns


class Rendering(Enum):
    """Where camera images are rendered: in the step, or in a thread, waited for when due or delivered when ready."""

    IN_STEP = auto()
    IN_THREAD = auto()
    LATE = auto()


class SimulationWorld(World):
    """Deterministic: equal arguments and equal frames on the bus give bit-identical messages.

    `bus` is the tractor's end of its bus; the world closes it. Only with `Rendering.IN_STEP` the process may fork.
    """

    def __init__(
        self, plant: Plant, scenario: Scenario, plan_paths: tuple[Path, ...], bus: can.BusABC, seed: int,
        config: SimulationConfig, is_folded: bool, operator: SimulatedOperator,
        rendering: Rendering = Rendering.IN_THREAD,
    ) -> None:  # fmt: skip
        site, vehicle, implement = plant.site, plant.vehicle, plant.implement
        self._now_ns = self._start_ns = config.start_stamp_ns
        environment = scenario.environment
        self._terrain = Terrain(site, config.terrain, seed, None if environment is None else environment.ground)
        self.machine = Machine(
            vehicle, implement, self._terrain, plant.start, is_folded, plant.models.machine, STEP_NS * 1e-9,
            generator(seed, "machine"),
        )  # fmt: skip
        self._vehicle, self._implement, self._site, self._scenario = vehicle, implement, site, scenario
        self._ends_m = vehicle.body.front_m, min(-vehicle.body.rear_m, implement.ends_m[1])
        self._poses = PoseBuffer(STEP_NS, POSE_BUFFER_S)
        self._body = BodyMotion(plant.models.machine.body_motion, STEP_NS * 1e-9, generator(seed, "body"))
        self._poses.append(self.machine.T_map_base)
        database = load_database()
        brake = vehicle.brake.deceleration_mps2
        self._bus = TractorBus(bus, database, vehicle.drivetrain.wheelbase_m, brake, config.bus)
        self._status = TractorStatus(self.machine, self._bus, database, generator(seed, "cab"))
        self._ground_truth = GroundTruth(site, vehicle, implement, seed, config.ground_truth)
        docks = {} if site.shed is None else {bay.name: bay.dock for bay in site.shed.bays}
        setting = EncounterSite(Polygon(site.boundary_m), 0.5 * max(implement.width_m, vehicle.body.width_m), docks)
        self._actors = self._create_actors(plan_paths, setting, seed)
        self._objects = ScriptedObjects(scenario.objects, plan_paths, site, vehicle, self._terrain, seed)
        self._media = None if environment is None else Media(environment, site, vehicle, self._terrain, seed)
        self._scene = Scene(lambda: scenery_of(site, self._terrain, config.scenery, environment, seed), self._media)
        self._background = Background(environment, site, self._terrain, seed)
        models = config.model_copy(update={"gnss": plant.models.gnss, "imu": plant.models.imu})
        self._sensors = make_sensors(SensorContext(site, vehicle, implement, scenario, seed), models)
        self._links = {
            topic: SensorLink(clock, generator(seed, f"clock/{topic}")) for topic, clock in plant.clocks.items()
        }
        self._rendering = rendering
        self._render_thread = ThreadPoolExecutor(1, "camera")  # starts with the first image
        self._pending: list[tuple[int, int, str, Pending]] = []
        self._put_count = 0
        self._seed, self._operator = seed, operator
        # shapes are logged where a judge needs them: for the objects and the environment of a scenario
        self._truth = (
            "truth_machine",
            "truth_objects",
            *(["truth_shapes"] if scenario.objects or scenario.environment else []),
        )
        self.writes = (*(s.topic for s in self._sensors), ORDERS_TOPIC, *self._truth)

    @property
    def terrain(self) -> Terrain:
        """The ground."""
        return self._terrain

    def next_ns(self) -> int | None:
        """Time of the next tick; the simulated world has no end."""
        return self._now_ns + TICK_NS

    def step(self, now_ns: int) -> Iterable[Output]:
        """Advances to `now_ns` in ticks; returns messages received by then, in order of arrival."""
        while self._now_ns + TICK_NS <= now_ns:
            self._tick(self._now_ns + TICK_NS)
        received = []
        while self._pending and self._pending[0][0] <= now_ns:
            _, _, topic, message = heapq.heappop(self._pending)
            if not isinstance(message, Future):
                received.append((topic, message))
            elif self._rendering is Rendering.LATE and not message.done():
                self._put(now_ns + TICK_NS, topic, message)
            else:
                received.append((topic, message.result()))
        return received

    def warm(self) -> None:
        """Loads and builds everything that would delay the first scan."""
        warm()
        if self._media is not None:
            warm_beams(self._media)
        found = self._vehicle.sensors
        if found.lidar or found.radar or found.ultrasonic or found.uwb:
            up = np.array([[0.0, 0.0, 50.0, 0.0, 0.0, 1.0]], np.float32)
            self._scene.static.cast(up)  # open3d builds its acceleration structure at the first cast
        for sensor in self._sensors:
            if isinstance(sensor, CameraModel):
                sensor.warm(self._scene)

    def add_actor(self, actor: Actor) -> None:
        """Adds an actor from now on."""
        self._actors.append(actor)

    def shapes_text(self) -> str:
        """True shapes of machine, implement and static solids (simulation/true_shapes.py)."""
        negative = self._terrain.features.negative
        return shapes_text(
            self._vehicle, self._implement, self._site, self._scene.pieces, negative, self._seed
        )  # fmt: skip

    def close(self) -> None:
        """Closes the bus."""
        self._bus.close()
        self._render_thread.shutdown()

    def _tick(self, now_ns: int) -> None:
        elapsed_ns = now_ns - self._start_ns
        self._bus.receive(self._now_ns)
        command = self._bus.command(self._now_ns)
        for _ in range(TICK_NS // STEP_NS):
            self.machine.step(command)
            m = self.machine
            left_mps2 = m.speed_mps * m.yaw_rate_radps
            self._poses.append(self._body.step(m.T_map_base, m.speed_mps, m.acceleration_mps2, left_mps2))
        self._now_ns = now_ns
        self._update_actors(elapsed_ns * 1e-9)
        self._measure(now_ns, elapsed_ns)
        self._issue_commands(now_ns, elapsed_ns)
        self._publish_truth(now_ns, elapsed_ns)
        self._status.send(elapsed_ns)

    def _create_actors(self, plan_paths: tuple[Path, ...], setting: EncounterSite, seed: int) -> list[Actor]:
        is_field = bool(plan_paths)  # encounters on the field need a plan
        encounters = tuple(e for e in self._scenario.encounters if is_field or isinstance(e, Bystander))
        drawn = place_encounters(encounters, plan_paths, setting, generator(seed, "scenario"))
        return [Actor(k, e, d, self._terrain) for k, (e, d) in enumerate(zip(encounters, drawn, strict=True))]

    def _update_actors(self, elapsed_s: float) -> None:
        T, is_reversing = self.machine.T_map_base, self.machine.speed_mps < 0.0
        tip = T[:3, 3] + self._ends_m[is_reversing] * T[:3, 0]
        heading = self.machine.yaw_rad + math.pi * is_reversing
        actors = (actor.update(elapsed_s, tip, heading) for actor in self._actors)
        objects = self._objects.update(elapsed_s, self.machine, self._bus.is_horn_on, (tip, heading))
        background = self._background.update(elapsed_s, self.machine)
        self._scene.actors = (*(f for f in actors if f is not None), *objects, *background)
        if self._media is not None:
            self._media.update(elapsed_s, self.machine)

    def _measure(self, now_ns: int, elapsed_ns: int) -> None:
        state = WorldState(now_ns, elapsed_ns * 1e-9, self._poses, self.machine, self._scene)
        for sensor in self._sensors:
            is_due = elapsed_ns // sensor.period_ns > (elapsed_ns - TICK_NS) // sensor.period_ns
            if not is_due:
                continue
            link = self._links.get(sensor.topic)
            message = self._sample(sensor, state if link is None else replace(state, stamp_ns=link.stamp_ns(now_ns)))
            if message is not None:
                at_ns = now_ns + sensor.latency_ns
                self._put(at_ns if link is None else link.receive_ns(at_ns), sensor.topic, message)

    def _sample(self, sensor: Sensor, state: WorldState) -> Pending | None:
        if isinstance(sensor, CameraModel) and self._rendering is not Rendering.IN_STEP:
            return self._render_thread.submit(sensor.render, sensor.prepare(state))
        return sensor.sample(state)

    def _issue_commands(self, now_ns: int, elapsed_ns: int) -> None:
        for command in self._scenario.operator_commands:
            if elapsed_ns - TICK_NS < command.at_s * 1e9 <= elapsed_ns:
                for kind in command.kinds:
                    self._put(
                        now_ns, ORDERS_TOPIC, self._operator.order(now_ns, kind, command.expires_s, command.left_m)
                    )

    def _publish_truth(self, now_ns: int, elapsed_ns: int) -> None:
        due = [topic for topic in self._truth if elapsed_ns % round(TOPICS[topic].period_s * 1e9) == 0]
        if not due:
            return
        outline, actors = self._ground_truth.outline(self.machine), self._scene.actors
        if "truth_machine" in due:
            self._ground_truth.update(outline, actors)
            self._put(now_ns, "truth_machine", self._ground_truth.machine_message(now_ns, self.machine))
        if "truth_objects" in due:
            self._put(now_ns, "truth_objects", self._ground_truth.objects_message(now_ns, outline, actors))
        if "truth_shapes" in due:
            self._put(now_ns, "truth_shapes", shapes_message(now_ns, actors, self.machine.attached))

    def _put(self, receive_ns: int, topic: str, message: Pending) -> None:
        self._put_count += 1
        heapq.heappush(self._pending, (receive_ns, self._put_count, topic, message))


def make_sensors(context: SensorContext, config: SimulationConfig) -> list[Sensor]:
    """Models of all sensors of a vehicle, each with its own random generator."""
    found, site = context.vehicle.sensors, context.site
    sensors: list[Sensor] = []
    if found.imu is not None:
        sensors.append(ImuModel(found.imu, config.imu, context.generator("imu")))
    if found.wheels is not None:
        sensors.append(WheelModel(found.wheels, context.generator("wheel")))
    for name, gnss in found.gnss.items():
        random = context.generator(f"gnss/{name}")
        sensors.append(GnssModel(name, gnss, site.datum.datum, site.shed, context.scenario.gnss, config.gnss, random))
    for name, tag in found.uwb.items():
        anchors = {} if site.shed is None else site.shed.anchors
        sensors.append(UwbModel(name, tag, anchors, config.uwb, context.generator(f"uwb/{name}")))
    for kind, make_model in MODELS.items():
        section = getattr(config, kind, None)
        sensors += [make_model(name, one, section, context) for name, one in sensors_of(found, kind).items()]
    return sensors
