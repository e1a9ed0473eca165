"""Types of command line arguments: what they refuse is one line, before anything is imported."""

import argparse
import ipaddress
import math
import re
from collections.abc import Callable
from pathlib import Path


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of a whole number within bounds."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be a whole number from {low} to {high}")
        return value

    return parse


def seeds(text: str) -> range:
    """Type of a range of seeds, FIRST-LAST."""
    found = re.fullmatch(r"([0-9]{1,9})-([0-9]{1,9})", text)
    first, last = (int(found[1]), int(found[2])) if found else (1, 0)
    if first > last:
        raise argparse.ArgumentTypeError(f"{text}: must be FIRST-LAST with whole numbers, e.g. 10001-10300")
    return range(first, last + 1)


def number(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Type of a finite number within bounds."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be a number from {low:g} to {high:g}{unit}")
        return value

    return parse


def file(text: str) -> Path:
    """Type of an existing file."""
    path = Path(text)
    if not path.is_file():
        why = "is a folder, a file is needed" if path.is_dir() else "no such file"
        raise argparse.ArgumentTypeError(f"{text}: {why}")
    return path


def model(text: str) -> Path:
    """Type of a detector model: a known name whose file is in the cache, or an existing file."""
    from configs.known_models import known_models, model_path
    from messages.errors import HeadlandError

    try:
        return model_path(text) if text in known_models().models else file(text)
    except HeadlandError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def path_name(text: str) -> str:
    """Type of the name of an existing file or folder."""
    if not Path(text).exists():
        raise argparse.ArgumentTypeError(f"{text}: no such file or folder")
    return text


def existing(text: str) -> Path:
    """Type of an existing file or folder."""
    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"{text}: {why_missing(path)}")
    return path


def why_missing(path: Path) -> str:
    """Why there is nothing at a path."""
    return f"the link target {path.readlink()} does not exist" if path.is_symlink() else "does not exist"


def new_file(text: str) -> Path:
    """Type of a file that is written: its folder exists, and no file of its name."""
    path = Path(text)
    if path.exists() and not path.is_char_device():
        raise argparse.ArgumentTypeError(f"{text}: exists and is not overwritten; choose another path or remove it")
    if not path.absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: the folder {path.parent} does not exist")
    return path


def folder(text: str) -> Path:
    """Type of a run folder: new, or an existing folder."""
    path = Path(text)
    if not text or (path.exists() and not path.is_dir()):
        raise argparse.ArgumentTypeError(
            f"{text}: is a file, not a folder" if text else "the name of a folder is empty"
        )
    return path


def names_of(known: tuple[str, ...]) -> Callable[[str], str]:
    """Type of names of a list, with commas between them."""

    def parse(text: str) -> str:
        if unknown := [name for name in text.split(",") if name not in known]:
            raise argparse.ArgumentTypeError(f"{unknown[0]!r}: must be of {', '.join(known)}")
        return text

    return parse


def regex(text: str) -> str:
    """Type of a regular expression."""
    try:
        re.compile(text)
    except (re.error, RecursionError, OverflowError) as error:
        raise argparse.ArgumentTypeError(f"{text}: not a regular expression ({error})") from error
    return text


def user(text: str) -> tuple[str, str]:
    """Type of a user of the page, NAME:ROLE."""
    name, _, role = text.partition(":")
    if not re.fullmatch(r"[\w.-]{1,40}", name) or role not in ("view", "operate", "setup", "service"):
        raise argparse.ArgumentTypeError(
            f"{text}: NAME:ROLE with ROLE view, operate, setup or service, NAME of letters and digits"
        )
    return name, role


def address(text: str) -> str:
    """Type of an IP address of this computer."""
    try:
        found = ipaddress.ip_address(text)
    except ValueError:
        found = None
    if found is None or found.version != 4 or found.is_unspecified or found.is_multicast:
        raise argparse.ArgumentTypeError(f"{text}: not the IPv4 address of one interface, such as 192.168.1.5")
    return str(found)
