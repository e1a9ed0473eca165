"""Statistics in a browser: a table by day and field, and its download."""

from html import escape
from typing import Any

from nicegui import ui

from hmi.drive_view.row import number
from hmi.parts import Moment
from hmi.statistics.store import Totals
from hmi.view import View

COLUMNS = ("day", "field", "drives", "area", "time", "distance", "stops")


class StatisticsPage(View):
    """Statistics view."""

    NAME = "statistics"

    def build_main(self) -> None:
        """Builds the table."""
        with ui.element("div").classes("hl-all"):
            link = f'<a class="hl-link" id="csv" href="/statistics.csv">{escape(self.texts("statistics.csv"))}</a>'
            note = '<p id="answer" class="hl-answer" role="alert"></p>'
            ui.html(self.table_card("statistics", COLUMNS) + note + link, sanitize=False)

    def update(self, moment: Moment) -> None:
        """Sends what has changed."""
        days = self.parts.days()
        rows = [[one.day, one.field, str(one.drives), *_cells(one.totals)] for one in days]
        if days:
            rows.append([self.texts("statistics.sum"), "", str(sum(one.drives for one in days)), *_cells(_sum(days))])
        self.send(
            moment,
            {"tables.statistics": rows, "texts": {"answer": self.parts.statistics_error or self._not_uploaded()}},
        )

    def _not_uploaded(self) -> str:
        """Why the platform does not get what is to be uploaded."""
        report, uploader = self.parts.report, self.parts.uploader
        error = (report.error if report is not None else "") or (uploader.error if uploader is not None else "")
        return self.texts("statistics.not_uploaded", error=error) if error else ""


def _sum(days: list[Any]) -> Totals:
    totals = [one.totals for one in days]
    return Totals(
        sum(t.area_m2 for t in totals), sum(t.engaged_s for t in totals), sum(t.distance_m for t in totals),
        sum(t.stops for t in totals),
    )  # fmt: skip


def _cells(totals: Totals) -> list[str]:
    whole_min = round(totals.engaged_s / 60.0)
    return [
        number(totals.area_m2 * 1e-4, 3, "ha"), f"{whole_min // 60}:{whole_min % 60:02d} h",
        number(totals.distance_m * 1e-3, 2, "km"), str(totals.stops),
    ]  # fmt: skip
