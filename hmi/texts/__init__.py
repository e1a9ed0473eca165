"""Texts of the page in English and Chinese; a key has a text in every language."""

from functools import cache
from pathlib import Path

from configs.strict import read_yaml
from hmi.config import LANGUAGES
from messages.errors import ConfigError

FOLDER = Path(__file__).parent


class Texts:
    """Texts of one language by dotted key; an unknown key raises ConfigError."""

    def __init__(self, language: str, texts: dict[str, str]) -> None:
        self.language = language
        self._texts = texts

    def __call__(self, key: str, **values: object) -> str:
        """The text of a key with its `{name}` replaced."""
        if key not in self._texts:
            raise ConfigError(f"hmi/texts/{self.language}.yaml: no text {key!r}")
        return self._texts[key].format(**values)

    def named(self, group: str, name: str) -> str:
        """The text of a name that a configuration chose, such as that of a sensor; the name itself without one."""
        return self._texts.get(f"{group}.{name}", name)

    def __contains__(self, key: str) -> bool:
        return key in self._texts

    @property
    def keys(self) -> frozenset[str]:
        """All keys."""
        return frozenset(self._texts)


@cache
def texts_of(language: str) -> Texts:
    """Texts of a language, of the first one for an unknown; raises ConfigError for a file that cannot be read."""
    known = language if language in LANGUAGES else LANGUAGES[0]
    return Texts(known, _flat("", read_yaml(FOLDER / f"{known}.yaml")))


def _flat(prefix: str, values: dict[str, object]) -> dict[str, str]:
    """Nested mappings as one, with dotted keys."""
    flat: dict[str, str] = {}
    for key, value in values.items():
        flat |= _flat(f"{prefix}{key}.", value) if isinstance(value, dict) else {f"{prefix}{key}": str(value)}
    return flat
