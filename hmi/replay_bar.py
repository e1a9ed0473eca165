"""Controls of a log that is played: pause, position, rate, next stop. All open pages show the same position."""

from dataclasses import dataclass

from nicegui import ui
from nicegui.events import GenericEventArguments

from hmi.feed import Playback
from hmi.texts import Texts

RATES = (1.0, 2.0, 5.0, 10.0, 20.0)


@dataclass
class ReplayBar:
    """Line with the controls of a playback."""

    playback: Playback
    texts: Texts

    def build(self) -> None:
        """Builds the line."""
        texts, playback = self.texts, self.playback
        self._rates: dict[float, ui.button] = {}
        with ui.element("section").classes("hl-card hl-replay"):
            self._pause = self._button("replay-pause", texts("replay.pause"), self._toggle)
            ui.html('<b id="replay-time"></b>', sanitize=False)
            self._slider = ui.slider(min=0.0, max=playback.length_s, step=0.5, value=0.0)
            self._slider.props(f'data-hl="replay-position" aria-label="{texts("replay.position")}"')
            self._slider.on("change", self._seek)
            self._next = self._button("replay-next", texts("replay.next_stop"), self._jump)
            for rate in RATES:
                name = texts("replay.rate", rate=f"{rate:g}")
                self._rates[rate] = self._button(
                    f"replay-rate-{rate:g}", f"{rate:g} ×", lambda r=rate: playback.set_rate(r)
                )
                self._rates[rate].props(f'aria-label="{name}"')

    def update(self) -> None:
        """Shows the position, whether it is paused, and the rate."""
        playback = self.playback
        if abs(self._slider.value - playback.position_s) >= 0.5:
            self._slider.set_value(round(playback.position_s, 1))
        self._pause.set_text(self.texts("replay.play" if playback.is_paused else "replay.pause"))
        for rate, button in self._rates.items():
            is_on = rate == playback.rate
            button.classes(add="hl-rate-on") if is_on else button.classes(remove="hl-rate-on")

    def _button(self, name: str, text: str, action: object) -> ui.button:
        button = ui.button(text, on_click=action, color=None)  # type: ignore[arg-type]
        return button.props(f'unelevated no-caps data-hl="{name}"').classes("hl-button")

    def _toggle(self) -> None:
        self.playback.is_paused = not self.playback.is_paused

    def _seek(self, event: GenericEventArguments) -> None:
        if isinstance(event.args, int | float):
            self.playback.seek(float(event.args))

    def _jump(self) -> None:
        if not self.playback.seek_next_stop():
            self._next.set_text(self.texts("replay.no_stop"))
