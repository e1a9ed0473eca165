"""The supervisor: reads what others say, asks the rules, keeps the mode, and alone builds the safe command.

messages ─► lookout (field, tracks, proven range, fence) ─┐
        └─► watchdog, timers ─────────────────────────────┼─► situation ─► rules ─► most restrictive
orders ─► events ─► mode table ◄──────────────────────────┘                             │
                        └──────────────────────────────────────► safe command ◄─────────┘
"""

import math
from collections.abc import Iterable

import numpy as np

from configs.vehicle import MountedImplement, TrailedImplement, Vehicle, kmh
from messages.command import MachineState, Mode, OperatorOrder, RuleResult, SupervisorState, Wish
from messages.errors import ConfigError
from messages.faults import Fault
from messages.motion import MapPose, Odometry
from messages.node import All, Every, Inbox, Latest, Node, Output, Read
from messages.perception import SensorHealth, Tracks
from messages.plan import MissionState, MissionStatus, Path
from messages.sensors import LidarScan
from messages.topics import kind_of
from safety.alarms import Alarms
from safety.bodies import shape_of
from safety.commander import Commander, Moment
from safety.config import SafetyConfig
from safety.fence import Fence
from safety.gauge import Gauge, Measured
from safety.judgement import Judgement, allowance_m, judged
from safety.lookout import Lookout, Seen
from safety.modes import WATCHED, Event, next_mode
from safety.motion import whole_odom, whole_pose
from safety.orders import Orders
from safety.reports import Reports
from safety.rules import RULES
from safety.rules.verdict import emergency, note
from safety.situation import Situation
from safety.stopping import required_range, stopping_distance
from safety.sweep import outline_of
from safety.timer import Held
from safety.watchdog import Age, age_of, silent

PERIOD_NS = 20_000_000
STATE_NS = 100_000_000
MOST_HITS = 300
BOUND_MPS = 0.02  # a limit this little below the wish is not told as its reason
ABLATION = note("safety.ablation", "obstacle rules switched off for a trial")
ORDERED = emergency("order.emergency_stop", "emergency stop ordered")


