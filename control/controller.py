"""Controller node: control command from path, pose and machine state."""

from collections.abc import Iterable

from configs.strict import Config
from configs.vehicle import MountedImplement, TrailedImplement, Vehicle
from control.implement import ImplementControl, ImplementControlConfig
from control.lateral_controller import LateralController, SteeringOutput, VehicleSample
from control.longitudinal_controller import STANDING_MPS, LongitudinalController, SpeedConfig, SpeedPlan
from control.pose_smoothing import PoseSmoothing, PoseSmoothingConfig
from control.reference import Reference
from control.slip import SlipConfig
from control.start_conditions import StartConditions, StartConditionsConfig
from control.steering import SteeringConfig
from control.tracking_law import TrackingConfig
from control.zero_phase import warm
from geometry.pose2 import Pose2
from messages.command import ControlCommand, MachineState, Mode, SafeCommand
from messages.motion import MapPose, Odometry
from messages.node import Every, Inbox, Latest, Node, Output
from messages.plan import MissionStatus, Path

PERIOD_NS = 20_000_000
NO_PATH = -1
FOLLOWED_MPS, FOLLOWED_MPS2 = 0.05, 0.05  # tolerance of speed and deceleration of a followed command


class ControlConfig(Config):
    """Section `control` of the stack configuration."""

    pose_smoothing: PoseSmoothingConfig
    tracking: TrackingConfig
    steering: SteeringConfig
    slip: SlipConfig
    speed: SpeedConfig
    start_conditions: StartConditionsConfig
    implement: ImplementControlConfig


