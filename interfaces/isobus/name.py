"""64-bit NAME that identifies a control function (ISO 11783-5)."""

from dataclasses import dataclass, fields

AGRICULTURE = 2
TRACTOR_ECU = 134

_BITS = {  # lowest bit and width; bit 48 is reserved and, unlike elsewhere, 0
    "identity": (0, 21),
    "manufacturer": (21, 11),
    "ecu_instance": (32, 3),
    "function_instance": (35, 5),
    "function": (40, 8),
    "device_class": (49, 7),
    "device_class_instance": (56, 4),
    "industry_group": (60, 3),
    "self_configurable": (63, 1),
}


@dataclass(frozen=True)
class Name:
    """A NAME by its fields; of two claims to one address the numerically lower NAME wins."""

    identity: int
    manufacturer: int
    ecu_instance: int
    function_instance: int
    function: int
    device_class: int
    device_class_instance: int
    industry_group: int
    self_configurable: int

    def __post_init__(self) -> None:
        for f in fields(self):
            value, width = getattr(self, f.name), _BITS[f.name][1]
            if not 0 <= value < 1 << width:
                raise ValueError(f"NAME {f.name} = {value}: not within {width} bits")

    def encode(self) -> int:
        """The NAME as a number."""
        return sum(int(getattr(self, name)) << low for name, (low, _) in _BITS.items())

    @classmethod
    def decode(cls, number: int) -> "Name":
        """The fields of a NAME."""
        return cls(**{name: number >> low & (1 << width) - 1 for name, (low, width) in _BITS.items()})
