"""`headland shadow --bus`: opens folder and bus, then logs every frame of a machine's CAN bus without sending."""

import argparse

from configs.strict import CONFIGS, load, parse
from runtime.interruption import Interruption
from runtime.live.config import CanConfig, LiveConfig, open_bus
from runtime.run_folder import RunFolder, command_of


def main(arguments: argparse.Namespace) -> int:
    """Logs until interrupted or for the given time; 0 if a frame was received."""
    port = load(LiveConfig, CONFIGS / "live.yaml").can.port
    values = {"interface": arguments.interface, "channel": arguments.bus, "port": port}
    config = parse(CanConfig, values, "--bus and --interface")
    with (
        RunFolder("shadow", arguments.out, command_of(arguments)) as folder,
        Interruption() as interruption,
        open_bus(config) as bus,
    ):
        # only now: these imports take seconds, and a wrong argument is reported at once
        from runtime.live.shadow import log_bus

        return log_bus(arguments, folder, interruption, bus, f"{config.interface}:{config.channel}")
