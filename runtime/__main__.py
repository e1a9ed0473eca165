"""Command line: parses the arguments, then imports the module of the command."""

import importlib
import os
import signal
import sys
from types import FrameType

from messages.errors import HeadlandError
from runtime.commands.options import parse_arguments

EXIT_ERROR, EXIT_INTERRUPTED, EXIT_TERMINATED = 2, 130, 143


class _Terminated(KeyboardInterrupt):
    """SIGTERM: as SIGINT, with another exit code."""


def main() -> int:
    """Runs the command; wrong input and what the computer refuses are one line on standard error and exit code 2."""
    signal.signal(signal.SIGTERM, _terminate)
    if (parent := os.environ.pop("HEADLAND_PARENT", "")).isdecimal():
        from runtime.processes import end_with_parent

        end_with_parent(int(parent))
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        arguments = parse_arguments()
        code = int(importlib.import_module(arguments.module).main(arguments))
        sys.stdout.flush()
        return code
    except HeadlandError as error:
        return _ended(str(error), EXIT_ERROR)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _ended(f"{where}{error.strerror or error}", EXIT_ERROR)
    except _Terminated:
        return _ended("terminated", EXIT_TERMINATED)
    except KeyboardInterrupt:
        return _ended("interrupted", EXIT_INTERRUPTED)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise _Terminated


def _ended(text: str, code: int) -> int:
    """Prints why the command ended; standard output may be closed or full, and is not written again at exit."""
    sys.stderr.write(f"headland: {text}\n")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return code


if __name__ == "__main__":
    sys.exit(main())
