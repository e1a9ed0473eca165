"""Symbols: one for each order, mode and actual state; well-formed, without colours of their own."""

from xml.etree import ElementTree

import pytest

from hmi.drive_view.controls import CONTROLS
from hmi.drive_view.machine import ROWS, machine_rows
from hmi.drive_view.motion import motion_rows
from hmi.drive_view.position import position_rows
from hmi.drive_view.standing import standing
from hmi.symbols import SYMBOLS, sprite, symbol
from hmi.texts import texts_of
from messages.command import Mode
from tests.hmi.drive_messages import machine, state_of, supervisor

EN = texts_of("en")
SHAPES = {"g", "path", "circle"}


@pytest.mark.parametrize("name", SYMBOLS)
def test_a_symbol_is_lines_in_the_colour_of_the_text(name: str) -> None:
    root = ElementTree.fromstring(f"<svg>{SYMBOLS[name]}</svg>")
    shapes = list(root.iter())[1:]
    assert {shape.tag for shape in shapes} <= SHAPES
    assert not any({"fill", "stroke", "style"} & set(shape.keys()) for shape in shapes)
    assert len(set(SYMBOLS.values())) == len(SYMBOLS)


def test_symbols_are_hidden_from_screen_readers() -> None:
    for text in (sprite(), symbol("start")):
        assert ElementTree.fromstring(text).get("aria-hidden") == "true"
    assert 'id="symbol-start"' in sprite()
    assert 'href="#symbol-start"' in symbol("start")


def test_each_order_and_mode_has_a_symbol() -> None:
    assert set(CONTROLS) <= SYMBOLS.keys()
    for mode in Mode:
        assert standing(state_of(("supervisor", supervisor(mode))), EN, str).symbol == str(mode)
        assert str(mode) in SYMBOLS
    assert standing(state_of(), EN, str).symbol in SYMBOLS


def test_actual_states_have_the_symbol_of_their_value() -> None:
    def shown(**values: object) -> dict[str, str]:
        return {row.key: row.symbol for row in machine_rows(state_of(("machine", machine(**values))), EN)}

    raised, working = shown(), shown(is_hitch_in_work=True, is_pto_engaged=True)
    assert (raised["hitch"], raised["pto"]) == ("hitch_up", "pto_off")
    assert (working["hitch"], working["pto"]) == ("hitch_work", "pto_on")
    unknown = {row.key: row.symbol for row in machine_rows(state_of(), EN)}
    for rows in (raised, working, unknown):
        assert rows.keys() == dict(ROWS).keys()
        assert set(rows.values()) <= SYMBOLS.keys()
    others = [*motion_rows(state_of(), EN), *position_rows(state_of(), EN)]
    assert {row.symbol for row in others} <= {"", *SYMBOLS}
