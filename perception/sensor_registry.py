"""Registry of the perception nodes by kind of sensor: `make_nodes` in perception/<kind>/nodes.py."""

from collections.abc import Callable
from typing import Any

from configs.sensor_kinds import registry
from configs.vehicle import Implement, Vehicle
from messages.node import Node

# vehicle, implement and configuration of the kind -> obstacle nodes and health nodes of all its sensors
MakeNodes = Callable[[Vehicle, Implement | None, Any], tuple[list[Node], list[Node]]]
NODES: dict[str, MakeNodes] = registry("perception.{}.nodes", "make_nodes")
