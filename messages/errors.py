"""Errors shown to the user, with the value and the remedy."""


class HeadlandError(Exception):
    """Base of all errors that the command line shows as one line without traceback."""


class ConfigError(HeadlandError):
    """Invalid configuration file or value; raised at start."""


class FieldError(HeadlandError):
    """A field, site or mission that cannot be worked, with the position."""


class WiringError(HeadlandError):
    """Nodes that cannot be connected: two writers, a read without writer, too little computing time."""


class LogError(HeadlandError):
    """A log cannot be read or written."""
