"""Plan view in a browser: field, options, plan on the map, and stored missions."""

import math
from collections.abc import Mapping
from html import escape
from typing import Any

from nicegui import ui

from hmi.drive_view.controls import check_standing
from hmi.drive_view.map_view import static_map
from hmi.drive_view.row import Row, number
from hmi.parts import Moment
from hmi.plan_view.options import HEIGHTS_CM, MAX_PASSES, MAX_SKIP, choices
from hmi.plan_view.progress import Progress, read_progress
from hmi.refusal import Refused
from hmi.scene import Scene
from hmi.view import View

AREAS = (
    ("no_go", "plan.no_go"), ("gate", "plan.gate_place"), ("lane", "plan.lane"), ("remove_areas", "plan.remove_areas")
)  # fmt: skip
ENDED = ("outline", "driven", "no_go", "lane")  # drawings that are ended by a button
AMOUNTS = {"margin": "3", "refill": "10000"}  # drawn with an amount (m, m²), at first this, and a reason
PLACED = ("swaths_from", *(f"{name}{part}" for name in AMOUNTS for part in ("", "_amount", "_reason")))
MAX_VALUE = 200  # characters
HEADINGS = range(0, 180, 5)
SIDES = ("left", "right", "middle")  # of the implement, along the edge of a field that is recorded
COLUMNS = ("name", "stored_at", "author", "", "", "", "")


