"""ISO 11783 and J1939 messages as bytes, one file per message group.

The simulated machine decodes with cantools from `configs/can/headland.dbc` instead, so that an error in one
implementation shows against the other.
"""
