"""Base of all configuration classes, and a loader whose errors name file, key and value."""

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from messages.errors import ConfigError

CONFIGS = Path(__file__).parent
C = TypeVar("C", bound="Config")


class Config(BaseModel):
    """Frozen model; unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with changed values; raises ConfigError for a key that the class does not have (pydantic adds it)."""
        unknown = sorted(set(update or ()) - type(self).model_fields.keys())
        if unknown:
            raise ConfigError(f"{type(self).__name__} has no key {unknown[0]!r}")
        return super().model_copy(update=update, deep=deep)


class _UniqueKeyLoader(yaml.CSafeLoader):
    """YAML loader of libyaml that refuses duplicate keys (CSafeLoader keeps the last one)."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise yaml.constructor.ConstructorError(None, None, f"{key!r} is not a valid key", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is duplicate", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> Any:
    """Content of a YAML file; raises ConfigError."""
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _UniqueKeyLoader)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not valid YAML ({error})") from error


def parse(cls: type[C], values: Any, where: str) -> C:
    """Instance of a configuration class; raises ConfigError with location, key and value."""
    try:
        return cls.model_validate(values)
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc'])) or 'file'} = {e['input']!r}: {e['msg']}" for e in error.errors()]
        raise ConfigError(f"{where}: " + "; ".join(lines)) from error


def load(cls: type[C], path: Path) -> C:
    """Configuration from a YAML file; raises ConfigError."""
    return parse(cls, read_yaml(path), str(path))


def find(folder: str, name: str) -> Path:
    """Path of the file `name`, or of `name` in `configs/<folder>/`; raises ConfigError with the known names."""
    for path in (Path(name), CONFIGS / folder / f"{name}.yaml"):
        if path.is_file():
            return path
    known = ", ".join(sorted(p.stem for p in (CONFIGS / folder).glob("*.yaml")))
    raise ConfigError(f"{folder} {name!r}: no such file, and not one of: {known or 'none'}")