class Supervisor(Node):
    """Lets through of control's wish what the rules allow, every 20 ms.

    `fault_topics` are those of other nodes. `fence` None means that no area is known (a recorded log). `disabled_rules`
    names rules of `safety.rules.RULES` that a trial switches off; it is never configuration, and it is told and logged.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        implement: MountedImplement | TrailedImplement | None,
        config: SafetyConfig,
        fence: Fence | None,
        fault_topics: tuple[str, ...],
        disabled_rules: frozenset[str] = frozenset(),
    ) -> None:
        unknown = sorted(disabled_rules - RULES.keys())
        if unknown:
            raise ConfigError(f"disabled_rules: no rule {unknown[0]!r}; there are {', '.join(RULES)}")
        self.name = "supervisor"
        sensors = vehicle.sensors
        self._lidars = tuple(sensors.lidar)
        own = ("imu",) * (sensors.imu is not None) + ("wheel",) * (sensors.wheels is not None)
        watched = ("machine", *own, *(f"lidar/{name}" for name in self._lidars),
                         "odom", "map_pose", "tracks", "wish")  # fmt: skip
        self._watched = {topic: kind_of(topic).type for topic in watched}
        self._fault_topics = fault_topics
        self.reads: dict[str, Read] = {topic: Latest() for topic in (*self._watched, "path", "mission")}
        self.reads |= {f"health/lidar_{name}": Latest() for name in self._lidars}
        self.reads |= {topic: All(50) for topic in ("order", *fault_topics)}
        self.writes = ("safe_command", "supervisor", "fault/supervisor")
        self.runs = Every(PERIOD_NS)
        self.mode = Mode.STANDBY
        self._config, self._disabled = config, disabled_rules
        self._max_speed_mps = min(kmh(vehicle.max_speed_kmh), kmh(config.limits.speed_kmh))
        self._range_sigma_m = max((lidar.range_sigma_m for lidar in sensors.lidar.values()), default=0.0)
        self._lookout = Lookout(shape_of(vehicle, implement), sensors.lidar, fence, config)
        self._gauge, self._commander = Gauge(config), Commander(vehicle, config)
        self._orders, self._reports, self._alarms = Orders(config.modes.authorities), Reports(), Alarms()
        self._latched: RuleResult | None = None
        self._cause, self._is_urgent = "", False
        self._clear, self._warned = Held(), Held()
        self._warning_s = config.modes.start_warning_s
        self._state_ns: int | None = None
        self._told = (self.mode, "")

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Read, judge, decide, command."""
        for topic in self._fault_topics:
            self._reports.take(inbox.all(topic, Fault))
        seen, machine = self._see(inbox), inbox.latest("machine", MachineState)
        measured = self._gauge.measure(
            now_ns, self.mode, seen.odom, machine, seen.map_pose, seen.path, seen.wish, self._commander.last
        )
        allowance = allowance_m(self._config.field, self._range_sigma_m, measured.position_sigma_m)
        self._lookout.look(seen, measured.direction, measured.fastest_mps, measured.braking, allowance)
        situation = self._situation(now_ns, inbox, seen, machine, measured, allowance)
        judgement = judged(situation, self._disabled)
        mission = inbox.latest("mission", MissionStatus)
        self._change_mode(now_ns, inbox.all("order", OperatorOrder), situation, judgement, mission)
        reason = self._reason(situation, judgement)
        command = self._commander.command(self._moment(situation, measured, judgement, reason))
        outputs: list[Output] = [("safe_command", command)]
        outputs += [("fault/supervisor", fault) for fault in self._tell(now_ns, judgement)]
        if self._is_state_due(now_ns, reason):
            outputs.append(("supervisor", self._state(situation, seen, judgement, reason)))
        return outputs

    def _see(self, inbox: Inbox) -> Seen:
        return Seen(
            whole_odom(inbox.latest("odom", Odometry)),
            whole_pose(inbox.latest("map_pose", MapPose)),
            inbox.latest("wish", Wish),
            inbox.latest("path", Path),
            inbox.latest("tracks", Tracks),
            {name: inbox.latest(f"lidar/{name}", LidarScan) for name in self._lidars},
            {name: inbox.latest(f"health/lidar_{name}", SensorHealth) for name in self._lidars},
        )

    def _ages(self, now_ns: int, inbox: Inbox, direction: int) -> list[Age]:
        """Ages of all that driving in this direction needs."""
        idle = {f"lidar/{eye.name}" for eye in self._lookout.eyes if not eye.looks(direction)}
        ages = []
        for topic, kind in self._watched.items():
            if topic not in idle:
                last = inbox.last(topic, kind)
                ages.append(age_of(topic, None if last is None else last.stamp_ns, now_ns))
        return ages

    def _situation(
        self, now_ns: int, inbox: Inbox, seen: Seen, machine: MachineState | None, measured: Measured, allowance: float
    ) -> Situation:
        eyes = [eye for eye in self._lookout.eyes if eye.looks(measured.direction)]
        return Situation(
            now_ns=now_ns,
            config=self._config,
            mode=self.mode,
            direction=measured.direction,
            speed_mps=measured.fastest_mps,
            is_speed_known=measured.speed_mps is not None,
            max_speed_mps=self._max_speed_mps,
            braking=measured.braking,
            allowance_m=allowance,
            odom=seen.odom,
            machine=machine,
            map_pose=seen.map_pose,
            wish=seen.wish,
            silent=silent(self._ages(now_ns, inbox, measured.direction)),
            frozen=tuple(f"lidar/{eye.name}" for eye in eyes if eye.is_frozen),
            faults=self._reports.active,
            gap=self._lookout.gap(),
            is_planned=self._lookout.way is not None and self._lookout.way.is_planned,
            threat=self._lookout.threat(),
            proven_m=self._lookout.proven_m(now_ns, measured.direction, seen.health),
            fence_m=self._lookout.fence_m(),
            position_sigma_m=measured.position_sigma_m,
            hand_forced_s=measured.hand_forced_s,
            steering_off_s=measured.steering_off_s,
            steering_lost_s=measured.steering_lost_s,
            brake_weak_s=measured.brake_weak_s,
        )

    def _change_mode(
        self,
        now_ns: int,
        orders: tuple[OperatorOrder, ...],
        situation: Situation,
        judgement: Judgement,
        mission: MissionStatus | None,
    ) -> None:
        asked = self._orders.events(now_ns, orders)
        events = guarded(asked, situation, judgement) | self._observed(now_ns, situation, judgement, mission)
        before, self.mode = self.mode, next_mode(self.mode, events)
        if Event.EMERGENCY in asked and before is not Mode.EMERGENCY_STOP:
            self._latched = ORDERED
        elif self.mode is not before:
            self._latched = judgement.fault if self.mode in LATCHING and judgement.is_fault else None
        if self.mode is not before:
            self._enter(before, situation, judgement)

    def _observed(
        self, now_ns: int, situation: Situation, judgement: Judgement, mission: MissionStatus | None
    ) -> frozenset[Event]:
        """Events that nobody ordered."""
        warned_s = self._warned.update(now_ns, self.mode is Mode.START_WARNING)
        is_passable = judgement.passable_mps >= kmh(self._config.modes.resume_kmh)
        clear_s = self._clear.update(now_ns, self.mode is Mode.OBSTACLE_STOP and is_passable)
        is_over = mission is not None and mission.state in (MissionState.FINISHED, MissionState.ABORTED)
        happened = {
            Event.EMERGENCY: judgement.is_emergency,
            Event.HAND: judgement.is_hand,
            Event.FAULT: judgement.is_fault,
            Event.DONE: is_over and not situation.is_moving,
            Event.OBSTACLE: self._is_blocked(situation, judgement),
            Event.CLEAR: clear_s >= self._config.modes.resume_clear_s,
            Event.WARNED: warned_s >= self._warning_s,
        }
        return frozenset(event for event, holds in happened.items() if holds)

    def _is_blocked(self, situation: Situation, judgement: Judgement) -> bool:
        """Whether an obstacle stops the machine: inside the stopping distance, or it stands and may not go on."""
        if judgement.is_obstacle_inside:
            return True
        if judgement.passable_mps >= self._config.modes.creep_mps or situation.is_moving:
            return False
        wish = situation.wish
        return self.mode is Mode.START_WARNING or (wish is not None and wish.speed_mps != 0.0)

    def _enter(self, before: Mode, situation: Situation, judgement: Judgement) -> None:
        """What a change of mode sets and forgets."""
        modes = self._config.modes
        is_resuming = before is Mode.OBSTACLE_STOP
        self._warning_s = modes.resume_warning_s if is_resuming else modes.start_warning_s
        self._warned.update(situation.now_ns, False)
        self._clear.update(situation.now_ns, False)
        if self.mode is Mode.OBSTACLE_STOP:
            self._cause = judgement.blocking.code
        if before in LATCHING and self.mode is Mode.STANDBY:
            self._reports.reset()
        self._orders.forget_start()

    def _reason(self, situation: Situation, judgement: Judgement) -> str:
        """Why the command is what it is; "" when the wish passes whole."""
        if self._latched is not None:
            return self._latched.code
        if self.mode is Mode.OBSTACLE_STOP:
            return self._cause
        if self.mode is Mode.AUTOMATIC:
            wished = 0.0 if situation.wish is None else abs(situation.wish.speed_mps)
            is_bound = judgement.allowed_mps < wished - BOUND_MPS or situation.wish is None
            return judgement.binding.code if is_bound else ""
        if self.mode is Mode.STANDBY and not judgement.is_ready:
            return judgement.fault.code
        return str(self.mode)

    def _moment(self, situation: Situation, measured: Measured, judgement: Judgement, reason: str) -> Moment:
        curvature = None if situation.machine is None else situation.machine.curvature_radpm
        gap = judgement.gap_m if judgement.binding_is_obstacle or self.mode is Mode.OBSTACLE_STOP else math.inf
        is_stopping = self.mode is Mode.OBSTACLE_STOP and situation.is_moving
        self._is_urgent = judgement.is_obstacle_inside or (self._is_urgent and is_stopping)
        gap = 0.0 if self._is_urgent else gap  # once inside the stopping distance: all the brakes to the end
        return Moment(
            situation.now_ns, self.mode, reason, situation.wish, situation.machine, measured.speed_mps, curvature,
            judgement.allowed_mps, gap, situation.braking,
        )  # fmt: skip

    def _tell(self, now_ns: int, judgement: Judgement) -> list[Fault]:
        told = [ABLATION] if self._disabled else []
        told += [self._latched] if self._latched is not None else []
        told += judgement.notes if self.mode in WATCHED else []
        return self._alarms.update(now_ns, told)

    def _is_state_due(self, now_ns: int, reason: str) -> bool:
        is_due = self._state_ns is None or abs(now_ns - self._state_ns) >= STATE_NS
        if not is_due and self._told == (self.mode, reason):
            return False
        self._state_ns, self._told = now_ns, (self.mode, reason)
        return True

    def _state(self, situation: Situation, seen: Seen, judgement: Judgement, reason: str) -> SupervisorState:
        hits = np.empty((0, 3)) if situation.gap is None else situation.gap.hits_base_m
        stride = max(1, math.ceil(len(hits) / MOST_HITS))
        way = self._lookout.way
        modes = self._config.modes
        clear_s = self._clear.update(situation.now_ns, self._clear.is_held)
        return SupervisorState(
            stamp_ns=situation.now_ns,
            mode=self.mode,
            reason=reason,
            rules=judgement.results,
            cause_class=self._lookout.cause(seen.odom, seen.tracks),
            gap_m=judgement.gap_m,
            stopping_m=stopping_distance(situation.speed_mps, situation.braking),
            required_m=required_range(situation.speed_mps, situation.braking, situation.allowance_m),
            proven_range_m=situation.proven_m,
            resume_in_s=max(0.0, modes.resume_clear_s - clear_s) if self.mode is Mode.OBSTACLE_STOP else 0.0,
            hits_base_m=hits[::stride].astype(np.float32),
            field_base_m=np.empty((0, 2)) if way is None else outline_of(way.main),
        )


LATCHING = frozenset({Mode.FAULT_STOP, Mode.EMERGENCY_STOP, Mode.MANUAL})


def guarded(asked: frozenset[Event], situation: Situation, judgement: Judgement) -> frozenset[Event]:
    """Orders that may be followed now: a reset and a start only at standstill and when nothing speaks against it."""
    allowed = set(asked)
    is_still = situation.is_speed_known and not situation.is_moving
    if not is_still or judgement.is_emergency:
        allowed.discard(Event.RESET)
    if not is_still or not judgement.is_ready:
        allowed.discard(Event.START)
    return frozenset(allowed)
