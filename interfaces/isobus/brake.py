"""External brake request, XBR (J1939-71, PGN 1024)."""

from interfaces.isobus.values import Scale

GROUP = 0x0400

_ACCELERATION_MPS2 = Scale(1.0 / 2048.0, -15.687, 2)
_ENDURANCE_ALLOWED = 2
_HIGHEST_PRIORITY = 0 << 2
_MAXIMUM_OF_BOTH = 2 << 4
_OFF = 0
_RESERVED = 3 << 6
_FULL_URGENCY = 250  # 100 %


def encode_request(deceleration_mps2: float) -> bytes:
    """Bytes 1–7: brake by `deceleration_mps2` ≥ 0 or no request (0); raises ValueError.

    The stronger of driver and request applies (control mode "maximum of driver and request").
    """
    if not deceleration_mps2 >= 0.0:
        raise ValueError(f"deceleration {deceleration_mps2!r} is not ≥ 0")
    is_braking = deceleration_mps2 > 0.0
    mode = _ENDURANCE_ALLOWED | _HIGHEST_PRIORITY | _MAXIMUM_OF_BOTH if is_braking else _OFF
    urgency = _FULL_URGENCY if is_braking else 0
    return _ACCELERATION_MPS2.encode(-deceleration_mps2) + bytes([_RESERVED | mode, urgency]) + b"\xff" * 3
