"""Registry of the kinds of obstacle sensors: validation/sensors/<kind>.py."""

from collections.abc import Callable
from typing import Any

from configs.sensor_kinds import registry
from validation.obstacle_stop.boxes import Box

# sensor of the vehicle -> half field of view (rad), range (m)
FIELDS_OF_VIEW: dict[str, Callable[[Any], tuple[float, float]]] = registry("validation.sensors.{}", "field_of_view")
# measurement, box of an object in base, sensor -> measurement without the object
REMOVALS: dict[str, Callable[[Any, Box, Any], Any]] = registry("validation.sensors.{}", "remove_object")
