"""The base of every configuration class, and the loader that names file, key and value when something is wrong."""

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from messages.errors import ConfigError

CONFIGS = Path(__file__).parent
C = TypeVar("C", bound="Config")


class Config(BaseModel):
    """Frozen; unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with changed values; raises ConfigError for a key that the class does not have (pydantic adds it)."""
        unknown = sorted(set(update or ()) - type(self).model_fields.keys())
        if unknown:
            raise ConfigError(f"{type(self).__name__} has no key {unknown[0]!r}")
        return super().model_copy(update=update, deep=deep)


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML that refuses a key written twice, where the plain loader would keep the last one in silence."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise yaml.constructor.ConstructorError(None, None, f"{key!r} is no key", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} stands twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; raises ConfigError."""
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _UniqueKeyLoader)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not valid YAML ({error})") from error


def parse(cls: type[C], values: Any, where: str) -> C:
    """An instance of a configuration class; raises ConfigError that names place, key and value."""
    try:
        return cls.model_validate(values)
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc'])) or 'file'} = {e['input']!r}: {e['msg']}" for e in error.errors()]
        raise ConfigError(f"{where}: " + "; ".join(lines)) from error


def load(cls: type[C], path: Path) -> C:
    """A configuration from a YAML file; raises ConfigError."""
    return parse(cls, read_yaml(path), str(path))


def find(folder: str, name: str) -> Path:
    """`name` as a file of its own or as a name in `configs/<folder>/`; raises ConfigError that lists what there is."""
    for path in (Path(name), CONFIGS / folder / f"{name}.yaml"):
        if path.is_file():
            return path
    known = ", ".join(sorted(p.stem for p in (CONFIGS / folder).glob("*.yaml")))
    raise ConfigError(f"{folder} {name!r}: no such file, and not one of: {known or 'none'}")
