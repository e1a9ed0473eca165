"""Registry of the sensor models by kind of obstacle sensor: `make_model` in simulation/sensors/<kind>.py."""

from collections.abc import Callable
from typing import Any

from configs.sensor_kinds import registry
from simulation.sensors.sensor import Sensor, SensorContext

# name, sensor of the vehicle, configuration of the kind, context -> model
MakeModel = Callable[[str, Any, Any, SensorContext], Sensor]
MODELS: dict[str, MakeModel] = registry("simulation.sensors.{}", "make_model")
