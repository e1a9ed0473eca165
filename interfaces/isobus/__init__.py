"""ISO 11783 and J1939 messages as bytes: our own codec, one file a message group.

The simulated machine decodes with cantools from `configs/can/headland.dbc` instead, so that a mistake in one shows
against the other.
"""
