"""Known networks of the camera detector: where they come from, and their file in the user's cache."""

import os
from hashlib import file_digest
from pathlib import Path

from pydantic import Field

from configs.strict import CONFIGS, Config, load
from messages.errors import ConfigError


class KnownModel(Config):
    """One file: where it is, its hash and size."""

    url: str = Field(pattern="^https?://")
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    size_bytes: int = Field(gt=0, le=1_000_000_000)
    licence: str


class KnownModels(Config):
    """`configs/models.yaml`: known models by name, and limits of a download."""

    timeout_s: float = Field(gt=0.0, le=600.0)
    max_duration_s: float = Field(gt=0.0, le=86_400.0)
    models: dict[str, KnownModel]

    def model(self, name: str) -> KnownModel:
        """The model of a name; raises ConfigError with the known names."""
        if name not in self.models:
            raise ConfigError(f"model {name!r}: not one of {', '.join(self.models)}")
        return self.models[name]


def known_models() -> KnownModels:
    """Content of `configs/models.yaml`; raises ConfigError."""
    return load(KnownModels, CONFIGS / "models.yaml")


def cached_file(name: str) -> Path:
    """Path of a known model in the cache (`XDG_CACHE_HOME`, else `~/.cache`), whether it exists or not."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # a relative path is to be ignored (XDG Base Directory Specification)
        cache = Path(given) if given.startswith("/") else Path.home() / ".cache"
    except RuntimeError as error:
        raise ConfigError("there is no home folder for the cache of models; set XDG_CACHE_HOME") from error
    return cache / "headland" / "models" / f"{name}.onnx"


def model_path(model: str) -> Path:
    """File of a configured model: a known name in the cache, or a path from the repository root.

    Raises ConfigError for a known model that was not downloaded or is damaged; a path may not exist.
    """
    known = known_models().models.get(model)
    if known is None:
        return CONFIGS.parent / model
    path = cached_file(model)
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; download it with ./headland model {model}")
    if not is_intact(path, known):
        raise ConfigError(f"{path}: not the known file (its SHA-256 is another); remove it and download it again")
    return path


def is_intact(path: Path, model: KnownModel) -> bool:
    """Whether the file has the known hash."""
    try:
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest() == model.sha256
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
