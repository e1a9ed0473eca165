"""Decoders of serialized ROS messages, by the definition in the recording where it has one."""

from collections.abc import Callable
from functools import cache
from typing import Any

from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from datasets.importers import livox

TRANSFORMS = "tf2_msgs/msg/TFMessage"
ROS1, ROS2 = "ROS1_NOETIC", "ROS2_HUMBLE"
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
# Definitions that ROS distributions do not have and early ROS 2 bags do not contain.
PACKETS = """\
std_msgs/Header header
nebula_msgs/NebulaPacket[] packets
================================================================================
MSG: nebula_msgs/NebulaPacket
builtin_interfaces/Time stamp
uint8[] data
"""
DEFINITIONS = {
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms",
    "nebula_msgs/msg/NebulaPackets": PACKETS,
}


@cache
def ros_types(name: str) -> Any:
    """rosbags type store of a ROS distribution, with `DEFINITIONS` added."""
    store = get_typestore(Stores[name])
    for kind, text in DEFINITIONS.items():
        own = get_types_from_msg(text, kind)
        store.register({k: fields for k, fields in own.items() if k not in store.fielddefs})
    return store


def type_name(name: str) -> str:
    """A ROS type as `package/msg/Type`, also for a name without `msg`."""
    full = name.replace("/", "/msg/") if name.count("/") == 1 else name
    return {"tf/msg/tfMessage": TRANSFORMS}.get(full, full)


@cache
def decoder_of(ros: str, kind: str, definition: str = "") -> Callable[[bytes], Any]:
    """Decoder of the type `kind` in the serialization of `ros`; `definition` is the text in the recording."""
    if kind in livox.TYPES:
        return livox.decode_ros1 if ros == ROS1 else livox.decode_cdr
    store = _store_of(ros, kind, definition)
    decode = store.deserialize_ros1 if ros == ROS1 else store.deserialize_cdr
    return lambda data: decode(data, kind)


def _store_of(ros: str, kind: str, definition: str) -> Any:
    known = ros_types(ros)
    if not definition:
        return known
    store = Typestore()
    try:
        own = get_types_from_msg(definition, kind)
        store.register({time: known.fielddefs[time] for time in TIMES} | own)
        store.get_msgdef(kind)
    except (TypesysError, KeyError):
        return known
    return store
