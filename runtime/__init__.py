"""Executor, bus, assembly and command line: what runs the nodes; imported by nobody."""

import gc

# The usual threshold of 700 objects costs a quarter of the time of all imports, and 3 % of a drive.
gc.set_threshold(20_000, 20, 20)