class PlanPage(View):
    """Plan view; what it shows is the state of the desk, which all pages share."""

    NAME = "plan"
    _mapped: object = None
    _moment: Moment | None = None
    _side = "left"

    def build_main(self) -> None:
        """Builds the map, the controls, and the table of missions."""
        with ui.element("div").classes("hl-act"):
            with ui.element("section").classes("hl-card"):
                self.seat.build()
                ui.html(
                    '<p id="why" class="hl-note"></p><p id="answer" class="hl-answer" role="alert"></p>', sanitize=False
                )
            ui.html(self._field_card() + self._options_card() + self._plan_card(), sanitize=False)
        with ui.element("div").classes("hl-map"):
            hint = '<p id="hint"></p>'
            ui.html(self.map_card(("all", "smaller", "larger"), hint), sanitize=False)
        cards = self.rows_card("plan") + self.table_card("missions", COLUMNS)
        ui.html(cards, sanitize=False).classes("hl-info hl-wide")

    def update(self, moment: Moment) -> None:
        """Sends what has changed."""
        self._moment = moment
        desk, texts = self.parts.desk, self.texts
        barred = self.seat.update()
        error = texts("plan.error", error=desk.error) if desk.error else ""
        answer = self.answer or error or moment.drive_error or self.parts.progress_error
        self.send(moment, {
            "draft": desk.drawing.points_m if desk.drawing.kind else None,
            "is_open": desk.drawing.kind in ("lane", "margin"),
            "texts": {
                "why": barred, "answer": answer, "hint": self._hint(), "progress": self._progress(),
                "consent": self._consent(), "line": self._line(),
            },
            "controls": self._controls(barred),
            "rows.plan": [[r.key, r.label, r.value, texts(f"level.{r.level}"), r.level] for r in self._rows()],
            "tables.missions": self._missions(barred),
        }, self._map(moment.state.scene))  # fmt: skip

    def _map(self, scene: Scene) -> dict[str, Any]:
        """What the map shows, if it is another than before: the plan, else the outline, else the present site."""
        desk = self.parts.desk
        source = desk.plan or desk.outline or scene  # a changed outline is another object
        if source is self._mapped:
            return {}
        self._mapped = source
        still = desk.shown_outline or static_map(scene) if desk.plan is None else desk.plan.map
        return {"still": still}

    async def act(self, action: str, values: Mapping[str, Any]) -> None:
        """Changes the desk."""
        desk, value = self.parts.desk, values.get("value")
        value = value[:MAX_VALUE] if isinstance(value, str) else ""
        match action:
            case "draw":
                desk.draw("outline")
            case "drive":
                desk.draw("driven", self._side)
            case "side" if value in SIDES:
                self._side = value
            case "no_go" | "gate" | "lane" | "ab":
                desk.draw(action)
            case "swaths_from":
                desk.draw(action)
            case "margin" | "refill":
                desk.draw_place(action, value)
            case "remove_places":
                desk.remove_places()
            case "a_plus":
                desk.draw_a_plus(value)
            case "guidance":
                desk.choose_line(value)
            case "remove_line":
                desk.remove_line()
            case "remove_areas":
                desk.remove_areas()
            case "corner":
                desk.add_point(_number(values.get("x")), _number(values.get("y")))
            case "undo":
                desk.remove_point()
            case "close":
                await desk.close_drawing(self.parts.drive.scene.site.datum, self.texts("plan.drawn_name"))
            case "feature":
                await desk.choose(value)
            case (
                "machine" | "implement" | "headland_passes" | "headland" | "turns" | "heading_deg" | "vegetation_cm"
                | "swath_skip"
            ):  # fmt: skip
                desk.set_option(action, value, self.session.name)
            case "plan":
                await desk.make_plan()
            case "cancel":
                desk.cancel()
            case "store":
                desk.store_mission(value, self.session.name)
            case "open":
                desk.reopen(value)
            case "delete" if self.is_sure(f"delete {value}"):
                desk.delete(value)
            case "start" if self.is_sure(f"start {value}"):
                self._start(value, None)
            case "continue" if self.is_sure(f"continue {value}"):
                self._start(value, read_progress(desk.store.find(value).folder))

    def _start(self, mission_id: str, progress: Progress | None) -> None:
        """Starts a simulated drive on a stored mission, or where it was interrupted; not while the machine drives."""
        if self.parts.drives is None or self._moment is None:
            raise Refused("no_simulation")
        check_standing(self._moment.state)
        mission = self.parts.desk.store.find(mission_id)
        if mission.about is None:
            raise Refused("damaged")
        self.parts.drives.start(mission, progress)
        self.parts.is_switching = True

    def _hint(self) -> str:
        desk = self.parts.desk
        if desk.drawing.kind:
            return self.texts(f"plan.hint_{desk.drawing.kind}", number=len(desk.drawing.points_m))
        return self.texts("plan.hint_site" if desk.outline is None else "plan.hint_field", name=desk.name)

    def _consent(self) -> str:
        """Who has consented to which height of plants."""
        consent = self.parts.desk.options.consent
        if consent is None:
            return ""
        height = number(100.0 * consent.vegetation_m, 0, "cm")
        return self.texts("plan.consent", height=height, name=consent.by)

    def _line(self) -> str:
        """The guidance line of the rows."""
        options, texts = self.parts.desk.options, self.texts
        if options.guidance is not None:
            return texts("plan.line_of_file", number=options.guidance)
        if options.through_m is None or options.heading_deg is None:
            return ""
        return texts("plan.line_drawn", heading=number(options.heading_deg, 2, "°"))

    def _progress(self) -> str:
        job = self.parts.desk.job
        if job is None:
            return ""
        stage = self.texts(f"stage.{job.stage}") if f"stage.{job.stage}" in self.texts else self.texts("stage.read")
        return self.texts("plan.progress", stage=stage, seconds=number(math.floor(job.elapsed_s), 0, "s"))

    def _controls(self, barred: str) -> dict[str, Any]:
        """State of each control by its id."""
        desk, options = self.parts.desk, self.parts.desk.options
        is_off = bool(barred) or desk.job is not None
        is_too_short = len(desk.drawing.points_m) < desk.drawing.least_points
        heading = "" if options.heading_deg is None else f"{options.heading_deg:g}"
        headings = sorted({f"{h}" for h in HEADINGS} | {heading} - {""}, key=float)
        height = "" if options.consent is None else f"{100.0 * options.consent.vegetation_m:.0f}"
        heights = [["", self.texts("plan.no_consent")], *([f"{h}", f"{h}\u202fcm"] for h in HEIGHTS_CM)]
        lines = [["", self.texts("plan.no_line")], *([line.number, line.name] for line in desk.lines)]
        if options.guidance is not None and not desk.lines:  # of a stored mission, whose file is not read again
            lines.append([options.guidance, options.guidance])
        skips = [["", self.texts("plan.auto")], *([f"{k}", f"{k}"] for k in range(MAX_SKIP + 1))]
        values: dict[str, tuple[str, list[list[str]]]] = {
            "feature": (desk.feature or "", [["", self.texts("plan.choose")], *([k, n] for k, n in desk.features)]),
            "machine": (options.machine, [[n, n] for n in choices()["machine"]]),
            "implement": (options.implement, [[n, n] for n in choices()["implement"]]),
            "headland": (options.headland, [[n, self.texts(f"headland.{n}")] for n in choices()["headland"]]),
            "turns": (options.turns, [[n, self.texts(f"turns.{n}")] for n in choices()["turns"]]),
            "headland_passes": (str(options.headland_passes), [[str(n), str(n)] for n in range(1, MAX_PASSES + 1)]),
            "vegetation_cm": (height, heights),
            "guidance": (options.guidance or "", lines),
            "swath_skip": ("" if options.swath_skip is None else f"{options.swath_skip}", skips),
            "heading_deg": (heading, [["", self.texts("plan.auto")], *([h, f"{h}°"] for h in headings)]),
        }  # fmt: skip
        found: dict[str, Any] = {
            name: {"off": is_off, "value": value, "choices": listed} for name, (value, listed) in values.items()
        }
        found["feature"]["hidden"] = len(desk.features) < 2
        found["guidance"]["hidden"] = len(lines) < 2
        found["heading_deg"]["hidden"] = options.guidance is not None
        found |= {
            "field-file": {"off": is_off}, "draw": {"off": is_off},
            "drive": {"off": is_off},
            "side": {"off": is_off, "value": self._side, "choices": [[n, self.texts(f"edge.{n}")] for n in SIDES]},
            "no_go": {"off": is_off or desk.outline is None}, "gate": {"off": is_off or desk.outline is None},
            "lane": {"off": is_off or desk.outline is None},
            "remove_areas": {"off": is_off, "hidden": not (desk.no_go_m or desk.gate_m or desk.lane_m)},
            "ab": {"off": is_off or desk.outline is None}, "a_plus": {"off": is_off or desk.outline is None},
            "a_plus_deg": {"off": is_off or desk.outline is None},
            "remove_line": {"off": is_off, "hidden": options.through_m is None and options.guidance is None},
            **{name: {"off": is_off or desk.outline is None} for name in PLACED},
            "remove_places": {"off": is_off, "hidden": options == options.without_places()},
            "undo": {"off": is_off, "hidden": desk.drawing.kind in ("", "gate", "a_plus", "swaths_from", "refill")},
            "close": {"off": is_off or is_too_short, "hidden": desk.drawing.kind not in ENDED},
            "plan": {"off": is_off or desk.outline is None},
            "cancel": {"off": bool(barred), "hidden": desk.job is None},
            "mission-name": {"off": is_off or desk.plan is None or desk.stored is not None},
            "store": {"off": is_off or desk.plan is None or desk.stored is not None},
        }  # fmt: skip
        return found

    def _rows(self) -> list[Row]:
        """Length, time and planned share of the plan, and what is not worked; notes of the file before."""
        desk, texts = self.parts.desk, self.texts
        rows = [Row(f"note{k}", texts("plan.note"), note) for k, note in enumerate(desk.notes)]
        plan = desk.plan
        if plan is None:
            return rows
        share, is_enough = plan.planned_share, plan.planned_share >= plan.least_share
        rows += [
            Row("length", texts("plan.length"), number(plan.length_m * 1e-3, 2, "km")),
            Row("time", texts("plan.time"), number(math.ceil(plan.time_s / 60.0), 0, "min")),
            Row("share", texts("plan.share"), f"{share:.1%}", "plain" if is_enough else "warning"),
            Row("area", texts("plan.area"), number(plan.field_m2 * 1e-4, 3, "ha")),
            Row("swaths", texts("plan.swaths"), f"{plan.swaths} · {plan.headland_passes}"),
            Row("gate", texts("plan.gate"), texts(f"plan.gate_{'yes' if plan.has_gate else 'no'}")),
        ]
        for k, (worked_m2, driven_m) in enumerate(plan.refills, 1):
            amounts = f"{number(worked_m2, 0, 'm²')} · {number(driven_m, 0, 'm')}"
            rows.append(Row(f"refill{k}", texts("plan.refill_stop", number=k), amounts))
        if plan.moved_swaths:
            rows.append(Row("moved", texts("plan.moved"), f"{plan.moved_swaths}", "warning"))
        for reason, area_m2 in plan.uncovered:
            key = str(reason).replace(" ", "_")
            rows.append(
                Row(key, texts("plan.uncovered"), f"{number(area_m2, 0, 'm²')}: {texts.named('uncovered', key)}")
            )
        return rows

    def _missions(self, barred: str) -> list[list[Any]]:
        desk, texts = self.parts.desk, self.texts
        rows: list[list[Any]] = []
        interrupted = desk.store.interrupted()
        for mission in desk.store.all():
            about, key = mission.about, mission.id
            is_off = bool(barred) or desk.job is not None
            name = texts("plan.damaged") if about is None else about.name
            is_shown = desk.stored is not None and desk.stored.id == key
            start: Any = ""
            resume: Any = ""
            if self.parts.drives is not None:
                start = self._pressed("start", key, texts("plan.start"), is_off or about is None)
                if key in interrupted:
                    text = texts("plan.continue", share=f"{interrupted[key].share:.0%}")
                    resume = self._pressed("continue", key, text, is_off)
            rows.append([
                {"text": f"▸ {name}" if is_shown else name}, mission.stored_at, "" if about is None else about.author,
                {"text": texts("plan.open"), "action": "open", "value": key, "off": is_off or about is None},
                resume, start, self._pressed("delete", key, texts("plan.delete"), is_off),
            ])  # fmt: skip
        return rows

    def _pressed(self, action: str, key: str, text: str, is_off: bool) -> dict[str, Any]:
        """Button of a table that is pressed twice."""
        asks = self.asks(f"{action} {key}")
        return {
            "text": self.texts("plan.sure") if asks else text,
            "action": action,
            "value": key,
            "off": is_off,
            "sure": asks,
        }

    def _field_card(self) -> str:
        texts = self.texts
        language = texts.language
        upload = (
            f'<label>{escape(texts("plan.file"))}<input id="field-file" type="file" multiple '
            f'data-upload="/plan/field?lang={language}" data-large="{escape(texts("refused.too_large"))}" '
            f'data-failed="{escape(texts("refused.upload_failed"))}"></label>'
        )
        select = self.select("feature", "plan.feature")
        buttons = (
            self.button("draw", "plan.draw") + self.button("undo", "plan.undo") + self.button("close", "plan.close")
        )
        areas = "".join(self.button(*one) for one in AREAS)
        drive = self.button("drive", "plan.drive") + self.select("side", "plan.side")
        note = f'<p class="hl-note">{escape(texts("plan.formats"))}</p>'
        pairs = "".join(f'<div class="hl-pair">{one}</div>' for one in (buttons, drive, areas, *self._places()))
        return self.card("field", f"{upload}{note}{select}{pairs}")

    def _places(self) -> list[str]:
        """Side of the first row, margins and refill place, with amount and reason of the last two."""
        texts, found = self.texts, list[str]()
        for name, amount in AMOUNTS.items():
            values = {f"{name}_amount": amount, f"{name}_reason": texts(f"plan.{name}_reason_value")}
            inputs = ""
            for one, value in values.items():
                field = f'<input id="{one}" maxlength="40" autocomplete="off" value="{escape(value)}">'
                inputs += f"<label>{escape(texts(f'plan.{one}'))}{field}</label>"
            found += [inputs, self.button(name, f"plan.{name}", taken_from=" ".join(values))]
        side = self.button("swaths_from", "plan.swaths_from")
        return [*found, side + self.button("remove_places", "plan.remove_places")]

    def _options_card(self) -> str:
        names = (
            "machine", "implement", "headland_passes", "headland", "turns", "swath_skip", "heading_deg", "guidance"
        )  # fmt: skip
        selects = "".join(self.select(name, f"plan.{name}") for name in names)
        heading = '<input id="a_plus_deg" inputmode="decimal" maxlength="20" autocomplete="off">'
        label = f"<label>{escape(self.texts('plan.a_plus_deg'))}{heading}</label>"
        buttons = (
            self.button("ab", "plan.ab") + self.button("a_plus", "plan.a_plus", taken_from="a_plus_deg")
            + self.button("remove_line", "plan.remove_line")
        )  # fmt: skip
        line = f'<p id="line"></p>{label}<div class="hl-pair">{buttons}</div>'
        note = f'<p class="hl-note">{escape(self.texts("plan.consent_note"))}</p><p id="consent"></p>'
        return self.card("options", selects + line + self.select("vegetation_cm", "plan.vegetation_cm") + note)

    def _plan_card(self) -> str:
        texts = self.texts
        field = '<input id="mission-name" maxlength="80" autocomplete="off">'
        name = f"<label>{escape(texts('plan.mission_name'))}{field}</label>"
        buttons = self.button("plan", "plan.make", " hl-go") + self.button("cancel", "plan.cancel")
        return self.card(
            "make_plan",
            f'<div class="hl-pair">{buttons}</div><p id="progress" class="hl-answer" role="status"></p>{name}'
            + self.button("store", "plan.store", taken_from="mission-name"),
        )


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
