"""The mission: publishes the path to drive, follows progress, and finds a way when something stays in the way."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import Pose2
from geometry.transforms import apply
from messages.command import ControlCommand, Mode, OperatorCommand, OperatorCommandKind, SupervisorState
from messages.errors import FieldError
from messages.motion import MapPose, Odometry
from messages.node import All, Every, Inbox, Latest, Node, Output, Read
from messages.perception import Tracks
from messages.plan import MissionState, MissionStatus, Path, PathSectionType, UncoveredArea
from planning.config import MissionConfig
from planning.docking.dock import Docking, plan_docking
from planning.docking.dock_approach import silence, way_in
from planning.path import rest_of
from planning.plan import Plan
from planning.recovery.detour import ground_without
from planning.recovery.obstacle_recovery import Blocked, Rejoin, Step, Trunk, blocked_again, settle, way_round
from planning.recovery.static_obstacles import ALIVE, Standing, first_in_way, from_hits, joined, standing

PERIOD_NS = 200_000_000
BACK_CLEARANCE_M = 0.3
EDGE_M = 0.4
SEEN_AGAIN_M = 3.0  # a standing track so near to what was driven round is the same thing


class MissionNode(Node):
    """Drives a plan: one path at a time, from OperatorCommandKind.START to the end of the last."""

    def __init__(self, plan: Plan, config: MissionConfig, seed: int) -> None:
        self.name = "mission"
        self.reads: dict[str, Read] = {
            "odom": Latest(), "map_pose": Latest(), "control_command": Latest(), "supervisor": Latest(),
            "tracks": Latest(),
            "operator_command": All(8),
        }  # fmt: skip
        self.writes = ("path", "mission")
        self.runs = Every(PERIOD_NS)
        self._plan, self._config, self._seed = plan, config, seed
        self._state, self._text = MissionState.WAITING, "waiting for the start order"
        self._steps: list[Step | Docking] = [*plan.given, *([plan.docking] if plan.docking else [])]
        self._homing: Docking | None = None  # once the way into the dock has begun
        self._between_ns: int | None = None  # since when a path has ended and the next is not there
        self._path: Path | None = None
        self._s_m, self._driven_m, self._total_m = 0.0, 0.0, plan.length_m
        self._order_sequence = -1
        self._last_id = max(p.path_id for p in plan.paths)
        self._blocked_ns: int | None = None
        self._again_ns = 0  # when to look again for another way into the dock
        self._detours = 0
        self._left_out: tuple[UncoveredArea, ...] = ()
        self._ground = plan.ground.allowed.buffer(-EDGE_M)  # what stands beyond is fence or hedge

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Start, follow, go on or find a way; the status goes out each time, a path when it is new."""
        before = self._path
        if self._state is MissionState.WAITING and self._is_started(now_ns, inbox):
            self._state, self._between_ns = MissionState.DRIVING, now_ns
            self._next(now_ns, inbox)
        elif self._state in (MissionState.DRIVING, MissionState.REPLANNING):
            self._follow(now_ns, inbox)
        outputs: list[Output] = [("mission", self._status(now_ns))]
        if self._path is not None and self._path is not before:
            outputs.append(("path", replace(self._path, stamp_ns=now_ns)))
        return outputs

    def _is_started(self, now_ns: int, inbox: Inbox) -> bool:
        is_started = False
        for order in inbox.all("operator_command", OperatorCommand):
            is_new = order.sequence > self._order_sequence and now_ns <= order.expires_ns
            self._order_sequence = max(self._order_sequence, order.sequence)
            is_started = is_started or (is_new and order.kind is OperatorCommandKind.START)
        return is_started

    def _follow(self, now_ns: int, inbox: Inbox) -> None:
        if self._between_ns is not None:
            self._next(now_ns, inbox)
            return
        control_command, path = inbox.latest("control_command", ControlCommand), self._path
        if path is not None and control_command is not None and control_command.path_id == path.path_id:
            self._s_m = float(np.clip(control_command.path_s_m, 0.0, path.s_m[-1]))
            if control_command.is_finished:
                self._finish_path(now_ns, inbox)
                return
        if self._homing is not None:
            pose = inbox.latest("map_pose", MapPose)
            reason = None if pose is None else silence(pose, self._homing.config.uwb_lost_s)
            if reason is not None:
                self._abort(reason)
                return
        self._watch(now_ns, inbox)

    def _finish_path(self, now_ns: int, inbox: Inbox) -> None:
        assert self._path is not None
        self._blocked_ns, self._s_m = None, float(self._path.s_m[-1])
        if self._steps:
            self._between_ns = now_ns
            self._next(now_ns, inbox)
        else:
            self._state, self._text = MissionState.FINISHED, "finished"

    def _next(self, now_ns: int, inbox: Inbox) -> None:
        """Take up the next step; a rejoining, or the way into the dock, is settled now, by what is seen now."""
        step = self._steps[0]
        if not isinstance(step, Path):
            pose = inbox.latest("map_pose", MapPose)
            if pose is None:
                return
            if isinstance(step, Docking):
                paths = self._way_in(now_ns, step, pose, inbox)
            else:
                paths = self._settled(step, pose, inbox)
            if not paths:
                return
            self._steps[:1] = paths
        self._take(self._steps, "driving")

    def _way_in(self, now_ns: int, docking: Docking, pose: MapPose, inbox: Inbox) -> list[Path]:
        """The paths into the dock from where the machine stands; none while UWB is silent, which ends in aborting."""
        reason = silence(pose, docking.config.uwb_age_s)
        if reason is not None:
            self._text = reason
            if self._between_ns is not None and now_ns - self._between_ns > docking.config.uwb_wait_s * 1e9:
                self._abort(reason)
            return []
        outlines = [o.outline for o in self._standing(pose, inbox)]
        try:
            paths = way_in(pose, docking, self._last_id + 1, outlines)
        except FieldError as error:
            self._abort(str(error))
            return []
        self._homing, self._last_id = docking, self._last_id + len(paths)
        return list(paths)

    def _settled(self, rejoin: Rejoin, pose: MapPose, inbox: Inbox) -> list[Path]:
        found, cause = self._standing(pose, inbox), rejoin.blocked.cause
        near = [o for o in found if o.outline.distance(cause.outline) < SEEN_AGAIN_M]
        seen = joined([cause, *near], SEEN_AGAIN_M)[0]  # its far side shows only from here
        ground = ground_without(self._plan.ground.allowed, [o.outline for o in found], BACK_CLEARANCE_M)
        p = pose.T_map_base[:2, 3]
        paths, missed = settle(rejoin, seen, p, ground, self._plan.rig, self._config, self._new_id)
        self._left_out = (*self._left_out, *missed)
        return paths

    def _watch(self, now_ns: int, inbox: Inbox) -> None:
        """Count how long an obstacle has stopped the machine; plan a way round when that is long enough."""
        supervisor = inbox.latest("supervisor", SupervisorState)
        if supervisor is None or supervisor.mode is not Mode.OBSTACLE_STOP:
            self._blocked_ns = None
            if self._state is MissionState.REPLANNING:
                self._state, self._text = MissionState.DRIVING, "driving"
            return
        self._blocked_ns = now_ns if self._blocked_ns is None else self._blocked_ns
        waited_s = (now_ns - self._blocked_ns) / 1e9
        if waited_s < self._config.blocked_s or now_ns < self._again_ns:
            return
        pose, odom = inbox.latest("map_pose", MapPose), inbox.latest("odom", Odometry)
        if pose is None or odom is None or abs(odom.speed_mps) > self._config.standing_mps:
            return
        found = self._standing(pose, inbox)
        cause = self._cause(found, pose, supervisor)
        if cause is None or (cause.label in ALIVE and waited_s < self._config.blocked_alive_s):
            return
        if self._path is not None and self._path.is_transport:
            self._again_ns = now_ns + round(self._config.blocked_s * 1e9)
            self._go_round_in_yard(cause, found, pose, waited_s)
        else:
            self._go_round(cause, found, pose)

    def _standing(self, pose: MapPose, inbox: Inbox) -> list[Standing]:
        tracks = inbox.latest("tracks", Tracks)
        return standing(tracks, pose.T_map_odom, self._config.standing_mps, self._ground, self._config.join_m)

    def _cause(self, found: list[Standing], pose: MapPose, supervisor: SupervisorState) -> Standing | None:
        path = self._path
        assert path is not None
        ahead = (path.s_m >= self._s_m) & (path.s_m <= self._s_m + self._config.look_m)
        rig = self._plan.docking.rig if path.is_transport and self._plan.docking is not None else self._plan.rig
        bodies = rig.bodies
        cause = first_in_way(found, bodies, path.p_map_m[ahead][::5], path.heading_rad[ahead][::5])
        if cause is not None:
            return cause
        hits = np.asarray(supervisor.triggering_points_base_m, np.float64)
        return from_hits(np.asarray(apply(pose.T_map_base, hits)[:, :2], np.float64))

    def _go_round(self, cause: Standing, found: list[Standing], pose: MapPose) -> None:
        path, p = self._path, pose.T_map_base[:2, 3]
        assert path is not None
        self._detours += 1
        if self._detours > self._config.most_detours:
            self._abort(f"gave up after {self._config.most_detours} detours")
            return
        self._state, self._text = MissionState.REPLANNING, f"looking for a way round: {cause.label}"
        self._blocked_ns = None
        if path.direction < 0 and self._rejoin is None:
            self._leave_back_up(p)
            return
        blocked = self._blocked(path, p, cause, tuple(o for o in found if o is not cause))
        steps = way_round(blocked, self._plan, self._config, self._seed + self._detours, self._new_id)
        if not steps:
            x, y = cause.outline.centroid.coords[0]
            self._abort(f"no way round {cause.label} at x {x:.1f} m, y {y:.1f} m")
            return
        later = self._steps if self._rejoin is None else self._steps[self._steps.index(self._rejoin) + 1 :]
        self._take([*steps, *later], "driving round an obstacle")

    def _go_round_in_yard(self, cause: Standing, found: list[Standing], pose: MapPose, waited_s: float) -> None:
        """Into the dock by another way if there is one; if not, or on the way out, wait and give up in the end."""
        if self._homing is not None:
            outlines = [cause.outline, *(o.outline for o in found if o is not cause)]
            try:
                paths = plan_docking(Pose2.of(pose.T_map_base), self._homing, self._last_id + 1, outlines)
            except FieldError as error:
                reason = str(error)
            else:
                self._last_id += len(paths)
                self._take(list(paths), "driving round an obstacle")
                return
        else:
            reason = "there is one way out of the bay"
        if self._plan.docking is not None and waited_s >= self._plan.docking.config.blocked_s:
            x, y = cause.outline.centroid.coords[0]
            self._abort(f"{cause.label} in the way at x {x:.1f} m, y {y:.1f} m: {reason}")

    def _leave_back_up(self, p_map_m: Float64) -> None:
        """Something is behind while backing up to where work should go on: work goes on from here."""
        rest = self._steps[0]
        assert isinstance(rest, Path)
        steps = [rest_of(rest, 0.0, p_map_m, self._new_id(), self._plan.rig), *self._steps[1:]]
        self._take(steps, "driving round an obstacle")

    def _blocked(self, path: Path, p_map_m: Float64, cause: Standing, others: tuple[Standing, ...]) -> Blocked:
        if self._rejoin is not None:
            return blocked_again(self._rejoin, path, self._s_m, p_map_m, cause, others)
        return Blocked(path, self._s_m, Trunk(path, 0.0, 0.0), self._s_m, p_map_m, cause, others)

    @property
    def _rejoin(self) -> Rejoin | None:
        """The rejoining that a detour still has before it."""
        return next((s for s in self._steps if isinstance(s, Rejoin)), None)

    def _take(self, steps: list[Step | Docking], text: str) -> None:
        """Leave the present path, at its end or before, for others."""
        self._driven_m += self._s_m
        first, *self._steps = steps
        assert isinstance(first, Path)
        self._path, self._s_m, self._between_ns, self._blocked_ns = first, 0.0, None, None
        self._state, self._text = MissionState.DRIVING, text
        self._total_m = self._driven_m + sum(self._length_m(s) for s in steps)

    def _length_m(self, step: Step | Docking) -> float:
        """Way of a step: of a rejoining what is left of its line, of docking what was planned at first."""
        if isinstance(step, Path):
            return float(step.s_m[-1])
        if isinstance(step, Docking):
            return sum(float(p.s_m[-1]) for p in self._plan.homing)
        return float(step.blocked.line.s_m[-1]) - step.rejoin_m

    def _abort(self, text: str) -> None:
        self._state, self._text = MissionState.ABORTED, text

    def _new_id(self) -> int:
        self._last_id += 1
        return self._last_id

    def _status(self, now_ns: int) -> MissionStatus:
        section_type, line, path_id = PathSectionType.LANE, -1, -1
        if self._path is not None:
            path_id = self._path.path_id
            k = min(int(np.searchsorted(self._path.s_m, self._s_m)), len(self._path.s_m) - 1)
            section = self._path.sections[int(self._path.section_index[k])]
            section_type, line = section.section_type, section.line
        return MissionStatus(
            now_ns, self._state, section_type, line, path_id, self._s_m, self._driven_m + self._s_m, self._total_m,
            self._text,
            self._left_out,
        )  # fmt: skip
