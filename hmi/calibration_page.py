"""Calibration in a browser: a trial is recorded, evaluated, plotted, and its values become a version of the setup."""

import math
from collections.abc import Mapping
from typing import Any

from nicegui import ui

from calibration.result import CalibrationResult, Estimate
from hmi.access import SETTERS
from hmi.calibration_view.desk import CalibrationDesk
from hmi.drive_view.controls import check_standing
from hmi.drive_view.row import number
from hmi.parts import Moment
from hmi.refusal import Refused
from hmi.setup_view.settings import unit_of
from hmi.view import View

ESTIMATES = ("setting", "present", "value", "error", "unit")
SIGMAS = 2.0  # of the shown error: 95 %
MAX_VALUE = 200  # characters


class CalibrationPage(View):
    """Calibration view; what it shows is the state of the desk, which all pages share."""

    NAME = "calibration"
    _moment: Moment | None = None
    _plotted: CalibrationResult | None = None

    def build_main(self) -> None:
        """Builds choice, instructions, controls, plot and table."""
        with ui.element("div").classes("hl-all"):
            with ui.element("section").classes("hl-card"):
                self.seat.build()
                ui.html(self._controls_html(), sanitize=False)
            plot = (
                '<div id="plot-box" hidden><svg id="plot" class="hl-plot" role="img" viewBox="0 0 620 295"></svg></div>'
            )
            verdict = '<p id="verdict" class="hl-answer" role="status"></p>'
            table = self.table_card("estimates", ESTIMATES)
            ui.html(self.card("plot", verdict + plot) + table, sanitize=False)

    def _controls_html(self) -> str:
        buttons = (
            self.button("trial", "calibration.trial") + self.button("record", "calibration.record")
            + self.button("end", "calibration.end") + self.button("evaluate", "calibration.evaluate", " hl-go")
            + self.button("accept", "calibration.accept")
        )  # fmt: skip
        return (
            '<p id="why" class="hl-note"></p><p id="answer" class="hl-answer" role="alert"></p>'
            f"{self.select('wizard', 'calibration.wizard')}"
            f'<p id="instruction"></p><div class="hl-pair">{buttons}</div>'
            '<p id="recorded" class="hl-answer" role="status"></p>'
        )

    def update(self, moment: Moment) -> None:
        """Sends what has changed."""
        self._moment = moment
        desk, barred = self.parts.calibration, self._why_not()
        sections: dict[str, Any] = {"controls": self._controls(desk, barred)}
        texts = {"why": barred, "answer": self.answer or moment.drive_error, "instruction": "", "recorded": ""}
        if desk is not None:
            texts |= {
                "instruction": self.texts(f"instruction.{desk.name.partition('.')[0]}"),
                "recorded": self._recorded(desk), "verdict": self._verdict(desk),
            }  # fmt: skip
            result = desk.result
            sections["tables.estimates"] = [] if result is None else [self._row(one) for one in result.estimates]
        self.send(moment, sections | {"texts": texts}, self._plot(None if desk is None else desk.result))

    async def act(self, action: str, values: Mapping[str, Any]) -> None:
        """Changes the desk."""
        desk, value = self.parts.calibration, values.get("value")
        value = value[:MAX_VALUE] if isinstance(value, str) else ""
        if desk is None or self._moment is None:
            raise Refused("no_machine")
        if self.session.role not in SETTERS:
            raise Refused("no_role")
        match action:
            case "wizard":
                desk.choose(value)
            case "trial" if self.is_sure("trial"):
                self._start_trial()
            case "record":
                desk.record(self.parts.drive.feed, self.parts.drive.scene)
            case "end":
                desk.end()
            case "evaluate":
                await desk.evaluate()
            case "accept" if self.is_sure("accept") and desk.result is not None:
                name = self.wizard_name(desk.name)
                found = ", ".join(f"{one.value:.4f} ± {SIGMAS * one.sigma:.4f}" for one in desk.result.estimates)
                desk.accept(self.session.name, f"{name}: {found}")

    def _start_trial(self) -> None:
        if self.parts.drives is None or self._moment is None:
            raise Refused("no_simulation")
        check_standing(self._moment.state)
        self.parts.drives.start_trial()
        self.parts.is_switching = True

    def _why_not(self) -> str:
        barred = self.seat.update()
        if self.parts.calibration is None:
            return self.texts("why.replay")
        return barred or ("" if self.session.role in SETTERS else self.texts("refused.no_role"))

    def wizard_name(self, name: str) -> str:
        """Name of a calibration."""
        kind, _, sensor = name.partition(".")
        place = self.texts.named("place", sensor)
        return (
            self.texts("wizard.of", name=self.texts(f"wizard.{kind}"), place=place)
            if place
            else self.texts(f"wizard.{kind}")
        )

    def _recorded(self, desk: CalibrationDesk) -> str:
        if desk.is_busy:
            return self.texts("calibration.busy")
        if desk.recorder is None:
            return self.texts("calibration.nothing")
        state = "running" if desk.is_recording else "ended"
        length, distance = number(desk.recorder.length_s, 0, "s"), number(desk.recorder.distance_m, 0, "m")
        return self.texts(f"calibration.{state}", length=length, distance=distance)

    def _verdict(self, desk: CalibrationDesk) -> str:
        if desk.missing is not None:
            missing = desk.missing
            return self.texts(f"missing.{missing.key}", has=f"{missing.has:.3g}", needs=f"{missing.needs:.3g}")
        if desk.result is None:
            return ""
        ratio = f"{desk.result.ratio:.1f}" if math.isfinite(desk.result.ratio) else "∞"
        return self.texts(
            "calibration.verified" if desk.result.is_verified else "calibration.not_verified", ratio=ratio
        )

    def _row(self, one: Estimate) -> list[Any]:
        sensor, is_mount, axis = one.key.partition(".mount.")
        if is_mount:
            index = int(axis[-1])
            column = (("x", "y", "z") if axis.startswith("xyz") else ("roll", "pitch", "yaw"))[index]
            name = f"{self.sensor_name(sensor)}, {self.texts(f'column.{column}')}"
        else:
            name = self.texts.named("setting", one.key.partition(".")[2].replace(".", "_"))
        error = f"± {SIGMAS * one.sigma:.4f}"
        return [name, f"{one.present:.4f}", {"text": f"{one.value:.4f}", "level": "good"}, error, unit_of(one.key)]

    def _plot(self, result: CalibrationResult | None) -> dict[str, Any]:
        """The plot, if it is another than before."""
        if result is self._plotted:
            return {}
        self._plotted = result
        if result is None:
            return {"plot": None}
        plot, texts = result.plot, self.texts
        x, y = texts(f"axis.{plot.x}"), texts(f"axis.{plot.y}")
        points, line = plot.points.round(5).tolist(), plot.line.round(5).tolist()
        return {"plot": {"x": x, "y": y, "points": points, "line": line, "title": f"{y} / {x}"}}

    def _controls(self, desk: CalibrationDesk | None, barred: str) -> dict[str, Any]:
        texts, off = self.texts, bool(barred)
        if desk is None:
            return {name: {"off": True} for name in ("wizard", "trial", "record", "end", "evaluate", "accept")}
        is_good = desk.result is not None and desk.result.is_verified
        trial, accept = self.asks("trial"), self.asks("accept")
        choices = [[name, self.wizard_name(name)] for name in desk.names]
        return {
            "wizard": {"off": off or desk.is_busy, "value": desk.name, "choices": choices},
            "trial": {
                "off": off or self.parts.drives is None, "sure": trial,
                "text": texts("plan.sure" if trial else "calibration.trial"),
            },
            "record": {"off": off or desk.is_recording},
            "end": {"off": off or not desk.is_recording},
            "evaluate": {"off": off or desk.is_busy or desk.recorder is None},
            "accept": {
                "off": off or not is_good, "sure": accept,
                "text": texts("plan.sure" if accept else "calibration.accept"),
            },
        }  # fmt: skip
