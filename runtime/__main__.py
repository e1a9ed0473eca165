"""Command line: parses the arguments, then imports the module of the command."""

import importlib
import sys

from messages.errors import HeadlandError
from runtime.commands.options import make_parser

EXIT_ERROR, EXIT_INTERRUPTED = 2, 130


def main() -> int:
    """Runs the command; a HeadlandError is one line on standard error and exit code 2."""
    arguments = make_parser().parse_args()
    try:
        return int(importlib.import_module(arguments.module).main(arguments))
    except HeadlandError as error:
        sys.stderr.write(f"headland: {error}\n")
        return EXIT_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("headland: interrupted\n")
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
