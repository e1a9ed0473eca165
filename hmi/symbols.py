"""Line symbols of orders and states, drawn for Headland in the style of ISO 3767 and GB/T 4269 (docs/hmi.md).

Each is the content of an SVG of 24 x 24 with lines in the colour of the text; the text beside it says the same.
"""

_OCTAGON = '<path d="M8 2.5h8L21.5 8v8L16 21.5H8L2.5 16V8z"/>'
_RING = '<circle cx="12" cy="12" r="9.5"/>'
_ROW = "M17.5 2v3M17.5 8v3M17.5 14v3M17.5 20v2"
_MIRRORED = '<g transform="matrix(-1 0 0 1 24 0)">{}</g>'
_NUDGE = f'<path d="{_ROW}M13.5 12H3M7 8l-4 4 4 4"/>'
SYMBOLS = {
    # orders
    "confirm_clear": (
        '<circle cx="8" cy="4.5" r="2.5"/><path d="M8 7v8M3.5 10.5h9M8 15l-3 7M8 15l3 7M14 17l3 3.5 5-8"/>'
    ),
    "start": '<path d="M6.5 3.5l14 8.5-14 8.5z"/>',
    "resume": '<path d="M3.5 3.5v17M8.5 3.5l13 8.5-13 8.5z"/>',
    "pause": '<path d="M5.5 3.5h4v17h-4zM14.5 3.5h4v17h-4z"/>',
    "forbid": f'{_RING}<path d="M5.3 5.3l13.4 13.4"/>',
    "permit": f'{_RING}<path d="M7 12.5l3.5 3.5 6.5-8"/>',
    "reset": '<path d="M5.5 7.5a8 8 0 1 1-1.3 6M5 2.5v5.5h5.5"/>',
    "manual": (
        '<path d="M7 12V6a1.5 1.5 0 0 1 3 0v5M10 10V4a1.5 1.5 0 0 1 3 0v6M13 10V5a1.5 1.5 0 0 1 3 0v6M16 10.5V8'
        'a1.5 1.5 0 0 1 3 0v7a7 7 0 0 1-7 7 7 7 0 0 1-5.5-3L3 13.8a1.6 1.6 0 0 1 2.6-1.8L7 13.5"/>'
    ),
    "automatic": (
        '<path d="M3.5 9a9 9 0 0 1 16-2.5M20.5 15a9 9 0 0 1-16 2.5M20 2v5h-5M4 22v-5h5'
        'M8.5 16L12 7.5l3.5 8.5M9.8 13h4.4"/>'
    ),
    "nudge_left": _NUDGE,
    "nudge_right": _MIRRORED.format(_NUDGE),
    # modes besides manual and automatic
    "no_data": '<path d="M2.5 9.5a13.5 13.5 0 0 1 19 0M6.5 14a8 8 0 0 1 11 0M12 19v.1M4 2.5l16 19"/>',
    "standby": f'{_RING}<path d="M9.5 8v8M14.5 8v8"/>',
    "start_warning": '<path d="M12 2.5L22.5 21h-21zM12 9v6M12 18v.1"/>',
    "obstacle_stop": f'{_OCTAGON}<path d="M7 12h10"/>',
    "fault_stop": f'{_OCTAGON}<path d="M12 6.5v7M12 17v.1"/>',
    "emergency_stop": f'{_OCTAGON}<circle cx="12" cy="12" r="4.5"/>',
    "finished": '<path d="M5 22V2.5M5 3.5h14l-3.5 4.5 3.5 4.5H5"/>',
    # actual states
    "steering": f'{_RING}<circle cx="12" cy="12" r="2.5"/><path d="M3 10l6.6 1.3M21 10l-6.6 1.3M12 14.5v7"/>',
    "hitch_up": '<path d="M2 20.5h7.5l8.5-6M18 8v12M7 15V3M3.5 6.5L7 3l3.5 3.5"/>',
    "hitch_work": '<path d="M2 12.5h7.5l8.5 4M18 10v10M12.5 22h10M7 2v8M3.5 6L7 9.5 10.5 6"/>',
    "pto_on": (
        '<circle cx="12" cy="12" r="4"/><path d="M12 8v8M8 12h8M2.5 12.5a9.5 9.5 0 0 1 16-7.2'
        'M21.5 11.5a9.5 9.5 0 0 1-16 7.2M19 1.5v4.3h-4.3M5 22.5v-4.3h4.3"/>'
    ),
    "pto_off": '<circle cx="12" cy="12" r="4"/><path d="M12 8v8M8 12h8"/>',
    "fold": '<path d="M8 19h8M8 19L3.5 8M16 19l4.5-11M1.5 11.5l2-3.5 3.5 2M22.5 11.5l-2-3.5-3.5 2"/>',
    "park_brake": (
        '<circle cx="12" cy="12" r="6.5"/><path d="M10.3 16V8h2.6a2.2 2.2 0 0 1 0 4.5h-2.6M4.5 4.5a10.5 10.5 0 0 0 0 15'
        'M19.5 4.5a10.5 10.5 0 0 1 0 15"/>'
    ),
    "brake_pedal": '<path d="M4 2.5l7.5 11M7 15.5l8-5.5 2.5 3.5-8 5.5zM3 22h18"/>',
    "horn": '<path d="M2.5 9.5v5h4l10 5v-15l-10 5zM20.5 8v8"/>',
    "beacon": '<path d="M4 21h16M7.5 21v-7a4.5 4.5 0 0 1 9 0v7M12 2.5v3.5M3.5 6.5l3 2.5M20.5 6.5l-3 2.5"/>',
    "seat": '<path d="M6.5 2.5L9 14h9.5M9 14l-2.5 3.5h12M12.5 17.5V21M8 21.5h9"/>',
    "button": '<path d="M5.5 10.5a6.5 5.5 0 0 1 13 0zM9.5 10.5V15M14.5 10.5V15M3.5 15h17v6.5h-17z"/>',
    "supply": '<path d="M2.5 7.5h19v12h-19zM5.5 7.5v-3h3v3M15.5 7.5v-3h3v3M5.5 13.5h4M14.5 13.5h4M16.5 11.5v4"/>',
    "gnss": (
        '<path d="M9 12l4-4 4 4-4 4zM11 10L6.5 5.5l3.5-3 3 5.5M15 14l4.5 4.5 3-3.5-5.5-3'
        'M2.5 13.5a8 8 0 0 0 8 8M2.5 17.5a4 4 0 0 0 4 4"/>'
    ),
}


def sprite() -> str:
    """All symbols, for a page that uses them; nothing is seen of it."""
    symbols = "".join(
        f'<symbol id="symbol-{name}" viewBox="0 0 24 24">{content}</symbol>' for name, content in SYMBOLS.items()
    )
    return f'<svg width="0" height="0" class="hl-sprite" aria-hidden="true">{symbols}</svg>'


def symbol(name: str) -> str:
    """A symbol of a page with the sprite."""
    return f'<svg class="hl-symbol" aria-hidden="true"><use href="#symbol-{name}"></use></svg>'
