"""Who has control: one operator at a time, with hand-over."""

import time
from dataclasses import dataclass

from nicegui import ui

from hmi.access import OPERATORS, Access, Session
from hmi.texts import Texts


@dataclass
class SeatBar:
    """Line with the holder of the seat, and the button to take or free it."""

    access: Access
    session: Session
    token: str
    texts: Texts

    def build(self) -> None:
        """Builds the line; without a button for a role that only views."""
        self._label = ui.label("").classes("hl-note").props('data-hl="seat"')
        self._button: ui.button | None = None
        if self.session.role in OPERATORS:
            self._button = ui.button("", on_click=self._press, color=None).classes("hl-button")
            self._button.props('unelevated no-caps data-hl="seat-button"')

    def update(self) -> str:
        """Shows the holder; returns the reason for which this session gives no orders, "" if it may."""
        why = self.why_not()
        holder = self.access.seated(time.monotonic())
        if holder is None:
            self._label.set_text(self.texts("seat.free"))
        else:
            own = self.texts("seat.own")
            self._label.set_text(own if holder is self.session else self.texts("seat.other", name=holder.name))
        if self._button is not None:
            self._button.set_text(self.texts("seat.release" if holder is self.session else "seat.take"))
            self._button.set_enabled(holder is None or holder is self.session)
        return why

    def why_not(self, is_action: bool = False) -> str:
        """Reason for which this session gives no orders now; an action prolongs the session."""
        now_s = time.monotonic()
        if self.access.session(self.token, now_s) is not self.session or self.session.role not in OPERATORS:
            return self.texts("why.view_only")
        if is_action:
            self.session.used_s = now_s
        holder = self.access.seated(now_s)
        if holder is self.session:
            return ""
        return self.texts("why.not_seated") if holder is None else self.texts("seat.other", name=holder.name)

    def _press(self) -> None:
        now_s = time.monotonic()
        if self.access.session(self.token, now_s) is not self.session:
            return
        self.session.used_s = now_s
        if self.access.holder is self.session:
            self.access.release_seat(self.session)
        else:
            self.access.take_seat(self.session, now_s)
