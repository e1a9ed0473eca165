"""A running `live`, found by its run folder: rings, order port, key, and what it has logged so far."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from datasets.reader import decode
from hmi.feed import is_event
from messages.errors import HeadlandError, LogError
from messages.message import Envelope
from runtime.live.config import ROLES
from runtime.page.log_feed import HISTORY, kept_entries, shown_log


@dataclass(frozen=True)
class RunningDrive:
    """Rings by process, order port, resolved configuration, and authority by public key of a running drive.

    `order_port` is None for a drive of `run`, which takes no orders.
    """

    rings: dict[str, Path]
    order_port: int | None
    config: str
    keys: dict[str, str]

    def authority_of(self, public_key: str, where: Path) -> str:
        """Authority of a key; raises HeadlandError if the machine does not know it."""
        if public_key not in self.keys:
            raise HeadlandError(f"--key {where}: the machine does not know {public_key}; add it to orders.keys")
        return self.keys[public_key]


def running_drive(folder: Path) -> RunningDrive:
    """The drive of a run folder; raises HeadlandError unless it is running."""
    conditions = _conditions(folder)
    rings = Path(str(conditions.get("rings", "")))
    if "rings" not in conditions or not rings.is_dir():
        raise HeadlandError(
            f"--connect {folder}: no drive of `headland live` is running there, nor one of `run --page`"
        )
    text = (folder / "config.yaml").read_text(encoding="utf-8")
    found = {role: rings / role for role in (*ROLES, "simulation") if (rings / role).exists()}
    port = conditions.get("order_port")
    return RunningDrive(found, None if port is None else int(port), text, _keys(text))


def logged(folder: Path) -> Iterable[Envelope]:
    """Events, motion and modes that a running drive has logged so far."""
    path = folder / "log.mcap"
    try:
        entries = list(kept_entries(shown_log(path))) if path.is_file() else []
    except LogError:
        entries = []
    return (decode(entry) for entry in entries if entry.topic in HISTORY or is_event(entry.topic))


def _conditions(folder: Path) -> dict[str, Any]:
    try:
        with (folder / "result.jsonl").open(encoding="utf-8") as file:
            found: Any = json.loads(file.readline())
    except (OSError, ValueError) as error:
        raise HeadlandError(f"--connect {folder}: not the run folder of a drive ({error})") from error
    return found if isinstance(found, dict) else {}


def _keys(text: str) -> dict[str, str]:
    values: Any = yaml.load(text, yaml.CSafeLoader)
    return {key["public_key"]: key["authority"] for key in values["stack"]["interfaces"]["orders"]["keys"].values()}
