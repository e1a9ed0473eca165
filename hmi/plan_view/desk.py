"""Planning desk: the field, options and plan that all pages show, and that the operator in control changes."""

import asyncio
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from configs.mission import EdgeMargin, Refill, Work
from configs.site import DatumConfig
from configs.strict import parse
from hmi.page_state import PageState
from hmi.plan_view.drawing import Drawing, Kind, Point, Ring
from hmi.plan_view.field_job import FieldJob, Task
from hmi.plan_view.mission_store import MISSION, PLAN, MissionStore, StoredMission, file_name, plain_name
from hmi.plan_view.options import PlanOptions, default_work, options_of, read_mission, write_mission
from hmi.plan_view.plan_result import PlanResult, read_result
from hmi.refusal import Refused
from messages.errors import ConfigError, HeadlandError

MIN_LINE_M, GUIDE_M = 1.0, 2000.0  # least distance of A and B; drawn to both sides of A
MAX_FIELD_BYTES = 20_000_000
MAX_FILES = 20
OF_THE_PLAN = ("sections", "guide", "labels", "margins")  # lines of a map that are not of the outline
MAX_NOTE, MAX_REASON = 300, 40
MAX_AT_M = 20_000.0  # from the origin of the map


@dataclass(frozen=True)
class FileLine:
    """A guidance line of the field file: its number and name, and points in `map`."""

    number: str
    name: str
    points_m: list[Point]


