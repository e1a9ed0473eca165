"""`headland shadow --bus`: opens folder and bus, then logs every frame of a machine's CAN bus without sending."""

import argparse

from runtime.interruption import Interruption
from runtime.live.can_bus import named_bus, open_bus
from runtime.run_folder import RunFolder, command_of


def main(arguments: argparse.Namespace) -> int:
    """Logs until interrupted or for the given time; 0 if a frame was received."""
    name = named_bus(arguments.bus)
    with (
        RunFolder("shadow", arguments.out, command_of(arguments)) as folder,
        Interruption() as interruption,
        open_bus(name) as bus,
    ):
        # only now: these imports take seconds, and a wrong argument is reported at once
        from runtime.live.shadow import log_bus

        return log_bus(arguments, folder, interruption, bus, name)