class Controller(Node):
    """Follows each new path from its beginning to standstill at its end; commands standstill without path or pose.

    A shift of the line by the operator is a shift of the pose against it, at the rate of its smoothing.
    """

    def __init__(self, vehicle: Vehicle, implement: MountedImplement | TrailedImplement, config: ControlConfig) -> None:
        self.name = "controller"
        self.reads = {k: Latest() for k in ("path", "odom", "map_pose", "machine", "safe_command", "mission")}
        self.writes = ("control_command",)
        self.runs = Every(PERIOD_NS)
        self._config, self._vehicle = config, vehicle
        self._pose_smoothing = PoseSmoothing(config.pose_smoothing)
        self._lateral = LateralController(vehicle, config.tracking, config.steering, config.slip)
        self._longitudinal = LongitudinalController(config.speed)
        self._implement = ImplementControl(implement, config.implement)
        self._start_conditions = StartConditions(implement, config.start_conditions)
        self._path: Path | None = None
        self._plan: SpeedPlan | None = None
        warm()
        self._last_ns: int | None = None
        self._commanded_mps = self._braking_mps2 = 0.0
        self._curvature_radpm = 0.0

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Builds one control command."""
        elapsed_s = 0.02 if self._last_ns is None else (now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        self._start_conditions.observe(inbox.latest("machine", MachineState))
        path = inbox.last("path", Path)
        sample = self._sample(inbox, elapsed_s)
        if path is None or sample is None:
            return [("control_command", self._standstill_command(now_ns, path))]
        if self._path is None or path.path_id != self._path.path_id:
            self._start(path, sample)
        return [("control_command", self._drive(now_ns, path, sample, inbox, elapsed_s))]

    def _sample(self, inbox: Inbox, elapsed_s: float) -> VehicleSample | None:
        odom, map_pose = inbox.latest("odom", Odometry), inbox.latest("map_pose", MapPose)
        if odom is None or map_pose is None or not map_pose.is_initialized:
            return None
        is_standing = abs(odom.speed_mps) < STANDING_MPS and self._commanded_mps == 0.0
        T_map_odom, T_odom_base = Pose2.of(map_pose.T_map_odom), Pose2.of(odom.T_odom_base)
        mission = inbox.latest("mission", MissionStatus)
        if mission is not None:  # the line is shifted to the left: the machine is more to the right of it
            T_map_odom = Pose2(-mission.shift_x_m, -mission.shift_y_m, 0.0) @ T_map_odom
        pose = self._pose_smoothing.update(T_map_odom, T_odom_base, elapsed_s, is_standing)
        rise = float(odom.T_odom_base[2, 0])
        return VehicleSample(odom.stamp_ns, pose, odom.speed_mps, odom.yaw_rate_radps, odom.curvature_radpm, rise)

    def _start(self, path: Path, sample: VehicleSample) -> None:
        self._path = path
        reference = Reference(path, self._config.tracking.smoothing_radpm)
        self._plan = SpeedPlan(path, reference, self._vehicle, self._config.speed)
        self._lateral.start(reference, sample.pose)
        self._longitudinal.start()
        self._implement.start(path)
        self._start_conditions.start(path.is_transport)

    def _drive(self, now_ns: int, path: Path, sample: VehicleSample, inbox: Inbox, elapsed_s: float) -> ControlCommand:
        assert self._plan is not None
        is_steering, is_followed = self._is_command_followed(inbox)
        steering = self._lateral.update(now_ns, sample, is_steering)
        forward_mps, s_m = path.direction * sample.speed_mps, steering.position.s_m
        target_mps = self._longitudinal.target_mps(self._plan, s_m, forward_mps, steering.offset_m)
        if self._start_conditions.is_held(sample, steering.curvature_radpm, is_steering, elapsed_s):
            target_mps = 0.0
        commanded_mps, acceleration_mps2 = self._longitudinal.command(
            target_mps, forward_mps, elapsed_s, is_followed, -path.direction * sample.rise
        )
        self._control_implement(now_ns, s_m, forward_mps, inbox)
        self._commanded_mps, self._braking_mps2 = path.direction * commanded_mps, -acceleration_mps2
        self._curvature_radpm = steering.curvature_radpm
        return self._command(now_ns, path, steering, acceleration_mps2, abs(sample.speed_mps) < STANDING_MPS)

    def _is_command_followed(self, inbox: Inbox) -> tuple[bool, bool]:
        """True if the steering is followed, and if steering and speed are."""
        safe = inbox.latest("safe_command", SafeCommand)
        if safe is None or not safe.is_drive_enabled or safe.mode is Mode.MANUAL:
            return False, False
        is_faster = abs(safe.speed_mps) >= abs(self._commanded_mps) - FOLLOWED_MPS
        return True, is_faster and safe.deceleration_mps2 <= self._braking_mps2 + FOLLOWED_MPS2

    def _control_implement(self, now_ns: int, s_m: float, forward_mps: float, inbox: Inbox) -> None:
        assert self._plan is not None
        machine = inbox.latest("machine", MachineState)
        hitch = 1.0 if machine is None or machine.implement_stamp_ns == 0 else machine.hitch
        if machine is not None and machine.implement_stamp_ns:
            self._implement.observe(machine.implement_stamp_ns, machine.hitch)
        if self._longitudinal.is_arrived:
            self._implement.lift()
        else:
            self._implement.step(now_ns, self._plan, s_m, forward_mps, hitch)

    def _command(
        self, now_ns: int, path: Path, steering: SteeringOutput, acceleration_mps2: float, is_standing: bool
    ) -> ControlCommand:
        is_reverse = 0.0 if path.direction > 0 else 1.0  # errors are left of the machine, not of its motion
        return ControlCommand(
            stamp_ns=now_ns,
            speed_mps=self._commanded_mps,
            acceleration_mps2=acceleration_mps2,
            curvature_radpm=self._curvature_radpm,
            is_implement_lowered=self._implement.is_lowered,
            is_pto_on=self._implement.is_pto_on,
            path_id=path.path_id,
            path_s_m=steering.position.s_m,
            xte_m=steering.offset_m * (1.0 - 2.0 * is_reverse),
            heading_error_rad=steering.heading_error_rad,
            is_finished=self._longitudinal.is_arrived and is_standing,
            is_implement_folded=self._start_conditions.is_folded,
        )

    def _standstill_command(self, now_ns: int, path: Path | None) -> ControlCommand:
        """Command without path or pose: standstill, curvature and implement unchanged."""
        self._commanded_mps = 0.0
        return ControlCommand(
            stamp_ns=now_ns,
            speed_mps=0.0,
            acceleration_mps2=-self._config.speed.holding_mps2,
            curvature_radpm=self._curvature_radpm,
            is_implement_lowered=self._implement.is_lowered,
            is_pto_on=self._implement.is_pto_on,
            path_id=NO_PATH if path is None else path.path_id,
            path_s_m=0.0,
            xte_m=0.0,
            heading_error_rad=0.0,
            is_finished=False,
            is_implement_folded=self._start_conditions.is_folded,
        )
