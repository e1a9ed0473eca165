"""Transition table of the mode machine.

        AUTOMATIC command        START               warned               obstacle
MANUAL ───────────────► STANDBY ───────► START_WARNING ─────► AUTOMATIC ─────────► OBSTACLE_STOP
  ▲                      ▲   ▲                 ▲                  │ done                │ clear for some seconds
  │ hand, MANUAL command   │   │ RESET           └──────────────────┼─────────────────────┘
  └── all but EMERGENCY  │   └─ FAULT_STOP, EMERGENCY_STOP        └─► FINISHED
                         └───────────── mission waits ◄──────── AUTOMATIC
"""

from enum import IntEnum

from messages.command import Mode


class Event(IntEnum):
    """Events by urgency; of several at once the first that has a transition in the mode counts."""

    EMERGENCY = 0
    HAND = 1
    FAULT = 2
    MANUAL = 3
    PAUSE = 4
    RESET = 5
    AUTOMATIC = 6
    DONE = 7
    WAIT = 8
    OBSTACLE = 9
    START = 10
    CLEAR = 11
    WARNED = 12


PERSON = frozenset({Event.MANUAL, Event.PAUSE, Event.RESET, Event.AUTOMATIC, Event.START})
MOVING = frozenset({Mode.AUTOMATIC})
WATCHED = frozenset({Mode.START_WARNING, Mode.AUTOMATIC, Mode.OBSTACLE_STOP})  # engaged: a fault stop is latched

_ENGAGED = {
    Event.EMERGENCY: Mode.EMERGENCY_STOP,
    Event.HAND: Mode.MANUAL,
    Event.FAULT: Mode.FAULT_STOP,
    Event.MANUAL: Mode.MANUAL,
    Event.PAUSE: Mode.STANDBY,
    Event.DONE: Mode.FINISHED,
}
_IDLE = {Event.EMERGENCY: Mode.EMERGENCY_STOP, Event.HAND: Mode.MANUAL, Event.MANUAL: Mode.MANUAL}

TRANSITIONS: dict[Mode, dict[Event, Mode]] = {
    Mode.MANUAL: {Event.EMERGENCY: Mode.EMERGENCY_STOP, Event.AUTOMATIC: Mode.STANDBY},
    Mode.STANDBY: {**_IDLE, Event.START: Mode.START_WARNING},
    Mode.START_WARNING: {**_ENGAGED, Event.OBSTACLE: Mode.OBSTACLE_STOP, Event.WARNED: Mode.AUTOMATIC},
    Mode.AUTOMATIC: {**_ENGAGED, Event.WAIT: Mode.STANDBY, Event.OBSTACLE: Mode.OBSTACLE_STOP},
    Mode.OBSTACLE_STOP: {**_ENGAGED, Event.CLEAR: Mode.START_WARNING},
    Mode.FAULT_STOP: {**_IDLE, Event.RESET: Mode.STANDBY},
    Mode.EMERGENCY_STOP: {Event.RESET: Mode.STANDBY},
    Mode.FINISHED: {**_IDLE, Event.START: Mode.START_WARNING, Event.RESET: Mode.STANDBY},
}


def next_mode(mode: Mode, events: frozenset[Event]) -> Mode:
    """The mode after the most urgent event that has a transition in this mode."""
    row = TRANSITIONS[mode]
    urgent = min((event for event in events if event in row), default=None)
    return mode if urgent is None else row[urgent]