class PlanDesk:
    """Field, options and plan; every change raises HeadlandError with the reason for which it is not possible now."""

    def __init__(self, store: MissionStore, command: tuple[str, ...], options: PlanOptions, limit_s: float) -> None:
        self.store, self.options = store, options
        self._command, self._limit_s = command, limit_s
        self.work: Callable[[], Work] = default_work  # speeds, overlap and margin of new plans
        self.job: FieldJob | None = None
        self.error = ""
        self.draft: Path | None = None
        self._clear()
        self.drawing = Drawing()

    def _clear(self) -> None:
        """Without field, plan, guidance line and consent; the draft of another one is removed."""
        self.options = replace(self.options.without_line().without_places(), consent=None)
        self.lines: list[FileLine] = []
        if self.draft is not None:
            self.store.remove_draft(self.draft)
        self.draft = None
        self.name = ""
        self.features: list[tuple[str, str]] = []
        self.feature: str | None = None
        self.notes: list[str] = []
        self.outline: dict[str, Any] | None = None
        self.no_go_m: tuple[Ring, ...] = ()  # besides those of the file
        self.gate_m: Point | None = None
        self.lane_m: Ring = ()  # from the gate to the yard
        self.plan: PlanResult | None = None
        self.stored: StoredMission | None = None

    async def load(self, files: Mapping[str, bytes]) -> None:
        """Takes the files of a field as a browser has sent them, and reads it."""
        self._check_free()
        names = [file_name(name) for name in files]
        if not files or len(set(names)) < len(names):
            raise Refused("same_name" if files else "no_file")
        self._clear()
        self.drawing, self.error = Drawing(), ""
        try:
            self.draft = self.store.new_draft()
            for name, data in zip(names, files.values(), strict=True):
                (self.draft / "field" / name).write_bytes(data)
        except OSError as error:
            self._clear()
            raise HeadlandError(f"{self.store.folder}: cannot be written ({error.strerror or error})") from error
        await self._read()

    async def choose(self, key: str) -> None:
        """Takes one of several fields of the file."""
        self._check_free()
        if key not in dict(self.features):
            raise Refused("no_feature", name=key[:60])
        self.feature, self.plan, self.stored, self.error = key, None, None, ""
        self.options = self.options.without_line().without_places()
        await self._read()

    def draw(self, kind: Kind, side: str = "") -> None:
        """Begins what is drawn by clicks, or by driving along the edge of the field with one side of the implement."""
        self._check_free()
        if kind not in ("outline", "driven"):
            if self.outline is None:
                raise Refused("no_field")
        else:
            self._clear()
        self.drawing, self.error = Drawing(kind, side), ""

    def draw_a_plus(self, heading: str) -> None:
        """Begins a guidance line by its heading, clockwise from north; its point A follows."""
        try:
            heading_deg = float(heading)
        except ValueError:
            heading_deg = math.nan
        if not 0.0 <= heading_deg <= 360.0:
            raise Refused("heading", value=heading[:20])
        self.draw("a_plus")
        self.drawing.heading_deg = heading_deg

    def draw_place(self, kind: Kind, amount_and_reason: str) -> None:
        """Begins a margin (m) or a refill place (m²) with its reason; the clicks follow."""
        amount, _, reason = amount_and_reason.strip().partition(" ")
        try:
            number = float(amount)
        except ValueError:
            number = math.nan
        if not number >= 0.0 or not reason.strip():
            raise Refused("amount", value=amount_and_reason[:40])
        self.draw(kind)
        self.drawing.amount, self.drawing.reason = number, plain_name(reason, MAX_REASON)

    def add_point(self, x_m: float, y_m: float) -> None:
        """A corner in the shown `map`; the point of a gate, and the last one of a guidance line, end their drawing."""
        if not (math.isfinite(x_m) and math.isfinite(y_m) and max(abs(x_m), abs(y_m)) <= MAX_AT_M):
            raise Refused("outside_map", x=f"{x_m:g}", y=f"{y_m:g}")
        if self.drawing.kind == "gate":
            self._check_free()
            self.drawing = Drawing()
            self._change(self.no_go_m, (round(x_m, 2), round(y_m, 2)), ())
        elif self.drawing.kind in ("ab", "a_plus"):
            self._check_free()
            self.drawing.add(x_m, y_m)
            self._take_line()
        elif self.drawing.kind in ("swaths_from", "margin", "refill"):
            self._check_free()
            self.drawing.add(x_m, y_m)
            self._take_place()
        elif self.drawing.kind != "driven":
            self.drawing.add(x_m, y_m)

    def _take_line(self) -> None:
        """Swaths along the drawn line, when it has all its points."""
        drawing = self.drawing
        a_m, heading_deg = drawing.points_m[0], drawing.heading_deg
        if drawing.kind == "ab":
            if len(drawing.points_m) < 2:
                return
            b_m = drawing.points_m[1]
            if math.dist(a_m, b_m) < MIN_LINE_M:
                drawing.points_m.pop()
                raise Refused("short_line", distance=f"{math.dist(a_m, b_m):.1f}", least=MIN_LINE_M)
            heading_deg = math.degrees(math.atan2(b_m[0] - a_m[0], b_m[1] - a_m[1]))
        self.drawing = Drawing()
        self._set_options(self.options.with_line(a_m, heading_deg))

    def _take_place(self) -> None:
        """Takes the side of the first swath, the refill place, or a margin between two points; raises ConfigError."""
        drawing, options = self.drawing, self.options
        at_m, reason = drawing.points_m[-1], drawing.reason
        if drawing.kind == "margin" and len(drawing.points_m) < 2:
            return
        self.drawing = Drawing()
        if drawing.kind == "swaths_from":
            changed = replace(options, swaths_from_m=at_m)
        elif drawing.kind == "refill":
            refill = parse(Refill, {"at_m": at_m, "every_m2": drawing.amount, "reason": reason}, "refill")
            changed = replace(options, refill=refill)
        else:
            ends = {"from_m": drawing.points_m[0], "to_m": at_m}
            margin = parse(EdgeMargin, {**ends, "margin_m": drawing.amount, "reason": reason}, "margin")
            changed = replace(options, margins=(*options.margins, margin))
        self._set_options(changed)

    def remove_places(self) -> None:
        """Removes side of the first swath, margins and refill place."""
        self._check_free()
        self._set_options(self.options.without_places())

    def remove_line(self) -> None:
        """Swaths without guidance line."""
        self._check_free()
        self._set_options(self.options.without_line())

    @property
    def guide(self) -> list[Point] | None:
        """Points in `map` of the guidance line of the swaths, a straight one to far outside; None without one."""
        options = self.options
        if options.through_m is not None and options.heading_deg is not None:
            (x_m, y_m), angle = options.through_m, math.radians(options.heading_deg)
            dx_m, dy_m = GUIDE_M * math.sin(angle), GUIDE_M * math.cos(angle)
            return [(x_m - dx_m, y_m - dy_m), (x_m + dx_m, y_m + dy_m)]
        return next((line.points_m for line in self.lines if line.number == options.guidance), None)

    def follow(self, state: PageState) -> None:
        """Takes the edge along which the machine drives."""
        if self.job is None:
            self.drawing.follow(state)

    def remove_point(self) -> None:
        """Removes the last corner."""
        if self.drawing.points_m:
            self.drawing.points_m.pop()

    def remove_areas(self) -> None:
        """Removes the drawn no-go areas and lane, and the chosen gate."""
        self._check_free()
        self._change((), None, ())

    async def close_drawing(self, datum: DatumConfig, name: str) -> None:
        """The drawn corners become a field file, an area to keep out of, or a lane."""
        self._check_free()
        drawing = self.drawing
        if len(drawing.points_m) < drawing.least_points:
            raise Refused("few_corners", number=len(drawing.points_m), least=drawing.least_points)
        if drawing.kind == "no_go":
            self.drawing = Drawing()
            self._change((*self.no_go_m, tuple(drawing.points_m)), self.gate_m, self.lane_m)
            return
        if drawing.kind == "lane":
            self.drawing = Drawing()
            self._change(self.no_go_m, None, tuple(drawing.points_m))
            return
        ring = []
        for x_m, y_m in (*drawing.points_m, drawing.points_m[0]):
            latitude, longitude, _ = datum.datum.to_ellipsoid(x_m, y_m, 0.0)
            ring.append([round(math.degrees(longitude), 9), round(math.degrees(latitude), 9)])
        geometry = {"type": "Polygon", "coordinates": [ring]}
        feature = {"type": "Feature", "properties": {"name": name}, "geometry": geometry}
        await self.load({"drawn.geojson": json.dumps(feature).encode()})
        if self.error:  # the corners can be corrected
            self.drawing = drawing

    def _change(self, no_go_m: tuple[Ring, ...], gate_m: Point | None, lane_m: Ring) -> None:
        """Takes areas, and a gate or a lane; a plan without them is void."""
        self.no_go_m, self.gate_m, self.lane_m, self.plan, self.stored = no_go_m, gate_m, lane_m, None, None
        self._redraw()

    def _redraw(self) -> None:
        if self.outline is not None:
            self.outline = dict(self.outline)  # another one than was shown

    @property
    def shown_outline(self) -> dict[str, Any] | None:
        """Outline for the map, with the drawn areas and lane, and the gate as a point."""
        outline = self.outline
        if outline is None:
            return None
        gates = [[self.gate_m, self.gate_m]] if self.gate_m is not None else outline["gates"]
        lanes = [self.lane_m] if self.lane_m else outline["lanes"]
        no_go = [*outline["no_go"], *self.no_go_m]
        return outline | {"no_go": no_go, "gates": gates, "lanes": lanes, "guide": self.guide} | self.places

    @property
    def places(self) -> dict[str, Any]:
        """Side of the first swath and refill place, and ends of the margins, for the map."""
        options = self.options
        points = [("1", options.swaths_from_m), ("R", None if options.refill is None else options.refill.at_m)]
        labelled = [[[*at_m], name] for name, at_m in points if at_m is not None]
        found = {"labels": labelled, "margins": [[m.from_m, m.to_m] for m in options.margins]}
        return {name: shown for name, shown in found.items() if shown}

    def set_option(self, name: str, value: str, by: str) -> None:
        """Changes an option, by a person; a plan with other ones is void."""
        self._check_free()
        self._set_options(self.options.changed(name, value, by))

    def choose_line(self, number: str) -> None:
        """Takes a guidance line of the file, none for an empty number."""
        self._check_free()
        if number and all(line.number != number for line in self.lines):
            raise Refused("no_line", name=number[:60])
        self._set_options(self.options.with_guidance(number) if number else self.options.without_line())

    def _set_options(self, changed: PlanOptions) -> None:
        if changed != self.options:
            self.options, self.plan, self.stored = changed, None, None
            self._redraw()

    async def make_plan(self) -> None:
        """Plans the field in a process of its own."""
        self._check_free()
        if self.draft is None or self.outline is None:
            raise Refused("no_field")
        self.plan, self.stored, self.error = None, None, ""
        (self.draft / PLAN).unlink(missing_ok=True)
        drawn = {"no_go_m": self.no_go_m, "gate_m": self.gate_m, "lane_m": self.lane_m}
        work = self.work().model_copy(update=drawn)
        write_mission(self.options.mission(self.name, work), self.draft / MISSION)
        draft = self.draft
        if await self._run("plan", draft) is not None:
            self.plan = await asyncio.to_thread(read_result, draft / PLAN)

    def cancel(self) -> None:
        """Ends the process that reads or plans."""
        if self.job is not None:
            self.job.cancel()

    def store_mission(self, name: str, author: str) -> StoredMission:
        """Stores field and plan under a name."""
        self._check_free()
        if self.draft is None or self.plan is None or self.stored is not None:
            raise Refused("no_plan")
        name = plain_name(name) or self.name
        draft, self.draft = self.draft, None
        try:
            stored = self.store.store(draft, name, self.feature, author)
        except HeadlandError:
            self.draft = draft
            raise
        self._show(stored)
        return stored

    def reopen(self, mission_id: str) -> None:
        """Shows a stored mission."""
        self._check_free()
        stored = self.store.find(mission_id)
        try:
            read_result(stored.folder / PLAN)
        except ConfigError as error:
            raise Refused("damaged") from error
        draft = self.store.reopen(stored)
        self._clear()
        self.draft, self.drawing, self.error = draft, Drawing(), ""
        self._show(stored)

    def delete(self, mission_id: str) -> None:
        """Deletes a stored mission; what is shown of it stays."""
        self._check_free()
        self.store.delete(mission_id)
        if self.stored is not None and self.stored.id == mission_id:
            self.stored = None

    def _show(self, stored: StoredMission) -> None:
        """Takes field, options and plan of a stored mission."""
        mission, work = read_mission(stored.folder / MISSION)
        if self.draft is None:
            self.draft = self.store.reopen(stored)
        self.options = options_of(mission, work)
        self.plan = read_result(stored.folder / PLAN)
        self.outline = {name: lines for name, lines in self.plan.map.items() if name not in OF_THE_PLAN}
        self.no_go_m, self.gate_m, self.lane_m = work.no_go_m, work.gate_m, work.lane_m
        drawn = len(work.no_go_m)  # the last areas of the site; they are drawn from the mission
        self.outline["no_go"] = self.outline["no_go"][: len(self.outline["no_go"]) - drawn]
        self.stored = stored
        self.features, self.notes, self.lines = [], [], []
        assert stored.about is not None
        self.name, self.feature = stored.about.name, stored.about.feature

    async def _read(self) -> None:
        assert self.draft is not None
        self.outline = None
        found = await self._run("read", self.draft)
        if found is None:
            return
        self.features = [(str(key), plain_name(str(name))) for key, name in found["features"]]
        self.notes = [plain_name(str(note), MAX_NOTE) for note in found["notes"]]
        self.lines = [FileLine(*line) for line in found.get("lines", ())]
        self.name = plain_name(str(found["name"]))
        self.outline = found.get("map")

    async def _run(self, task: Task, folder: Path) -> dict[str, Any] | None:
        """Result of a process, None if it was cancelled or has failed: `error` says why."""
        job = self.job = FieldJob(self._command, task)
        try:
            result = await job.run(folder, self.feature, self._limit_s)
        finally:
            self.job = None
        if job.is_cancelled:
            return None
        self.error = "" if "done" in result else str(result.get("error", "the planner has died"))[:500]
        found: dict[str, Any] | None = result.get("done")
        return found

    def _check_free(self) -> None:
        if self.job is not None:
            raise Refused("busy")
