"""Network families: input preparation, and decoding of the outputs to candidates in input pixels."""

from perception.camera.networks.focal import Nanodet, Picodet
from perception.camera.networks.network import Network, Outputs
from perception.camera.networks.rtdetr import RtDetr, RtDetrLogits
from perception.camera.networks.yolox import Yolox

FAMILIES: tuple[type[Yolox] | type[Nanodet] | type[Picodet] | type[RtDetr] | type[RtDetrLogits], ...] = (
    Yolox,
    Nanodet,
    Picodet,
    RtDetr,
    RtDetrLogits,
)


def recognize(outputs: Outputs, height: int, width: int) -> Network | None:
    """The network family of the outputs of a trial run by name, or None."""
    found = (family.recognize(outputs, height, width) for family in FAMILIES)
    return next((network for network in found if network is not None), None)
