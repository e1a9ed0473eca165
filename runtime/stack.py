"""The stack configuration: one file of `configs/stack/` per folder, one field of `StackConfig` each."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from configs.strict import CONFIGS, Config, parse, read_yaml
from control.controller import ControlConfig
from datasets.log import LogConfig
from datasets.viewer import ViewerConfig
from interfaces.gateway import GatewayConfig
from interfaces.orders.config import OrderKey, OrdersConfig
from localization.config import LocalizationConfig
from messages.errors import ConfigError
from perception.config import PerceptionConfig
from planning.config import PlanningConfig
from safety.supervisor_config import SupervisorConfig
from simulation.world import SimulationConfig


class InterfacesConfig(Config):
    """Section `interfaces`."""

    gateway: GatewayConfig
    orders: OrdersConfig


class DatasetsConfig(Config):
    """Section `datasets`."""

    log: LogConfig
    viewer: ViewerConfig


class ExecutorConfig(Config):
    """Section `executor`: available cores and latency of each node by prefix of its name."""

    cores: int = Field(ge=1, le=64)
    latency_ms: dict[str, Annotated[float, Field(gt=0.0, le=5000.0)]]

    def latency_ns(self, name: str) -> int:
        """Latency of a node by its longest matching prefix, in ns; 0 without a match, which `check_wiring` refuses."""
        known = [key for key in self.latency_ms if name.startswith(key)]
        return round(self.latency_ms[max(known, key=len)] * 1e6) if known else 0


class StackConfig(Config):
    """All of `configs/stack/`."""

    executor: ExecutorConfig
    interfaces: InterfacesConfig
    perception: PerceptionConfig
    datasets: DatasetsConfig
    localization: LocalizationConfig
    planning: PlanningConfig
    control: ControlConfig
    safety: SupervisorConfig
    simulation: SimulationConfig

    @model_validator(mode="after")
    def _authorities_are_known(self) -> "StackConfig":
        known = self.safety.modes.authorities
        for name, key in self.interfaces.orders.keys.items():
            if key.authority not in known:
                raise ValueError(f"interfaces.orders.keys.{name}.authority {key.authority!r}: not one of {known}")
        return self


def load_stack() -> StackConfig:
    """Stack configuration of the repository; raises ConfigError that names file, key and value."""
    sections = {name: read_yaml(CONFIGS / "stack" / f"{name}.yaml") for name in StackConfig.model_fields}
    return parse(StackConfig, sections, str(CONFIGS / "stack"))


def with_detector(stack: StackConfig, model: Path | None) -> StackConfig:
    """Stack with the camera detector from this file, unchanged for None; raises ConfigError for a missing file."""
    if model is None:
        return stack
    if not model.is_file():
        raise ConfigError(f"{model}: no such model file")
    detector = stack.perception.camera.detector.model_copy(update={"model": str(model.resolve())})
    camera = stack.perception.camera.model_copy(update={"detector": detector})
    return stack.model_copy(update={"perception": stack.perception.model_copy(update={"camera": camera})})


def with_order_key(stack: StackConfig, name: str, key: OrderKey) -> StackConfig:
    """Stack that accepts the orders of this key too."""
    orders = stack.interfaces.orders
    orders = orders.model_copy(update={"keys": orders.keys | {name: key}})
    return stack.model_copy(update={"interfaces": stack.interfaces.model_copy(update={"orders": orders})})
