"""Operator's page: what is shown is a function of messages, orders of a person are signed for the order gate."""
