"""Mission node: publishes the path to drive, follows progress, and plans detours around persistent obstacles."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import Pose2
from geometry.transforms import apply
from messages.command import ControlCommand, Mode, OperatorCommand, OperatorCommandKind, SupervisorState
from messages.errors import FieldError
from messages.motion import MapPose, Odometry
from messages.node import All, Every, Inbox, Latest, Node, Output, Read
from messages.perception import ObstacleClass, Tracks
from messages.plan import MissionState, MissionStatus, Path, PathSectionType, UncoveredArea
from planning.config import MissionConfig
from planning.docking.dock import Docking, plan_docking
from planning.docking.dock_approach import plan_approach, uwb_unavailable_reason
from planning.line_shift import LineShift
from planning.path import rest_of
from planning.plan import Plan, RefillStop
from planning.recovery.detour import area_without_obstacles
from planning.recovery.obstacle_recovery import (
    ActivePath,
    Blockage,
    ResumeStep,
    Step,
    blockage_on_detour,
    plan_recovery,
    plan_resume,
)
from planning.recovery.static_obstacles import (
    LIVING_CLASSES,
    StaticObstacle,
    first_on_path,
    merged,
    obstacle_from_points,
    static_obstacles,
)

PERIOD_NS = 100_000_000
REVERSE_CLEARANCE_M = 0.3
EDGE_M = 0.4
ORDERED = (Mode.START_WARNING, Mode.AUTOMATIC)
SAME_OBSTACLE_M = 3.0  # a static track so close to the obstacle passed is the same obstacle


class MissionNode(Node):
    """Executes a plan path by path, from OperatorCommandKind.START to the end of the last path.

    At a refill place it waits until the supervisor has stopped the machine and then taken a start or resume.
    """

    def __init__(self, plan: Plan, config: MissionConfig, seed: int) -> None:
        self.name = "mission"
        self.reads: dict[str, Read] = {
            "odom": Latest(), "map_pose": Latest(), "control_command": Latest(), "supervisor": Latest(),
            "tracks": Latest(), "operator_command": All(8),
        }  # fmt: skip
        self.writes = ("path", "mission")
        self.runs = Every(PERIOD_NS)
        self._plan, self._config, self._seed = plan, config, seed
        self._state, self._text = MissionState.WAITING, "waiting for the start command"
        stops = {stop.path_id: stop for stop in plan.refills}
        self._steps: list[Step | Docking | RefillStop] = []
        for path in plan.fixed_paths:
            self._steps += [path, stops[path.path_id]] if path.path_id in stops else [path]
        self._steps += [plan.docking] if plan.docking else []
        self._has_stood = False  # at a refill place
        self._active_docking: Docking | None = None  # set when the approach into the dock has begun
        self._path_ended_ns: int | None = None  # end of a path while the next one is not available
        self._path: Path | None = None
        self._s_m, self._driven_m, self._total_m = 0.0, 0.0, plan.length_m
        self._command_sequence = -1
        self._line_shift = LineShift(config.max_shift_m)
        self._last_id = max(p.path_id for p in plan.paths)
        self._blocked_ns: int | None = None
        self._retry_ns = 0  # earliest next search for another path into the dock
        self._detours = 0
        self._is_waiting = False
        self._uncovered: tuple[UncoveredArea, ...] = ()
        self._drivable = plan.drivable.allowed.buffer(-EDGE_M)  # static objects beyond it are fence or hedge

    def step(self, now_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publishes the status in each step and a path when it is new."""
        before = self._path
        commands = self._new_commands(now_ns, inbox)
        if self._state is MissionState.WAITING:
            if self._is_ordered(commands, inbox):
                self._state, self._path_ended_ns = MissionState.DRIVING, now_ns
                self._start_next(now_ns, inbox)
        elif self._state in (MissionState.DRIVING, MissionState.REPLANNING):
            self._follow(now_ns, inbox)
        self._shift_line(commands)
        outputs: list[Output] = [("mission", self._status(now_ns))]
        if self._path is not None and self._path is not before:
            outputs.append(("path", replace(self._path, stamp_ns=now_ns)))
        return outputs

    def _new_commands(self, now_ns: int, inbox: Inbox) -> list[OperatorCommand]:
        """Commands with a rising number that have not expired."""
        found = []
        for command in inbox.all("operator_command", OperatorCommand):
            if command.sequence > self._command_sequence and now_ns <= command.expires_ns:
                found.append(command)
            self._command_sequence = max(self._command_sequence, command.sequence)
        return found

    def _shift_line(self, commands: list[OperatorCommand]) -> None:
        """Takes nudges of the operator; the end of the mission ends the shift."""
        for command in commands:
            if command.kind is OperatorCommandKind.NUDGE and self._path is not None:
                self._line_shift.nudge(command.left_m, self._path, self._s_m)
        if self._state in (MissionState.FINISHED, MissionState.ABORTED):
            self._line_shift.reset()

    def _follow(self, now_ns: int, inbox: Inbox) -> None:
        if self._path_ended_ns is not None:
            self._start_next(now_ns, inbox)
            return
        control_command, path = inbox.latest("control_command", ControlCommand), self._path
        if path is not None and control_command is not None and control_command.path_id == path.path_id:
            self._s_m = float(np.clip(control_command.path_s_m, 0.0, path.s_m[-1]))
            if control_command.is_finished:
                self._finish_path(now_ns, inbox)
                return
        if self._active_docking is not None:
            pose = inbox.latest("map_pose", MapPose)
            reason = None if pose is None else uwb_unavailable_reason(pose, self._active_docking.config.uwb_lost_s)
            if reason is not None:
                self._abort(reason)
                return
        self._monitor_stop(now_ns, inbox)

    def _finish_path(self, now_ns: int, inbox: Inbox) -> None:
        assert self._path is not None
        self._blocked_ns, self._s_m = None, float(self._path.s_m[-1])
        if self._steps and isinstance(self._steps[0], RefillStop):
            stop, *self._steps = self._steps
            assert isinstance(stop, RefillStop)
            self._state, self._has_stood = MissionState.WAITING, False
            self._text = f"waiting at refill place {stop.number} ({stop.reason}) for the start command"
        elif self._steps:
            self._path_ended_ns = now_ns
            self._start_next(now_ns, inbox)
        else:
            self._state, self._text = MissionState.FINISHED, "finished"

    def _is_ordered(self, commands: list[OperatorCommand], inbox: Inbox) -> bool:
        """Whether a start was ordered; at a refill place, whether the supervisor has stopped and taken one since."""
        if self._path is None:
            return any(c.kind is OperatorCommandKind.START for c in commands)
        supervisor = inbox.latest("supervisor", SupervisorState)
        if supervisor is None:
            return False
        is_engaged = supervisor.mode in ORDERED
        self._has_stood = self._has_stood or not is_engaged
        return self._has_stood and is_engaged

    def _start_next(self, now_ns: int, inbox: Inbox) -> None:
        """Starts the next step; a resume step or the dock approach is planned now, from the present observation."""
        step = self._steps[0]
        assert not isinstance(step, RefillStop)
        if not isinstance(step, Path):
            pose = inbox.latest("map_pose", MapPose)
            if pose is None:
                return
            if isinstance(step, Docking):
                paths = self._approach(now_ns, step, pose, inbox)
            else:
                paths = self._resume_paths(step, pose, inbox)
            if not paths:
                return
            self._steps[:1] = paths
        self._switch_to(self._steps, "driving")

    def _approach(self, now_ns: int, docking: Docking, pose: MapPose, inbox: Inbox) -> list[Path]:
        """Paths into the dock from the measured pose; none while UWB is unavailable, which aborts after a time."""
        reason = uwb_unavailable_reason(pose, docking.config.max_uwb_age_s)
        if reason is not None:
            self._text = reason
            if self._path_ended_ns is not None and now_ns - self._path_ended_ns > docking.config.uwb_wait_s * 1e9:
                self._abort(reason)
            return []
        outlines = [o.outline for o in self._static_obstacles(pose, inbox)]
        try:
            paths = plan_approach(pose, docking, self._last_id + 1, outlines)
        except FieldError as error:
            self._abort(str(error))
            return []
        self._active_docking, self._last_id = docking, self._last_id + len(paths)
        return list(paths)

    def _resume_paths(self, resume: ResumeStep, pose: MapPose, inbox: Inbox) -> list[Path]:
        found, cause = self._static_obstacles(pose, inbox), resume.blockage.cause
        near = [o for o in found if o.outline.distance(cause.outline) < SAME_OBSTACLE_M]
        obstacle = merged([cause, *near], SAME_OBSTACLE_M)[0]  # its far side is visible only from here
        drivable = area_without_obstacles(self._plan.drivable.allowed, [o.outline for o in found], REVERSE_CLEARANCE_M)
        p = pose.T_map_base[:2, 3]
        paths, uncovered = plan_resume(resume, obstacle, p, drivable, self._plan.rig, self._config, self._new_id)
        self._uncovered = (*self._uncovered, *uncovered)
        return paths

    def _monitor_stop(self, now_ns: int, inbox: Inbox) -> None:
        """Measures the duration of an obstacle stop; plans a detour when it is long enough."""
        supervisor = inbox.latest("supervisor", SupervisorState)
        if supervisor is None or supervisor.mode is not Mode.OBSTACLE_STOP:
            self._blocked_ns = None
            if self._is_waiting or self._state is MissionState.REPLANNING:
                self._is_waiting, self._state, self._text = False, MissionState.DRIVING, "driving"
            return
        self._blocked_ns = now_ns if self._blocked_ns is None else self._blocked_ns
        waited_s = (now_ns - self._blocked_ns) / 1e9
        if waited_s < self._config.blocked_s or now_ns < self._retry_ns:
            return
        pose, odom = inbox.latest("map_pose", MapPose), inbox.latest("odom", Odometry)
        if pose is None or odom is None or abs(odom.speed_mps) > self._config.static_speed_mps:
            return
        found = self._static_obstacles(pose, inbox)
        cause = self._cause(found, pose, supervisor)
        is_unknown = cause is not None and cause.label is ObstacleClass.UNKNOWN
        if cause is None or (is_unknown and waited_s < self._config.blocked_unknown_s):
            return
        if self._path is not None and self._path.is_transport:
            self._retry_ns = now_ns + round(self._config.blocked_s * 1e9)
            self._avoid_in_yard(cause, found, pose, waited_s)
        else:
            self._avoid(cause, found, pose)

    def _static_obstacles(self, pose: MapPose, inbox: Inbox) -> list[StaticObstacle]:
        tracks = inbox.latest("tracks", Tracks)
        return static_obstacles(
            tracks, pose.T_map_odom, self._config.static_speed_mps, self._drivable, self._config.merge_distance_m
        )

    def _cause(self, found: list[StaticObstacle], pose: MapPose, supervisor: SupervisorState) -> StaticObstacle | None:
        path = self._path
        assert path is not None
        ahead = (path.s_m >= self._s_m) & (path.s_m <= self._s_m + self._config.search_distance_m)
        rig = self._plan.folded_rig if path.is_transport else self._plan.rig
        cause = first_on_path(found, rig.bodies, path.p_map_m[ahead][::5], path.heading_rad[ahead][::5])
        if cause is not None:
            return cause
        hits = np.asarray(supervisor.triggering_points_base_m, np.float64)
        return obstacle_from_points(np.asarray(apply(pose.T_map_base, hits)[:, :2], np.float64))

    def _avoid(self, cause: StaticObstacle, found: list[StaticObstacle], pose: MapPose) -> None:
        path, p = self._path, pose.T_map_base[:2, 3]
        assert path is not None
        is_leaving = path.direction < 0 and self._resume_step is None  # reversing ends, work goes on forward
        if cause.label in LIVING_CLASSES and not is_leaving:
            self._is_waiting, self._text = True, f"waiting until {cause.label} has left the path"
            return
        self._detours += 1
        if self._detours > self._config.max_detours:
            self._abort(f"aborted after {self._config.max_detours} detours")
            return
        self._state, self._text = MissionState.REPLANNING, f"planning a detour around: {cause.label}"
        self._blocked_ns = None
        if is_leaving:
            self._cancel_reverse(p)
            return
        blockage = self._blockage(path, p, cause, tuple(o for o in found if o is not cause))
        steps = plan_recovery(blockage, self._plan, self._config, self._seed + self._detours, self._new_id)
        if not steps:
            x, y = cause.outline.centroid.coords[0]
            self._abort(f"no path around {cause.label} at x {x:.1f} m, y {y:.1f} m")
            return
        later = self._steps if self._resume_step is None else self._steps[self._steps.index(self._resume_step) + 1 :]
        self._switch_to([*steps, *later], "driving around an obstacle")

    def _avoid_in_yard(
        self, cause: StaticObstacle, found: list[StaticObstacle], pose: MapPose, waited_s: float
    ) -> None:
        """Switches to another path into the dock; without one, and when undocking, waits and aborts after a time."""
        if cause.label in LIVING_CLASSES:
            reason = "it is not driven around"
        elif self._active_docking is not None:
            outlines = [cause.outline, *(o.outline for o in found if o is not cause)]
            try:
                paths = plan_docking(Pose2.of(pose.T_map_base), self._active_docking, self._last_id + 1, outlines)
            except FieldError as error:
                reason = str(error)
            else:
                self._last_id += len(paths)
                self._switch_to(list(paths), "driving around an obstacle")
                return
        else:
            reason = "there is no other path"
        if self._plan.docking is not None and waited_s >= self._plan.docking.config.blocked_timeout_s:
            x, y = cause.outline.centroid.coords[0]
            self._abort(f"{cause.label} on the path at x {x:.1f} m, y {y:.1f} m: {reason}")

    def _cancel_reverse(self, p_map_m: Float64) -> None:
        """Ends reversing because of an obstacle behind: work resumes from the present position."""
        remaining = self._steps[0]
        assert isinstance(remaining, Path)
        steps = [rest_of(remaining, 0.0, p_map_m, self._new_id(), self._plan.rig), *self._steps[1:]]
        self._switch_to(steps, "driving around an obstacle")

    def _blockage(
        self, path: Path, p_map_m: Float64, cause: StaticObstacle, others: tuple[StaticObstacle, ...]
    ) -> Blockage:
        if self._resume_step is not None:
            return blockage_on_detour(self._resume_step, path, self._s_m, p_map_m, cause, others)
        return Blockage(path, self._s_m, ActivePath(path, 0.0, 0.0), self._s_m, p_map_m, cause, others)

    @property
    def _resume_step(self) -> ResumeStep | None:
        """The resume step still ahead on a detour."""
        return next((s for s in self._steps if isinstance(s, ResumeStep)), None)

    def _switch_to(self, steps: Sequence[Step | Docking | RefillStop], text: str) -> None:
        """Replaces the present path, at its end or before."""
        self._driven_m += self._s_m
        first, *self._steps = steps
        assert isinstance(first, Path)
        self._path, self._s_m, self._path_ended_ns, self._blocked_ns = first, 0.0, None, None
        self._state, self._text = MissionState.DRIVING, text
        self._total_m = self._driven_m + sum(self._length_m(s) for s in steps)

    def _length_m(self, step: Step | Docking | RefillStop) -> float:
        """Length of a step: of a resume step the rest of its line, of docking the planned length."""
        if isinstance(step, RefillStop):
            return 0.0
        if isinstance(step, Path):
            return float(step.s_m[-1])
        if isinstance(step, Docking):
            return sum(float(p.s_m[-1]) for p in self._plan.docking_paths)
        return float(step.blockage.line.s_m[-1]) - step.rejoin_m

    def _abort(self, text: str) -> None:
        self._state, self._text = MissionState.ABORTED, text

    def _new_id(self) -> int:
        self._last_id += 1
        return self._last_id

    def _status(self, now_ns: int) -> MissionStatus:
        section_type, line, path_id, shift = PathSectionType.LANE, -1, -1, (0.0, 0.0, 0.0)
        if self._path is not None:
            path_id, shift = self._path.path_id, self._line_shift.at(self._path, self._s_m)
            section = self._path.section_at(self._s_m)
            section_type, line = section.section_type, section.line
        return MissionStatus(
            now_ns, self._state, section_type, line, path_id, self._s_m, self._driven_m + self._s_m, self._total_m,
            self._text, self._uncovered, *shift,
        )  # fmt: skip
