"""Actual states of the actuators, as the machine reports them on its bus."""

import math

from hmi.drive_view.row import UNKNOWN, Level, Row, number
from hmi.page_state import PageState
from hmi.texts import Texts
from messages.command import MachineState

LOW_SUPPLY_V = 11.0
SYMBOLS = {"hitch": "hitch_up", "pto": "pto_off"}  # of an unknown state
ROWS = (
    ("steering", "steering_stamp_ns"), ("hitch", "implement_stamp_ns"), ("pto", "implement_stamp_ns"),
    ("fold", "implement_stamp_ns"), ("park_brake", "cab_stamp_ns"), ("brake_pedal", "cab_stamp_ns"),
    ("horn", "cab_stamp_ns"), ("beacon", "cab_stamp_ns"), ("seat", "cab_stamp_ns"), ("button", "cab_stamp_ns"),
    ("supply", "cab_stamp_ns"),
)  # fmt: skip


def machine_rows(state: PageState, texts: Texts) -> list[Row]:
    """One row for each actuator and input of the cab; unknown where its group of frames was never received."""
    machine = state.fresh("machine", MachineState)
    if machine is None:
        return [Row(key, texts(f"machine.{key}"), UNKNOWN, "warning", SYMBOLS.get(key, key)) for key, _ in ROWS]
    rows = []
    for key, stamp in ROWS:
        value, level = _value(key, machine, texts) if getattr(machine, stamp) else (UNKNOWN, "warning")
        rows.append(Row(key, texts(f"machine.{key}"), value, level, _symbol(key, machine)))
    return rows


def _symbol(key: str, machine: MachineState) -> str:
    if key == "hitch":
        return "hitch_work" if machine.is_hitch_in_work else "hitch_up"
    if key == "pto":
        return "pto_on" if machine.is_pto_engaged else "pto_off"
    return key


def _value(key: str, machine: MachineState, texts: Texts) -> tuple[str, Level]:
    on_off = {
        "park_brake": machine.is_park_brake_set, "horn": machine.is_horn_on, "beacon": machine.is_beacon_on,
        "seat": machine.is_seat_occupied, "button": machine.is_emergency_button_pressed,
    }  # fmt: skip
    if key in on_off:
        level: Level = "alarm" if key == "button" and on_off[key] else "plain"
        return texts(f"machine_state.{key}_{'on' if on_off[key] else 'off'}"), level
    if key == "steering":
        return texts(f"machine_state.steering_{'ready' if machine.is_steering_ready else 'off'}"), "plain"
    if key == "hitch":
        work = texts(f"machine_state.hitch_{'work' if machine.is_hitch_in_work else 'up'}")
        return f"{number(100.0 * machine.hitch, 0, '%')} · {work}", "plain"
    if key == "pto":
        return number(machine.pto_radps * 30.0 / math.pi, 0, "1/min"), "plain"
    if key == "fold":
        return number(100.0 * machine.fold_position, 0, "%"), "plain"
    if key == "brake_pedal":
        return number(100.0 * machine.brake_pedal, 0, "%"), "plain"
    return number(machine.supply_v, 1, "V"), "plain" if machine.supply_v >= LOW_SUPPLY_V else "warning"
